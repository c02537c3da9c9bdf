"""Replay a run that an exploration has found, with the real engines: one `fame.Simulation` per robot.

Behaviours and scripts that take time are replaced by steps, as in the exploration, which end or fail when the run says
so; decisions about unknown values are taken as in the run. Messages go from robot to robot in the order of the run.
What is left after the run goes on by itself: all steps end, all messages arrive, all timers fire. A mission without the
fault then completes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fame.bpmn import model
from fame.bpmn.pools import shared_topics
from fame.check.explore.abstraction import STEP, Abstraction, abstraction
from fame.check.explore.purity import waits
from fame.clock import SECOND
from fame.engine.canonical import stimuli
from fame.engine.host import BpmnError
from fame.errors import FameError
from fame.scenario.exploration import cast_of
from fame.scripting import Sleep
from fame.simulation import Simulation

ROUNDS = 30
"""How often what is left goes on, after which a mission counts as never completing."""
Step = tuple[str, str, str, str]
"""(robot, kind, element, detail) as in `fame.check.explore.trace.Step`."""


@dataclass(slots=True)
class Replay:
    """What a replayed run has come to.

    waiting   robot -> what it still waits at, of the robots that have not completed
    skipped   steps of the run that were not possible
    """

    waiting: dict[str, tuple[str, ...]] = field(default_factory=dict)
    skipped: list[Step] = field(default_factory=list)

    @property
    def completed(self) -> bool:
        """Whether every robot has completed."""
        return not self.waiting


def replay(
    path: str | Path | model.Definitions,
    steps: Sequence[Step],
    *,
    robots: Mapping[str, int] = MappingProxyType({}),
    library: str | Path | Sequence[str | Path] = (),
    choices: Mapping[str, Sequence[int]] = MappingProxyType({}),
) -> Replay:
    """Drive a team along the steps of a run, then let it go on.

    `choices`: element -> the decisions about unknown values there, in order: 0 for true, 1 for false.
    Raises ModelError and ConfigError as `fame.explore` does.
    """
    definitions, found, cast = cast_of(path, robots, library)
    pools = list({pool.name: pool for pool in cast.values()}.values())
    types = dict(shared_topics(definitions, pools, found))
    abstract = abstraction(definitions, pools, found, types)
    explored = _replaced(definitions, abstract, choices)
    team = _Team(abstract, {robot: (explored, pool.process.id) for robot, pool in cast.items()}, choices)
    for robot, kind, element, detail in steps:
        if not team.step(robot, kind, element, detail):
            team.result.skipped.append((robot, kind, element, detail))
    for _ in range(ROUNDS):
        if not team.go_on():
            break
    team.result.waiting = team.waiting()
    team.close()
    return team.result


class _Team:
    """The simulations of a team, and the messages between them."""

    def __init__(self, abstract: Abstraction, robots: Mapping[str, tuple[model.Definitions, str]],
                 choices: Mapping[str, Sequence[int]]) -> None:  # fmt: skip
        self.result = Replay()
        self.abstract = abstract
        self._choices = {element: deque(one) for element, one in choices.items()}
        names = [name for definitions, _ in robots.values() for name in _steps_in(definitions)]
        services = dict.fromkeys(names, _never_ending)
        self.robots = {
            robot: Simulation(definitions, process, {"decide": self._decide}, services=services, robot=robot)
            for robot, (definitions, process) in robots.items()
        }
        self._mail: dict[str, deque[tuple[str, Any]]] = {robot: deque() for robot in robots}
        for robot, simulation in self.robots.items():
            outside = simulation.middleware.node("replay")
            for topic in sorted(abstract.shared):
                outside.subscription(topic, abstract.types[topic].type, self._noting(robot, topic))
        for simulation in self.robots.values():
            simulation.run(until=0.0)

    def _noting(self, sender: str, topic: str) -> Any:
        def note(message: Any) -> None:
            for robot, mail in self._mail.items():
                if robot != sender and topic in self._topics(robot):
                    mail.append((topic, message))

        return note

    def _topics(self, robot: str) -> set[str]:
        nodes = self.robots[robot].node.engine.program.nodes
        return {node.catch.topic for node in nodes if node.catch is not None}

    def _decide(self, element: str) -> bool:
        left = self._choices.get(element)
        return bool(left) and left.popleft() == 0  # type: ignore[union-attr]

    # ---- steps ---------------------------------------------------------------------------------------

    def step(self, robot: str, kind: str, element: str, detail: str) -> bool:
        """One step of a run. Whether it was possible."""
        simulation = self.robots[robot]
        try:
            match kind:
                case "end" | "fail":
                    return self._end(simulation, element, detail)
                case "timer":
                    return self._fire(simulation, element)
                case "person":
                    simulation.complete(element)
                case "offer":
                    simulation.activate(element)
                case "outside":
                    simulation.signal(detail)
                case "receive" | "miss" | "loss":
                    return self._receive(robot, detail, lost=kind == "loss")
        except FameError:
            return False
        return True

    def _end(self, simulation: Simulation, element: str, code: str) -> bool:
        engine = simulation.node.engine
        for key, wait in stimuli(engine).scripts.items():
            if wait.node.id == element:
                simulation.node.runner.cancel(key)
                operation = next((name for name in self.abstract.steps if name.endswith(f" {element}")), "")
                for topic, _ in self.abstract.steps[operation].emits if operation and not code else ():
                    message = simulation.node.host.publish(topic, None)
                    engine.post(topic, message)
                engine.script_ended(key, BpmnError(code) if code else None)
                simulation.run(until=simulation.now)
                return True
        return False

    def _fire(self, simulation: Simulation, element: str = "") -> bool:
        """Let time pass until a timer fires: that of an element, else the next one."""
        node = simulation.node
        due = [
            time
            for key, timer in stimuli(node.engine).timers.items()
            if element in ("", timer.id) and (time := node.host.timers.due(key)) is not None
        ]
        if due:
            simulation.run(until=max(simulation.now, min(due) / SECOND))
        return bool(due)

    def _receive(self, robot: str, topic: str, *, lost: bool) -> bool:
        mail = self._mail[robot]
        for place, (name, message) in enumerate(mail):
            if name == topic:
                del mail[place]
                if not lost:
                    self.robots[robot].signal(topic, message)
                return True
        return False

    # ---- afterwards ----------------------------------------------------------------------------------

    def go_on(self) -> bool:
        """Let all that is left go on once. Whether something was."""
        moved = False
        for robot, mail in self._mail.items():
            while mail:
                topic, message = mail.popleft()
                self.robots[robot].signal(topic, message)
                moved = True
        for simulation in self.robots.values():
            found = stimuli(simulation.node.engine)
            for wait in found.scripts.values():
                moved |= self._end(simulation, wait.node.id, "")
            for wait in found.people:
                moved |= self.step(simulation.node.name, "person", wait.node.id, "")
            for topic in sorted(found.topics & self.abstract.outside):
                simulation.signal(topic)
                moved = True
        if not moved:
            moved = sum(map(self._fire, self.robots.values())) > 0
        return moved and bool(self.waiting())

    def waiting(self) -> dict[str, tuple[str, ...]]:
        """Robot -> what it waits at, of those that run."""
        return {
            robot: tuple(element for one in running for element in one.waiting)
            for robot, simulation in self.robots.items()
            if (running := list(simulation.node.engine.instances.values()))
        }

    def close(self) -> None:
        for simulation in self.robots.values():
            simulation.close()


async def _never_ending(variables: dict[str, Any]) -> None:
    await Sleep(1e8)


# ---- the model -------------------------------------------------------------------------------------------------------


def _steps_in(definitions: model.Definitions) -> list[str]:
    nodes = (node for process in definitions.processes for node in process.body.walk())
    return [node.operation for node in nodes if isinstance(node, model.Task) and node.operation.startswith(STEP)]


def _replaced(
    definitions: model.Definitions, abstract: Abstraction, choices: Mapping[str, Sequence[int]]
) -> model.Definitions:
    """The model with steps in place of what takes time, and called processes of other files in it."""
    processes: dict[str, model.Process] = {}
    pending = [(definitions, process, process.id) for process in definitions.processes]
    while pending:
        home, process, id = pending.pop(0)
        if id in processes:
            continue
        made = abstract.process(home, process)
        processes[id] = replace(made, id=id, body=_body(made.body, home, abstract, choices))
        calls = [node for node in made.body.walk() if isinstance(node, model.CallActivity)]
        pending += [(*abstract.library.find(home, call), call.called) for call in calls]
    return replace(definitions, processes=tuple(processes.values()))


def _body(
    body: model.Body, home: model.Definitions, abstract: Abstraction, choices: Mapping[str, Sequence[int]]
) -> model.Body:
    nodes: list[model.FlowNode] = []
    for node in body.nodes:
        if isinstance(node, model.SubProcess):
            node = replace(node, body=_body(node.body, home, abstract, choices))
        elif isinstance(node, model.Task) and node.script is not None and waits(node.script):
            node = _as_step(node, abstract)
        nodes.append(node)
    flows = [
        replace(flow, condition=model.Expression(f"decide({flow.source!r})", condition=True))
        if flow.condition is not None and flow.source in choices
        else flow
        for flow in body.flows
    ]
    return replace(body, nodes=tuple(nodes), flows=tuple(flows))


def _as_step(task: model.Task, abstract: Abstraction) -> model.Task:
    from fame.check.explore.host import step_of

    assert task.script is not None
    name = f"{STEP}script {task.id}"
    abstract.steps[name] = step_of(task.script, task.id)
    kept = {item.name: getattr(task, item.name) for item in fields(model.Activity)}
    return model.Task(kind="service", operation=name, **kept)
