"""Durable execution of one robot: record what its engine does, and go on from there after a crash.

Theory of operation. A stimulus of the engine runs to completion, and then `DurableRecorder.settled` appends one record
with what it has changed: tokens, variables, timers, counters. Nothing is computed again when the engine is resumed: the
state is read, so no script, condition or service that has ended runs twice.

*Effects* are signals, messages, goals and service calls. An effect waits until the record of its stimulus is on the
disk, and leaves then. When it has left, a record says so. After a crash those that may not have left are sent again:
effects are delivered at least once, each under an id that stays the same. What scripts publish with `robot.publish` is
no effect: it leaves at once.

The requests (goals, service calls) of a task are numbered. A task that was waiting starts again on resumption; its
request of the same number takes up the goal from before, if the server still knows it, and otherwise does what the
task's property ``retry`` says. If the task is cancelled before it comes to that, so is the goal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from errno import EIO
from functools import partial
from typing import Any, NamedTuple
from uuid import NAMESPACE_URL, uuid5

from fame.clock import SECOND, Kind
from fame.engine import BpmnError
from fame.engine.state import Wait
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import Publisher
from fame.robot.journal import Journal, JournalRecord
from fame.robot.node import RobotNode
from fame.robot.restoring import epoch_of, follow_cancelled, go_on, set_timers, tables_of
from fame.robot.state_tables import StateTables, TableRows, Tables, instance_data
from fame.robot.state_transfer import arm_taken_over
from fame.robot.stored_values import StoredValues, plain_messages
from fame.scripting.requests import Act, Call

RECOVERED = "~/recovered"
"""The signal that a resumed engine raises inside itself; its payload is how long it was away (s)."""
_ENDED = 10
"""Number of ended instances that are kept."""
_RETRY_DISK = SECOND
_UNWRITABLE = (OSError, MemoryError)
"""Errors while a state is written that may pass: of the disk, and of what a record takes."""


class _Request(NamedTuple):
    """A request that is to leave: what is recorded of it, and what lets it leave."""

    recorded: list[Any]
    leave: Callable[[], object]


class _Signals(NamedTuple):
    """Signals in a row on one topic."""

    publisher: Publisher
    messages: list[Any]


_Effect = _Signals | _Request


def _nothing() -> None:
    """Do nothing before or after writing a state: the default."""


class DurableRecorder:
    """Records one robot's engine in a journal, and holds its effects until they are on the disk.

    on_trouble  called with the reason when the journal cannot be written, and with an empty text when it can again
    answers     to requests of people; what is new in it is recorded at the end of `at_once`
    epoch       the date of the scheduler's time 0 in what is stored (ns since 1970); by default that of the mission
    anew        writes what belongs to the journal besides, into a directory that has taken the place of the old one
    """

    node: RobotNode
    journal: Journal

    def __init__(
        self,
        node: RobotNode,
        journal: Journal,
        *,
        on_trouble: Callable[[str], object] = lambda text: None,
        answers: TableRows | None = None,
        epoch: int | None = None,
    ) -> None:
        self.node, self.journal, self._on_trouble = node, journal, on_trouble
        self._answers, self._has_answered = {} if answers is None else answers, False
        journal.failed = self._fail
        self._epoch = epoch_of(node) if epoch is None else epoch
        self._dump = StoredValues(node.mission).dump
        self._tables = StateTables(node.engine, self._report_unstorable, self._dump)
        self._outbox: list[_Effect] = []
        self._leaving: dict[str, list[_Effect]] = {}  # by batch: the effects of one stimulus
        self._recorded: dict[str, list[Any]] = {}
        self._next = 1
        self._requests: dict[Wait, list[str]] = {}  # the ids of the requests of a task, in order
        self._made: dict[Wait, int] = {}  # how many of them it has made since it began, or since the resumption
        self._goals: dict[Wait, list[str]] = {}  # the last of each task: hex id, action, type
        self._not_taken_up: set[Wait] = set()  # tasks whose goal is from before the resumption
        self._given_up: TableRows = {}  # goals that were cancelled before the resumption
        over = [instance for instance in node.instances if instance.status != "running"][-_ENDED:]
        program = node.engine.program
        self._ended: dict[str, Any] = {str(each.key): instance_data(each, program, self._dump) for each in over}
        self._has_ended = bool(over)
        self._reported: set[tuple[str, str]] = set()
        node.host.scripts.altered = self._report_altered
        self._note = ""
        self.anew: Callable[[], object] = _nothing
        self._is_bare = False  # whether another directory has taken the place of the old one, and `anew` has failed
        self._before: Callable[[], object] = _nothing
        self._start: Callable[[], object] = _nothing
        self._after: Callable[[], object] = _nothing
        self._begins: Tables = {}  # how the process is to start, and with which timers, until it has started
        self._gathers = False  # whether changes wait for the end of `at_once`
        self._trouble = ""
        self._quiet = False
        node.engine.settled = self.settled
        node.host.recorder = self
        node.runner.outward = self

    # ---- records -----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Write the state as the beginning of a journal. Raises OSError."""
        self._is_bare |= self.journal.directory.lock_again()
        if self._is_bare:
            self.anew()
        self._is_bare = False
        self._before()
        self.journal.begin_segment(self._record(whole=True))
        self._after()
        self._before = self._after = _nothing

    def begin_with(
        self,
        before: Callable[[], object],
        after: Callable[[], object],
        start: Callable[[], object],
        timers: TableRows | None,
    ) -> None:
        """Call `before`, write the state as `begin` does, call `after`; if the disk fails, all of it is tried again.

        `start` is called when it has been written. `timers`: those of the process that this one takes over, None for
        one that starts from its beginning. Until the record after `start`, the state says that it is to be started.
        """
        self._before, self._after, self._start, self.anew = before, after, start, before
        self._begins = {"begins": {"": "process" if timers is None else "taken over"}}
        if timers is not None:
            later = self._epoch - epoch_of(self.node)
            self._begins["timers"] = {key: [*what, base + later, n] for key, (*what, base, n) in timers.items()}
        try:
            self.begin()
        except _UNWRITABLE as error:
            self._fail(error)
        else:
            self._start_process()

    def _start_process(self) -> None:
        start, self._start = self._start, _nothing
        with self.at_once():
            try:
                start()
            finally:
                self._begins = {"begins": {}}

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Record all that the block does in one record, together with what is new in the answers."""
        self._gathers = True
        try:
            yield
        finally:
            self._gathers = False
        self._has_answered = True
        self.settled()

    def settled(self) -> None:
        """Record the changes of a stimulus that has run to completion, then send its effects."""
        if self._quiet or self._gathers or self._trouble:
            return
        batch = self._close_batch()
        try:
            if self.journal.is_long:
                self.begin()
            elif record := self._record():
                self.journal.append(record)
            if batch:
                self.journal.sync(partial(self._let_leave, batch))
        except _UNWRITABLE as error:
            self._fail(error)

    def _close_batch(self) -> str:
        """Put the effects since the last record into a batch. Returns its id, or nothing without effects."""
        if not self._outbox:
            return ""
        batch, self._next = str(self._next), self._next + 1
        self._leaving[batch], self._outbox = self._outbox, []
        if recorded := _recorded(self._leaving[batch]):
            self._recorded[batch] = recorded
        return batch

    def _record(self, *, whole: bool = False) -> JournalRecord:
        """The changes since the last record, or the whole state; empty if nothing has changed."""
        for wait in [wait for wait in self._requests if not wait.alive]:
            self._forget_requests(wait)
        more: Tables = {
            **tables_of(self.node, self._epoch),
            "effects": self._recorded,
            "requests": {str(wait.key): made for wait, made in self._requests.items()},
            "goals": {str(wait.key): goal for wait, goal in self._goals.items()},
            "recorder": {"next": self._next},
            **self._begins,
        }
        if whole or self._has_ended:
            more["ended"], self._has_ended = self._ended, False
        if whole or self._has_answered:
            more["answers"], self._has_answered = self._answers, False
        change = self._tables.changes(more, whole=whole)
        if self._note:
            change["note"], self._note = self._note, ""
        return {"time": self.now, **change} if change else {}

    @property
    def now(self) -> int:
        """The date (ns since 1970) in the time of the mission."""
        return self._epoch + self.node.scheduler.now

    def count_from(self, epoch: int) -> None:
        """Store dates by a clock that was perhaps set: `epoch` as of the class. Less than a second is left as it is."""
        if abs(epoch - self._epoch) > SECOND:
            self._epoch = epoch
            self.settled()

    def wait_until_written(self) -> None:
        """Wait until all that has been recorded is on the disk. Raises OSError."""
        if self._trouble:
            raise OSError(EIO, self._trouble)
        self.journal.flush()

    def instance_ended(self, instance: Any) -> None:
        self._ended[str(instance.key)], self._has_ended = instance_data(instance, instance.program, self._dump), True
        for key in list(self._ended)[:-_ENDED]:
            del self._ended[key]

    def note(self, text: str) -> None:
        """Add a line for people to the next record."""
        self._note = text

    def close(self) -> None:
        """Record and send the remaining effects, and stop. The journal stays open."""
        try:
            if not self._quiet and not self._trouble:
                self._flush()
                self._give_up_goals()
        except OSError as error:
            reason = error.strerror or str(error)
            self.node.host.report("", f"its last changes are not on the disk, and what they send is not sent: {reason}")
        self._quiet = True
        self.node.engine.settled = None
        self.node.host.recorder = None
        self.node.runner.outward = None

    def drop(self) -> None:
        """Stop, and record nothing more: what has changed since the last record may be half done."""
        self._quiet = True
        self.close()

    def _flush(self) -> None:
        self._close_batch()
        if record := self._record():
            self.journal.append(record)
        if self._leaving:
            self.journal.flush()
            for batch in list(self._leaving):
                self._let_leave(batch)

    def _give_up_goals(self) -> None:
        """Record the goals that end with this engine: the next one makes sure of it, and sends them again."""
        runner = self.node.runner
        followed = {goal[0]: [*goal[1:], False] for wait, goal in self._goals.items() if runner.follows_goal(wait.key)}
        if followed:
            self.journal.append({"time": self.now, "set": {"cancelled": followed}})

    # ---- effects -----------------------------------------------------------------------------------------------------

    def signal(self, publisher: Publisher, message: Any) -> None:
        """Send a signal, or a message to all robots, once its record is on the disk."""
        last = self._outbox[-1] if self._outbox else None
        if last.__class__ is _Signals and last[0] is publisher:
            last[1].append(message)
        else:
            self._outbox.append(_Signals(publisher, [message]))

    def message(self, topic: str, value: Any, robot: Any) -> None:
        """Send a message to one robot, once its record is on the disk. Raises what `DirectMessages.prepare` raises."""
        direct = self.node.endpoints.direct
        publisher, message = direct.prepare(topic, value, robot)
        recorded = ["message", topic, str(robot), messages.to_mapping(message)]
        self._outbox.append(_Request(recorded, partial(direct.enter, publisher, message)))

    def once_written(self, send: Callable[[], object]) -> None:
        """Call this once what has happened so far is on the disk."""
        self._outbox.append(_Request([], send))
        self.node.scheduler.soon(self.settled, Kind.RESUMPTION)

    def _let_leave(self, batch: str) -> None:
        """Send the effects of a batch, whose record is on the disk."""
        if self._quiet:
            return
        for effect in self._leaving.pop(batch, ()):
            if isinstance(effect, _Request):
                try:
                    effect.leave()
                except FameError as error:
                    self._report_unsent(effect, error)
                continue
            publish = effect.publisher.publish
            for message in effect.messages:
                try:
                    publish(message)
                except FameError as error:
                    self._report_unsent(effect, error)
        if self._recorded.pop(batch, None) is not None and not self._trouble:
            try:
                self.journal.append({"time": self.now, **self._tables.drop("effects", batch)})
            except _UNWRITABLE as error:
                self._fail(error)

    def _report_unsent(self, effect: _Effect, error: FameError) -> None:
        what = " ".join(map(str, part[:2])) if (part := next(iter(_recorded([effect])), None)) else "an acknowledgement"
        self.node.host.report("", f"{what} cannot be sent: {error}")

    # ---- requests of tasks (`fame.scripting.runner.Outward`) ---------------------------------------------------------

    def request(
        self,
        key: int,
        request: Act | Call,
        begin: Callable[[bytes | None], object],
        attach: Callable[[bytes], object] | None,
        lost: Callable[[str], object],
    ) -> None:
        """Make a request of a task when its record is on the disk, or take up the one that it made before."""
        wait = self.node.engine.waits.get(key)
        if wait is None:
            begin(None)
            return
        number = self._made.get(wait, 0)
        self._made[wait] = number + 1
        known = self._requests.setdefault(wait, [])
        if number >= len(known) - 1:  # its last request from before, or a new one: no goal is left behind
            self._not_taken_up.discard(wait)
        if number >= len(known):
            self._ask(wait, number, request, begin)
        elif (goal := self._goal(known[number])).hex() in self._given_up:
            lost("it was cancelled when the engine ended")
        elif attach is not None:
            attach(goal)
        else:
            lost("it was made before the engine ended")

    def repeat(self, key: int, request: Act | Call, begin: Callable[[bytes | None], object]) -> None:
        """Make the last request of a task again."""
        wait = self.node.engine.waits.get(key)
        if wait is None:
            begin(None)
        else:
            self._ask(wait, self._made[wait] - 1, request, begin)

    def _ask(self, wait: Wait, number: int, request: Act | Call, begin: Callable[[bytes | None], object]) -> None:
        """Make a request under a new id."""
        name = request.action if isinstance(request, Act) else request.service
        kind = "goal" if isinstance(request, Act) else "call"
        id, self._next = str(self._next), self._next + 1
        self._outbox.append(_Request([kind, name, wait.node.id], partial(begin, self._goal(id))))
        self._requests[wait] = [*self._requests.get(wait, [])[:number], id]
        if isinstance(request, Act):
            self._goals[wait] = [self._goal(id).hex(), request.action, request.type]
        self.node.scheduler.soon(self.settled, Kind.RESUMPTION)

    def task_cancelled(self, key: int) -> None:
        """Forget the requests of a task that is cancelled: should it start again, it makes them anew."""
        if (wait := self.node.engine.waits.get(key)) is not None:
            self._forget_requests(wait)

    def _forget_requests(self, wait: Wait) -> None:
        """Forget those of a task, and cancel its goal from before the resumption unless it has taken that up."""
        for table in (self._requests, self._made):
            table.pop(wait, None)
        goal, runner = self._goals.pop(wait, None), self.node.runner
        if goal is not None and wait in self._not_taken_up:
            runner.cancelled.take_up({goal[0]: (*goal[1:], False)}, runner.inbox.action)
        self._not_taken_up.discard(wait)

    def _goal(self, id: str) -> bytes:
        """The id of a goal: the same after every resumption."""
        return uuid5(NAMESPACE_URL, f"fame:{self.journal.header['journal']}:{id}").bytes

    # ---- trouble -----------------------------------------------------------------------------------------------------

    def check_directory(self) -> None:
        """Report that the directory was removed, in which what is written would be lost."""
        try:
            self.journal.directory.touch()
        except _UNWRITABLE as error:
            self._fail(error)

    def _fail(self, error: OSError | MemoryError) -> None:
        """Report that the state cannot be written: nothing leaves until the whole of it is written."""
        if not self._trouble:
            self._trouble = "no memory is left" if isinstance(error, MemoryError) else error.strerror or str(error)
            self._on_trouble(self._trouble)
            self.node.scheduler.after(_RETRY_DISK, self._try_again, Kind.RESUMPTION)

    def _try_again(self) -> None:
        if self._quiet:
            return
        self._close_batch()
        try:
            self.begin()
        except _UNWRITABLE:
            self.node.scheduler.after(_RETRY_DISK, self._try_again, Kind.RESUMPTION)
            return
        self._trouble = ""
        for batch in list(self._leaving):
            self._let_leave(batch)
        self._on_trouble("")
        self._start_process()

    def _report_unstorable(self, name: str, reason: str, fate: str = "is lost") -> None:
        if (name, reason) in self._reported:
            return
        self._reported.add((name, reason))
        self.node.host.report("", f"variable {name} {fate} if the engine ends: {reason}" if name else reason)

    def _report_altered(self, name: str, reason: str) -> None:
        self._report_unstorable(name, reason, "changes")

    # ---- resumption --------------------------------------------------------------------------------------------------

    def go_on(self, tables: Tables, away: float, set_back: int = 0) -> None:
        """Go on with a restored engine, which was away for this long (s).

        The robot is brought to its safe state; what may not have left is sent; `RECOVERED` is raised; then timers are
        set, and scripts start again. `set_back` is how far the clock is before the last moment known (ns).
        """
        node, engine = self.node, self.node.engine
        waits = engine.waits
        self._requests = {
            waits[int(key)]: made for key, made in tables.get("requests", {}).items() if int(key) in waits
        }
        self._goals = {waits[int(key)]: goal for key, goal in tables.get("goals", {}).items() if int(key) in waits}
        self._not_taken_up, self._given_up = set(self._goals), tables.get("cancelled", {})
        self._ended = dict(tables.get("ended", {}))
        self._recorded = dict(tables.get("effects", {}))
        self._leaving = {batch: list(self._again(found)) for batch, found in self._recorded.items()}
        self._next = tables["recorder"]["next"]
        node.host.make_safe("suspended")
        follow_cancelled(node, tables)
        missed = set_timers(node, tables, max(0, set_back))
        begins = tables.get("begins", {}).get("")
        self._quiet = True  # until the new state is written as a whole, a second crash finds the old one
        if begins == "process":
            engine.begin({})
        else:
            node.raise_signal(RECOVERED, "std_msgs/msg/Float64", away)
        for wait in missed:
            if wait.alive:
                wait.catch.give_up(engine, wait, BpmnError("missed", "the timer came due while the engine was away"))
        engine.run()
        if begins == "taken over":
            arm_taken_over(node)
        self._quiet = False
        self._close_batch()
        try:
            self.begin()
        except _UNWRITABLE as error:
            self._fail(error)
        for batch in list(self._leaving) if not self._trouble else ():
            self._let_leave(batch)
        go_on(node)
        self.settled()

    def _again(self, effects: list[list[Any]]) -> Iterator[_Effect]:
        """Effects that may not have left. A request is made again by its task."""
        for kind, name, *rest in effects:
            if kind == "signal":
                type, values = rest
                publisher = self.node.endpoints.publisher(name, type)
                yield _Signals(publisher, [messages.create(type, value) for value in values])
            elif kind == "message":
                robot, value = rest
                send = partial(self.node.endpoints.direct.send, name, value, robot)
                yield _Request([kind, name, *rest], send)


def _recorded(effects: Sequence[_Effect]) -> list[list[Any]]:
    """The records of some effects."""
    return [
        effect.recorded
        if isinstance(effect, _Request)
        else ["signal", (to := effect.publisher).topic, to.type, plain_messages(to.type, effect.messages)]
        for effect in effects
        if not isinstance(effect, _Request) or effect.recorded
    ]
