"""Recordings are converted to the logs that a run writes itself, and to OCEL 2.0."""

from __future__ import annotations

import json
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from fame.bpmn import read
from fame.cli import main
from fame.clock import SECOND
from fame.log import logging_to
from fame.log.elements import element_info
from fame.log.xes import xes
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
        logging_to(folder / "all.mcap", files, topics="all") as everything,
    ):
        scenario.run(observer=combine_observers([mcap, jsonl, csv, xes, everything]))
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


SCHEMA = json.loads((Path(__file__).parent / "ocel2_schema.json").read_text())


def test_ocel_is_valid_by_the_schema_of_its_specification(run: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    log = json.loads(converted(run, ".ocel.json").read_text())
    validator = jsonschema.Draft202012Validator(SCHEMA, format_checker=jsonschema.FormatChecker())
    assert not [error.message for error in validator.iter_errors(log)]
    del log["events"][0]["time"]
    log["eventTypes"][0]["attributes"].append({"name": "n", "type": "text"})
    assert len(list(validator.iter_errors(log))) == 2


def test_ocel_has_what_the_mission_shows_unless_all_is_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = {}
    for level in ("mission", "all"):
        target = run / f"{level}.ocel.json"
        assert main(["log", "convert", str(run / "all.mcap"), "-o", str(target), "--level", level]) == 0
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
    assert main(["log", "convert", str(run / "all.mcap"), "-o", str(run / "z.csv"), "--level", "all"]) == 2
    assert "--level is for .ocel.json only" in capsys.readouterr().err


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
        assert isinstance(attribute["value"], str)
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


def test_a_recording_is_not_merged_into_itself(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = run / "run.mcap"
    before = path.read_bytes()
    assert main(["log", "merge", str(path), "-o", str(path)]) == 2
    assert "expected a new file, got one of those that are merged" in capsys.readouterr().err
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
