"""Blocks of a run: each can be shown alone, and together they are the run."""

import itertools
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from recorded_runs import record
from run_states import replayed

from fame.bpmn.reader import read
from fame.log import Recording, logging_to
from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.robot.events import combine_observers
from fame.robot.robot_state import RobotState, ScopeState
from fame.scenario import Scenario
from fame.view import LiveRun, RunControl
from fame.view.blocks import COLUMNS, Packer
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.mission import place_of, role_of
from fame.view.replay import Replay
from fame.view.state import WHATS

EXAMPLES = Path(__file__).parent.parent / "examples"
MODELS = Path(__file__).parent.parent / "models"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=60)
    return record(scenario, tmp_path_factory.mktemp("view") / "agriculture.mcap")


@pytest.mark.long
def test_a_block_alone_leads_to_the_next(recording: Path) -> None:
    with Replay(recording) as replay:
        replay.wait()
        blocks = replay._packer.blocks
        assert len(blocks) > 3
        for block, following in itertools.pairwise(blocks):
            state = replayed(block)
            assert sorted(state["tokens"]) == sorted(following.key["tokens"])
            assert sorted(state["counts"]) == sorted(following.key["counts"])
            assert sorted(state["ends"]) == sorted(following.key["ends"])
            assert block.end < following.start


def test_of_what_was_read_the_last_block_alone_stays_in_memory(recording: Path) -> None:
    with Replay(recording) as replay:
        replay.wait()
        *stored, last = replay.blocks
        assert [block.number for block in replay.blocks if "columns" in vars(block)] == [last.number]
        assert [json.loads(replay.block(block.number)) for block in stored] == [block.to_json() for block in stored]


@pytest.mark.long
def test_blocks_have_every_event_of_the_recording(recording: Path) -> None:
    with Replay(recording) as replay:
        replay.wait()
        elements = replay.catalogue.elements
        shown = [
            (time, replay._packer.robots[robot], instance, scope, elements[element].element.id, WHATS[what])
            for block in replay._packer.blocks
            for time, robot, instance, scope, element, what in zip(
                *(block.columns[name] for name in COLUMNS), strict=True
            )
            if element >= 0
        ]
        with Recording(recording) as source:
            recorded = [(*event[:4], event.element, event.what) for event in source.events() if event.element]
        assert shown == recorded


def test_counts_are_those_of_the_recording(recording: Path) -> None:
    with Replay(recording) as replay:
        replay.wait()
        packer, elements = replay._packer, replay.catalogue.elements
        with Recording(recording) as source:
            last = source.state(source.end)
        robot, rows = packer.robots.index("Drone"), packer.key_json()
        for id, counts in itertools.chain.from_iterable(each.items() for each in last.robots["Drone"].counts.values()):
            ended = sum(sum(row[2:]) for row in rows["counts"] if row[0] == robot and elements[row[1]].element.id == id)
            resting = sum(row[4] for row in rows["tokens"] if row[0] == robot and elements[row[3]].element.id == id)
            passed = counts.get("take", 0) or counts.get("enter", 0)
            assert ended + resting == passed, id


def packer_of(model: str) -> Packer:
    return Packer(Catalogue([read(MODELS / model)]), ["REX"])


def test_calls_and_what_they_call_are_known_by_number(recording: Path) -> None:
    with Replay(recording) as replay:
        catalogue = replay.catalogue
        go_to = next(number for number, entry in enumerate(catalogue.elements) if entry.element.id == "GoTo")
        calls = [catalogue.elements[call].element.label for call, called in catalogue.called.items() if called == go_to]
        assert "Go To" in calls


def test_what_is_inside_a_call_knows_its_call(recording: Path) -> None:
    with Replay(recording) as replay:
        replay.wait()
        rows = [row for block in replay._packer.blocks for row in block.lists["scopes"]]
        openers = {replay.catalogue.elements[opener].element.label for row in rows for opener in row[4]}
        assert {"Take Off", "Explore", "Go To"} <= openers


def test_a_robot_waits_no_more_for_the_starts_of_a_process_that_it_no_longer_runs() -> None:
    packer = packer_of("ground_vehicles.bpmn")
    packer.run(0, [0])
    robot = role_of(packer.catalogue, "DINGO")
    assert robot["starts"]
    assert robot | place_of(packer, 0, "Gone") == {"plane": NOWHERE, "pool": NOWHERE, "starts": []}
    assert robot | role_of(packer.catalogue, "Nobody") == {"pool": NOWHERE, "starts": []}


def test_a_page_that_knows_part_of_a_block_gets_the_rest() -> None:
    packer = packer_of("ground_vehicles.bpmn")
    packer.put(EVENTS, 1, events(1, 1, ["Process_REX", "start"]))
    mark = packer.blocks[0].mark()
    packer.put(EVENTS, 2, events(0, 0, ["", "log", "later"]))
    rest = packer.blocks[0].to_json(mark)
    assert (rest["first"], rest["t"], rest["d"]) == (1, [2], {"1": "later"})
    assert "key" not in rest


def test_the_state_at_the_start_of_a_block_is_not_changed_by_what_comes_later() -> None:
    packer = Packer(Catalogue([]), ["REX"])
    known = RobotState(scopes={1: ScopeState(1, values={"x": 2})})
    packer.put(EVENTS, 0, events(1, 1, ["Process_REX", "start"]))
    packer.put(VARIABLES, 0, {"robot": "REX", "changes": [{"scope": 1, "set": {"x": 1}}]})
    packer.put(KEY, 5, {"robots": {"REX": known.to_key()}})
    packer.put(VARIABLES, 7, {"robot": "REX", "changes": [{"scope": 1, "set": {"x": 3}}]})
    assert packer.blocks[-1].to_json()["key"]["variables"] == [[0, 1, {"x": [2, 5]}]]


def events(instance: int, scope: int, *marks: list[str]) -> dict[str, Any]:
    """A message of events of REX in a scope that opens."""
    opens = [{"scope": scope, "instance": instance}] if scope else []
    return {"robot": "REX", "opens": opens, "events": [{"instance": instance, "scope": scope, "marks": marks}]}


def places(packer: Packer) -> dict[tuple[str, int, str], int]:
    """How many tokens are where: robot, instance, id of the element."""
    found: Counter[tuple[str, int, str]] = Counter()
    for robot, instance, _, element, number, _ in packer.key_json()["tokens"]:
        found[packer.robots[robot], instance, packer.catalogue.elements[element].element.id] += number
    return dict(found)


@pytest.mark.long
def test_a_run_that_lasts_has_the_blocks_of_its_recording(tmp_path: Path) -> None:
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=20)
    live = LiveRun(scenario, RunControl(speed=0))
    with logging_to(tmp_path / "run.mcap", scenario.closures()) as log:
        result = scenario.run(observer=combine_observers([log, live.observer]), pace=live)
    live.end(result.status)
    with Replay(tmp_path / "run.mcap") as replay:
        replay.wait()
        assert [block.to_json() for block in live._packer.blocks] == [
            block.to_json() for block in replay._packer.blocks
        ]
        assert live._packer.blocks[-1].key["tokens"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["agriculture", "ground_vehicles", "warehouse"])
def test_a_key_alone_gives_the_tokens_of_activities_too(name: str, tmp_path: Path) -> None:
    record(Scenario.load(EXAMPLES / f"{name}.yaml", duration=30), tmp_path / "run.mcap")
    states = []
    with Recording(tmp_path / "run.mcap") as recording:
        middle = recording.last(KEY, 15 * 10**9)
        assert middle is not None
        files = [read(source, file=name) for name, source in recording.models.items()]
        for start in (0, middle.time):
            packer = Packer(Catalogue(files), recording.robots)
            for message in recording.messages((KEY, EVENTS, VARIABLES, WAITING), start, 25 * 10**9):
                packer.put(message.topic, message.time, message.json())
            states.append((places(packer), sorted(packer.key_json()["counts"])))
    assert states[0] == states[1]
    assert states[0][0]
