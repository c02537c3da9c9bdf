"""Logs of a run: what is written of each event, in each form, and that equal runs give equal bytes."""

import csv
import json
import os
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import pytest
from bpmn_text import process
from collaborations import text_of

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Definitions
from fame.cli import main
from fame.errors import ConfigError
from fame.log import COLUMNS, About, logging_to, outcomes, visits
from fame.log.elements import element_info
from fame.log.reading import run_outcomes
from fame.robot import Event
from fame.robot.events import Observer
from fame.scenario import Scenario
from fame.scenario.team_logs import team_logs

XES = "{http://www.xes-standard.org/}"
SMALL = process(
    """<startEvent id="s" name="mission
    starts"/>
    <scriptTask id="look" name="Look"><script>await sleep(1.5)</script></scriptTask>
    <subProcess id="search" name="Search">
      <startEvent id="s2"/><userTask id="ask" name="Ask"/>
      <sequenceFlow id="f4" sourceRef="s2" targetRef="ask"/>
    </subProcess>
    <boundaryEvent id="late" attachedToRef="search">
      <timerEventDefinition><timeDuration>PT2S</timeDuration></timerEventDefinition>
    </boundaryEvent>
    <endEvent id="e"/>
    <sequenceFlow id="f1" sourceRef="s" targetRef="look"/><sequenceFlow id="f2" sourceRef="look" targetRef="search"/>
    <sequenceFlow id="f3" sourceRef="late" targetRef="e"/>""",
    attributes='name="Patrol"',
)
"""Looks for 1.5 s, then searches in vain for 2 s, since nobody answers."""

ARROW = '<sequenceFlow id="f" sourceRef="s" targetRef="e"/>'


def logged(path: Path, text: str = SMALL, robot: str = "REX", until: float | None = None) -> str:
    """The log of a run."""
    definitions = read_text(text, file="patrol.bpmn")
    with logging_to(path, [definitions]) as write:
        fame.Simulation(definitions, observer=write, robot=robot).run(until)
    return path.read_bytes().decode(errors="replace")


def test_a_json_line_tells_one_event(tmp_path: Path) -> None:
    lines = logged(tmp_path / "run.jsonl").splitlines()
    assert json.loads(lines[1]) == {
        "time": 0.0, "robot": "REX", "instance": 1, "scope": 2, "element": "s", "name": "mission starts",
        "kind": "startEvent", "what": "enter",
    }  # fmt: skip
    assert json.loads(lines[-1])["detail"] == "completed"
    told = [json.loads(line)["what"] for line in lines if '"kind": "boundaryEvent"' in line]
    assert told == ["enter", "leave"]


def test_times_are_exact_simulated_seconds(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    with logging_to(path, []) as write:
        write(Event(3_600_000_000_000_001, "REX", 1, 2, "P", "start"))
    assert path.read_text().startswith('{"time": 3600000.000000001, ')


def test_a_table_tells_the_same(tmp_path: Path) -> None:
    logged(tmp_path / "run.csv")
    logged(tmp_path / "run.jsonl")
    with (tmp_path / "run.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    told = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    assert rows == [{name: str(line.get(name, "")) for name in COLUMNS} for line in told]


def activities(trace: ET.Element) -> list[tuple[str, str, str, str]]:
    """(name, transition, number, second) of each event."""
    found = []
    for event in trace.iter(f"{XES}event"):
        values = {attribute.get("key"): attribute.get("value", "") for attribute in event}
        second = values["time:timestamp"].removeprefix("1970-01-01T00:").removesuffix("+00:00")
        found.append((values["concept:name"], values["lifecycle:transition"], values["concept:instance"], second))
    return found


def test_xes_has_a_trace_per_instance_with_start_and_end_of_every_activity(tmp_path: Path) -> None:
    root = ET.fromstring(logged(tmp_path / "run.xes"))
    (trace,) = root.iter(f"{XES}trace")
    said = {attribute.get("key"): attribute.get("value") for attribute in trace.iterfind(f"{XES}string")}
    assert said == {"concept:name": "REX/1", "process": "Patrol", "robot": "REX", "status": "completed"}
    assert sorted(activities(trace)) == [
        ("Ask", "ate_abort", "3", "00:03.500000"),
        ("Ask", "start", "3", "00:01.500000"),
        ("Look", "complete", "1", "00:01.500000"),
        ("Look", "start", "1", "00:00.000000"),
        ("Search", "ate_abort", "2", "00:03.500000"),
        ("Search", "start", "2", "00:01.500000"),
    ]
    assert {event.find(f"{XES}string[@key='org:resource']").get("value") for event in trace.iter(f"{XES}event")} == {
        "REX"
    }


def test_executions_of_one_activity_at_a_time_have_numbers_of_their_own(tmp_path: Path) -> None:
    twice = process(
        """<startEvent id="s"/><scriptTask id="t"><script>await sleep(1)</script></scriptTask>
        <sequenceFlow id="a" sourceRef="s" targetRef="t"/><sequenceFlow id="b" sourceRef="s" targetRef="t"/>"""
    )
    (trace,) = ET.fromstring(logged(tmp_path / "run.xes", twice)).iter(f"{XES}trace")
    by_number = Counter((number, transition) for _, transition, number, _ in activities(trace))
    assert by_number == {(number, which): 1 for number in "12" for which in ("start", "complete")}


def test_a_failed_activity_is_aborted_with_its_error(tmp_path: Path) -> None:
    failing = process(
        """<startEvent id="s"/><scriptTask id="t"><script>raise BpmnError("blocked \\x00 &lt;")</script></scriptTask>
        <sequenceFlow id="a" sourceRef="s" targetRef="t"/>"""
    )
    root = ET.fromstring(logged(tmp_path / "run.xes", failing, robot="<R&D>"))
    assert root.find(f".//{XES}trace/{XES}string[@key='status']").get("value") == "failed"
    assert root.find(f".//{XES}string[@key='error']").get("value") == "blocked \ufffd <"
    assert root.find(f".//{XES}event/{XES}string[@key='org:resource']").get("value") == "<R&D>"


@pytest.mark.parametrize("ending", ["jsonl", "csv", "xes"])
def test_the_file_is_whole_when_the_run_breaks_off(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{ending}"

    def break_off() -> None:
        definitions = read_text(SMALL, file="patrol.bpmn")
        with logging_to(path, [definitions]) as write:
            fame.Simulation(definitions, observer=write).run(until=1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    text = path.read_text()
    assert text.endswith("\n")
    if ending == "xes":
        status = ET.fromstring(text).find(f".//{XES}trace/{XES}string[@key='status']")
        assert status.get("value") == "running"
    else:
        assert run_outcomes(path, read_text(SMALL, file="patrol.bpmn")).tallies["look"] == {"waiting": 1}


def test_a_log_in_a_folder_that_is_not_there_makes_it(tmp_path: Path) -> None:
    logged(tmp_path / "deep" / "down" / "run.CSV")


@pytest.mark.parametrize("ending", ["jsonl", "csv", "xes", "mcap"])
def test_others_may_not_write_a_log_whatever_the_umask_is(ending: str, tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        logged(tmp_path / f"run.{ending}")
    finally:
        os.umask(before)
    assert (tmp_path / f"run.{ending}").stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("ending", ["jsonl", "csv", "xes"])
def test_a_file_has_one_writer_at_a_time_and_is_new_each_time(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{ending}"
    with logging_to(path, ()):
        pass
    first = path.read_bytes()
    path.write_bytes(b"what stood there before, and is longer" * 100)
    with (
        logging_to(path, ()),
        pytest.raises(ConfigError, match="is already being written, by another run"),
        logging_to(tmp_path / "." / path.name, ()),
    ):
        raise AssertionError("two at a time")
    assert path.read_bytes() == first


@pytest.mark.parametrize("ending", ["jsonl", "csv", "xes"])
@pytest.mark.parametrize("why", ["bad model", "unknown fault"])
def test_a_run_that_is_refused_leaves_an_old_log(why: str, ending: str, tmp_path: Path, capsys) -> None:
    path, mission = tmp_path / f"old.{ending}", tmp_path / "mission.bpmn"
    path.write_text("what stood there before")
    text = SMALL.replace("PT2S", "PT2Z") if why == "bad model" else SMALL
    mission.write_text(text)
    fault = ["--fault", "Patrol@1:legs"] if why == "unknown fault" else []
    assert main(["run", str(mission), "--duration", "1", "--log", str(path), *fault]) == 2
    assert capsys.readouterr().err.startswith("fame: error: ")
    assert path.read_text() == "what stood there before"


@pytest.mark.parametrize("ending", ["jsonl", "csv", "xes"])
def test_a_log_on_a_full_disk_is_named(ending: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / f"full.{ending}"
    path.symlink_to("/dev/full")
    mission = tmp_path / "mission.bpmn"
    mission.write_text(SMALL)
    assert main(["run", str(mission), "--duration", "1", "--log", str(path)]) == 2
    assert capsys.readouterr().err == f"fame: error: {path}: cannot be written: No space left on device\n"


def test_a_log_where_no_file_can_be_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.csv").mkdir()
    for path, why in (("file/run.csv", f"{tmp_path / 'file'} is not a folder"), ("folder.csv", "Is a directory")):
        with pytest.raises(ConfigError, match=f"{path}: cannot be written: {why}"), logging_to(tmp_path / path, ()):
            raise AssertionError("it was opened")


def test_an_unknown_ending_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"one of \.jsonl, \.csv, \.xes, \.mcap, got '\.txt'"):
        logged(tmp_path / "run.txt")
    assert list(tmp_path.iterdir()) == []


# ---- names -----------------------------------------------------------------------------------------------------------


def test_kinds_are_the_tags_of_bpmn() -> None:
    tags = [
        "task", "userTask", "manualTask", "serviceTask", "sendTask", "receiveTask", "businessRuleTask", "callActivity",
        "exclusiveGateway", "parallelGateway", "inclusiveGateway", "complexGateway", "eventBasedGateway",
        "intermediateThrowEvent", "endEvent", "startEvent", "subProcess", "transaction", "adHocSubProcess",
    ]  # fmt: skip
    text = process("".join(f'<{tag} id="{tag}"/>' for tag in tags))
    nodes = read_text(text, file="tags.bpmn").processes[0].body.nodes
    assert [node.tag for node in nodes] == tags


def test_of_equal_ids_in_several_files_the_first_counts() -> None:
    first, second = (read_text(process(f'<task id="t" name="{name}"/>'), file=name) for name in ("one", "two"))
    assert element_info([first, second])["t"].name == "one"


# ---- reading ---------------------------------------------------------------------------------------------------------


def test_names_of_before_warn_and_work(tmp_path: Path) -> None:
    logged(tmp_path / "run.jsonl")
    with pytest.warns(DeprecationWarning, match="rows_of"):
        came = visits(tmp_path / "run.jsonl")
    assert came["look"] == came["f1"] == 1
    definitions = read_text(SMALL, file="patrol.bpmn")
    with pytest.warns(DeprecationWarning, match="run_outcomes"):
        found = outcomes(tmp_path / "run.jsonl", definitions)
    assert found == run_outcomes(tmp_path / "run.jsonl", definitions).tallies


@pytest.mark.parametrize("ending", ["jsonl", "csv", "mcap"])
def test_outcomes_tell_what_was_completed_and_cancelled(ending: str, tmp_path: Path) -> None:
    logged(tmp_path / f"run.{ending}")
    came = run_outcomes(tmp_path / f"run.{ending}", read_text(SMALL, file="patrol.bpmn")).tallies
    assert {id for id, tally in came.items() if tally == {"cancelled": 1}} == {"search", "ask"}
    assert {id for id, tally in came.items() if tally == {"completed": 1}} == {
        "s", "f1", "look", "f2", "s2", "f4", "late", "f3", "e",
    }  # fmt: skip


def test_what_has_not_ended_with_the_log_is_waiting(tmp_path: Path) -> None:
    logged(tmp_path / "run.jsonl", until=1.0)
    came = run_outcomes(tmp_path / "run.jsonl", read_text(SMALL, file="patrol.bpmn")).tallies
    assert came["look"] == {"waiting": 1}


@pytest.mark.parametrize("ending", ["jsonl", "csv"])
def test_a_log_that_ends_without_the_end_of_its_run_says_so(ending: str, tmp_path: Path) -> None:
    path, definitions = tmp_path / f"run.{ending}", read_text(SMALL, file="patrol.bpmn")
    unknown = "the recording is incomplete: how the run went on is not known"
    logged(path)
    assert unknown not in run_outcomes(path, definitions).notes(definitions)
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:5]))
    assert run_outcomes(path, definitions).notes(definitions)[-1] == unknown


def test_a_task_that_raises_an_error_has_failed(tmp_path: Path) -> None:
    text = SMALL.replace("await sleep(1.5)", "1 / 0")
    definitions = read_text(text, file="patrol.bpmn")
    with logging_to(tmp_path / "run.jsonl", [definitions]) as write:
        fame.Simulation(definitions, observer=write).run()
    assert run_outcomes(tmp_path / "run.jsonl", definitions).tallies["look"] == {"failed": 1}


@pytest.mark.parametrize("ending", ["jsonl", "csv", "mcap"])
def test_the_notes_below_a_drawing_tell_the_time_and_what_failed(ending: str, tmp_path: Path) -> None:
    text = SMALL.replace("await sleep(1.5)", "await sleep(1.5); 1 / 0")
    definitions = read_text(text, file="patrol.bpmn")
    with logging_to(tmp_path / f"run.{ending}", [definitions]) as write:
        fame.Simulation(definitions, observer=write, robot="REX").run()
    run = run_outcomes(tmp_path / f"run.{ending}", definitions, robots=["REX"])
    assert run.notes(definitions) == ["REX: 0.0 s to 1.5 s", 'REX failed at 1.5 s: "Look" (look): script']
    with pytest.raises(ConfigError, match="unknown robot 'RAX'; did you mean 'REX'"):
        run_outcomes(tmp_path / f"run.{ending}", definitions, robots=["RAX"])


def test_a_failure_is_told_by_the_error_that_nothing_caught(tmp_path: Path) -> None:
    """Another one, in the same instant, was caught."""
    steps = {"A": [("guard", ["run raise BpmnError('c')"], "error c", ["run y = 1 / 0"])]}
    definitions = read_text(text_of(steps), file="guard.bpmn")
    with logging_to(tmp_path / "run.jsonl", [definitions]) as write:
        fame.Simulation(definitions, observer=write).run()
    (failure,) = run_outcomes(tmp_path / "run.jsonl", definitions).failures
    assert failure == (0.0, "robot", "A_script_10", "script")


def test_a_failure_without_a_mark_of_its_own_is_not_told_by_an_error_that_was_caught(tmp_path: Path) -> None:
    """As one without end of moves, behind the boundary event of a task."""
    steps = {"A": [("guard", ["run raise BpmnError('c')"], "error c", ["run y = 1"])]}
    definitions = read_text(text_of(steps), file="guard.bpmn")
    with logging_to(tmp_path / "run.jsonl", [definitions]) as write:
        fame.Simulation(definitions, observer=write).run()
    log = (tmp_path / "run.jsonl").read_text()
    (tmp_path / "run.jsonl").write_text(log.replace('"end", "detail": "completed"', '"end", "detail": "failed"'))
    assert run_outcomes(tmp_path / "run.jsonl", definitions).failures == [(0.0, "robot", "P_A", "")]


@pytest.mark.parametrize("ending", ["jsonl", "csv"])
def test_the_path_of_an_empty_log_is_not_drawn(ending: str, tmp_path: Path) -> None:
    (tmp_path / f"run.{ending}").touch()
    with pytest.raises(ConfigError, match="is empty: there is no run in it"):
        run_outcomes(tmp_path / f"run.{ending}", read_text(SMALL, file="patrol.bpmn"))


def test_the_path_of_a_robot_begins_with_its_first_step(tmp_path: Path) -> None:
    row = {"instance": 1, "scope": 1, "element": "patrol", "what": "start"}
    rows = [json.dumps({"time": time, "robot": robot} | row) for time, robot in ((5, "REX"), (7, "DINGO"))]
    (tmp_path / "run.jsonl").write_text("\n".join(rows))
    run = run_outcomes(tmp_path / "run.jsonl", read_text(SMALL, file="patrol.bpmn"), robots=["DINGO"])
    assert (run.start, run.end) == (7, 7)


def test_an_end_event_that_raises_an_error_has_failed_once(tmp_path: Path) -> None:
    text = process('<startEvent id="s"/><endEvent id="e"><errorEventDefinition/></endEvent>' + ARROW)
    definitions = read_text(text, file="raise.bpmn")
    with logging_to(tmp_path / "run.jsonl", [definitions]) as write:
        fame.Simulation(definitions, observer=write).run()
    assert run_outcomes(tmp_path / "run.jsonl", definitions).tallies["e"] == {"failed": 1}


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (SMALL.replace('"look"', '"watch"'), "another model: P in other.bpmn has no element look"),
        (process('<task id="t"/>').replace('"P"', '"Q"'), "another model: it mentions no element of other.bpmn"),
    ],
    ids=["the same process, changed", "another process"],
)
def test_the_log_of_another_model_is_refused(other: str, found: str, tmp_path: Path) -> None:
    logged(tmp_path / "run.jsonl")
    with pytest.raises(ConfigError, match=found):
        run_outcomes(tmp_path / "run.jsonl", read_text(other, file="other.bpmn"))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.jsonl", "no JSON"),
        ("b.jsonl", "[1]\n"),
        ("c.jsonl", '{"element": "x"}'),
        ("d.csv", "a,b\n1,2\n"),
        ("e.xes", ""),
    ],
)
def test_what_is_no_log_is_refused(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=name):
        run_outcomes(tmp_path / name, read_text(SMALL, file="patrol.bpmn"))


# ---- a whole mission -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Definitions]]:
    """The logs of the ground-vehicle mission, in all forms."""
    folder = tmp_path_factory.mktemp("logs")
    target = {"name": "target", "at": [0.9, 2.2], "radius": 0.08}  # close by
    example = Path(__file__).parent.parent / "examples" / "ground_vehicles.yaml"
    scenario = Scenario.load(example, changes={"world.targets": [target]})
    files = scenario.closures()
    with (
        logging_to(folder / "run.jsonl", files) as lines,
        logging_to(folder / "run.csv", files) as rows,
        logging_to(folder / "run.xes", files) as traces,
    ):
        result = scenario.run(observer=lambda event: (lines(event), rows(event), traces(event)))
    assert result.status == "completed"
    return folder, files


def test_every_activity_of_the_mission_has_an_end_for_each_start(mission) -> None:
    root = ET.parse(mission[0] / "run.xes").getroot()
    traces = list(root.iter(f"{XES}trace"))
    assert len(traces) == 2
    for trace in traces:
        found = activities(trace)
        started = {number for _, transition, number, _ in found if transition == "start"}
        ended = [number for _, transition, number, _ in found if transition != "start"]
        assert sorted(ended) == sorted(started)
        assert [second for *_, second in found] == sorted(second for *_, second in found)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of pm4py and pandas
def test_process_mining_reads_the_mission(mission) -> None:
    log = pytest.importorskip("pm4py").read_xes(str(mission[0] / "run.xes"))
    assert sorted(log["case:concept:name"].unique()) == ["DINGO/1", "REX/1"]
    assert sorted(log["org:resource"].unique()) == ["DINGO", "REX"]
    assert sorted(log["lifecycle:transition"].unique()) == ["ate_abort", "complete", "start"]
    assert log["time:timestamp"].dtype.kind == "M"
    steps = log[log["case:robot"] == "DINGO"].sort_values("time:timestamp", kind="stable")
    assert [*steps[steps["kind"] == "callActivity"]["lifecycle:transition"]] == ["start", "complete"]
    assert steps["concept:name"].iloc[-1] == "Fire"


def test_an_event_log_keeps_what_an_observer_hears() -> None:
    """Also what is said by scripts, in its place."""
    text = process(
        """<startEvent id="s"/><scriptTask id="t"><script>log("half")
log("done")</script></scriptTask><userTask id="u"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
        <sequenceFlow id="g" sourceRef="t" targetRef="u"/>"""
    )
    log, heard = fame.EventLog(), []
    for observer in (log, heard.append):
        fame.Simulation(read_text(text, file="said.bpmn"), observer=observer).run().complete("u")
    assert list(log) == heard
    assert len(log) == len(heard)
    said = [(event.element or event.detail, event.what) for event in log]
    assert said[3:8] == [("f", "take"), ("t", "enter"), ("half", "log"), ("done", "log"), ("t", "leave")]


def test_what_takes_long_is_heard_in_between(tmp_path: Path) -> None:
    """A loop within one stimulus is logged as it goes, and not a line is lost or twice."""
    text = process(
        """<startEvent id="s"/><exclusiveGateway id="m"/><scriptTask id="t"><script>x = x + 1</script></scriptTask>
        <exclusiveGateway id="g" default="f4"/><endEvent id="e"/>
        <sequenceFlow id="f1" sourceRef="s" targetRef="m"/><sequenceFlow id="f2" sourceRef="m" targetRef="t"/>
        <sequenceFlow id="f3" sourceRef="t" targetRef="g"/><sequenceFlow id="f4" sourceRef="g" targetRef="e"/>
        <sequenceFlow id="f5" sourceRef="g" targetRef="m"><conditionExpression>x &lt; 1000</conditionExpression>
        </sequenceFlow>"""
    )
    definitions, trails = read_text(text, file="loop.bpmn"), []
    log = fame.EventLog()

    class Counting(Observer):
        def __call__(self, event: Event) -> None:
            log(event)

        def trail(self, time: int, robot: str, trail: object) -> None:
            trails.append(trail)
            log.trail(time, robot, trail)

    fame.Simulation(definitions, variables={"x": 0}, observer=Counting()).run()
    assert len(trails) > 5
    assert Counter((event.element, event.what) for event in log)["t", "leave"] == 1000
    with logging_to(tmp_path / "run.jsonl", [definitions]) as write:
        fame.Simulation(definitions, variables={"x": 0}, observer=write).run()
    assert len((tmp_path / "run.jsonl").read_text().splitlines()) == len(log)


def test_a_robot_may_have_any_name(tmp_path: Path) -> None:
    """Lines are put together from a format; nothing in a name is taken for a part of it."""
    path = tmp_path / "run.jsonl"
    with logging_to(path, []) as write:
        write(Event(0, "100%d", 1, 2, "a", "enter"))
    (line,) = map(json.loads, path.read_text().splitlines())
    assert (line["robot"], line["instance"], line["scope"], line["element"]) == ("100%d", 1, 2, "a")


# ---- of a run in many processes --------------------------------------------------------------------------------------

VEHICLES = Path(__file__).parent.parent / "examples" / "ground_vehicles.yaml"


def test_without_an_event_of_a_robot_no_property_is_known(tmp_path: Path) -> None:
    scenario = Scenario.load(VEHICLES)
    with team_logs(scenario, [tmp_path / "run.jsonl"], About(), "signals") as logs:
        assert logs is not None
        judgements = logs.finish(lambda path: pytest.fail("there is no recording"))
    assert [one.name for one in judgements] == [one.name for one in scenario.properties] != []
    assert {one.verdict for one in judgements} == {"not known"}


def test_a_recording_may_be_named_twice(tmp_path: Path) -> None:
    """It was copied onto itself after the run, whose result was lost."""
    (tmp_path / "other").mkdir()
    files = [tmp_path / "run.mcap", tmp_path / "other" / ".." / "run.mcap", tmp_path / "second.mcap"]
    with team_logs(Scenario.load(VEHICLES), files, About(), "signals") as logs:
        assert logs is not None
        logs._open()
        logs.finish(lambda path: ())
    assert files[0].read_bytes() == files[2].read_bytes() != b""


def test_logs_of_a_team_that_cannot_be_written_are_refused_before_it_starts(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (kept := tmp_path / "kept.csv").write_text("kept")
    with (
        pytest.raises(ConfigError, match="cannot be written"),
        team_logs(Scenario.load(VEHICLES), [kept, tmp_path / "file" / "run.csv"], About(), "signals"),
    ):
        pytest.fail("it starts")
    assert kept.read_text() == "kept"
