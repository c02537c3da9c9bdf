"""Properties of runs: judged while a mission runs, checked before, and judged again from its logs."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process, properties
from collaborations import text_of

from fame.bpmn import read, read_text
from fame.check import check
from fame.cli import main
from fame.errors import ConfigError, ModelError
from fame.log import Recording
from fame.log.channels import PROPERTIES as CHANGES
from fame.log.judge import judge_log
from fame.log.reading import run_outcomes
from fame.log.recording import RecordedMessage
from fame.properties import parse
from fame.properties.files import read_properties
from fame.properties.judgement import ABSENT
from fame.scenario import Scenario
from fame.scenario.judging import team_vocabulary
from fame.testing import ExpectationError, MissionLoader

pytest_plugins = ["pytester"]

TEAM = {"A": ["timer PT2S", "run x = 3", "throw go", "work"], "B": ["catch go", "timer PT1S", "throw done"]}
PROPERTIES = """\
properties:
  answer:  after A throws /go, B throws /done within 1 s
  late:    after A throws /go, B throws /done within 500 ms
  order:   B throws /done only after A throws /go
  small:   always A.x < 4
  big:     always A.x > 3
  over:    B completes within 3 s
  unasked: after A fails, B completes
  fresh:   B throws /done each time only after A throws /go
"""
WORDS = {
    "answer": "holds", "late": "violated", "order": "holds", "small": "holds", "big": "violated", "over": "holds",
    "unasked": "not triggered", "fresh": "holds",
}  # fmt: skip


DEADLINE = f"""<startEvent id="Start"/><sequenceFlow id="f" sourceRef="Start" targetRef="Wait"/>
<intermediateCatchEvent id="Wait">{properties(deadline="PT1S")}<timerEventDefinition id="t">
<timeDuration>PT2S</timeDuration></timerEventDefinition></intermediateCatchEvent>"""


@pytest.fixture
def team(tmp_path: Path) -> Path:
    """A model of two robots with properties beside it."""
    path = tmp_path / "team.bpmn"
    path.write_text(text_of(TEAM))
    path.with_name("team.properties.yaml").write_text(PROPERTIES)
    return path


def test_a_run_judges_the_properties_beside_its_model(team: Path) -> None:
    result = Scenario.load(team).run()
    found = {each.name: each for each in result.judgements}
    assert {name: each.verdict for name, each in found.items()} == WORDS
    assert (found["answer"].slack, found["small"].slack, found["big"].slack) == (0.0, 1.0, 0.0)
    assert (found["late"].time, found["late"].began) == (2.5, 2.0)
    assert found["late"].text == "A throws /go at 2 s, and not: B throws /done by 2.5 s"
    assert found["big"].text == "at 2 s A.x is 3"
    assert (result.status, result.exit_code) == ("completed", 1)
    reports = [event.detail for event in result.reports if "property" in event.detail]
    assert reports == [f"property {name} is violated: {found[name].text}" for name in ("big", "late")]


def test_a_run_that_is_cut_leaves_properties_pending(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    team.with_name("team.properties.yaml").write_text(
        "properties: {done: B completes within 9 s, low: always A.x < 9}\n"
    )
    assert main(["run", str(team), "--duration", "2.5", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)["properties"]
    assert [(each["property"], each["verdict"], each["time"]) for each in found] == [
        ("done", "pending", 9.0), ("low", "holds", None)
    ]  # fmt: skip
    result = Scenario.load(team, duration=2.5).run()
    held, pending = replace(result, judgements=result.judgements[1:]), replace(result, status="interrupted")
    assert (result.exit_code, pending.exit_code) == (3, 130)
    assert (held.exit_code, replace(held, status="interrupted").exit_code) == (1, 130)  # the mission is not over


def test_a_value_is_judged_as_it_was_before_a_script_changed_it_in_place(team: Path) -> None:
    team.write_text(text_of({"A": ["run v = [99]", "timer PT2S", "run v[0] = 1"], "B": ["timer PT1S"]}))
    team.with_name("team.properties.yaml").write_text("properties: {small: 'always A.v[0] < 50'}")
    (found,) = Scenario.load(team).run().judgements
    assert (found.verdict, found.time) == ("violated", 0)


@pytest.mark.parametrize("change", ["v = float('nan')", "del v", "v = float('inf')"])
def test_a_value_that_is_no_number_any_more_is_judged_alike_in_the_run_and_its_recording(
    team: Path, change: str, capsys: pytest.CaptureFixture[str]
) -> None:
    team.write_text(text_of({"A": ["run v = 1", "timer PT2S", f"run {change}", "timer PT2S"], "B": ["timer PT1S"]}))
    place, log = team.with_name("team.properties.yaml"), team.with_name("run.mcap")
    place.write_text(
        "properties: {small: always A.v < 10, other: always A.v != 3, late: 'after B completes, never A.v == 1'}"
    )
    main(["run", str(team), "--quiet", "--log", str(log)])
    words = [each.verdict for each in Scenario.load(team).run().judgements]
    capsys.readouterr()
    main(["log", "judge", str(place), str(log), "--json"])
    (recorded,) = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["runs"].values()
    assert words == [each["verdict"] for each in recorded]
    assert words[:2] == (["violated", "holds"] if "inf" in change else ["not known"] * 2)


def test_what_cannot_come_any_more_is_violated(team: Path) -> None:
    team.write_text(text_of({"A": ["throw go"], "B": ["catch never"]}))
    team.with_name("team.properties.yaml").write_text("properties:\n  answer: after A throws /go, B completes\n")
    (found,) = Scenario.load(team).run().judgements
    assert (found.verdict, found.time) == ("violated", 0.0)


def test_values_that_nothing_samples_are_not_known(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    team.with_name("team.properties.yaml").write_text("properties:\n  full: always A.battery > 0.1\n")
    assert main(["run", str(team)]) == 3
    assert "full      not known         its values were not sampled" in capsys.readouterr().out
    assert main(["check", str(team)]) == 0
    place = team.with_name("team.properties.yaml")
    assert f"{place}:2: warning: full: can never be judged: A has no battery here" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("sentence", "column", "text"),
    [
        ("Aa completes", 10, "unknown robot or pool 'Aa'; did you mean 'A'?"),
        ("always A.y < 1", 17, "A has no variable 'y'; known are: x, battery"),
        ("always /go.sec > 1", 17, "std_msgs/msg/Empty has no field sec"),
        ("always /gone.sec > 1", 17, "no robot uses topic /gone; did you mean '/done'?"),
    ],
)
def test_a_wrong_property_is_refused(
    team: Path, capsys: pytest.CaptureFixture[str], sentence: str, column: int, text: str
) -> None:
    place = team.with_name("team.properties.yaml")
    place.write_text(f"properties:\n  wrong: {sentence}\n")
    assert main(["run", str(team)]) == 2
    assert f"{place}:2:{column}: properties.wrong: {text}" in capsys.readouterr().err
    assert main(["check", str(team)]) == 1
    assert f"{place}:2:{column}: error: properties.wrong: {text}" in capsys.readouterr().out


@pytest.mark.parametrize("form", ["mcap", "jsonl", "csv"])
def test_a_log_is_judged_as_its_run_was(team: Path, form: str) -> None:
    log = team.with_name(f"run.{form}")
    assert main(["run", str(team), "--quiet", "--log", str(log)]) == 1
    result = Scenario.load(team).run()
    definitions = Scenario.load(team).definitions
    found = judge_log(log, read_properties(team.with_name("team.properties.yaml")), definitions)
    if form == "mcap":
        assert found == list(result.judgements)
    else:
        events = [each for each in result.judgements if each.name not in ("small", "big")]
        assert [each for each in found if each.name not in ("small", "big")] == events
        assert {each.verdict for each in found if each.name in ("small", "big")} == {"not known"}


ONE_ROBOT = """\
  worked: exists A completes "work"
  again:  A starts "work" at most 1 times
  soon:   after A starts "work", A completes "work" within 1 ms
"""
CARRIED = {
    ".xes": {"worked", "again", "soon"},  # activities alone
    ".ocel.json": {"answer", "late", "order", "over", "unasked", "fresh", "worked", "again", "soon"},
}


@pytest.mark.parametrize(("form", "level"), [(".xes", ()), (".ocel.json", ()), (".ocel.json", ("--level", "all"))])
def test_what_a_log_for_process_mining_carries_is_judged_as_its_run_was(
    team: Path, form: str, level: tuple[str, ...]
) -> None:
    with team.with_name("team.properties.yaml").open("a") as file:
        file.write(ONE_ROBOT)
    recording, log = team.with_name("run.mcap"), team.with_name(f"run{form}")
    main(["run", str(team), "--quiet", "--log", str(recording)])
    assert main(["log", "convert", str(recording), "-o", str(log), *level]) == 0
    made = read_properties(team.with_name("team.properties.yaml"))
    live = {one.name: one for one in judge_log(recording, made)}
    found = {one.name: one for one in judge_log(log, made, read(team))}
    assert {name for name, one in found.items() if one.verdict != "not known"} == CARRIED[form]
    assert [found[name] for name in CARRIED[form]] == [live[name] for name in CARRIED[form]]
    assert all(one.text for one in found.values() if one.verdict == "not known")


def judged(
    folder: Path, team: dict[str, list[Any]], properties: str, forms: Sequence[str], *options: str
) -> Iterator[tuple[str, dict[str, str]]]:
    """The verdicts of a run, and those from each of its logs, by the form of the log."""
    model, run, place = folder / "m.bpmn", folder / "run.mcap", folder / "m.properties.yaml"
    model.write_text(text_of(team))
    place.write_text(f"properties:\n{properties}")
    main(["run", str(model), "--quiet", "--log", str(run), *options])
    made, definitions = read_properties(place), read(model)
    with Recording(run) as recording:
        yield "run", {one["property"]: one["verdict"] for one in recording.verdicts}
    for form in forms:
        log = folder / f"run.{form}"
        if form != "mcap":
            assert main(["log", "convert", str(run), "-o", str(log)]) == 0
        yield form, {one.name: one.verdict for one in judge_log(log, made, definitions)}


LOGS = ("mcap", "jsonl", "csv", "ocel.json", "xes")
ENDS = {"A": [("and", ["work"], ["catch go", "stop"])], "B": ["timer PT0.5S", "throw go"]}


def test_what_is_cancelled_in_the_last_instant_is_judged_unless_the_run_was_stopped(tmp_path: Path) -> None:
    never = '  never_so: never A is cancelled at "work"\n'
    for form, found in judged(tmp_path, ENDS, never, LOGS):
        assert found == {"never_so": "violated"}, form
    for form, found in judged(tmp_path, ENDS, never, LOGS, "--duration", "0.25"):
        assert found == {"never_so": "holds"}, form


def test_what_happens_in_one_instant_has_no_order_in_logs_for_process_mining(tmp_path: Path) -> None:
    between = {"A": [("scope", ["throw s", "catch t"], "u", ["end"])], "B": ["catch s", "run x = 1", "throw t"]}
    scope, script = (next(iter(re.findall(name, text_of(between)))) for name in (r"A_scope_\d+", r"B_script_\d+"))
    sentence = f"  alone: after A starts {scope} until A completes {scope}, never B starts {script}\n"
    for form, found in judged(tmp_path, between, sentence, LOGS):
        assert found == {"alone": "not known" if form == "xes" else "violated"}, form
    ended = {"A": ["throw go"], "B": ["catch go", "work"]}
    for form, found in judged(tmp_path, ended, '  still: after A completes, never B starts "work"\n', LOGS[:-1]):
        assert found["still"] == ("not known" if form == "ocel.json" else "violated"), form


def test_robots_whose_beginning_a_log_does_not_have_are_not_known(tmp_path: Path) -> None:
    properties = '  idle: never A starts "work"\n  soon: A completes within 9 s\n'
    runs = judged(tmp_path, {"A": ["work"], "B": ["work"]}, properties, ["jsonl"])
    assert [found for _, found in runs] == [{"idle": "violated", "soon": "holds"}] * 2
    log, made = tmp_path / "run.jsonl", read_properties(tmp_path / "m.properties.yaml")
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(line for line in lines if '"what": "start"' not in line))
    words = [one.verdict for one in judge_log(log, made, read(tmp_path / "m.bpmn"))]
    assert words == ["violated", "not known"]


def test_a_property_of_robots_that_are_not_there_is_not_known(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(text_of({"T": ["work"], "B": ["work"]}, several=["T"]))
    place = tmp_path / "m.properties.yaml"
    place.write_text(
        'properties:\n  none: never T_9 starts "work"\n  some: never some T_9 starts "work"\n  all: T starts "work"\n'
    )
    found = {one.name: (one.verdict, one.text) for one in Scenario.load(tmp_path / "m.bpmn").run().judgements}
    assert found == {"none": ("not known", ABSENT), "some": ("not known", ABSENT), "all": ("holds", "")}
    assert main(["check", "--explore", str(tmp_path / "m.bpmn")]) == 3
    (tmp_path / "empty.jsonl").write_text("")
    assert main(["log", "judge", str(place), str(tmp_path / "empty.jsonl")]) == 3
    place.write_text("properties:\n  wrong: never t_1 completes\n")
    with pytest.raises(ConfigError, match="unknown robot or pool 't_1'; did you mean 'T_1'"):
        Scenario.load(tmp_path / "m.bpmn").run()


@pytest.mark.parametrize("form", ["xes", "ocel.json"])
@pytest.mark.parametrize("text", ["", "{}", "<log/>", '{"objects": [], "events": [3]}', "<log><trace/></log>"])
def test_a_file_that_is_no_such_log_is_refused_or_says_nothing(team: Path, form: str, text: str) -> None:
    log = team.with_name(f"run.{form}")
    log.write_text(text)
    assert main(["log", "judge", str(team.with_name("team.properties.yaml")), str(log)]) in (2, 3)


ROWS = "time,robot,what,element,instance\n0.0,A,start,P_A,1\n0.5,A,enter,x,1\n"


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ("0.25,A,leave,x,1", "4: time 0.25 comes after 0.5: expected the events of a robot in their order"),
        ("1.0,A,ENTER,x,1", "4: unknown what 'ENTER'; did you mean 'enter'?"),
        ("1.0,A,leave,x", "4: expected 5 cells, got 4"),
        ("1.0,A,leave,x,1,1,1", "4: expected 5 cells, got 7"),
        ("inf,A,leave,x,1", "4: the time is inf: expected seconds"),
    ],
)
def test_a_log_with_rows_that_cannot_be_is_refused(
    team: Path, rows: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log = team.with_name("run.csv")
    log.write_text(f"{ROWS}{rows}\n")
    assert main(["log", "judge", str(team.with_name("team.properties.yaml")), str(log)]) == 2
    assert f"run.csv:{text}" in capsys.readouterr().err


def test_a_log_has_the_robots_one_after_another_or_its_objects_in_any_order(team: Path) -> None:
    made, definitions = read_properties(team.with_name("team.properties.yaml")), read(team)
    for form in ("jsonl", "ocel.json"):
        run, log = team.with_name("run.mcap"), team.with_name(f"run.{form}")
        main(["run", str(team), "--quiet", "--log", str(run)])
        assert main(["log", "convert", str(run), "-o", str(log)]) == 0
        expected = judge_log(log, made, definitions)
        if form == "jsonl":
            lines = log.read_text().splitlines(keepends=True)
            log.write_text("".join(sorted(lines, key=lambda line: json.loads(line).get("robot", "~"), reverse=True)))
        else:
            data = json.loads(log.read_text())
            log.write_text(json.dumps({**data, "events": data["events"][::-1]}))
        found = {one.name: one.verdict for one in judge_log(log, made, definitions)}
        assert found == {one.name: one.verdict for one in expected}, form


def test_ocel_with_an_id_twice_is_refused_and_a_log_without_events_says_nothing(tmp_path: Path) -> None:
    properties = '  twice: A starts "work" at most 1 times\n  idle: never B starts "work"\n'
    runs = dict(judged(tmp_path, {"A": ["work"], "B": ["work"]}, properties, ("ocel.json", "xes")))
    assert runs["ocel.json"] == {"twice": "holds", "idle": "violated"}
    made, definitions = read_properties(tmp_path / "m.properties.yaml"), read(tmp_path / "m.bpmn")
    ocel, xes = tmp_path / "run.ocel.json", tmp_path / "run.xes"
    data = json.loads(ocel.read_text())
    ocel.write_text(json.dumps({**data, "events": [*data["events"], data["events"][0]]}))
    with pytest.raises(ConfigError, match="has several events 'e1': expected unique ids"):
        judge_log(ocel, made, definitions)
    ocel.write_text(json.dumps({**data, "events": []}))
    xes.write_text(re.sub(r"<event>.*?</event>", "", xes.read_text(), flags=re.DOTALL))
    for log in (ocel, xes):
        assert {one.verdict for one in judge_log(log, made, definitions)} == {"not known"}, log


def test_the_command_judges_a_folder_of_logs(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one.mcap", "two.mcap"):
        main(["run", str(team), "--quiet", "--log", str(team.parent / "logs" / name)])
    capsys.readouterr()
    assert main(["log", "judge", str(team.with_name("team.properties.yaml")), str(team.parent / "logs")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["run", "property", "verdict", "slack", "why"]
    assert len(lines) == 1 + 2 * len(WORDS)
    assert main(["log", "judge", str(team), str(team.parent / "logs")]) == 2


def test_every_log_has_the_violations(team: Path) -> None:
    log = team.with_name("run.jsonl")
    main(["run", str(team), "--quiet", "--log", str(log)])
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(row["time"], row["robot"]) for row in rows if str(row.get("detail")).startswith("property late is")] == [
        (3.0, "A")
    ]


@pytest.mark.parametrize(("suspended", "word", "slack"), [(2.5, "holds", 1.0), (8, "violated", None)])
def test_a_deadline_runs_on_while_its_robot_is_suspended(
    tmp_path: Path, suspended: float, word: str, slack: float | None
) -> None:
    (tmp_path / "sign.bpmn").write_text(process(f'<userTask id="Sign">{properties(deadline="PT5S")}</userTask>'))
    mission = MissionLoader(lambda: tmp_path / "saved").load(tmp_path / "sign.bpmn")
    hand = mission.advance(1).take_over("P")
    mission.advance(suspended)
    hand.resume()
    mission.advance(0.5).complete("Sign")
    judgement = mission.expect_property("deadline_Sign").judgement
    assert (judgement.verdict, judgement.slack) == (word, slack)  # 4 s after it was entered, or 5 s, in the suspension
    assert judgement.time == (5.0 if word == "violated" else None)


@pytest.mark.parametrize("form", ["mcap", "jsonl"])
def test_a_drawing_of_a_run_shows_the_element_whose_deadline_broke(tmp_path: Path, form: str) -> None:
    part = read_text(process(DEADLINE), file="slow.bpmn")
    model, log = tmp_path / "slow.bpmn", tmp_path / f"slow.{form}"
    model.write_bytes(part.source)
    assert main(["run", str(model), "--quiet", "--log", str(log)]) == 1
    found = run_outcomes(log, part)
    assert found.tallies["Wait"]["violated"] == 1
    assert found.notes(part)[-1].startswith('property deadline_Wait is violated: P starts "Wait" at 0 s')


def test_where_values_break_an_annotation_the_elements_are_marked_that_it_is_associated_with(
    team: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    note = """<textAnnotation id="N"><text>property low: always A.x &lt; 3</text></textAnnotation>
      <association id="X" sourceRef="B_throw_done_6" targetRef="N"/>"""
    team.write_text(text_of(TEAM).replace("</collaboration>", f"{note}</collaboration>"))
    team.with_name("team.properties.yaml").unlink()
    log = team.with_name("run.mcap")
    assert main(["run", str(team), "--json", "--log", str(log)]) == 1
    (found,) = json.loads(capsys.readouterr().out)["properties"]
    assert (found["verdict"], found["elements"]) == ("violated", [["B", "B_throw_done_6"]])
    assert run_outcomes(log, read(team)).tallies["B_throw_done_6"]["violated"] == 1
    with Recording(log) as recording:
        (declared,) = (one for one in map(RecordedMessage.json, recording.messages([CHANGES])) if "names" in one)
    assert declared["names"] == [["B", "B_throw_done_6"]]  # which the page outlines


def test_a_test_expects_properties(team: Path, tmp_path: Path) -> None:
    mission = MissionLoader(lambda: tmp_path / "saved").load(team)
    mission.advance(2.2)
    assert mission.expect_property("order").holds(vacuous=True).judgement.verdict == "not triggered"
    with pytest.raises(ExpectationError, match="expected property answer to hold: property answer is pending"):
        mission.expect_property("answer").holds()
    mission.advance(5)
    mission.expect_property("answer").holds()
    with pytest.raises(ConfigError, match="judges no property 'anwser'; did you mean 'answer'"):
        mission.expect_property("anwser")
    with pytest.raises(ExpectationError, match="property big is violated: at 2 s"):
        mission.check_properties()
    mission.expect_property("big").is_violated()
    mission.expect_property("late").is_violated()
    mission.check_properties()
    mission.close()


def test_a_test_that_violates_a_property_fails(team: Path, pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        f"""
        def test_nothing_is_said(mission):
            mission.load({str(team)!r}).advance(5)

        def test_it_is_expected(mission):
            m = mission.load({str(team)!r})
            m.advance(5)
            m.expect_property("late").is_violated()
            m.expect_property("big").is_violated()
        """
    )
    result = pytester.runpytest("-p", "no:randomly")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*property late is violated: A throws /go at 2 s, and not: B throws /done by 2.5 s*"])


UNANSWERED = "properties: {answer: 'after A throws /go, B throws /done', full: always A.battery > 0.1}"


def test_a_test_fails_if_what_has_not_come_cannot_come_any_more(team: Path, pytester: pytest.Pytester) -> None:
    tasks = {"A": ["throw go", "timer PT1S", "throw out"], "B": ["catch go", "catch no", "throw done"]}
    team.write_text(text_of(tasks))
    team.with_name("team.properties.yaml").write_text(UNANSWERED)
    pytester.makepyfile(
        f"""
        from hypothesis import given, strategies
        from fame.testing.strategies import load

        def test_stuck(mission):
            mission.load({str(team)!r}).advance(5)

        def test_over(mission):
            m = mission.load({str(team)!r})
            m.fault("B", "engine").advance(5)

        @given(strategies.just(1))
        def test_case(one):
            with load({str(team)!r}) as m:
                m.advance(5)

        def test_it_is_expected(mission):
            m = mission.load({str(team)!r})
            m.advance(5).expect_property("answer").is_violated()

        def test_a_part(mission):
            mission.load({str(team)!r}).advance(0.5)

        def test_by_hand(mission):
            mission.by_hand({str(team)!r}).advance(0)
        """
    )
    result = pytester.runpytest("-p", "no:randomly", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, failed=3)
    text = "property answer is violated: A throws /go at 0 s, and not: B throws /done by"
    result.stdout.fnmatch_lines(
        [
            f"*{text} 5 s", f"*{text} 5 s", f"*{text} 5 s",
            "*properties not decided*",
            "*::test_it_is_expected: property full is not known: its values were not sampled",
            "*::test_a_part: property answer is pending: A throws /go at 0 s, and not: B throws /done",
            "*::test_a_part: property full is not known: its values were not sampled",
            "*::test_by_hand: property answer is pending: A throws /go at 0 s, and not: B throws /done",
            "*::test_by_hand: property full is not known: its values were not sampled",
        ]
    )  # fmt: skip


def test_kept_expectations_are_of_how_a_property_is_judged_now(team: Path, tmp_path: Path) -> None:
    mission = MissionLoader(lambda: tmp_path / "saved").load(team)
    late = mission.advance(1).expect_property("late").holds(vacuous=True)
    mission.advance(5).expect_property("big")
    with pytest.raises(ExpectationError, match="expected property late to hold"):
        late.holds(vacuous=True)
    late.is_violated()
    mission.check_properties()
    mission.close()


def test_a_property_that_held_and_is_violated_later_fails_the_test(team: Path, tmp_path: Path) -> None:
    mission = MissionLoader(lambda: tmp_path / "saved").load(team)
    mission.advance(1).expect_property("late").holds(vacuous=True)
    mission.advance(5).expect_property("big").is_violated()
    with pytest.raises(ExpectationError, match="property late is violated: A throws /go at 2 s"):
        mission.check_properties()
    mission.close()


@pytest.mark.parametrize(("deadline", "verdict"), [("PT2S", "holds"), ("PT1.5S", "violated")])
def test_a_deadline_is_drawn(tmp_path: Path, deadline: str, verdict: str) -> None:
    wait = '<timerEventDefinition id="d"><timeDuration>PT2S</timeDuration></timerEventDefinition>'
    event = f'<intermediateCatchEvent id="t" name="Rest">{properties(deadline=deadline)}{wait}</intermediateCatchEvent>'
    path = tmp_path / "m.bpmn"
    path.write_text(process(f'<startEvent id="s"/>{event}<sequenceFlow id="f" sourceRef="s" targetRef="t"/>'))
    (found,) = Scenario.load(path).run().judgements
    assert (found.name, found.verdict) == ("deadline_t", verdict)
    assert not [finding for finding in check(path) if "deadline" in str(finding)]


def test_what_is_set_as_the_mission_ends_is_judged(tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(text_of({"A": ["run n = 0", "timer PT2S", "run n = 5"], "B": ["timer PT1S"]}))
    path.with_name("m.properties.yaml").write_text("properties:\n  low: always A.n < 5\n")
    (found,) = Scenario.load(path).run().judgements
    assert (found.verdict, found.time) == ("violated", 2)
    log = tmp_path / "run.mcap"
    assert main(["run", str(path), "--quiet", "--log", str(log)]) == 1
    team = team_vocabulary(Scenario.load(path))
    (again,) = judge_log(log, Scenario.load(path).properties, team=team)
    assert (again.verdict, again.time) == ("violated", 2)


@pytest.mark.parametrize(("times", "verdict"), [("[1, 5]", "violated"), ("[1, 3]", "holds")])
def test_a_deadline_counts_for_each_instance_of_an_activity(tmp_path: Path, times: str, verdict: str) -> None:
    wait = '<timerEventDefinition id="d"><timeDuration>PT${pause}S</timeDuration></timerEventDefinition>'
    path = tmp_path / "m.bpmn"
    path.write_text(
        process(
            f"""<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
            <subProcess id="t">{properties(deadline="PT3S")}<multiInstanceLoopCharacteristics id="mi"
            camunda:collection="${{{times}}}" camunda:elementVariable="pause"/>
            <startEvent id="a"/><sequenceFlow id="g" sourceRef="a" targetRef="c"/>
            <intermediateCatchEvent id="c">{wait}</intermediateCatchEvent></subProcess>"""
        )
    )
    (found,) = Scenario.load(path).run().judgements
    assert (found.name, found.verdict) == ("deadline_t", verdict)


def test_which_of_two_tokens_left_an_activity_is_not_known(tmp_path: Path) -> None:
    """The deadline is kept if the first one left first; both were in it for 5 s otherwise."""
    wait = '<timerEventDefinition id="d"><timeDuration>PT3S</timeDuration></timerEventDefinition>'
    event = f'<intermediateCatchEvent id="t">{properties(deadline="PT4S")}{wait}</intermediateCatchEvent>'
    pause = f'<intermediateCatchEvent id="p">{wait.replace("3", "2")}</intermediateCatchEvent>'
    ends = [("s", "g"), ("g", "t"), ("g", "p"), ("p", "t")]
    flows = "".join(
        f'<sequenceFlow id="f{n}" sourceRef="{one}" targetRef="{other}"/>' for n, (one, other) in enumerate(ends)
    )
    path = tmp_path / "m.bpmn"
    path.write_text(process(f'<startEvent id="s"/><parallelGateway id="g"/>{event}{pause}{flows}'))
    (found,) = Scenario.load(path).run().judgements
    assert (found.verdict, found.slack) == ("not known", -1)
    assert found.text == "several started before one ended, and nobody knows which of them did"


def test_a_deadline_that_is_no_duration_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(process(f'<startEvent id="s">{properties(deadline="soon")}</startEvent>'))
    with pytest.raises(ModelError, match=r"m.bpmn:\d+: s: expected a duration as deadline, as in PT5S, got 'soon'"):
        Scenario.load(path)
    assert main(["check", str(path)]) == 1


def test_a_deadline_that_a_template_leaves_empty_is_none(tmp_path: Path) -> None:
    part = read_text(process(DEADLINE.replace("PT1S", " ")), file="empty.bpmn")
    path = tmp_path / "empty.bpmn"
    path.write_bytes(part.source)
    assert Scenario.load(path).properties == ()


def test_a_text_annotation_is_a_property(team: Path) -> None:
    note = """<textAnnotation id="N"><text>property soon:
      after A throws /go, B throws /done within 2 s</text></textAnnotation>
      <association id="X" sourceRef="B_throw_done_4" targetRef="N"/>"""
    team.write_text(text_of(TEAM).replace("</collaboration>", f"{note}</collaboration>"))
    result = Scenario.load(team).run()
    assert {each.name: each.verdict for each in result.judgements} == {**WORDS, "soon": "holds"}
    (annotation,) = Scenario.load(team).definitions.artifacts
    assert annotation.about == ("B_throw_done_4",)
    team.write_text(team.read_text().replace("B throws", "C throws"))
    with pytest.raises(ConfigError, match=r"properties.soon: unknown robot or pool 'C'"):
        Scenario.load(team).run()


@pytest.mark.parametrize(("due", "named"), [("PT5S", {"deadline_T"}), ("2026-11-26T10:00:00", set())])
def test_a_due_date_that_is_a_duration_is_a_deadline(tmp_path: Path, due: str, named: set[str]) -> None:
    path = tmp_path / "due.bpmn"
    path.write_text(process(f'<userTask id="T" camunda:dueDate="{due}"/>'))
    assert {each.name for each in Scenario.load(path).properties} == named


def test_what_is_violated_only_as_two_clocks_stand_is_not_known(team: Path) -> None:
    log, names = team.with_name("run.mcap"), team_vocabulary(Scenario.load(team))
    assert main(["run", str(team), "--quiet", "--log", str(log)]) == 1
    given = [parse(f"never {one}", name="given") for one in ("A throws /go before B throws /done", "A throws /go")]
    apart = [[each.verdict for each in judge_log(log, given, team=names, apart=ns)] for ns in (0, 10**8, 10**10)]
    assert apart == [["violated", "violated"], ["violated", "violated"], ["not known", "violated"]]
