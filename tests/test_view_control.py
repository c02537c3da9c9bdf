"""Control of a run from its page: the run itself does what is asked, at an instant; a branch is the same run again."""

# ruff: noqa: E501 (a model as XML, and a table of commands)

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from recorded_runs import record
from view_page import beyond, eventually, opened, says, shot, until

from fame.cli import main, parser
from fame.cli.view import _compared, _recorded_command, _source, viewed
from fame.clock import SECOND
from fame.errors import ConfigError, FameError
from fame.log import About, Recording
from fame.scenario import Fault, Result, Scenario
from fame.view import LiveRun, RunControl, SameRun
from fame.view.state import WHATS

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EXAMPLES = Path(__file__).parent.parent / "examples"
PORTER = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" id="d" targetNamespace="x">
  <bpmn:signal id="Go" name="go"/>
  <bpmn:process id="PORTER" isExecutable="true">
    <bpmn:startEvent id="S"><bpmn:outgoing>a</bpmn:outgoing></bpmn:startEvent>
    <bpmn:sequenceFlow id="a" sourceRef="S" targetRef="Sign"/>
    <bpmn:userTask id="Sign" name="Sign"><bpmn:incoming>a</bpmn:incoming><bpmn:outgoing>b</bpmn:outgoing></bpmn:userTask>
    <bpmn:sequenceFlow id="b" sourceRef="Sign" targetRef="Wait"/>
    <bpmn:intermediateCatchEvent id="Wait"><bpmn:incoming>b</bpmn:incoming><bpmn:outgoing>c</bpmn:outgoing>
      <bpmn:signalEventDefinition id="s" signalRef="Go"/></bpmn:intermediateCatchEvent>
    <bpmn:sequenceFlow id="c" sourceRef="Wait" targetRef="Full"/>
    <bpmn:intermediateCatchEvent id="Full"><bpmn:incoming>c</bpmn:incoming><bpmn:outgoing>f</bpmn:outgoing>
      <bpmn:conditionalEventDefinition id="q"><bpmn:condition>load &gt; 3</bpmn:condition></bpmn:conditionalEventDefinition>
    </bpmn:intermediateCatchEvent>
    <bpmn:sequenceFlow id="f" sourceRef="Full" targetRef="E"/>
    <bpmn:endEvent id="E"><bpmn:incoming>f</bpmn:incoming></bpmn:endEvent>
  </bpmn:process>
</bpmn:definitions>"""


@contextmanager
def running(scenario: Scenario, control: RunControl, **options: Any) -> Iterator[tuple[LiveRun, Callable[[], Result]]]:
    """A run in a thread, and what waits for its result."""
    live, results = LiveRun(scenario, control), []

    def work() -> None:
        results.append(scenario.run(observer=live.observer, pace=live, **options))
        live.end(results[0].status)

    thread = threading.Thread(target=work)

    def result() -> Result:
        thread.join(60)
        assert results
        return results[0]

    thread.start()
    try:
        yield live, result
    finally:
        if thread.is_alive() and live._run is not None:
            live._run.interrupted = True
        thread.join(60)


@pytest.fixture
def porter(tmp_path: Path) -> Scenario:
    model = tmp_path / "porter.bpmn"
    model.write_text(PORTER, encoding="utf-8")
    return Scenario.load(model, duration=3600)


def waiting(live: LiveRun) -> list[str]:
    return [token["element"] for state in live._packer.state.robots.values() for token in state.tokens.values()]


def test_a_task_is_completed_a_signal_sent_a_variable_set(porter: Scenario) -> None:
    with running(porter, RunControl()) as (live, result):
        eventually(lambda: waiting(live) == ["Sign"])
        live.control({"do": "pause"})
        live.control({"do": "complete", "robot": "PORTER", "element": "Sign", "value": '{"approved": true}'})
        assert waiting(live) == ["Wait"]
        nodes = len(live._run.middleware.nodes)  # type: ignore[union-attr]
        for _ in range(2):
            assert live.control({"do": "signal", "topic": "/go", "robot": "PORTER"}) == {"said": "/go is sent."}
        assert len(live._run.middleware.nodes) == nodes + 1  # type: ignore[union-attr]
        assert waiting(live) == ["Full"]
        said = live.control({"do": "set", "robot": "PORTER", "name": "load", "value": "4"})
        assert said == {"said": "load is set; it was not a variable before."}
        found = result()
    assert found.status == "completed"
    told = [str(event.detail) for event in found.reports]
    assert told == ["completed by a person: Sign", "set load=4 by a person"]


def test_a_run_that_begins_paused_has_done_nothing_until_somebody_resumes_it(porter: Scenario) -> None:
    arguments = parser("run").parse_args(["run", "porter.bpmn", "--view", "--paused", "--no-open"])
    with viewed(arguments, porter) as live:
        assert live is not None
        thread = threading.Thread(target=lambda: porter.run(observer=live.observer, pace=live))
        thread.start()
        status = eventually(lambda: next((one for one in live.news(None)[1] if one["type"] == "run"), None))
        assert (status["paused"], status["stopped"], waiting(live)) == (True, "Paused before the first step.", [])
        live.control({"do": "resume"})
        eventually(lambda: waiting(live) == ["Sign"])
        live._run.interrupted = True  # type: ignore[union-attr]
        thread.join(60)


def test_the_version_of_a_mission_is_another_one_when_it_has_changed_and_in_another_run(porter: Scenario) -> None:
    live, versions = LiveRun(porter, RunControl()), list[Any]()
    known = None
    for _ in range(2):
        versions.append(live.mission()["version"])
        known, news = live.news(known)
        assert news[0] == {"type": "reload", "version": versions[-1]}
        live.hand_over()
    versions.append(LiveRun(porter, RunControl()).mission()["version"])
    assert len({*versions}) == 3


def test_a_paused_run_stands_still_until_it_is_stepped() -> None:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=20)
    with running(scenario, RunControl(pause_at=2 * SECOND)) as (live, _):
        eventually(lambda: live.control_of_run.paused)
        assert live._time == 2 * SECOND
        events = live._packer.blocks[-1].events
        live.control({"do": "step"})
        eventually(lambda: live._packer.blocks[-1].events > events)
        first = live._time
        times = {time for time in live._packer.blocks[-1].columns["t"] if time > 2 * SECOND}
        assert times == {first}


def test_a_breakpoint_pauses_where_a_token_comes() -> None:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml")
    control = RunControl(speed=0.0)
    live = LiveRun(scenario, control)
    element = next(
        number for number, one in enumerate(live.catalogue.elements) if one.element.id == "Event_Turn_Odometry"
    )
    control.breakpoints.add(element)
    with running(scenario, control) as (live, _):
        eventually(lambda: control.paused)
        block = live._packer.blocks[-1]
        last = [place for place, what in enumerate(block.columns["w"]) if block.columns["e"][place] == element]
        assert block.columns["w"][last[-1]] == WHATS.index("enter")
        assert block.columns["t"][last[-1]] == live._run.scheduler.now  # type: ignore[union-attr]
        assert control.stopped == "Breakpoint reached."


def test_something_breaks_on_demand() -> None:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=5)
    with running(scenario, RunControl(pause_at=SECOND)) as (live, result):
        eventually(lambda: live.control_of_run.paused)
        assert ["REX", "engine"] in [list(one) for one in live.mission()["faults"]]
        live.control({"do": "fault", "robot": "REX", "kind": "engine"})
        found = result()
    assert found.robots[0].failed == 1


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ({}, "unknown command None; commands are: pause"),
        ({"do": "explode"}, "unknown command 'explode'"),
        ({"do": "complete"}, "expected the parts of the command 'complete'"),
        ({"do": "complete", "robot": "NOBODY", "element": "Sign"}, "unknown robot 'NOBODY'; robots are: PORTER"),
        ({"do": "complete", "robot": "PORTER", "element": "Sign", "value": "nonsense"}, "expected a value as JSON, got 'nonsense'"),
        ({"do": "complete", "robot": "PORTER", "element": "Sign", "value": "[1]"}, "expected results as a JSON object"),
        ({"do": "complete", "robot": "PORTER", "element": "E"}, "E: is not waiting; currently waiting: Sign"),
        ({"do": "speed", "speed": -1}, "expected a speed from 0"),
        ({"do": "speed", "speed": True}, "expected a speed from 0 (at once) to 1e6, got True"),
        ({"do": "speed", "speed": 10**400}, "expected a speed from 0 (at once) to 1e6, got 1000"),
        ({"do": "breakpoint", "element": float("inf"), "on": True}, "expected the number of an element from 0 to"),
        ({"do": "breakpoint", "element": 10**6, "on": True}, ", got 1000000"),
        ({"do": "run_to", "element": -1}, ", got -1"),
        ({"do": "speed", "speed": "fast"}, "expected a speed from 0 (at once) to 1e6, got 'fast'"),
        ({"do": "set", "robot": "PORTER", "name": "not a name", "value": "1"}, "expected the name of a variable"),
        ({"do": "set", "robot": "PORTER", "name": "x", "value": "{"}, "expected a value as JSON"),
        ({"do": "fault", "robot": "PORTER", "kind": "wings"}, "unknown fault 'wings' of PORTER; known are: engine"),
        ({"do": "signal", "topic": "/go", "robot": "PORTER", "value": '{"x": 1}'}, "x"),
        ({"do": "signal", "topic": "go", "robot": "PORTER"}, "no process uses the topic /PORTER/go; known are: /go"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_and_the_run_goes_on(porter: Scenario, command: Any, text: str) -> None:
    with running(porter, RunControl(speed=1.0)) as (live, _):
        eventually(lambda: waiting(live) == ["Sign"])
        with pytest.raises(FameError, match=re.escape(text)):
            live.control(command)
        assert live.control({"do": "pause"}) == {"said": ""}


def test_a_command_that_was_not_answered_in_time_is_not_carried_out_later(
    porter: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fame.view.control._PATIENCE", 0.0)
    live = LiveRun(porter, control := RunControl())  # nothing runs yet, as if a script did not end
    with pytest.raises(FameError, match=r"has not answered within 10 s \(nothing is done\)"):
        live.control({"do": "speed", "speed": 7})
    with running(porter, control) as (later, _):
        eventually(lambda: waiting(later) == ["Sign"])
    assert control.speed == 1.0


def test_what_a_form_requires_and_a_person_leaves_out_is_said(tmp_path: Path) -> None:
    form = "<bpmn:extensionElements><camunda:formData><camunda:formField id='approved' type='boolean'><camunda:validation><camunda:constraint name='required'/></camunda:validation></camunda:formField></camunda:formData></bpmn:extensionElements>"
    model = PORTER.replace('name="Sign">', f'name="Sign">{form}').replace(
        "xmlns:bpmn", 'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" xmlns:bpmn', 1
    )
    (path := tmp_path / "porter.bpmn").write_text(model, encoding="utf-8")
    with running(Scenario.load(path, duration=3600), RunControl()) as (live, _):
        eventually(lambda: waiting(live) == ["Sign"])
        said = live.control({"do": "complete", "robot": "PORTER", "element": "Sign"})
    assert said == {"said": "Sign is completed; without approved, which its form requires."}


def test_a_run_that_is_over_takes_no_commands(porter: Scenario) -> None:
    live = LiveRun(porter, RunControl())
    live.end("completed")
    with pytest.raises(FameError, match="the run is over"):
        live.control({"do": "pause"})


# ---- branches --------------------------------------------------------------------------------------------------------


def recorded(scenario: Scenario, path: Path) -> Path:
    about = About(metadata={"seed": str(scenario.seed), "command": "fame run x"})
    return record(scenario, path, about=about)


def branched(scenario: Scenario, recording: Recording, time: int) -> tuple[LiveRun, SameRun]:
    live = LiveRun(scenario, RunControl(pause_at=time))
    return live, SameRun(recording, time, live)


@pytest.mark.long
def test_a_branch_is_the_recorded_run_until_there(tmp_path: Path) -> None:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=15)
    with Recording(recorded(scenario, tmp_path / "run.mcap")) as recording:
        live, same = branched(scenario, recording, 10 * SECOND)
        live.hand_over = lambda: setattr(live._run, "interrupted", True)  # type: ignore[method-assign]
        scenario.run(observer=live.observer, pace=same)
        before = [event for event in recording.events(end=10 * SECOND) if event.element]
    assert same._reached
    shown = [time for block in live._packer.blocks for time in block.columns["t"] if time <= 10 * SECOND]
    assert len(shown) >= len(before) > 100


@pytest.mark.long
def test_a_page_sees_how_far_a_branch_has_come_and_controls_it_from_there_on(tmp_path: Path) -> None:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=2)
    seen: list[tuple[int, int]] = []
    with Recording(recorded(scenario, tmp_path / "run.mcap")) as recording:
        live, same = branched(scenario, recording, SECOND)

        def look(time: int, topic: str, data: Any) -> None:
            (status,) = [one for one in live.news(None)[1] if one["type"] == "run"]
            seen.append((status["time"], status["repeats"]))
            assert live.mission()["control"] == []
            with pytest.raises(FameError, match="the run is being repeated: it takes commands from 1 s on"):
                live.control({"do": "resume"})
            compare(time, topic, data)

        compare, live.listen = same._compare, look
        hand_over = live.hand_over
        live.hand_over = lambda: (hand_over(), setattr(live._run, "interrupted", True))  # type: ignore[method-assign]
        scenario.run(observer=live.observer, pace=same)
    assert {repeats for _, repeats in seen} == {SECOND}
    assert len({time for time, _ in seen}) > 10
    assert "resume" in live.mission()["control"]
    assert live.news(None)[1][-1]["repeats"] is None


@pytest.mark.long
def test_the_page_of_a_branch_that_fails_stays_with_the_error(own_code: Path) -> None:
    words = ["--branch", "0.5", "--no-open", "--yes", "--changed"]
    model = own_code / "porter.bpmn"
    model.write_text(
        model.read_text().replace('id="Sign" name="Sign"', 'id="Sign" name="Signed"').replace("Sign", "Sign2")
    )
    with subprocess.Popen(
        [sys.executable, "-m", "fame", "view", str(own_code / "run.mcap"), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().strip()
        error = process.stderr.readline()
        assert re.match(r"fame: error: .*the run again is not the recorded one: at 0 s expected", error)
        assert process.stderr.readline().startswith("The run has ended.")
        with urlopen(f"{address}mission.json") as answer:
            mission = json.loads(answer.read())
        assert (mission["control"], mission["chips"][0][0]) == ([], "failed")
        request = Request(f"{address}control", json.dumps({"do": "resume"}).encode(), method="POST")
        with pytest.raises(HTTPError) as refused:
            urlopen(request)
        assert "is not the recorded one" in refused.value.read().decode()
        refused.value.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 2


@pytest.mark.long
def test_a_branch_of_another_run_is_refused_with_the_first_difference(tmp_path: Path) -> None:
    path = recorded(Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=15), tmp_path / "run.mcap")
    other = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=15, faults=[Fault("REX", 3.0, "engine")])
    with Recording(path) as recording:
        live, same = branched(other, recording, 14 * SECOND)
        with pytest.raises(ConfigError, match=r"not the recorded one: at 3[\d.]* s expected REX .*, got "):
            other.run(observer=live.observer, pace=same)


def test_a_branch_of_a_failed_run_that_an_older_version_has_recorded_is_the_recorded_run(tmp_path: Path) -> None:
    """The recording is of FAME 0.2.0 at commit 943a21f, which did not report the error that ended an instance."""
    with Recording(Path(__file__).with_name("recordings") / "failed.mcap") as recording:
        assert [event.detail for event in recording.events() if event.what in ("fail", "report")] == ["broken"]
        for name, content in recording.attachments.items():
            (tmp_path / Path(name).name).write_bytes(content)
        scenario = Scenario.load(tmp_path / "two.yaml", seed=int(recording.metadata["seed"]))
        live, same = branched(scenario, recording, 9 * SECOND)
        live.hand_over = lambda: setattr(live._run, "interrupted", True)  # type: ignore[method-assign]
        scenario.run(observer=live.observer, pace=same)
    assert same._reached


def test_a_branch_of_a_run_with_other_values_is_refused(tmp_path: Path) -> None:
    """Another seed: at first the tokens move at the same times, but the noise differs."""
    path = recorded(Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=5), tmp_path / "run.mcap")
    other = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=5, seed=9)
    with Recording(path) as recording:
        live, same = branched(other, recording, 4 * SECOND)
        with pytest.raises(ConfigError, match=r"at 0 s expected REX odom\.pose\.pose\.position\.x = .*, got REX odom"):
            other.run(observer=live.observer, pace=same)


def test_a_branch_at_the_end_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(EXAMPLES / "ground_vehicles.yaml"), "--duration", "1", "--quiet"]
    monkeypatch.setattr(sys, "argv", ["fame", *command])
    main([*command, "--log", str(tmp_path / "run.mcap")])
    capsys.readouterr()
    for second in ("1", "500"):
        assert main(["view", str(tmp_path / "run.mcap"), "--branch", second, "--no-open"]) == 2
        expected = f"expected a second before the end of the recording at 1 s, got {second}\n"
        assert capsys.readouterr().err.endswith(expected)


@pytest.fixture
def own_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of a scenario whose world names code, which leaves a file `ran` where it is imported."""
    (tmp_path / "porter.bpmn").write_text(PORTER, encoding="utf-8")
    (tmp_path / "world.yaml").write_text("size: [5, 5]\nrobots: {PORTER: {type: 'own.py:Own', at: [2, 2]}}\n")
    code = "from pathlib import Path\nfrom sim2d.robot import robot_class\nPath(__file__).with_name('ran').touch()\n"
    (tmp_path / "own.py").write_text(f"{code}Own = robot_class('carrier')\n")
    (tmp_path / "run.yaml").write_text("model: porter.bpmn\nworld: world.yaml\nduration: 2\n")
    words = ["run", str(tmp_path / "run.yaml"), "--quiet", "--log", str(tmp_path / "run.mcap")]
    monkeypatch.setattr(sys, "argv", ["fame", *words])
    assert main(words) == 1
    (tmp_path / "ran").unlink()
    for name in [name for name in sys.modules if name.startswith("fame_user_own_")]:
        del sys.modules[name]
    return tmp_path


def test_a_branch_names_what_it_runs_before_it_is_imported_and_refuses_what_differs(
    own_code: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["view", str(own_code / "run.mcap"), "--branch", "0.5", "--no-open"]
    capsys.readouterr()
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for name in ("run.yaml", "porter.bpmn", "world.yaml", "own.py"):
        assert f"{own_code / name} (as recorded)" in said
    with (own_code / "own.py").open("a") as file:
        file.write("# other\n")
    assert main([*words, "--yes"]) == 2
    assert f"as they are now: {own_code / 'own.py'} (differs); --changed runs" in capsys.readouterr().err
    assert not (own_code / "ran").exists()


def test_what_a_recording_does_not_have_is_not_compared(own_code: Path) -> None:
    with Recording(own_code / "run.mcap") as recording:
        del recording.attachments["code/own.py"]  # type: ignore[attr-defined]
        files = dict(_compared(recording, _recorded_command(recording)))
        assert files[str(own_code / "own.py")] == "not compared: not in the recording"
        (own_code / "run.yaml").write_text("model: porter.bpmn\n")
        files = dict(_compared(recording, _recorded_command(recording)))
        assert files[str(own_code / "run.yaml")] == "differs"
        assert files["world/world.yaml"] == "recorded, not used now"


# ---- in the browser --------------------------------------------------------------------------------------------------


def test_the_page_follows_a_run_and_controls_it(chromium: Browser, porter: Scenario) -> None:
    with running(porter, RunControl()) as (live, result), opened(chromium, live, has_touch=True) as page:
        until(page, "fame.player.following && fame.store.end > 0")
        page.get_by_role("button", name="With results").tap()
        page.get_by_label("Results").fill("by = Ada")
        page.locator("dialog").get_by_role("button", name="Complete").tap()
        until(page, "[...fame.state.waits.get(0).values()].some((one) => one.element === 'Wait')")
        page.evaluate("fame.control.send({do: 'signal', topic: '/go', robot: 'PORTER', value: ''})")
        until(page, "[...fame.state.waits.get(0).values()].some((one) => one.element === 'Full')")
        until(page, "/load > 3.*not set/s.test(document.querySelector('#inspector').innerText)")
        page.evaluate("fame.control.send({do: 'set', robot: 'PORTER', name: 'load', value: '9'})")
        assert result().status == "completed"
        until(page, "document.querySelector('.chip.completed') !== null")
        page.get_by_role("button", name="Signal").wait_for(state="detached")  # drawn after the chip


def test_a_page_to_which_the_run_has_said_nothing_yet_pauses_it_all_the_same(
    chromium: Browser, porter: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(porter, RunControl(speed=1.0)) as (live, _):
        monkeypatch.setattr(live, "news", lambda known: (known, []))
        with opened(chromium, live) as page:
            page.get_by_role("button", name="Pause").click()
            eventually(lambda: live.control_of_run.paused)


def test_the_page_asks_before_it_branches_and_opens_the_tab_at_once(chromium: Browser, own_code: Path) -> None:
    arguments = parser("view").parse_args(["view", str(own_code / "run.mcap"), "--no-open"])
    with _source(own_code / "run.mcap", arguments) as replay, opened(chromium, replay, has_touch=True) as page:
        page.evaluate("fame.player.seek(0.5e9)")
        page.get_by_role("button", name="Branch here").tap()
        says(page, "dialog[open]", f"{own_code / 'own.py'} as recorded")
        shot(page, "branch")
        page.get_by_role("button", name="Cancel").tap()
        assert not (own_code / "ran").exists()
        page.get_by_role("button", name="Branch here").tap()
        with page.expect_popup() as popup:
            page.get_by_role("button", name="Run", exact=True).tap()
        popup.value.wait_for_url("http://**", timeout=60_000)  # at first it is empty
        until(popup.value, "document.querySelector('.chip.live') !== null && fame.control.status.time === 0.5e9")
        popup.value.get_by_role("button", name="Resume", exact=True).wait_for()


def test_the_page_of_a_branch_shows_its_progress_its_error_and_no_controls(porter: Scenario, chromium: Browser) -> None:
    live = LiveRun(porter, RunControl(pause_at=2 * SECOND))
    with opened(chromium, live) as page:
        until(page, "document.querySelector('progress')?.max === 2e9")
        page.get_by_text("Repeating the run: 0.0 of 2.0 s").wait_for()
        page.get_by_role("button", name="Signal").wait_for(state="detached")
        live.end("failed", "the run again is not the recorded one: at 1 s")
        until(page, "document.querySelector('[role=alert].failure')?.textContent.includes('not the recorded one')")
        assert beyond(page) == []


def test_an_element_that_comes_while_a_mission_is_on_its_way_stays(porter: Scenario, chromium: Browser) -> None:
    with opened(chromium, LiveRun(porter, RunControl())) as page:
        last = "fame.mission.elements.at(-1).id"
        before = page.evaluate(last)
        page.evaluate("fame.load({ ...fame.mission, elements: fame.mission.elements.slice(0, -1) })")
        assert page.evaluate(last) == before


def test_the_page_shows_the_speed_of_the_command_line(porter: Scenario, chromium: Browser) -> None:
    speed = "document.querySelector('select[title=\"Speed of the run\"]').selectedOptions[0].text"
    with running(porter, RunControl(speed=4.0)) as (live, _), opened(chromium, live) as page:
        until(page, f"{speed} === '4\N{MULTIPLICATION SIGN}'")


def test_a_button_stays_under_the_finger_while_the_page_follows_the_run(chromium: Browser, porter: Scenario) -> None:
    since = "document.querySelector('#inspector .waits .quiet').textContent"
    with running(porter, RunControl(speed=1.0)) as (live, _), opened(chromium, live) as page:
        page.get_by_role("button", name="Complete").hover()
        page.mouse.down()
        before = page.evaluate(since)
        until(page, f"{since} !== {before!r}")
        page.mouse.up()
        until(page, "[...fame.state.waits.get(0).values()].some((one) => one.element === 'Wait')")


@pytest.mark.long
def test_the_command_serves_the_page_of_a_run_until_it_is_interrupted(tmp_path: Path) -> None:
    model = tmp_path / "porter.bpmn"
    model.write_text(PORTER, encoding="utf-8")
    words = [
        sys.executable,
        "-m",
        "fame",
        "run",
        str(model),
        "--view",
        "--no-open",
        "--duration",
        "1",
        "--speed",
        "100",
        *("--as", "ann:nurse", "--as", "bob:technician", "--take-over", "technician"),
    ]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address, hers, his = (process.stdout.readline() for _ in range(3))
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\S{24}/\n", address)
        assert re.fullmatch(r"ann \(nurse\): http://127\.0\.0\.1:\d+/\S{24}/\n", hers)
        assert re.fullmatch(r"bob \(technician\): http://127\.0\.0\.1:\d+/\S{24}/\n", his)
        assert len({address.split("/")[-2], hers.split("/")[-2], his.split("/")[-2]}) == 3
        while "The page stays until Ctrl-C" not in process.stderr.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 1


@pytest.mark.long
def test_ctrl_c_ends_the_run_and_says_that_its_page_stays_until_the_next(tmp_path: Path) -> None:
    model = tmp_path / "porter.bpmn"
    model.write_text(PORTER, encoding="utf-8")
    words = [sys.executable, "-m", "fame", "run", str(model), "--view", "--no-open", "--duration", "600"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().strip()
        eventually(lambda: json.load(urlopen(f"{address}mission.json"))["end"])  # it has begun
        process.send_signal(signal.SIGINT)
        said = iter(process.stderr.readline, "")
        assert "its page stays until you press Ctrl-C again" in next(line for line in said if line.strip())
        assert any("The run has ended. The page stays until Ctrl-C." in line for line in said)
        with urlopen(address) as page:
            assert b"fame view" in page.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
