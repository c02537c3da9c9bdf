"""The whole state of a robot's mission as plain data, whatever tables the code has for it, and what must not change it.

`state_of` walks through all attributes of the engine's objects: one that a restart or a migration forgets is seen, also
if it stands in no table of `fame.engine.state_fields`. A crash changes nothing: what a robot goes on with is what it
had when it was killed. Nor does a migration, but for what the new model lacks.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from fame.clock import SECOND
from fame.deploy import EngineNode
from fame.engine.program import Body, Node
from fame.engine.repair import AT_INCIDENT
from fame.engine.snapshot import all_scopes, all_waits
from fame.engine.state import Continuation, Instance, Mailbox, Record, Scope, Wait
from fame.middleware import messages
from fame.robot import Event, RobotNode
from fame.robot.durable import DurableRecorder
from fame.robot.journal import read_segment
from fame.robot.restoring import epoch_of
from fame.robot.state_tables import fold

from .disks import Disk
from .processes import Process

State = dict[str, Any]
_NOT_STATE = {
    "program", "host", "new_variables", "on_incident", "settled", "at_once", "emit", "place", "_trail", "limit",
    "portion", "unsettled", "restored", "suspensions", "starts_no_more", "missed", "ready", "cancelling", "parameters",
    "catch", "body", "counts", "depth", "scopes", "instance", "error",
}  # fmt: skip
"""Attributes that follow from others, or belong to a stimulus or to the host."""
_CHANGING = re.compile("^(moved to|skipped|failed|restarted|retried .* x)|starts from the beginning")
_EARLY = SECOND // 1000
"""Dates of a process are those of its clock, to the microsecond."""


def state_of(node: RobotNode) -> State:
    """The state of a mission between two stimuli: objects by name and key, and what there is once."""
    engine = node.engine
    writer = _Writer()
    writer.write_fields("engine", engine, vars(engine))
    waiting = [(one.node, one.scope) for one in dict.fromkeys(engine.cancelling.values())]
    waiting += [entry for entry in engine.ready if entry[0] is not None]
    writer.found["engine"]["continuations"] = sorted(map(str, map(writer.write, waiting)))
    for instance in engine.instances.values():
        writer.found[f"Instance {instance.key}"]["visits"] = _visits(node, instance)
    return {
        **writer.found,
        "incidents": sorted([one.node.id, *what] for one, what in engine.incidents.items()),
        "totals": [node.started, node.completed, node.failed],
        "suspension": node.suspension.by,
        "signals": _signals(node),
        "ended": {
            f"{one.key}": [one.status, _visits(node, one), writer.write(one.variables), str(one.error or "")]
            for one in [one for one in node.instances if one.status != "running"][-10:]
        },
    }


def _signals(node: RobotNode) -> State:
    """Which acknowledged signals it has thrown, and accepted."""
    if (signals := node.acknowledged) is None:
        return {}
    return {
        "thrown": {name: one.last for name, one in signals.outgoing.items()},
        "accepted": {name: sorted(map(str, one.accepted.items())) for name, one in signals.incoming.items()},
    }


def _visits(node: RobotNode, instance: Instance) -> dict[str, int]:
    """How often each element was entered; of those alone that a migration has left: a record has no others."""
    elements = set(node.engine.program.elements)
    return {element: count for element, count in instance.visits.items() if element in elements}


def disorder(node: RobotNode) -> Iterator[str]:
    """What is armed or in progress without a token that it belongs to, twice, or although that is suspended."""
    engine, runner = node.engine, node.runner
    waits = dict.fromkeys(all_waits(all_scopes(engine)))
    heard = [wait for one in engine.listeners.values() for wait in one if isinstance(wait, Wait)] + [*engine.conditions]
    for wait in dict.fromkeys([*engine.waits.values(), *heard]):
        if wait not in waits:
            yield f"waits at {wait.node.id} without an activity that is active"
    for wait in heard:
        if wait.paused:
            yield f"listens at {wait.node.id}, which is suspended"
    for (_, armed), number in Counter(
        (wait.owner or wait.scope, wait.node) for wait in waits if not wait.token
    ).items():
        if number > 1:
            yield f"waits at {armed.id} {number} times for one activity"
    for key, task in runner._tasks.items():
        if not task.leaving and ((one := engine.waits.get(key)) is None or one.paused):
            yield f"goes on with {task.request}, of a token that {'is suspended' if one else 'has left'}"
    if node.holds and engine.held is None:
        yield f"goes on, and holds for {sorted(node.holds)}"


def stored(disk: Disk) -> dict[str, Any]:
    """The tables of the newest journal on a disk."""
    tables: dict[str, Any] = {}
    if paths := [path for path in disk.content if path.name.removeprefix("journal-").isdecimal()]:
        for change in read_segment(max(paths), disk).records():
            fold(tables, change)
    return tables


def timers_of(node: RobotNode) -> dict[int, int]:
    """When each timer is due (ns since 1970)."""
    dues = {key: node.host.timers.due(key) for key in (*node.engine.waits, *node.engine.armed_starts)}
    return {key: due + epoch_of(node) for key, due in dues.items() if due is not None}


def requests_of(recorder: DurableRecorder) -> State:
    """What leaves the robot, by the keys of the tasks that it is for."""
    return {
        "requests": {wait.key: list(ids) for wait, ids in recorder._requests.items()},
        "goals": {wait.key: list(goal) for wait, goal in recorder._goals.items()},
        "next": recorder._next,
        "cancelled": sorted(recorder.node.runner.cancelled.table()),
    }


def _kept(node: RobotNode, elements: set[str]) -> State:
    """What a migration keeps of a mission: variables, and tokens at elements that both models have."""
    catching = {one for all in node.engine.listeners.values() for one in all}
    boxes = [one for one in catching if isinstance(one, Mailbox) and one.node.id in elements]
    return {
        "variables": {f"{key}": _Writer().write(one.variables) for key, one in node.engine.instances.items()},
        "queues": {one.node.id: _Writer().write(one.messages) for one in sorted(boxes, key=attrgetter("key"))},
        "tokens": sorted(id for one in node.engine.instances.values() for id in one.waiting if id in elements),
        "incidents": sorted(one.node.id for one in node.engine.incidents if one.node.id in elements),
        "suspended": node.suspension.by,
    }


def _dues(node: RobotNode, elements: set[str]) -> list[tuple[str, int]]:
    """When the timers of elements that both models have are due."""
    waits = node.engine.waits
    return sorted(
        (waits[key].node.id, due)
        for key, due in timers_of(node).items()
        if key in waits and waits[key].node.id in elements
    )


class _Writer:
    """Writes values as plain data; objects of the engine once, by name."""

    def __init__(self) -> None:
        self.found: dict[str, Any] = {}

    def write(self, value: Any) -> Any:
        match value:
            case None | bool() | int() | str() | float():
                return value
            case Node():
                return f"Node {value.key}"
            case Scope() | Wait() | Mailbox() | Instance():
                return self.write_object(value)
            case Record():
                return [self.write(value.node), self.write(dict(value.variables)), self.write(value.inner)]
            case Mapping():
                return self.write_mapping(value)
            case list() | tuple() | deque() | set() | frozenset():
                return [self.write(item) for item in value if getattr(item, "alive", True)]
            case Continuation() | Body():
                return ""
        if getattr(value, "__msgtype__", None):
            return [value.__msgtype__, str(messages.to_mapping(value))]
        return f"({type(value).__name__})"

    def write_object(self, item: Any) -> str:
        name = f"{type(item).__name__} {item.key}"
        if name not in self.found:
            self.found[name] = {}
            slots = getattr(item, "__slots__", None) or vars(item)
            self.write_fields(name, item, {slot: getattr(item, slot, None) for slot in slots})
            if isinstance(item, Wait):
                self.found[name]["fails"] = item.catch is AT_INCIDENT
        return name

    def write_fields(self, name: str, item: Any, fields: Mapping[str, Any]) -> None:
        self.found[name] = {}
        self.found[name].update({key: self.write(fields[key]) for key in fields if key not in _NOT_STATE})

    def write_mapping(self, value: Mapping[Any, Any]) -> Any:
        """Pairs in order; variables without what is no data. Empty entries of counters are nothing."""
        pairs = [(self.write(key), item) for key, item in value.items()]
        if all(
            isinstance(key, str) and not key.startswith(("Wait ", "Scope ", "Mailbox ", "Node ")) for key, _ in pairs
        ):
            kept = [(key, self.write(item)) for key, item in pairs if not key.startswith("__")]
            return {key: item for key, item in kept if not str(item).startswith(("(function", "(type", "(module"))}
        return [[key, self.write(item)] for key, item in pairs]


@dataclass
class Witness:
    """What a robot had when it was killed, and whether the next process has the same. `wrong` gets what differs.

    It knows nothing (`forget`) where more than a process was lost: written records are torn, or rot.
    """

    wrong: Callable[[str], object]
    durations: Mapping[str, float] = field(default_factory=dict)  # of timer events, by id (s)
    clocks_are_right: bool = True
    compared: int = 0
    changed: bool = False  # whether a person has changed what comes of the mission
    _before: tuple[str, State, dict[int, int], State] | None = None
    _migrates: bool = False  # whether it tells what a migration begins, in the new model
    _held: Any = None  # what the engine holds
    _held_at: float = 0.0
    _busy_at: float = 0.0  # when it last was away, stopped or held (s)
    _begun: dict[tuple[int, str], float] = field(default_factory=dict)  # timers

    def look(self, now: float, process: Process | None, engine: EngineNode | None) -> None:
        """See whether it can do anything now (s)."""
        node = engine.running if engine is not None else None
        if node is None or process is None or process.stopped or node.holds or (engine and engine.resuming):
            self._busy_at = now
        if node is not None and engine is not None and process is not None and not process.stopped:
            if node.engine.incidents and not node.holds and not node.leaving:
                self.wrong(f"does not hold, with an incident at {[one.node.id for one in node.engine.incidents]}")
            if node.holds - {"deployment"} and engine.state == "running":
                self.wrong(f"says that it is running, and holds for {sorted(node.holds)}")
            if not engine._no_memory and not engine.resuming:
                for text in disorder(node):
                    self.wrong(text)
            self.held_for(now, engine)

    @property
    def held(self) -> bool:
        """Whether its mission was held when it was looked at."""
        return self._held is not None

    def held_for(self, now: float, engine: EngineNode) -> float:
        """For how long its mission has been held, as far as was seen (s); -1 if it is not."""
        held = engine.running.engine.held if engine.running is not None else None
        if held is not self._held:
            self._held, self._held_at = held, now
        return now - self._held_at if held is not None else -1.0

    def on_event(self, now: float, engine: EngineNode, event: Event) -> None:
        """What happens in its mission (s)."""
        if event.what == "report" and _CHANGING.search(str(event.detail)):
            self.changed = True
        node = engine.running
        if event.what not in ("enter", "leave") or node is None or self._migrates:
            return
        if self.held_for(now, engine) > 0:
            self.wrong(f"does {event.what} {event.element} while it is held for {sorted(node.holds)}")
        if event.element and event.element not in node.engine.program.elements:
            self.wrong(f"does {event.what} {event.element}, which its model does not have")
        if (duration := self.durations.get(event.element)) is None:
            return
        place = event.scope, event.element
        if event.what == "enter":
            self._begun[place] = now
        elif place in self._begun and not self.changed:
            due = self._begun.pop(place) + duration
            if now < due - 0.001:
                self.wrong(f"leaves timer {event.element} {due - now:.3f} s too early")
            if now > max(due, self._busy_at + 1) + 0.2 and self.clocks_are_right:
                self.wrong(f"leaves timer {event.element} {now - due:.3f} s late")

    def forget(self) -> None:
        """What comes back may be older: also a timer that has fired, and is set once more."""
        self._before = None
        self._begun.clear()

    def killed(self, engine: EngineNode) -> None:
        """The process ends now, between two stimuli. One that has not resumed leaves what it found."""
        node, keeper = engine.running, engine._keeper
        if engine.resuming or keeper is None:
            return
        self._before = None
        recorder = keeper.recorder
        if node is not None and recorder is not None and recorder.node is node:
            settled = not (recorder._outbox or recorder._trouble or recorder._quiet or recorder._begins.get("begins"))
            if settled and not engine._no_memory:
                self._before = engine.deployed, state_of(node), timers_of(node), requests_of(recorder)

    def watch(self, now: float, engine: EngineNode) -> None:
        """Compare what this process resumes, which begins now (s)."""
        self._busy_at = now
        if not self.clocks_are_right:  # a clock set forward is as a longer outage: what was under way is due earlier
            self._begun.clear()
        take_over = engine._take_over

        def taken_over(candidate: Any, before: str) -> Any:
            assert engine.running is not None
            new, engine._anew = set(candidate.process.engine.program.elements), ""
            if {*candidate.envelope.plan.get("elements", ())} & {*engine.running.engine.program.elements}:
                self.changed, new = True, set()
            had, dues = _kept(engine.running, new), _dues(engine.running, new)
            self._migrates = True
            try:
                go_on, timers = take_over(candidate, before)
            finally:
                self._migrates = False
            if engine._anew:
                self.wrong(f"was ready to migrate, and {engine._anew}")
            elif wrong := list(differences(had, _kept(candidate.process, new))):
                self.wrong(f"has forgotten in a migration: {'; '.join(wrong[:3])}")

            def gone_on() -> object:
                found, process = go_on(), candidate.process
                now, waiting = epoch_of(process) + process.scheduler.now, process.engine.waits.values()
                after, left = _dues(process, new), {wait.node.id for wait in waiting}
                if lost := [one for one in dues if one[1] > now and one[0] in left and one not in after]:
                    self.wrong(f"has not the timers that it had before a migration: {lost} became {after}")
                return found

            return gone_on if timers is not None else go_on, timers

        engine._take_over = taken_over  # type: ignore[method-assign]
        keeper = engine._keeper
        if keeper is None:
            return
        resume = keeper.resume

        def resumed(stored: Any, process: RobotNode) -> Callable[[], object]:
            go_on = resume(stored, process)
            recorder = keeper.recorder
            assert recorder is not None
            before, self._before = self._before, None
            if before is not None and before[0] == stored.envelope.deployment:
                self._compare(before, process, recorder)
            return go_on

        keeper.resume = resumed  # type: ignore[method-assign]

    def _compare(
        self, before: tuple[str, State, dict[int, int], State], process: RobotNode, recorder: DurableRecorder
    ) -> None:
        _, state, dues, requests = before
        original = recorder.go_on

        def go_on(tables: Any, away: float, set_back: int = 0) -> None:
            self.compared += 1
            now = epoch_of(process) + process.scheduler.now
            found = list(differences(state, state_of(process)))
            stored = {
                "requests": {int(key): ids for key, ids in tables.get("requests", {}).items()},
                "goals": {int(key): goal for key, goal in tables.get("goals", {}).items()},
                "next": tables["recorder"]["next"],
                "cancelled": sorted({*tables.get("cancelled", ())}.intersection(requests["cancelled"])),
            }  # a goal that has ended since the last record is cancelled once more, in vain
            found += differences(requests, stored)
            waits = {*process.engine.waits, *process.engine.armed_starts}
            original(tables, away, set_back)
            skipped = {element for element, missed in process.mission.missed().items() if missed != "fire"}
            after = timers_of(process)
            for key, due in dues.items() if self.clocks_are_right else ():
                if key not in waits or not (key in process.engine.waits or key in process.engine.armed_starts):
                    continue
                late = abs(max(after.get(key, 0), now) - max(due, now)) > _EARLY
                if process.engine.timed(key).id not in skipped and (key not in after or late):
                    found.append(f"timer {key}: due at {due}, then at {after.get(key)}")
            if found:
                self.wrong(f"has forgotten in a crash: {'; '.join(found[:3])}")

        recorder.go_on = go_on  # type: ignore[method-assign]


def differences(before: Mapping[str, Any], after: Mapping[str, Any], at: str = "") -> Iterator[str]:
    """What is not the same in two states."""
    for key in dict.fromkeys((*before, *after)):
        one, other = before.get(key), after.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            yield from differences(one, other, f"{at}{key} ")
        elif one != other and (one or other):
            yield f"{at}{key}: {one} became {other}"
