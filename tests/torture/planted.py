"""Bugs that are planted in the code under test, one at a time, to see whether the search finds them, and how soon."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

from fame.deploy import robot_protocol, sender_protocol, termination
from fame.deploy.engine_node import EngineNode
from fame.deploy.envelope import Envelope
from fame.deploy.request_verifier import RequestVerifier
from fame.deploy.requests import TaskServer
from fame.deploy.resumption import _PROMISE, StateKeeper
from fame.engine import Engine, tasks
from fame.gc_tuning import uncollected
from fame.robot import acknowledged, delivery_protocol, journal
from fame.robot.acknowledged import AcknowledgedSignals
from fame.robot.durable import DurableRecorder
from fame.robot.journal import Journal, StateDirectory
from fame.robot.live import LiveFeed
from fame.robot.node import RobotNode
from fame.scripting.cancelled_goals import CancelledGoals

from .invariants import judge
from .plan import draw
from .team import Team

_transition = robot_protocol._Transition


def _reborn_answers_aborted(original: Any) -> Any:
    """An engine that was born after a deployment began answers for its predecessor."""
    return lambda self, envelope: original(self, replace(envelope, born=self.state.born))


def _promise_without_disk(original: Any) -> Any:
    """What the disk refuses is promised nevertheless."""

    def promise(self: StateKeeper, candidate: Any) -> str:
        original(self, candidate)
        return ""

    return promise


def _feed_begins_alone(original: Any) -> Any:
    """A process that begins makes the feed forget those that are loaded."""

    def begin(self: LiveFeed, node: Any, *, resumed: bool = False) -> None:
        original(self, node, resumed=resumed)
        self._loaded.clear()

    return begin


def _nothing(original: Any) -> Any:
    """Does nothing."""
    return lambda *_, **__: None


def _empty(original: Any) -> Any:
    """Does nothing, and says that it is done."""
    return lambda *_, **__: ""


def _zero(original: Any) -> Any:
    """Says 0, whatever the clock says."""
    return lambda *_, **__: 0


def _effect_before_record(original: Any) -> Any:
    """An effect leaves before its record is on the disk."""

    def sync(self: Journal, then: Callable[[], object]) -> None:
        then()

    return sync


def _claims_too_much(original: Any) -> Any:
    """A line says that the one before it is on the disk, which it may not be."""

    def append(self: Journal, record: Any) -> None:
        self._synced = self._number
        original(self, record)

    return append


def _start_at_once(original: Any) -> Any:
    """The sender starts those that are ready before all are."""

    def vote(state: Any, now: int) -> Any:
        ready = sum(each.state == "ready" for each in state.robots)
        return sender_protocol._start(state, now) if ready >= 2 else original(state, now)

    return vote


def _decides_alone(original: Any) -> Any:
    """A robot that is ready aborts by itself when its sender falls silent."""

    def step(state: Any, event: Any) -> Any:
        return (state, termination.Abort()) if isinstance(event, termination.Silence) else original(state, event)

    return step


def _starts_alone(original: Any) -> Any:
    """A robot that is ready starts by itself when its sender falls silent."""

    def step(state: Any, event: Any) -> Any:
        return (
            (state, termination.StartCandidate()) if isinstance(event, termination.Silence) else original(state, event)
        )

    return step


def _ready_is_aborted(original: Any) -> Any:
    """A robot that is ready tells the others that it has aborted, and stays ready."""
    return lambda state, *, started: "started" if started else "aborted"


def _promise_not_resumed(original: Any) -> Any:
    """An engine that is born again does not know what the one before had promised."""
    return lambda self: None


def _file_not_synced(original: Any) -> Any:
    """A file is renamed before its content is on the disk."""

    def write_file(self: StateDirectory, name: str, data: bytes) -> None:
        file = self.disk.write(self.path / (name + ".tmp"), new=True)
        file.write(data)
        self.disk.rename(self.path / (name + ".tmp"), self.path / name)
        self.disk.sync_directory(self.path)

    return write_file


def _name_not_synced(original: Any) -> Any:
    """A file is renamed, and its new name is not on the disk."""

    def write_file(self: StateDirectory, name: str, data: bytes) -> None:
        file = self.disk.write(self.path / (name + ".tmp"), new=True)
        file.write(data)
        file.sync()
        self.disk.rename(self.path / (name + ".tmp"), self.path / name)

    return write_file


def _unchecked(original: Any) -> Any:
    """The checksum of a record is not compared."""

    def checked(line: bytes, seed: int) -> tuple[int, int] | None:
        try:
            number, synced = line[9:].split(b" ", 2)[:2]
            return int(number), int(synced)
        except ValueError:
            return None

    return checked


def _changes_forgotten(original: Any) -> Any:
    """Every tenth stimulus is not recorded."""

    def append(self: Journal, record: Any) -> None:
        self._skipped = not getattr(self, "_skipped", False) and self._number % 10 == 0
        if not self._skipped:
            original(self, record)

    return append


def _promise_removed_at_start(original: Any) -> Any:
    """A promise is forgotten when its process starts, before that is on the disk."""

    def begin(self: StateKeeper, envelope: Envelope, *rest: Any) -> None:
        self.forget_promises(envelope.order)
        original(self, envelope, *rest)

    return begin


def _start_unwritten(original: Any) -> Any:
    """A process starts, and is said to be started, before that is on the disk."""

    def begin_with(self: DurableRecorder, before: Any, after: Any, start: Callable[[], object]) -> None:
        original(self, before, after, lambda: None)
        start()

    return begin_with


def _set_aside_is_dropped(original: Any) -> Any:
    """A promise that a newer deployment sets aside is forgotten."""

    def set_aside(self: Any) -> None:
        original(self)
        self.state = replace(self.state, promises=())

    return set_aside


def _again_after_migration(original: Any) -> Any:
    """What was received before a migration is taken again."""
    return lambda self: None


def _started_again(original: Any) -> Any:
    """What a restored state continues starts again, though what ended a hold has started it."""

    def restart(self: Engine) -> None:
        for wait in list(self.waits.values()):
            if wait.started and wait.alive and not wait.paused:
                tasks.restart(self, wait)
        self.run()

    return restart


def _some_dropped(original: Any) -> Any:
    """Every tenth message is lost on its way to the engine."""

    def on_message(self: RobotNode, topic: str, message: Any) -> None:
        if message.data % 10:
            original(self, topic, message)

    return on_message


def _alarms_dropped(original: Any) -> Any:
    """Every second alarm is lost on its way to the engine."""

    def on_message(self: RobotNode, topic: str, message: Any) -> None:
        if not topic.endswith("alarm") or message.data % 4 == 3:
            original(self, topic, message)

    return on_message


def _deaf_in_the_end(original: Any) -> Any:
    """No message from the 15th of a version on reaches the engine."""

    def on_message(self: RobotNode, topic: str, message: Any) -> None:
        if message.data % 1000 < 15:
            original(self, topic, message)

    return on_message


def _signal_taken_again(original: Any) -> Any:
    """An acknowledged signal that arrives again is taken again."""

    def step(state: Any, event: Any) -> Any:
        after, actions = original(state, event)
        again = event.number and event.number == state.accepted.get((event.robot, event.life))
        return after, (delivery_protocol.Accept(event.data), *actions) if again else actions

    return step


def _repair_each_time(original: Any) -> Any:
    """A request that is repeated is done again, and answered by its last result."""

    def on_request(self: Any, message: Any) -> None:
        self._answers.clear()
        original(self, message)

    return on_request


def _sequence_reversed(original: Any) -> Any:
    """Of two deployments the older is taken for the newer."""
    return property(lambda self: (-self.sequence, self.deployment))


def _promise_overwrites_nothing(original: Any) -> Any:
    """A promise is written only if there is none yet."""

    def promise(self: StateKeeper, candidate: Any) -> str:
        if self.directory.read_file(_PROMISE) is None:
            self._write_promises([candidate.envelope])
        return ""

    return promise


Bug = tuple[object, str, Callable[[Any], Any]]
BUGS: dict[str, Bug] = {
    "a reborn robot answers aborted": (_transition, "_answer_peer", _reborn_answers_aborted),
    "a promise that the disk refused": (StateKeeper, "promise", _promise_without_disk),
    "a candidate's feed is forgotten": (LiveFeed, "begin", _feed_begins_alone),
    "a promise that is not written": (StateKeeper, "promise", _empty),
    "a promise that is not read again": (EngineNode, "_read_promises", _promise_not_resumed),
    "a promise that hides the next one": (StateKeeper, "promise", _promise_overwrites_nothing),
    "a promise that is removed too early": (StateKeeper, "begin", _promise_removed_at_start),
    "a start before its record": (DurableRecorder, "begin_with", _start_unwritten),
    "an effect before its record": (Journal, "sync", _effect_before_record),
    "a record that claims too much": (Journal, "append", _claims_too_much),
    "a checksum that nobody compares": (journal, "_checked", _unchecked),
    "a change that is not recorded": (Journal, "append", _changes_forgotten),
    "a file renamed before it is synced": (StateDirectory, "write_file", _file_not_synced),
    "a name that is not synced": (StateDirectory, "write_file", _name_not_synced),
    "a state that is not synced at its end": (DurableRecorder, "_let_leave", _nothing),
    "a sender that starts too early": (sender_protocol, "_vote", _start_at_once),
    "a robot that aborts alone": (termination, "step", _decides_alone),
    "a robot that starts alone": (termination, "step", _starts_alone),
    "a ready robot that says aborted": (termination, "reply", _ready_is_aborted),
    "what was set aside is forgotten": (_transition, "_set_aside", _set_aside_is_dropped),
    "messages twice after a migration": (RobotNode, "forget_early", _again_after_migration),
    "work twice after a migration": (Engine, "restart", _started_again),
    "a goal that runs on without a word": (CancelledGoals, "texts", lambda original: lambda self: []),
    "a message that is dropped": (RobotNode, "on_message", _some_dropped),
    "a robot that stops listening": (RobotNode, "on_message", _deaf_in_the_end),
    "an alarm that is dropped": (RobotNode, "on_message", _alarms_dropped),
    "a signal taken as often as it arrives": (acknowledged, "step_incoming", _signal_taken_again),
    "a repair done each time it is asked": (TaskServer, "_on_request", _repair_each_time),
    "a sequence compared wrongly": (Envelope, "order", _sequence_reversed),
    "a robot that does not report": (EngineNode, "_on_loaded", _nothing),
    "a hold that nobody ends": (_transition, "decide", _nothing),
    "a clock that moves the timers": (StateKeeper, "_set_back", _zero),
    "a signature that nobody checks": (RequestVerifier, "verify_deployment", _nothing),
    "signals accepted again after a crash": (AcknowledgedSignals, "restore", _nothing),
    "signals that expire without a word": (AcknowledgedSignals, "_report", _nothing),
}
"""What the code does wrong: where, and its replacement made from the original."""


@contextmanager
def planted(name: str) -> Iterator[None]:
    """The bug of this name is in the code meanwhile."""
    target, attribute, make = BUGS[name]
    with patch.object(target, attribute, make(vars(target)[attribute])):
        yield


def seeds_until_found(name: str, starts: Sequence[int], limit: int) -> int:
    """After how many seeds a bug is found: the median over the first seeds; `limit` if it is not."""
    searching = set(starts)
    with planted(name):
        for number in range(limit):
            with uncollected(stays=True):
                searching -= {start for start in searching if judge(Team(draw(start + number)))}
                gc.collect()
            if len(searching) <= len(starts) // 2:
                return number + 1
    return limit
