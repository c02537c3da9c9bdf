"""Recordings are converted to the logs that a run writes itself, and to OCEL 2.0."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from bpmn_text import document, properties
from collaborations import text_of
from mcap.records import Channel, Schema
from recorded_runs import record

from fame.bpmn import read
from fame.cli import main
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.log import logging_to
from fame.log.elements import element_info
from fame.log.judge import judge_log
from fame.log.merging import merge
from fame.log.reading import rows_of
from fame.log.recording import Recording
from fame.log.recording_file import RecordingFile
from fame.log.xes_reading import read_foreign_xes
from fame.mining.xes import xes
from fame.properties.files import read_properties
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.robot.events import Event, combine_observers
from fame.scenario import Scenario

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the logs and the recording of one run of the agriculture example."""
    folder = tmp_path_factory.mktemp("run")
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=40)
    files = scenario.closures()
    with (
        logging_to(folder / "run.mcap", files) as mcap,
        logging_to(folder / "run.jsonl", files) as jsonl,
        logging_to(folder / "run.csv", files) as csv,
        logging_to(folder / "run.xes", files) as xes,
    ):
        scenario.run(observer=combine_observers([mcap, jsonl, csv, xes]))
    return folder


def converted(run: Path, suffix: str) -> Path:
    target = run / f"converted{suffix}"
    assert main(["log", "convert", str(run / "run.mcap"), "-o", str(target)]) == 0
    return target


@pytest.mark.parametrize("suffix", [".jsonl", ".csv"])
def test_every_line_is_that_of_the_runs_own_log(run: Path, suffix: str) -> None:
    # Within one instant a recording has the events robot by robot.
    written, own = converted(run, suffix).read_text(), (run / f"run{suffix}").read_text()
    assert sorted(written.splitlines()) == sorted(own.splitlines())


def test_the_traces_are_those_of_the_runs_own_log(run: Path) -> None:
    written, own = converted(run, ".xes").read_text(), (run / "run.xes").read_text()
    assert sorted(written.split("<trace>")) == sorted(own.split("<trace>"))


def verdicts(log: Path) -> dict[str, tuple[str, float | None]]:
    """Property -> verdict and slack, as each form of log has them."""
    if log.name.endswith(".ocel.json"):
        objects = [one for one in json.loads(log.read_text())["objects"] if one["type"] == "property"]
        values = {one["id"]: {each["name"]: each["value"] for each in one["attributes"]} for one in objects}
        return {id.removeprefix("property:"): (one["verdict"], one.get("slack")) for id, one in values.items()}
    if log.suffix == ".xes":
        found = [one for one in ElementTree.parse(log).getroot() if one.get("key", "").startswith("property:")]
        slacks = [[float(each.attrib["value"]) for each in one if each.get("key") == "slack"] for one in found]
        names = [(one.attrib["key"].removeprefix("property:"), one.attrib["value"]) for one in found]
        return {name: (word, next(iter(slack), None)) for (name, word), slack in zip(names, slacks, strict=True)}
    with rows_of(log) as rows:
        details = [row["detail"] for row in rows if row["what"] == "verdict"]
    judged = [json.loads(each) if log.suffix == ".csv" else each for each in details]
    return {one["property"]: (one["verdict"], one["slack"]) for one in judged}


@pytest.mark.long
def test_every_log_has_the_verdicts_about_properties(tmp_path: Path) -> None:
    properties = [
        "apart: always distance(any two Tractor) > 0.5",
        'late: after Drone throws /weed_found, some Tractor starts "Go To" within 1 s',
        "seldom: after Tractor fails, Drone completes within 5 s",
    ]
    (tmp_path / "p.properties.yaml").write_text("properties:\n" + "".join(f"  {each}\n" for each in properties))
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=40)
    scenario = replace(scenario, properties=read_properties(tmp_path / "p.properties.yaml"))
    files = scenario.closures()
    with ExitStack() as stack:
        logs = [
            stack.enter_context(logging_to(tmp_path / f"run.{form}", files)) for form in ("mcap", "jsonl", "csv", "xes")
        ]
        result = scenario.run(observer=combine_observers(logs))
    expected = {one.name: (one.verdict, one.slack) for one in result.judgements}
    assert {verdict for verdict, _ in expected.values()} >= {"violated", "not triggered"}
    with Recording(tmp_path / "run.mcap") as recording:
        assert [one.to_json() for one in result.judgements] == recording.verdicts
    for form in ("jsonl", "csv", "xes", "ocel.json"):
        assert verdicts(converted(tmp_path, f".{form}")) == expected, form
    for form in ("jsonl", "csv", "xes"):
        assert verdicts(tmp_path / f"run.{form}") == expected, form


ORDERS = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:camunda="http://camunda.org/schema/1.0/bpmn">
  <process id="Pack_Orders" isExecutable="true">
    <startEvent id="s"/>
    <scriptTask id="read" scriptFormat="python"><script>orders = [[7, ["a", "b"]], [8, ["c"]]]</script></scriptTask>
    <subProcess id="order" name="Order">
      <multiInstanceLoopCharacteristics camunda:collection="orders" camunda:elementVariable="each"/>
      <startEvent id="s2"/>
      <scriptTask id="take" scriptFormat="python"><script>order_id, parcels = each</script></scriptTask>
      <scriptTask id="pack" name="Pack" scriptFormat="python">
        <multiInstanceLoopCharacteristics camunda:collection="parcels" camunda:elementVariable="parcel"/>
        <script>await sleep(1)</script>
      </scriptTask>
      <task id="close" name="Close"/>
      <endEvent id="e2"/>
      <sequenceFlow id="f3" sourceRef="s2" targetRef="take"/>
      <sequenceFlow id="f4" sourceRef="take" targetRef="pack"/>
      <sequenceFlow id="f5" sourceRef="pack" targetRef="close"/>
      <sequenceFlow id="f6" sourceRef="close" targetRef="e2"/>
    </subProcess>
    <endEvent id="e"/>
    <sequenceFlow id="f0" sourceRef="s" targetRef="read"/>
    <sequenceFlow id="f1" sourceRef="read" targetRef="order"/>
    <sequenceFlow id="f2" sourceRef="order" targetRef="e"/>
  </process>
</definitions>
"""

SCHEMA = json.loads((Path(__file__).parent / "ocel2_schema.json").read_text())


def test_ocel_is_valid_by_the_schema_of_its_specification(run: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    log = json.loads(converted(run, ".ocel.json").read_text())
    validator = jsonschema.Draft202012Validator(SCHEMA, format_checker=jsonschema.FormatChecker())
    assert not [error.message for error in validator.iter_errors(log)]
    del log["events"][0]["time"]
    log["eventTypes"][0]["attributes"].append({"name": "n", "type": "text"})
    assert len(list(validator.iter_errors(log))) == 2


@pytest.mark.long
def test_ocel_has_what_the_mission_shows_unless_all_is_asked_for(run: Path) -> None:
    scenario, logs = Scenario.load(EXAMPLES / "agriculture.yaml", duration=40), {}
    everything = record(scenario, run / "all.mcap", topics="all")
    for level in ("mission", "all"):
        target = run / f"{level}.ocel.json"
        assert main(["log", "convert", str(everything), "-o", str(target), "--level", level]) == 0
        logs[level] = json.loads(target.read_text())
    drawn = {id for id, info in element_info([read("models/agriculture.bpmn")]).items() if info.name or info.activity}
    found = {
        level: {each["value"] for event in log["events"] for each in event["attributes"] if each["name"] == "element"}
        for level, log in logs.items()
    }
    assert found["mission"] == found["all"] & drawn != found["all"]
    sent = {level: {each["id"] for each in log["objects"] if each["type"] == "signal"} for level, log in logs.items()}
    assert any("/odom#" in id for id in sent["all"])
    topics = {id.split("#")[0].removeprefix("signal:/") for id in sent["mission"]}
    assert topics == {"weed_found", "weed_position", "tractor_position", "closest_tractor"}
    assert len(json.dumps(logs["mission"])) < len(json.dumps(logs["all"])) / 10


def test_ocel_declares_what_it_uses(run: Path) -> None:
    log = json.loads(converted(run, ".ocel.json").read_text())
    assert log.keys() == {"objectTypes", "eventTypes", "objects", "events"}
    declared: dict[str, dict[str, dict[str, str]]] = {}
    for kind in ("objectTypes", "eventTypes"):
        declared[kind] = {}
        for each in log[kind]:
            assert each.keys() == {"name", "attributes"}
            declared[kind][each["name"]] = {one["name"]: one["type"] for one in each["attributes"]}
            assert {one["type"] for one in each["attributes"]} <= {"string", "time", "integer", "float", "boolean"}
        assert len(declared[kind]) == len(log[kind])
    ids = {each["id"] for each in log["objects"]}
    assert len(ids) == len(log["objects"])
    assert len({each["id"] for each in log["events"]}) == len(log["events"])
    for each in log["objects"]:
        check(each, declared["objectTypes"], ids, {"id", "type", "attributes", "relationships"})
        for attribute in each["attributes"]:
            assert datetime.fromisoformat(attribute["time"]).tzinfo is not None
    for each in log["events"]:
        check(each, declared["eventTypes"], ids, {"id", "type", "time", "attributes", "relationships"})
        assert datetime.fromisoformat(each["time"]).tzinfo is not None
        assert each["relationships"]


def check(each: dict[str, Any], types: dict[str, dict[str, str]], ids: set[str], keys: set[str]) -> None:
    """The rules that objects and events share."""
    assert each.keys() == keys
    assert isinstance(each["id"], str)
    assert each["type"] in types
    for attribute in each["attributes"]:
        assert attribute["name"] in types[each["type"]]
        assert isinstance(attribute["value"], {"string": str, "float": float}[types[each["type"]][attribute["name"]]])
    for related in each["relationships"]:
        assert related.keys() == {"objectId", "qualifier"}
        assert related["objectId"] in ids


def test_signals_relate_the_robots_that_sent_and_received_them(run: Path) -> None:
    log = json.loads(converted(run, ".ocel.json").read_text())
    roles: dict[str, set[tuple[str, str]]] = {}
    for event in log["events"]:
        if event["type"] in ("signal sent", "signal received"):
            signal = next(one["objectId"] for one in event["relationships"] if one["qualifier"] == "signal")
            roles.setdefault(signal, set()).update(
                (one["qualifier"], one["objectId"]) for one in event["relationships"]
            )
    of_weeds = [found for signal, found in roles.items() if "/weed_position#" in signal]
    assert of_weeds
    assert all(("sender", "robot:Drone") in found for found in of_weeds)
    types = {each["id"]: each["type"] for each in log["objects"]}
    assert {"robot", "instance", "signal"} <= set(types.values())


def event(tag: str, id: str, definition: str = '<signalEventDefinition signalRef="S"/>', inner: str = "") -> str:
    tag, _, attributes = tag.partition(" ")
    return f'<{tag} id="{id}" name="{id}" {attributes}>{inner}{definition}</{tag}>'


def chain(*ids: str) -> str:
    return "".join(
        f'<sequenceFlow id="{one}_{other}" sourceRef="{one}" targetRef="{other}"/>' for one, other in pairwise(ids)
    )


def pause(id: str, seconds: float) -> str:
    length = f"<timerEventDefinition><timeDuration>PT{seconds}S</timeDuration></timerEventDefinition>"
    return event("intermediateCatchEvent", id, length)


THROWS = "".join(event("intermediateThrowEvent", f"t{number}") for number in range(4))
WAITS = '<startEvent id="s"/><userTask id="u"/>' + chain("s", "u")
CATCHES = {
    "intermediate": (
        '<startEvent id="s"/>' + "".join(event("intermediateCatchEvent", id) for id in "ab") + chain("s", "a", "b"),
        ["a: 0", "b: 1"],
    ),
    "boundary": (
        WAITS + event('boundaryEvent attachedToRef="u" cancelActivity="false"', "b"),
        ["b: 0", "b: 1", "b: 2", "b: 3"],
    ),
    "event sub-process": (
        f"""{WAITS}<subProcess id="h" triggeredByEvent="true">
            {event('startEvent isInterrupting="false"', "c")}</subProcess>""",
        ["c: 0", "c: 1", "c: 2", "c: 3"],
    ),
    "start": (event("startEvent", "c"), ["c: 0", "c: 1", "c: 2", "c: 3"]),
    "queue": (
        f"""<startEvent id="s"/>{pause("w", 1.5)}
            {event("intermediateCatchEvent", "a", inner=properties(queue="2"))}{event("intermediateCatchEvent", "b")}
            {chain("s", "w", "a", "b")}""",
        ["a: 1", "b: 3"],  # 0 is no longer kept, and none that came before at b
    ),
}


@pytest.mark.parametrize("kind", CATCHES)
def test_every_kind_of_event_receives_the_signals_that_it_takes(kind: str, tmp_path: Path) -> None:
    """Two signals at 0 s, one at 1 s, one at 2 s. What is sent stands before what it causes, behind what causes it."""
    catches, expected = CATCHES[kind]
    sends = f"""<process id="P" isExecutable="true"><startEvent id="s0"/>{THROWS}{pause("w1", 1)}{pause("w2", 1)}
        <scriptTask id="x" name="x"><script>pass</script></scriptTask>
        {chain("s0", "x", "t0", "t1", "w1", "t2", "w2", "t3")}</process>"""
    pools = '<participant id="A" name="A" processRef="P"/><participant id="B" name="B" processRef="Q"/>'
    model = document(
        f"""<collaboration id="C">{pools}</collaboration>{sends}
            <process id="Q" isExecutable="true">{catches}</process><signal id="S" name="go"/>"""
    )
    (tmp_path / "m.bpmn").write_text(model)
    record(Scenario.load(tmp_path / "m.bpmn", duration=5), tmp_path / "run.mcap")
    log = json.loads(converted(tmp_path, ".ocel.json").read_text())
    sent = [one["id"] for one in log["objects"] if one["type"] == "signal"]
    assert len(sent) == 4
    found, kinds = [], [one["type"] for one in log["events"]]
    for number, one in enumerate(log["events"]):
        if one["type"] == "signal received":
            (signal,) = (each["objectId"] for each in one["relationships"] if each["qualifier"] == "signal")
            found.append(f"{kinds[number + 1]}: {sent.index(signal)}")
            throw = next(
                place for place, each in enumerate(log["events"]) if each["relationships"][0]["objectId"] == signal
            )
            assert throw < number
    assert found == expected
    sends_and_throws = [each for each in kinds if each in ("x", "signal sent", "t0", "t1", "t2", "t3")]
    assert sends_and_throws == ["x", *(each for number in range(4) for each in ("signal sent", f"t{number}"))]


def told(parts: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The error of a command that is refused."""
    assert main(["log", "convert", *parts]) == 2
    return capsys.readouterr().err


def test_what_a_variable_names_is_an_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two instances bear two orders at the same time; a repeated activity has a parcel for each repetition."""
    (tmp_path / "orders.bpmn").write_text(ORDERS)
    source = str(record(Scenario.load(tmp_path / "orders.bpmn", duration=10), tmp_path / "run.mcap"))
    target = tmp_path / "run.ocel.json"
    objects = ["--object", "order=order_id", "--object", "parcel=parcel"]
    assert main(["log", "convert", source, "-o", str(target), *objects]) == 0
    log_of = json.loads(target.read_text())
    named = [
        (event["type"], [one["objectId"] for one in event["relationships"] if one["qualifier"] in ("order", "parcel")])
        for event in log_of["events"]
    ]
    assert [objects for kind, objects in named if kind == "Pack"] == 2 * [  # start, complete
        ["order:7", "parcel:a"],
        ["order:7", "parcel:b"],
        ["order:8", "parcel:c"],
    ]
    assert [objects for kind, objects in named if kind == "Close"] == [["order:7"], ["order:8"]]
    assert {"order", "parcel"} <= {each["name"] for each in log_of["objectTypes"]}
    assert {each["id"] for each in log_of["objects"] if each["type"] == "parcel"} == {
        "parcel:a",
        "parcel:b",
        "parcel:c",
    }

    give = [source, "-o", str(target), "--object"]
    assert "has no variable 'parcl': did you mean 'parcel'?" in told([*give, "p=parcl"], capsys)
    assert "the variable 'parcels' is never text or a number at an event" in told([*give, "p=parcels"], capsys)
    assert "each log has objects of type 'robot' already" in told([*give, "robot=parcel"], capsys)
    assert "expected KEY=NAME, as in parcel=parcel_id or robot=org:resource, got 'parcel'" in told(
        [*give, "parcel"], capsys
    )
    assert "--object is for .ocel.json only" in told([source, "-o", str(tmp_path / "x.xes"), *objects], capsys)


def test_a_log_of_a_part_says_so_and_judges_and_draws_nothing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, part = str(run / "run.mcap"), ["--robot", "Tractor_*", "--level", "mission"]
    model, properties = str(Path("models/agriculture.bpmn").resolve()), run / "agriculture.properties.yaml"
    properties.write_text("properties:\n  quiet: never Drone throws /weed_found\n")
    (run / "agriculture.bpmn").write_text(Path(model).read_text())
    for suffix in (".jsonl", ".csv", ".xes"):
        target = run / f"part{suffix}"
        assert main(["log", "convert", source, "-o", str(target), *part]) == 0
        text = target.read_text()
        assert "level mission, robots Tractor_1, Tractor_2" in text
        assert "Tractor_1" in text
        assert "Explore" not in text
        assert main(["log", "judge", str(properties), str(target)]) == 2
        assert "has only a part of its run (level mission, robots Tractor_1, Tractor_2" in capsys.readouterr().err
    assert main(["draw", model, "--log", str(run / "part.csv"), "-o", str(run / "part.svg")]) == 2
    assert "has only a part of its run" in capsys.readouterr().err
    assert "has no robot 'Traktor': did you mean 'Tractor_" in told(
        [source, "-o", str(run / "x.csv"), "--robot", "Traktor"], capsys
    )
    assert "--robot is for logs of single robots" in told(
        [source, "-o", str(run / "x.ocel.json"), "--robot", "Drone"], capsys
    )
    assert "--level is for logs of events" in told([source, "-o", str(run / "bag"), "--level", "all"], capsys)


@pytest.mark.long
def test_pm4py_opens_it(run: Path) -> None:
    pm4py = pytest.importorskip("pm4py")
    log = pm4py.read_ocel2_json(str(converted(run, ".ocel.json")))
    expected = json.loads((run / "converted.ocel.json").read_text())
    assert len(log.events) == len(expected["events"])
    assert set(pm4py.ocel_get_object_types(log)) >= {"robot", "instance", "signal"}


def test_other_ends_are_refused_in_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "convert", str(run / "run.mcap"), "-o", str(run / "x.txt")]) == 2
    expected = "ends in one of .jsonl, .csv, .xes, .ocel.json, or the name of a folder for a bag of ROS 2, got 'x.txt'"
    assert expected in capsys.readouterr().err
    assert main(["log", "convert", str(run / "run.mcap"), "-o", str(run / "run.jsonl" / "bag")]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["log", "convert", str(run / "run.jsonl"), "-o", str(run / "y.csv")]) == 2
    assert "is not an MCAP file" in capsys.readouterr().err
    assert not (run / "y.csv").exists()


def test_a_recording_that_was_cut_short_is_converted_and_drawn_as_far_as_it_is_whole(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, data = tmp_path / "cut.mcap", (run / "run.mcap").read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    model = Path(__file__).parent.parent / "models" / "agriculture.bpmn"
    for words in (["log", "convert", str(cut)], ["draw", str(model), "--log", str(cut)]):
        output = tmp_path / ("out.csv" if words[0] == "log" else "out.svg")
        assert main([*words, "-o", str(output)]) == 0
        assert f"fame: {cut}: is incomplete" in capsys.readouterr().err
        assert output.stat().st_size > 0
    assert "the recording is incomplete: how the run went on is not known" in output.read_text()


def test_what_an_incomplete_recording_does_not_violate_is_not_known(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, data = tmp_path / "cut.mcap", (run / "run.mcap").read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    scenario = str(Path(__file__).parent.parent / "examples" / "agriculture.yaml")
    assert main(["log", "judge", scenario, str(cut), "--json"]) == 3
    (found,) = json.loads(capsys.readouterr().out)["runs"].values()
    assert {one["verdict"] for one in found} == {"not known"}
    assert all("the recording is incomplete after" in one["text"] for one in found)
    for form in ("jsonl", "xes", "ocel.json"):
        log = str(tmp_path / f"run.{form}")
        assert main(["log", "convert", str(cut), "-o", log]) == 0
        assert main(["log", "judge", scenario, log]) == 2
        assert "has only a part of its run (incomplete after" in capsys.readouterr().err


def test_an_object_that_a_variable_names_recording_is_no_part(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario, log = str(Path(__file__).parent.parent / "examples" / "agriculture.yaml"), tmp_path / "run.ocel.json"
    data = json.loads(converted(run, ".ocel.json").read_text())
    data["objects"].append({"id": "recording:7", "type": "recording", "attributes": []})
    log.write_text(json.dumps(data))
    assert main(["log", "judge", scenario, str(log)]) in (0, 3)
    assert capsys.readouterr().err == ""


@pytest.mark.long
def test_an_event_log_is_judged_with_what_called_processes_throw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(Scenario.load(EXAMPLES / "ground_vehicles.yaml"), tmp_path / "run.jsonl")
    assert main(["log", "judge", str(EXAMPLES / "ground_vehicles.yaml"), str(tmp_path / "run.jsonl"), "--json"]) == 3
    (found,) = json.loads(capsys.readouterr().out)["runs"].values()
    assert {one["property"]: one["verdict"] for one in found} == {
        "found_first": "holds", "answer": "holds", "apart": "not known",
    }  # fmt: skip


@pytest.mark.long_but("words0")
@pytest.mark.parametrize(
    "words",
    [
        ["convert", "run.mcap", "--object", "no_such=Thing", "-o", "old.ocel.json"],
        ["merge", "run.mcap", "-o", "old.mcap"],
    ],
)
def test_what_is_refused_or_fails_leaves_the_file_that_was_there(
    words: list[str], run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: object) -> None:
        raise ConfigError("no space")

    monkeypatch.chdir(run)
    monkeypatch.setattr(RecordingFile, "finish", fail)
    Path(words[-1]).write_text("old")
    assert main(["log", *words]) == 2
    assert Path(words[-1]).read_text() == "old"
    Path(words[-1]).unlink()
    assert main(["log", *words]) == 2
    assert [path.name for path in run.iterdir() if "old" in path.name] == []


FORMS = ("jsonl", "csv", "xes", "ocel.json")


@pytest.mark.parametrize(("duration", "verdict"), [("60", "violated"), ("3", "pending")], ids=["stuck", "cut"])
def test_how_a_run_ended_is_in_every_log(
    duration: str, verdict: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One robot waits for ever. Stuck, nothing can come any more; cut while the other still works, it could."""
    model = tmp_path / "m.bpmn"
    model.write_text(text_of({"A": ["catch never", "work"], "B": ["timer PT5S"]}))
    model.with_name("m.properties.yaml").write_text("properties: {done: A completes A_work_4 within 1 h}\n")
    own = [str(tmp_path / f"own.{form}") for form in ("mcap", "jsonl", "csv", "xes")]
    main(["run", str(model), "--quiet", "--duration", duration, *(word for log in own for word in ("--log", log))])
    logs = [*own, *(str(tmp_path / f"converted.{form}") for form in FORMS)]
    for log in logs[4:]:
        assert main(["log", "convert", own[0], "-o", log]) == 0
    capsys.readouterr()
    main(["log", "judge", str(model.with_name("m.properties.yaml")), *logs, "--json"])
    found = json.loads(capsys.readouterr().out)["runs"]
    assert {log: [one["verdict"] for one in found[log]] for log in logs} == {
        log: ["not known" if log.endswith("xes") else verdict] for log in logs  # which has no start of A's instance
    }  # fmt: skip


def test_xes_says_how_the_run_ended_of_activities(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "m.bpmn"
    model.write_text(text_of({"A": ["catch never", "work"], "B": ["work"]}))
    model.with_name("m.properties.yaml").write_text("properties: {done: A completes A_work_4}\n")
    for duration, code in (("60", 1), ("0.5", 3)):
        assert main(["run", str(model), "--quiet", "--duration", duration, "--log", str(tmp_path / "r.xes")]) == code
        assert main(["log", "judge", str(model.with_name("m.properties.yaml")), str(tmp_path / "r.xes")]) == code


FOREIGN = """<log xmlns="http://www.xes-standard.org/"><trace><string key="concept:name" value="order 7"/>
  <event><string key="activity" value="B_work_4"/><string key="org:resource" value="B"/>
    <date key="time:timestamp" value="2026-05-01T10:00:00+02:00"/></event>
  <event><string key="activity" value="A_work_2"/><string key="org:resource" value="a"/>
    <float key="error" value="nan"/><date key="time:timestamp" value="2026-05-01T08:00:09Z"/></event></trace></log>"""
NESTED = """<log xes.version="1.0"><string key="creator" value="miner"><string key="unit" value="B"/></string><trace>
  <string key="concept:name" value="Case 1"/><string key="unit" value="A"/>
  <container key="meta"><string key="unit" value="B"/></container>
  <event><string key="concept:name" value="work"/><string key="lifecycle:transition" value="schedule"/>
    <date key="time:timestamp" value="2026-05-01T09:00:00.000+02:00"/></event>
  <event><string key="concept:name" value="work"><string key="concept:name" value="rest"/></string>
    <list key="parts"><values><string key="unit" value="B"/></values></list>
    <string key="lifecycle:transition" value="START"/><date key="time:timestamp" value="2026-05-01T10:00:00"/></event>
  <event><string key="concept:name" value="work"/><string key="lifecycle:transition" value="complete"/>
    <date key="time:timestamp" value="2026-05-01T12:00:05.250+02:00"/></event></trace></log>"""


Foreign = Callable[..., str]


@pytest.fixture
def foreign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Foreign:
    """Judges the events of another tool by some properties: the exit code and what was printed, on one line."""
    (tmp_path / "m.bpmn").write_text(text_of({"A": ["work"], "B": ["catch go", "work"]}))

    def judge(text: str | bytes, properties: str, *columns: str, name: str = "foreign.xes") -> str:
        (tmp_path / "m.properties.yaml").write_text(f"properties:\n{properties}")
        (tmp_path / name).write_bytes(text.encode() if isinstance(text, str) else text)
        words = [word for column in columns for word in ("--columns", column)]
        code = main(["log", "judge", str(tmp_path / "m.properties.yaml"), str(tmp_path / name), *words])
        said = capsys.readouterr()
        assert code != 2 or said.err.count("\n") == 1
        return " ".join(f"{code} {said.out} {said.err}".split())

    return judge


ORDER = "  order: B starts B_work_4 only after A completes A_work_2\n"


def test_an_event_log_of_another_tool_is_judged_by_the_names_of_its_columns(foreign: Foreign) -> None:
    soon = "  soon: after B ends B_work_4, A starts A_work_2 within 10 s\n  begun: A starts within 1 s\n"
    table = foreign(FOREIGN, ORDER + soon, "element=activity")
    assert re.match("1 .* order violated .* soon holds 1 begun not known", table)
    strange = '<event><string key="activity" value="other"/><string key="org:resource" value="B"/></event></trace>'
    table = foreign(FOREIGN.replace("</trace>", strange), ORDER, "element=activity")
    assert re.match("3 .* the log does not have all of B", table)
    assert foreign(gzip.compress(FOREIGN.encode()), ORDER, "element=activity", name="foreign.xes.gz").startswith("1 ")


def test_one_with_a_life_cycle_nested_values_and_zones_is_judged(foreign: Foreign) -> None:
    takes = "  takes: after A starts A_work_2, A completes A_work_2 within 10 s\n"
    assert foreign(NESTED, takes, "robot=case:unit") == "0 property verdict slack why takes holds 4.75"
    for old, new in (("complete", "DONE"), ('value="work"/>', 'value="tidy up"/>')):  # what that means nobody knows
        table = foreign(NESTED.replace(old, new), takes, "robot=unit")
        assert re.match("3 .* the log does not have all of A", table)


def test_the_end_of_an_execution_whose_start_another_tool_did_not_log_has_one(foreign: Foreign, tmp_path: Path) -> None:
    """One that was cancelled, too: the next one begins as well."""
    (tmp_path / "l.xes").write_text(NESTED.replace('"START"', '"ate_abort"'))
    events = read_foreign_xes(tmp_path / "l.xes", read(tmp_path / "m.bpmn"), {"robot": "unit"})
    assert [row["what"] for row in events.rows] == ["enter", "cancel", "enter", "leave"]


@pytest.mark.parametrize(
    ("old", "new", "columns", "text"),
    [
        ("", "", [], "is not a log as fame log convert writes it; --columns maps the names of another one, which has "
         "activity, case:concept:name, org:resource, time:timestamp"),
        ("", "", ["element=task"], "no event has 'task' (element); there are activity, case:concept:name, org:"),
        ("", "", ["time=activity"], "'concept:name' names no activity of"),
        ("activity", "concept:name", ["robot=concept:name"], "'concept:name' names no robot of"),
        ("A_work_2", "B_work_4", ["robot=activity"], "(A, B): it has B_work_4; see"),
        ("_work_", "_play_", ["element=activity"], "(A_work_2, B_work_4, work): it has A_play_2, B_play_4; see"),
        ("time:timestamp", "at", ["element=activity"], "trace 'order 7': an event has no 'time:timestamp' (time); it"),
        ("2026-05-01T10", "at 10", ["element=activity"], "trace 'order 7': 'at 10:00:00+02:00' is not an ISO 8601"),
        ("", "", ["colour=red"], "--columns: unknown key 'colour'; keys are: robot, element, transition, time"),
    ],
)  # fmt: skip
def test_wrong_names_are_refused_with_those_that_are_there(
    foreign: Foreign, old: str, new: str, columns: list[str], text: str
) -> None:
    said = foreign(FOREIGN.replace(old, new), ORDER, *columns)
    assert text in said
    assert said.startswith("2 ")


def test_a_packed_log_that_is_damaged_or_too_large_is_refused(
    foreign: Foreign, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = gzip.compress(FOREIGN.encode())
    for data in (FOREIGN.encode(), packed[:80], packed[:-9] + b"123456789"):
        said = foreign(data, ORDER, "element=activity", name="foreign.xes.gz")
        assert re.match("2 .* is damaged, or not packed by gzip", said)
    monkeypatch.setattr("fame.log.xes_reading._PACKED", 300)
    assert "unpack it" in foreign(packed, ORDER, "element=activity", name="foreign.xes.gz")
    assert "2 fame: error: --columns is for .xes files, got" in foreign(FOREIGN, ORDER, "time=at", name="run.jsonl")


def test_two_missions_of_one_robot_are_cases_apart(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(text_of({"A": ["work"]}))
    runs = [str(tmp_path / f"{hour}.mcap") for hour in (10, 11)]
    for hour, log in zip((10, 11), runs, strict=True):
        assert (
            main(["run", str(tmp_path / "m.bpmn"), "--quiet", "--epoch", f"2026-06-01T{hour}:00Z", "--log", log]) == 0
        )
    assert main(["log", "merge", *runs, "-o", str(tmp_path / "run.mcap")]) == 0
    with rows_of(converted(tmp_path, ".jsonl")) as rows:
        assert [row["instance"] for row in rows if row["what"] in ("start", "end")] == [1, 1, 2, 2]
    traces = ElementTree.parse(converted(tmp_path, ".xes")).getroot().findall("{*}trace")
    assert [trace[0].get("value") for trace in traces] == ["A/1", "A/2"]
    objects = json.loads(converted(tmp_path, ".ocel.json").read_text())["objects"]
    assert [one["id"] for one in objects if one["type"] == "instance"] == ["instance:A/1", "instance:A/2"]


def test_two_runs_of_one_time_are_not_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.bpmn").write_text(text_of({"A": ["work"]}))
    runs = [str(tmp_path / f"{seed}.mcap") for seed in (1, 2)]
    for seed, log in enumerate(runs):
        assert main(["run", str(tmp_path / "m.bpmn"), "--quiet", "--seed", str(seed), "--log", log]) == 0
    assert main(["log", "merge", *runs, "-o", str(tmp_path / "run.mcap")]) == 2
    assert "is another run at the same time as" in capsys.readouterr().err
    assert not (tmp_path / "run.mcap").exists()


def recorded(path: Path, metadata: dict[str, str], messages: list[tuple[int, str, str, bytes]]) -> str:
    """A recording with messages: time (ns), topic, type, definition of the type; each of 8 bytes."""
    with path.open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({"epoch": "2026-06-01T10:00:00Z", **metadata})
        for time, topic, type, definition in messages:
            channel = Channel(0, topic, "cdr", {"node": "/A/sensor"}, 0)
            file.write(file.same_channel(channel, Schema(0, definition, "ros2msg", type)), time, bytes(8))
        file.finish()
    return str(path)


def test_merged_messages_keep_the_definition_of_their_type(tmp_path: Path) -> None:
    one = recorded(tmp_path / "1.mcap", {}, [(1, "/x", "own_msgs/msg/Load", b"float32 kg\n")])
    merge([one, one], tmp_path / "run.mcap")  # which nobody has registered
    with Recording(tmp_path / "run.mcap") as merged:
        assert merged.definitions == {"own_msgs/msg/Load": "float32 kg\n"}
        assert [message.topic for message in merged.messages()] == ["/x"]


@pytest.mark.parametrize(
    ("type", "definition", "other"),
    [
        ("own_msgs/msg/Force", b"float32 kg\n", "own_msgs/msg/Load"),
        ("own_msgs/msg/Load", b"float32 t\n", "one with other fields"),
    ],
)
def test_a_topic_of_two_types_is_not_merged(type: str, definition: bytes, other: str, tmp_path: Path) -> None:
    one = recorded(tmp_path / "1.mcap", {}, [(1, "/x", "own_msgs/msg/Load", b"float32 kg\n")])
    two = recorded(tmp_path / "2.mcap", {"epoch": "2026-06-01T11:00:00Z"}, [(1, "/x", type, definition)])
    with pytest.raises(ConfigError, match=re.escape(f"2.mcap: /x is {type}, and in {one} {other}")):
        merge([one, two], tmp_path / "run.mcap")


@pytest.mark.parametrize(
    ("ends", "merged"),
    [(("complete", "complete"), "complete"), (("cut", "complete"), "cut"), (("complete", ""), None), (("", ""), None)],
)
def test_what_was_merged_says_how_its_runs_ended(ends: tuple[str, ...], merged: str | None, tmp_path: Path) -> None:
    runs = [recorded(tmp_path / f"{end}{number}.mcap", {"ended": end, "end": f"{number}0"} if end else {}, [])
            for number, end in enumerate(ends)]  # fmt: skip
    merge(runs, tmp_path / "run.mcap")
    with Recording(tmp_path / "run.mcap") as recording:
        assert recording.metadata.get("ended") == merged


@pytest.mark.parametrize("metadata", [{"clocks": "measured"}, {"robot": "A"}, {}])
def test_clocks_that_nobody_measured_are_doubted_after_a_merge_too(metadata: dict[str, str], tmp_path: Path) -> None:
    """Those of a recorder on the network, and of an engine with its own log; a run in one process has one clock."""
    (tmp_path / "m.bpmn").write_text(text_of({"A": ["throw x"], "B": ["catch x", "work"]}))
    assert main(["run", str(tmp_path / "m.bpmn"), "--quiet", "--log", str(tmp_path / "1.mcap")]) == 0
    about = recorded(tmp_path / "2.mcap", {"epoch": "1970-01-01T00:00:00Z", **metadata}, [])
    merge([tmp_path / "1.mcap", about], tmp_path / "run.mcap")
    promise = parse("after A throws /x, B completes within 5 s", NOWHERE, "p")
    (judgement,) = judge_log(tmp_path / "run.mcap", [promise])
    assert judgement.verdict == ("not known" if metadata else "holds")


def test_what_was_merged_of_an_incomplete_recording_is_incomplete(run: Path, tmp_path: Path) -> None:
    whole = (run / "run.mcap").read_bytes()
    (tmp_path / "torn.mcap").write_bytes(whole[:-200])
    assert merge([tmp_path / "torn.mcap"], tmp_path / "merged.mcap")
    with Recording(tmp_path / "merged.mcap") as recording:
        assert recording.warnings == [f"{recording.file}: was merged of incomplete recordings (torn.mcap)"]
        assert recording.lack.startswith("incomplete after")


def test_a_recording_is_not_merged_into_itself(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = run / "run.mcap"
    before = path.read_bytes()
    assert main(["log", "merge", str(path), "-o", str(path)]) == 2
    assert "expected a new file, got one that is read" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_an_instance_whose_beginning_was_not_recorded_is_a_trace_that_says_so(tmp_path: Path) -> None:
    stream = BytesIO()
    with xes(stream, element_info([read("models/ground_vehicles.bpmn")])) as log:
        for what, element in (("leave", "Activity_14nkpvd"), ("end", "Process_REX")):
            log(Event(SECOND, "REX", 3, 4, element, what, "completed"))
        log(Event(SECOND, "DINGO", 1, 2, "Process_DINGO", "end", "completed"))
    root = ElementTree.fromstring(stream.getvalue())
    traces = [{item.get("key"): item.get("value") for item in one} for one in root if one.tag.endswith("trace")]
    assert [(one["robot"], one["process"], one["incomplete"]) for one in traces] == [
        (robot, "unknown", "the log does not have its beginning") for robot in ("REX", "DINGO")
    ]
