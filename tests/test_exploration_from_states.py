"""Exploration from the states that robots are in, instead of from their starts."""

import json
from collections.abc import Mapping
from typing import Any

import pytest
from collaborations import Steps, generated, team

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.check.explore import Exploration, Request, explore_from
from fame.engine import snapshot
from fame.engine.encoding import Data
from fame.engine.migration import MigrationPlan, migrate
from fame.errors import ConfigError, MissionError
from fame.robot.node import RobotNode
from fame.robot.stored_values import dump
from fame.scenario.explore.exploration import cast_of, explore
from fame.simulation import Simulation
from fame.testing import MissionLoader


def state_of(node: RobotNode, *, held: bool = False) -> Data:
    """The state of a robot, as it would be sent to somebody."""
    if held:
        node.engine.hold()
    found: Data = json.loads(json.dumps(snapshot(node.engine, dump=dump)))
    return found


def started(model: Definitions, cast: Mapping[str, Pool], until: float = 0.0) -> dict[str, RobotNode]:
    return {robot: Simulation(model, pool.process.id, robot=robot).run(until).node for robot, pool in cast.items()}


def from_states(model: Definitions, states: Mapping[str, Data]) -> Exploration:
    definitions, library, cast = cast_of(model, {}, ())
    return explore_from(definitions, library, cast, states, Request(delivery=("run",), limit=1_000, samples=False))


HANDSHAKE: dict[str, Steps] = {"A": ["work", "throw go", "catch done"], "B": ["catch go", "work", "throw done"]}


@pytest.mark.long_but("[0-8]-*")
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_from_the_states_of_the_start_as_many_states_follow_as_from_the_start(seed: int, held: bool) -> None:
    steps = {robot: ["work", *steps] for robot, steps in generated(seed).items()}
    model = team(steps)
    _, _, cast = cast_of(model, {}, ())
    states = {robot: state_of(node, held=held) for robot, node in started(model, cast).items()}
    whole, rest = explore(model, delivery="run", limit=1_000, samples=False), from_states(model, states)
    assert rest.exhaustive is whole.exhaustive
    assert rest.states == whole.states
    assert rest.failed == whole.failed


def test_what_can_no_longer_come_is_a_deadlock_with_its_run() -> None:
    model = team(HANDSHAKE)
    _, _, cast = cast_of(model, {}, ())
    nodes = started(model, cast)
    nodes["A"].scheduler.run(2 * 10**9)  # alone: its signal reaches nobody
    result = from_states(model, {robot: state_of(node) for robot, node in nodes.items()})
    (finding,) = [one for one in result.findings if one.level == "error"]
    assert finding.text.startswith("deadlock: A waits at")
    assert not explore(model).failed


def test_robots_without_a_state_start() -> None:
    model = team({"A": ["catch ready", "throw go"], "B": ["throw ready", "catch go"]})
    _, _, cast = cast_of(model, {}, ())
    assert not from_states(model, {"A": state_of(started(model, cast)["A"])}).failed


@pytest.mark.long
def test_a_behaviour_under_way_is_a_step_that_ends_or_fails(mission: MissionLoader) -> None:
    m = mission.load("examples/ground_vehicles.yaml")
    m.run_until("DINGO", at="Go To")
    m.advance(1)
    states = {robot: state_of(m.node(robot), held=True) for robot in m.robots}
    scenario = m.scenario
    result = explore_from(scenario.definitions, scenario.library, scenario.cast, states, Request())
    assert result.exhaustive
    assert not result.failed
    whole = explore("examples/ground_vehicles.yaml")
    assert {one.text for one in result.findings} <= {one.text for one in whole.findings}
    assert 0 < result.states < whole.states


def test_a_migration_that_would_deadlock_is_found_before_anything_moves() -> None:
    """B is told twice in the new model; A, which has told it once already, does not do so any more."""
    old = team({"A": ["throw go", "catch done"], "B": ["catch go", "work", "throw done"]})
    same = team({"A": ["throw go", "run x = 1", "catch done"], "B": ["catch go", "work", "throw done"]})
    twice = team({"A": ["throw go", "throw ok", "catch done"], "B": ["catch go", "work", "queue ok", "throw done"]})
    _, _, cast = cast_of(old, {}, ())
    nodes = started(old, cast)
    nodes["B"].deliver("/go", None)
    nodes["B"].scheduler.run(0)
    results = []
    for new in (same, twice):
        assert not explore(new, delivery="run").failed
        plan = MigrationPlan(to={_id(old, "A_catch_done"): _id(new, "A_catch_done")})
        states = {}
        for robot, node in nodes.items():
            program = Simulation(new, cast[robot].process.id, robot=robot).node.engine.program
            states[robot], _ = migrate(state_of(node), node.engine.program, program, plan)
        results.append(from_states(new, states))
    assert [result.failed for result in results] == [False, True]
    finding = results[1].findings[0]
    assert "A waits at" in finding.text
    assert "B waits at" in finding.text
    assert [step.text for step in finding.run] == ['B\'s "work" ends']


def _id(model: Definitions, begin: str) -> str:
    nodes = (node.id for process in model.processes for node in process.body.nodes)
    return next(id for id in nodes if id.startswith(begin))


def test_the_state_of_another_model() -> None:
    model, other = team(HANDSHAKE), team({"A": ["person", "throw go", "catch done"], "B": ["catch go", "throw done"]})
    _, _, cast = cast_of(other, {}, ())
    state = state_of(started(other, cast)["A"])
    with pytest.raises(MissionError, match="token at A_person_2, which the model does not have"):
        from_states(model, {"A": state})


def test_no_library_is_needed_for_a_model_that_calls_nothing() -> None:
    model = team(HANDSHAKE)
    _, _, cast = cast_of(model, {}, ())
    states = {robot: state_of(node) for robot, node in started(model, cast).items()}
    assert explore_from(model, Library(), cast, states, Request(delivery=("any",))).exhaustive


@pytest.mark.parametrize("delivery", [(), ("slow",)])
def test_without_a_known_delivery_nothing_would_be_explored(delivery: Any) -> None:
    definitions, library, cast = cast_of(team(HANDSHAKE), {}, ())
    with pytest.raises(ConfigError, match=r"expected at least one of run, fast, any, got"):
        explore_from(definitions, library, cast, {}, Request(delivery=delivery))
