"""``fame run``: what it prints, writes and returns."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from bpmn_text import document, process, properties
from collaborations import text_of

import fame
from fame.bpmn import read_text
from fame.cli import main
from fame.cli.output import progress_line, progress_text, table
from fame.robot import Event
from fame.scenario import Progress
from fame.scenario.result import Result

ROOT = Path(__file__).parent.parent
EXAMPLE = str(ROOT / "examples" / "ground_vehicles.yaml")
WAITS = process(
    """<startEvent id="s"/><scriptTask id="t" name="Wait"><script>log("waiting")
await sleep(3600)</script></scriptTask><sequenceFlow id="f" sourceRef="s" targetRef="t"/>""",
    attributes='name="REX"',
)
ENDS = WAITS.replace("3600", "2")


@pytest.fixture
def waits(tmp_path: Path) -> str:
    """A model that waits for an hour."""
    path = tmp_path / "waits.bpmn"
    path.write_text(WAITS)
    return str(path)


@pytest.fixture
def ends(tmp_path: Path) -> str:
    """A model that is over after two seconds."""
    path = tmp_path / "ends.bpmn"
    path.write_text(ENDS)
    return str(path)


@pytest.mark.long
def test_the_mission_as_json_with_all_that_can_be_written(tmp_path: Path, capsys) -> None:
    files = [tmp_path / "out" / name for name in ("run.jsonl", "run.csv", "run.xes", "run.png", "run.gif")]
    logs = [text for file in files[:3] for text in ("--log", str(file))]
    assert main(["run", EXAMPLE, "--json", *logs, "--picture", str(files[3]), "--animate", str(files[4])]) == 0
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert (told["status"], err) == ("completed", "")
    assert told["world"]["robots"]["DINGO"]["distances"]["target"] < 0.3
    assert told["world"]["robots"]["DINGO"]["led"] == "red"
    assert files[3].read_bytes().startswith(b"\x89PNG")
    assert files[4].read_bytes().startswith(b"GIF89a")
    assert all(file.stat().st_size > 10_000 for file in files)


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path: Path) -> None:
    def log(name: str, seed: str) -> list[bytes]:
        files = [tmp_path / f"{name}.{ending}" for ending in ("jsonl", "csv", "xes")]
        logs = [text for file in files for text in ("--log", str(file))]
        assert main(["run", EXAMPLE, "--quiet", "--seed", seed, "--duration", "30", *logs]) == 1  # it is not over
        return [file.read_bytes() for file in files]

    first = log("a", "7")
    assert log("b", "7") == first
    assert all(one != other for one, other in zip(log("c", "8"), first, strict=True))


def test_the_summary_has_a_row_per_robot_and_the_times(tmp_path: Path, capsys) -> None:
    (tmp_path / "two.bpmn").write_text(text_of({"REX": ["work", "throw go"], "DINGO": ["catch go"]}))
    assert main(["run", str(tmp_path / "two.bpmn")]) == 0
    head, *robots, blank, last = capsys.readouterr().out.splitlines()
    assert head.split() == ["robot", "instances", "elements", "status"]
    rows = [row.split() for row in robots]
    assert [row[:2] + row[3:] for row in rows] == [["REX", "1", "completed"], ["DINGO", "1", "completed"]]
    assert blank == ""
    assert last.startswith("completed: ")
    assert " s simulated in " in last


def test_a_model_runs_without_a_world(ends: str, capsys) -> None:
    assert main(["run", ends]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[-1].startswith("completed: 2.0 s simulated in ")
    assert "0.0 s   REX: waiting" in err


def test_quiet_prints_nothing_if_all_goes_well(ends: str, capsys) -> None:
    assert main(["run", ends, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_quiet_still_says_what_went_wrong(waits: str, capsys) -> None:
    assert main(["run", waits, "--quiet", "--duration", "5"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert all(line.startswith("fame: ") for line in err.splitlines())
    assert 'REX waits at "Wait" (t)' in err


def test_the_duration_ends_the_run_and_it_says_who_waits(waits: str, capsys) -> None:
    assert main(["run", waits, "--duration", "7.5"]) == 1
    out, err = capsys.readouterr()
    assert "running" in out
    assert "timeout: 7.5 s simulated" in out
    assert 'REX waits at "Wait" (t) for sleep' in err


def test_the_log_is_whole_when_the_mission_fails(tmp_path: Path, capsys) -> None:
    model, log = tmp_path / "fails.bpmn", tmp_path / "run.jsonl"
    model.write_text(ENDS.replace("await sleep(2)", "raise BpmnError('blocked')"))
    assert main(["run", str(model), "--log", str(log)]) == 1
    *_, end, why, last = map(json.loads, log.read_text().splitlines())
    assert (last["what"], last["detail"]) == ("ended", "complete")
    assert (end["what"], end["detail"]) == ("end", "failed")
    assert (why["what"], why["element"], why["detail"]) == ("report", "t", "error blocked was not caught")
    assert "blocked" in capsys.readouterr().err


def test_strict_makes_an_undefined_name_in_a_payload_an_error(tmp_path: Path, capsys) -> None:
    model = tmp_path / "strict.bpmn"
    model.write_text(
        process(
            """<startEvent id="s"/><endEvent id="e"><extensionElements><camunda:properties>
            <camunda:property name="type" value="std_msgs/msg/Bool"/>
            <camunda:property name="payload" value="${nobody_set_it}"/></camunda:properties></extensionElements>
            <signalEventDefinition signalRef="S"/></endEvent><sequenceFlow id="f" sourceRef="s" targetRef="e"/>""",
            root='<signal id="S" name="done"/>',
        )
    )
    assert main(["run", str(model)]) == 0
    assert "nobody_set_it" in capsys.readouterr().err
    assert main(["run", str(model), "--strict"]) == 2
    assert "nobody_set_it" in capsys.readouterr().err


def test_a_library_folder_holds_called_processes(tmp_path: Path, ends: str) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "Linger.bpmn").write_text(Path(ends).read_text().replace('id="P"', 'id="Linger"'))
    caller = tmp_path / "caller.bpmn"
    caller.write_text(
        process(
            '<startEvent id="s"/><callActivity id="c" calledElement="Linger"/>'
            '<sequenceFlow id="f" sourceRef="s" targetRef="c"/>'
        )
    )
    assert main(["run", str(caller), "--quiet"]) == 2
    assert main(["run", str(caller), "--quiet", "--library", str(tmp_path / "mine")]) == 0


# ---- the terminal ----------------------------------------------------------------------------------------------------


def test_a_table_aligns_words_to_the_left_and_numbers_to_the_right() -> None:
    assert table(("robot", "n"), [("REX", 5), ("DINGO_2", 10)]).splitlines() == [
        "robot     n",
        "REX       5",
        "DINGO_2  10",
    ]


def test_the_progress_says_what_each_robot_is_at() -> None:
    text = progress_text(Progress(12.34, 60.0, {"REX": "Explore: Look", "DINGO": ""}))
    assert text == "   12.3 s   REX: Explore: Look"


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_while_a_film_is_drawn_its_frames_are_counted() -> None:
    stream = Terminal()
    with progress_line(stream) as line:
        assert line is not None
        line.count_frames(3, 150)
        line.count_frames(150, 150)
    assert "drawing the film: frame 3 of 150\r" in stream.getvalue()
    assert "drawing the film: frame 150 of 150, writing it" in stream.getvalue()


def test_a_line_that_stands_for_long_says_for_how_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.cli.output._TICK", 0.001)
    stream = Terminal()
    with progress_line(stream) as line:
        assert line is not None
        line.write("drawing")
        line._since -= 60
        while "at:" not in stream.getvalue():
            time.sleep(0.001)
    assert "for 60 s at:   drawing" in stream.getvalue()
    assert stream.getvalue().endswith("\x1b[2K")


def test_long_work_says_how_much_time_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, *(second for share in (0, 1, 10, 50, 90, 100) for second in [36.0 * share])])
    stream = Terminal()
    with progress_line(stream) as line:
        assert line is not None
        line.close()
        monkeypatch.setattr("fame.cli.output.time.monotonic", lambda: next(clock))
        next(clock)
        for share in (0, 1, 10, 50, 90, 100):
            line.write(f"{share} runs", share / 100)
    shown = re.findall(r"\d+ runs[^\r]*", stream.getvalue())
    left = ["", ", about 59 min left", ", about 54 min left", ", about 30 min left", ", about 6 min left", ""]
    assert shown == [f"{share} runs{text}" for share, text in zip((0, 1, 10, 50, 90, 100), left, strict=True)]


def test_without_a_terminal_the_progress_is_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.cli.output.EVERY", 0.001)
    stream = io.StringIO()
    with progress_line(stream) as line:
        assert line is not None
        while not stream.getvalue():
            line.write("3 of 100 runs")
            time.sleep(0.001)
    assert {*stream.getvalue().splitlines()} <= {"3 of 100 runs", "for 0 s at:   3 of 100 runs"}
    assert "\r" not in stream.getvalue()


def test_reports_that_differ_in_numbers_only_are_told_once_with_their_count() -> None:
    def event(second: int, text: str, what: str = "report") -> Event:
        return Event(second * 1_000_000_000, "REX_2", 0, 0, "", what, text)

    reports = (event(1, "lost 4 messages"), event(2, "picked 1", "log"), event(3, "picked 2", "log"))
    result = Result(
        status="completed",
        seed=0,
        robots=(),
        simulated=9.0,
        wall=1.0,
        ending="",
        world=None,
        reports=(*reports, event(9, "lost 25 messages")),
    )
    told = [(one.time // 1_000_000_000, one.detail, count) for one, count in result.told]
    assert told == [(1, "lost 25 messages", 2), (2, "picked 1", 1), (3, "picked 2", 1)]


@pytest.mark.processes
def test_on_a_terminal_the_progress_is_one_line_and_control_c_ends_the_run(waits: str) -> None:
    """The real command on a real pseudo-terminal: it shows where it is, and stops in order when it is interrupted."""
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "fame", "run", waits, "--real-time"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=theirs, text=True) as run:
        os.close(theirs)
        shown = b""
        while b"REX: Wait" not in shown:
            shown += os.read(ours, 4096)
        run.send_signal(signal.SIGINT)
        out = run.stdout.read()  # type: ignore[union-attr]
        with suppress(OSError):  # that is how a terminal tells that the other end is closed
            while more := os.read(ours, 4096):
                shown += more
    os.close(ours)
    assert run.returncode == 130
    assert "interrupted: " in out
    before = shown[: shown.index(b"\r\nstopping after this step")]
    assert b"\n" not in before  # it overwrites its line
    assert b"Traceback" not in shown


def test_types_of_ones_own_are_given_as_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "types" / "orchard_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Apple.msg").write_text("float64 weight\nbool ripe\n")
    said = properties(type="orchard_msgs/msg/Apple", payload="{weight: 0.2, ripe: true}")
    event = f'<intermediateThrowEvent id="t">{said}<signalEventDefinition signalRef="S"/></intermediateThrowEvent>'
    flow = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
    (tmp_path / "pick.bpmn").write_text(process(flow + event, root='<signal id="S" name="picked"/>'))
    words = ["run", str(tmp_path / "pick.bpmn"), "--quiet"]
    assert main(words) == 2
    assert "orchard_msgs/msg/Apple" in capsys.readouterr().err
    assert main([*words, "--types", str(tmp_path / "types")]) == 0
    assert main([*words, "--types", str(tmp_path / "empty")]) == 2
    assert "there is no .msg, .srv or .action file" in capsys.readouterr().err


def test_an_uncaught_error_of_a_called_process_says_where_it_was_called(tmp_path: Path, capsys) -> None:
    begin = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="c"/>'
    mission = tmp_path / "bad.bpmn"
    mission.write_text(process(f'{begin}\n<callActivity id="c" calledElement="GoTo"/>'))
    assert main(["run", str(mission)]) == 1
    line = next(number for number, text in enumerate(mission.read_text().splitlines(), 1) if "<callActivity" in text)
    assert capsys.readouterr().err.endswith(f"name 'x_goal' is not defined; called at c ({mission}:{line})\n")


def test_an_uncaught_error_is_a_line_of_its_time_and_a_model_alone_is_told_that_it_has_no_world(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """GoTo gets no plan where no robot is."""
    goal = '<scriptTask id="g"><script>x_goal, y_goal = 5.0, 5.0</script></scriptTask>'
    flows = "".join(f'<sequenceFlow id="{a}-{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ("sg", "gc"))
    mission = tmp_path / "alone.bpmn"
    mission.write_text(process(f'<startEvent id="s"/>{goal}<callActivity id="c" calledElement="GoTo"/>{flows}'))
    assert main(["run", str(mission)]) == 1
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("   30.0 s   P: ")
    assert last.endswith("; a model alone has no world: a scenario has one")


def test_a_robot_that_never_started_says_what_it_waits_for(tmp_path: Path, capsys) -> None:
    start = '<startEvent id="s"><signalEventDefinition signalRef="S"/></startEvent>'
    mission = tmp_path / "waits.bpmn"
    mission.write_text(process(start, root='<signal id="S" name="go"/>'))
    main(["run", str(mission)])
    assert "never started; waits for its start on topic /go" in capsys.readouterr().out


def test_who_waits_for_what_came_too_early_is_told_so(tmp_path: Path, capsys) -> None:
    event = '<{tag} id="{id}"><signalEventDefinition signalRef="S"/></{tag}>'
    robots = {
        "EARLY": event.format(tag="intermediateThrowEvent", id="t"),
        "LATE": '<scriptTask id="w"><script>await sleep(1)</script></scriptTask>'
        + event.format(tag="intermediateCatchEvent", id="c")
        + '<sequenceFlow id="f" sourceRef="w" targetRef="c"/>',
    }
    pools = "".join(f'<participant id="{name}" name="{name}" processRef="P_{name}"/>' for name in robots)
    drawn = "".join(f'<process id="P_{name}">{content}</process>' for name, content in robots.items())
    mission = tmp_path / "early.bpmn"
    mission.write_text(document(f'<collaboration id="C">{pools}</collaboration>{drawn}<signal id="S" name="go"/>'))
    assert main(["run", str(mission)]) == 1
    assert (
        "LATE waits at c for topic /go (its last message came 1 s ago, before anything waited"
        in capsys.readouterr().err
    )


def test_who_waits_for_somebody_is_told_how_to_reach_it(tmp_path: Path, capsys) -> None:
    mission = tmp_path / "asks.bpmn"
    mission.write_text(process('<userTask id="u"/>', attributes='name="REX"'))
    assert main(["run", str(mission)]) == 1
    err = capsys.readouterr().err
    assert "REX waits at u for a person to complete it\n" in err
    assert "fame: --complete REX@S:u does it at simulated second S; fame complete reaches robots in processes" in err


def test_of_what_came_too_early_nothing_is_told_once_it_came_in_time() -> None:
    catch = '<intermediateCatchEvent id="{0}"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>'
    content = (
        '<scriptTask id="w"><script>await sleep(1)</script></scriptTask>'
        + catch.format("a")
        + catch.format("b")
        + '<sequenceFlow id="f" sourceRef="w" targetRef="a"/><sequenceFlow id="g" sourceRef="a" targetRef="b"/>'
    )
    simulation = fame.Simulation(read_text(process(content, root='<signal id="S" name="go"/>')))
    told = []
    for second in (0.5, 2, 3):
        simulation.run(until=second)
        told.append([wait.text for wait in simulation.node.waiting_tokens()])
        simulation.signal("go")
    topic = "topic /go, which no other node publishes"
    assert told == [
        ["sleep(1)"],
        [f"{topic} (its last message came 1.5 s ago, before anything waited for it)"],
        [topic],
    ]


def test_a_module_that_is_not_found_is_named_with_the_way_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = '<startEvent id="s"/><scriptTask id="t"><script>import my_tools</script></scriptTask>'
    (tmp_path / "a.bpmn").write_text(process(f'{script}<sequenceFlow id="f" sourceRef="s" targetRef="t"/>'))
    (tmp_path / "my_tools.py").touch()
    assert main(["run", str(tmp_path / "a.bpmn")]) == 1
    assert "No module named 'my_tools': install it, or name its folder in PYTHONPATH" in capsys.readouterr().err
