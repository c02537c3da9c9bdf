"""``fame check --explore`` and ``fame deploy --explore`` on the command line."""

import json
import re
from contextlib import nullcontext
from pathlib import Path
from threading import Event
from typing import Any, TextIO

import pytest
from collaborations import Steps, text_of
from deployment_field import Field
from fame_test_runs import fame_test

from fame.cli import deployment, exploration, main, output
from fame.log import Recording
from fame.testing import ExpectationError, MissionLoader


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.bpmn"
    path.write_text(text_of({"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}))
    return path


def test_the_first_line_says_that_all_states_were_explored(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", "models/ground_vehicles.bpmn"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("models/ground_vehicles.bpmn: all states explored (REX, DINGO; delivery run and fast)")


def test_a_search_that_is_cut_says_so_first_and_last_and_does_not_pass(
    broken: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine, cut = "models/ground_vehicles.bpmn", ["check", "--explore", "--limit", "20", "models/convoy.bpmn"]
    assert main(cut) == 3
    shown = capsys.readouterr().out.splitlines()
    assert "NOT all states explored (the limit of 20 states is reached" in shown[0]
    assert re.match(r"no error found in a partial search \([\d,]+ of unknown\)", shown[-1])
    assert main([*cut, "--allow-partial"]) == 0
    assert main([*cut[:2], "--delivery", "run", fine, "models/convoy.bpmn"]) == 0
    assert main([*cut, fine]) == 3
    assert main([*cut, str(broken)]) == 1  # 1 before 3 before 0
    capsys.readouterr()
    assert main([*cut, "--json"]) == 3
    shown_json = json.loads(capsys.readouterr().out)
    assert (shown_json["status"], shown_json["explorations"][0]["status"]) == ("partial", "partial")


GROWING: dict[str, Steps] = {"A": [("loop", ["work", "throw go"])], "B": ["start go", "work"]}
"""Not explored whole: the instances of B are not bounded."""


def test_a_mission_that_is_not_explored_whole_is_not_deployed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, field = written(tmp_path / "m.bpmn", GROWING), Field("A", "B")
    monkeypatch.setattr(deployment, "connected", lambda _: nullcontext((field.scheduler, field.middleware)))
    assert main(["deploy", "--explore", model]) == 3
    assert "not deployed: no error found in a partial search" in capsys.readouterr().err
    assert main(["deploy", "--explore", model, "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["status"] == "partial"
    assert not any(one.deployment for one in field.said)
    assert main(["deploy", "--explore", model, "--allow-partial", "--wait", "1"]) == 0
    assert any(one.deployment for one in field.said)
    assert main(["deploy", model, "--allow-partial"]) == 2


def test_a_test_of_a_mission_that_is_not_explored_whole_fails(tmp_path: Path, mission: MissionLoader) -> None:
    model = written(tmp_path / "m.bpmn", GROWING)
    with pytest.raises(ExpectationError, match="no error found in a partial search"):
        mission.explore(model)
    assert mission.explore(model, allow_partial=True).status == "partial"
    deadlock = written(tmp_path / "d.bpmn", {"A": ["catch b", "throw a"], "B": ["catch a", "throw b"]})
    with pytest.raises(ExpectationError, match="error: deadlock: A waits"):
        mission.explore(deadlock, allow_partial=True)


def test_progress_is_written_to_stderr_without_a_terminal(
    broken: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exploration, "_EVERY", 0.0)
    monkeypatch.setattr(output, "EVERY", 0.0001)
    write, show, shown_once = output.ProgressLine.write, output._show, Event()

    def write_and_wait(line: output.ProgressLine, text: str) -> None:  # the line is shown by a thread of its own
        write(line, text)
        assert shown_once.wait(60)

    def show_once(stream: TextIO, text: str) -> None:
        show(stream, text)
        if "states" in text:
            shown_once.set()

    monkeypatch.setattr(output.ProgressLine, "write", write_and_wait)
    monkeypatch.setattr(output, "_show", show_once)
    main(["check", "--explore", str(broken), "--json"])
    shown = capsys.readouterr()
    assert re.search(r"broken.bpmn: \d+ states, [\d,]+ per second, \d+ in the frontier", shown.err)
    json.loads(shown.out)


def test_a_lost_signal_fails_the_check_with_its_run(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(broken), "--delivery", "run"]) == 1
    shown = capsys.readouterr().out
    assert "error: lost signal: A waits at" in shown
    assert "B misses /go: it does not listen" in shown
    assert "from here on the mission cannot complete" in shown


def test_json(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(broken), "--json"]) == 1
    (result,) = json.loads(capsys.readouterr().out)["explorations"]
    assert result["exhaustive"] is True
    assert result["findings"][0]["kind"] == "lost"
    assert result["findings"][0]["run"][-1]["text"]


def test_traces_are_tests_that_fail_today_and_pass_once_it_is_mended(broken: Path, tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    assert main(["check", "--explore", str(broken), "--delivery", "run", "--trace", str(folder)]) == 1
    (test,) = folder.glob("test_*.py")
    assert 'm = mission.by_hand("../broken.bpmn", lenient=True)' in test.read_text()
    assert 'm.arrive("B", "/go")   # B misses /go: it does not listen' in test.read_text()
    code, shown = fame_test(str(test), folder=tmp_path)
    assert code == 1
    assert "A: expected to have completed within 60 s" in shown
    broken.write_text(text_of({"A": ["throw go", "catch done"], "B": ["work", "queue go", "throw done"]}))
    code, shown = fame_test(str(test), folder=tmp_path)
    assert code == 0, shown
    assert "steps left out" not in shown  # it went the way of the run
    broken.write_text(text_of({"A": ["work"], "B": ["work", "queue go", "throw done"]}))
    _, shown = fame_test(str(test), "--pytest=-rA", folder=tmp_path)
    assert "B: expected a message on /go on its way to it" in shown.split("steps left out")[1]


def test_the_trace_of_a_refuted_property_fails_until_it_holds(tmp_path: Path) -> None:
    model, folder = tmp_path / "m.bpmn", tmp_path / "traces"
    model.write_text(text_of({"A": ["run n = 1", "work", "run n = n * 4", "work"]}))
    (tmp_path / "m.properties.yaml").write_text("properties:\n  low: always A.n < 3\n")
    assert main(["check", "--explore", str(model), "--trace", str(folder)]) == 1
    assert {file.name for file in folder.iterdir()} >= {"test_m_property_low.py", "m_property_low.mcap"}
    code, shown = fame_test(str(folder), folder=tmp_path)
    assert code == 1
    assert "property low is violated: at 0 s A.n is 4" in shown
    model.write_text(model.read_text().replace("n * 4", "n * 2"))
    code, shown = fame_test(str(folder), folder=tmp_path)
    assert code == 0, shown


@pytest.mark.long
def test_traces_are_recordings_of_the_real_engines_and_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    model = "models/ground_vehicles.bpmn"
    main(["check", "--explore", model, "--delivery", "run", "--faults", "--trace", str(folder)])
    test = next(path for path in folder.glob("test_*.py") if 'raises="blocked"' in path.read_text())
    name = test.stem.removeprefix("test_")
    assert "DINGO" in (folder / f"{name}.svg").read_text()
    with Recording(folder / f"{name}.mcap") as recording:
        events = [(event.robot, event.element, event.what) for event in recording.events()]
    assert ("DINGO", "Activity_GoTo", "fail") in events
    assert ("REX", "Event_DoneCaught", "enter") in events
    assert ("REX", "Event_DoneCaught", "leave") not in events


def test_options_that_need_explore(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "models/ground_vehicles.bpmn", "--limit", "5"]) == 2
    assert "--limit needs --explore" in capsys.readouterr().err
    assert main(["check", "--explore", "models/agriculture.bpmn", "--robots", "Tractor"]) == 2
    assert "expected POOL=N" in capsys.readouterr().err
    assert main(["check", "--explore", "models/agriculture.bpmn", "--limit", "0"]) == 2


def test_a_model_with_errors_is_not_explored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.bpmn"
    path.write_text(text_of({"A": ["run x = (", "work"]}))
    assert main(["check", "--explore", str(path)]) == 2
    assert "has errors: nothing is explored" in capsys.readouterr().err


# ---- bad input -------------------------------------------------------------------------------------------------------


def written(path: Path, steps: dict[str, Steps], **options: Any) -> str:
    path.write_text(text_of(steps, **options))
    return str(path)


def test_warnings_of_the_model_itself_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(text_of({"A": ["run y = never_set"]}))
    assert main(["check", "--explore", str(path)]) == 0
    assert "1 warning of the model itself: fame check" in capsys.readouterr().err
    scenario = tmp_path / "m.yaml"
    scenario.write_text("model: m.bpmn\nvariables:\n  A: {never_set: 1}\n")  # which is set then, as fame check knows
    assert main(["check", "--explore", str(scenario)]) == 0
    assert capsys.readouterr().err == ""


def test_no_code_of_a_model_is_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    marker = tmp_path / "marker"
    (tmp_path / "helper.py").write_text(f"open({str(marker)!r}, 'w')")
    script = f"run import sys\nsys.path.insert(0, {str(tmp_path)!r})\nimport helper\nx = open({str(marker)!r}, 'w')"
    model = written(tmp_path / "model.bpmn", {"A": [script, ("if", "x > 5", ["throw go"], []), "throw on"],
                                              "B": ["catch on"]})  # fmt: skip
    assert main(["check", "--explore", model]) == 0
    assert not marker.exists()


def test_a_condition_that_raises(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = written(tmp_path / "m.bpmn", {"A": ["run x = []", ("if", "x[3] > 5", ["throw go"], ["work"])],
                                          "B": ["catch go"]})  # fmt: skip
    assert main(["check", "--explore", model]) == 1
    first, _, error, *rest = capsys.readouterr().out.splitlines()
    assert ": all states explored (A, B; " in first
    assert re.fullmatch(
        r"error: A: A_split_\d+ fails: IndexError: list index out of range; "
        r'then B waits at "go" \(B_catch_go_\d+\) for /go, forever',
        error,
    )
    assert any("A: never entered" in line for line in rest)


def test_a_behaviour_that_cannot_be_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of({"A": ["throw go"], "B": ["catch go"]})
    call = '<callActivity id="C" name="Dance" calledElement="Dance"/><intermediateThrowEvent'
    (tmp_path / "m.bpmn").write_text(text.replace("<intermediateThrowEvent", call, 1))
    for command in ("check", "deploy"):
        assert main([command, "--explore", str(tmp_path / "m.bpmn")]) == 2
        said = capsys.readouterr()
        assert "\"Dance\" (C): called element 'Dance': found neither" in said.out + said.err


def test_a_finding_that_its_owner_accepts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    steps: dict[str, Steps] = {"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}
    model = written(tmp_path / "m.bpmn", steps, accept=dict.fromkeys("AB", "deadlock: the operator ends it"))
    assert main(["check", "--explore", model]) == 0
    said = capsys.readouterr().out
    assert "note: lost signal: A waits" in said
    assert "accepted: the operator ends it" in said
    assert main(["check", "--explore", model, "--json"]) == 0
    (found,) = (one for one in json.loads(capsys.readouterr().out)["explorations"][0]["findings"] if one["accepted"])
    assert found["level"] == "note"
    wrong = written(tmp_path / "m.bpmn", steps, accept={"A": "deadlok: the operator ends it"})
    assert main(["check", "--explore", wrong]) == 2
    assert "P_A: accept: expected KIND: REASON, where KIND is one of deadlock, never" in capsys.readouterr().err


@pytest.mark.long
def test_json_says_that_not_all_was_explored(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", "models/agriculture.bpmn", "--limit", "20", "--json"]) == 3
    (found,) = json.loads(capsys.readouterr().out)["explorations"]
    assert found["exhaustive"] is False
    assert found["cuts"] == ["the limit of 20 states is reached", "no budget is left for delivery fast"]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--limit", "0"], "limit: expected a number of states above 0, got 0"),
        (["--seconds", "0"], "--seconds: expected a number above 0, got '0'"),
        (["--delivery", "slow"], "--delivery: got 'slow'; known are: run, fast, any"),
        (["--robots", "Drone=2"], "unknown multi-instance pool 'Drone'; there are: Tractor"),
        (["--robots", "Tractor=99999999"], "robots of Tractor: expected 1 to 1000, got 99999999"),
        (["--robots", "Tractor=0"], "robots of Tractor: expected 1 to 1000, got 0"),
        (["--trace", "/proc/nothing"], "cannot be written"),
        (["--timers", "some"], "--timers: got 'some'; known are: any, ordered"),
    ],
)
def test_bad_options(options: list[str], text: str, capsys: pytest.CaptureFixture[str], broken: Path) -> None:
    model = str(broken) if "--trace" in options else "models/agriculture.bpmn"
    assert main(["check", "--explore", model, *options]) == 2
    assert text in capsys.readouterr().err


def test_paths_are_short(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", "examples/ground_vehicles.yaml", "--delivery", "run"]) == 3
    said = capsys.readouterr().out
    assert said.startswith("models/ground_vehicles.bpmn: all states explored")
    assert "property found_first is proved" in said  # of the scenario
    assert "property answer is not known: it has a bound" in said


def test_a_mission_that_may_deadlock_is_not_deployed(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["deploy", "--explore", str(broken)]) == 1
    assert "not deployed: lost signal: A waits at" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("sentence", "code", "text"),
    [
        ("never B starts", 1, "not deployed: property order is refuted"),
        ("after A starts, B starts within 5 s", 0, "it is not known whether order may be violated"),
        ("never A completes before A starts", 0, "all states explored"),
    ],
)
def test_a_mission_that_violates_a_property_beside_it_is_not_deployed(
    sentence: str,
    code: int,
    text: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, field = written(tmp_path / "m.bpmn", {"A": ["work", "throw go"], "B": ["start go", "work"]}), Field("A", "B")
    (tmp_path / "m.properties.yaml").write_text(f"properties:\n  order: {sentence}\n")
    monkeypatch.setattr(deployment, "connected", lambda _: nullcontext((field.scheduler, field.middleware)))
    assert main(["deploy", "--explore", model, "--wait", "1"]) == code
    assert text in capsys.readouterr().err
    assert any(one.deployment for one in field.said) is not bool(code)


@pytest.mark.parametrize(("robots", "code"), [(["F_4", "F_7"], 0), (["F_4"], 1)])
def test_a_deployment_explores_the_robots_that_it_finds(
    robots: list[str], code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, field = tmp_path / "fleet.bpmn", Field("C", *robots)
    steps: dict[str, Steps] = {"C": ["throw go", "catch done", "catch done"], "F": ["catch go", "work", "throw done"]}
    path.write_text(text_of(steps, ["F"]))
    monkeypatch.setattr(deployment, "connected", lambda _: nullcontext((field.scheduler, field.middleware)))
    assert main(["deploy", "--explore", str(path), "--wait", "1"]) == code
    shown = capsys.readouterr()
    assert f"all states explored (C, {', '.join(robots)}; delivery run and fast)" in shown.err
    assert ("not deployed: deadlock: C waits at" in shown.err) is bool(code)
    assert any(one.deployment for one in field.said) is not bool(code)
