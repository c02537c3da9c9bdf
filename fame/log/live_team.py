"""Follow a team on the network: batches of ``/<robot>/bpmn_events`` become the messages of a recording.

Batches of several robots come in any order. They wait for a while (half a second unless a page wants them earlier), so
that what `put` gets is in the order of time. A robot that is new, or of which a batch was lost, gives everything
with a later batch: then a message of ``/fame/key`` comes, with the state of the whole team and with ``gaps``, and what
was lost is counted and reported. An engine that waits for a process says so on ``bpmn_status`` alone: if it took the
place of one that ran a mission, that mission is lost, and the robot has an empty state from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Set
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from heapq import heappop, heappush
from itertools import count
from typing import Any

from fame.clock import SECOND, Entry, Scheduler
from fame.closing import Closing
from fame.dataclasses import dataclass, field
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.log.team_state import KeyWriter, Put, TeamState, shift_times
from fame.middleware.interface import LATCHED, MAX_MESSAGE_SIZE, AnyMessage, Middleware, Node
from fame.middleware.typesystem import STRING
from fame.robot.robot_state import EVENTS_TOPIC, MODEL_TOPIC, RobotState
from fame.text import read_json
from fame.version import differs

DELAY = SECOND // 2
"""How long batches wait for those of other robots (ns)."""
_DISCOVERY = SECOND // 2
"""Interval of the search for robots (ns)."""
_MATCHED = SECOND // 2
"""How long a robot takes at most to find out that somebody listens (ns)."""
_STRANGE = (ValueError, TypeError, LookupError, AttributeError)
"""Errors raised by a foreign message that is not a batch."""
RESTARTED = "its engine restarted; its mission is lost"
"""What is reported of a robot whose engine does not know the mission of the one before."""
_TAKEN = 3 * SECOND
"""For how long an engine has to be silent until another one of the same name is believed to be in its place (ns)."""
_SETTLED = 1.0
"""After how long an engine that waits for a process does not continue one from its folder (s)."""
_CHANNELS = {"events": EVENTS, "variables": VARIABLES, "waiting": WAITING}


@dataclass(slots=True)
class _Source:
    """The state of one robot's batches."""

    session: int = -1
    batch: int = 0
    time: int = 0  # of the robot's clock at the last batch (ns)
    until: int = 0  # the same since the team's epoch
    synchronised: bool = False
    lost: int = 0  # batches since it was
    heard: int = 0  # when its engine was heard last: a batch or a status of the session (ns of the scheduler)
    batched: int = 0  # when the last batch came (the same)
    successor: int = -1  # the session of an engine in its place that has no process
    ends: list[Any] = field(default_factory=list)
    since: int = 0  # when it was subscribed to (ns of the scheduler)


class LiveTeam(Closing):
    """Follows the robots of a team, or those named in `robots`. `put` gets messages, with times (ns) since `epoch`.

    state     of the team, up to the last call of `put`
    epoch     date of time 0: that of the first robot's clock; None before the first batch
    models    what each robot runs, as its ``bpmn_model`` says
    gaps      how many batches of each robot were lost
    gone      robots that have left the network
    restarted robots whose engine restarted and lost their mission, until they get another one, and since when (ns)
    foreign   robots whose events are of another protocol and are not read, and what to say of each

    `on_model` gets the name of a robot and what it runs, whenever that changes; `note` gets lines for people. What
    comes late has the time `floor` at least. `now` gives the time of the mission (ns since `epoch`) where a simulation
    says it. Without `node`, batches are given to `feed`.
    """

    def __init__(
        self,
        node: Node | None,
        middleware: Middleware | None,
        scheduler: Scheduler,
        put: Put,
        *,
        on_model: Callable[[str, Mapping[str, Any]], object] = lambda robot, model: None,
        note: Callable[[str], object] = lambda text: None,
        robots: frozenset[str] = frozenset(),
        delay: int = DELAY,
        floor: Callable[[], int] = lambda: 0,
        now: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._node, self._middleware, self._scheduler, self._floor = node, middleware, scheduler, floor
        self._on_model, self._wanted, self._now, self._note = on_model, robots, now, note
        self._left_out = False  # whether a change could not be recorded
        self.delay: int = delay
        self._writer = KeyWriter(put)
        self.epoch: datetime | None = None
        self.models: dict[str, Mapping[str, Any]] = {}
        self.gaps: dict[str, int] = {}
        self.gone: Set[str] = set()
        self.restarted: dict[str, int] = {}
        self.foreign: dict[str, str] = {}
        self._sources: dict[str, _Source] = {}
        self._waiting: list[tuple[int, int, Callable[[int], object]]] = []  # time, number, what to do then
        self._numbers = count()
        self._arrived: dict[int, int] = {}  # number of what waits -> when it came
        self.ahead: int = 0  # what is added to all times (ns), since simulated time began again
        self._discovery: Entry = scheduler.soon(self._discover)
        self._release: Entry | None = None

    @property
    def state(self) -> TeamState:
        return self._writer.state

    @property
    def robots(self) -> list[str]:
        """The robots that were found, in order."""
        return sorted(self._sources)

    def listens(self, robots: Iterable[str]) -> bool:
        """Return whether robots have been listened to for so long that they know it: what begins now is complete."""
        since = [self._sources[robot].since if robot in self._sources else self._scheduler.now for robot in robots]
        return all(self._scheduler.now - each >= _MATCHED for each in since)

    def last_time(self, robot: str) -> int:
        """Return the time of a robot's clock in its last batch (ns); 0 without one."""
        return self._sources[robot].time if robot in self._sources else 0

    def last_end(self, robot: str) -> int:
        """Return the end of a robot's last batch (ns since `epoch`); 0 without one."""
        return self._sources[robot].until if robot in self._sources else 0

    def feed(self, robot: str, batch: Mapping[str, Any]) -> None:
        with suppress(*_STRANGE):
            self._take(robot, self._sources.setdefault(robot, _Source()), batch)

    def _discover(self) -> None:
        """Subscribe to the robots that are new."""
        if self._node is None or self._middleware is None:
            return
        self._discovery = self._scheduler.after(_DISCOVERY, self._discover)
        suffix = f"/{EVENTS_TOPIC}"
        names = [info.name for info in self._middleware.graph() if info.name.endswith(suffix) and info.publishers]
        there = {name[1 : -len(suffix)]: name for name in names}
        for robot in sorted(there.keys() - self._sources.keys()):
            if not self._wanted or robot in self._wanted:
                source = self._sources[robot] = _Source(since=self._scheduler.now)
                on_batch, on_model = partial(self._on_batch, robot), partial(self._on_model_message, robot)
                on_status = partial(self._on_status, robot, source)
                source.ends = [
                    self._node.subscription(there[robot], STRING, on_batch),
                    self._node.subscription(f"/{robot}/{MODEL_TOPIC}", STRING, on_model, LATCHED),
                    self._node.subscription(f"/{robot}/bpmn_status", STRING, on_status, LATCHED),
                ]
        self.gone = self._sources.keys() - there.keys()

    def _on_model_message(self, robot: str, message: AnyMessage) -> None:
        with suppress(ValueError, TypeError):
            model = read_json(message.data, MAX_MESSAGE_SIZE)
            if isinstance(model, dict) and self.models.get(robot) != model:
                self.models[robot] = model
                self._on_model(robot, model)

    def _on_status(self, robot: str, source: _Source, message: AnyMessage) -> None:
        """Notice that another engine, which has no process, is in the place of the one whose batches came."""
        with suppress(*_STRANGE):
            report = read_json(message.data, MAX_MESSAGE_SIZE)
            if report["robot"] == robot and source.session >= 0:
                self._compare(robot, source, int(report["born"]), report["state"], float(report["time"]))

    def _compare(self, robot: str, source: _Source, born: int, state: str, age: float) -> None:
        """Compare the engine that was `born` then and reports a state, at an `age` (s), to that of the batches."""
        now = self._scheduler.now
        if born == source.session:
            source.heard = now
        elif (
            born > source.session
            and (state, source.successor) == ("waiting", -1)
            and age >= _SETTLED
            and now - source.heard > _TAKEN
        ):
            source.successor, simulated = born, self._now()
            time = source.until + now - source.batched if simulated is None else simulated
            self.enter(time, partial(self._restart, robot))

    def _on_batch(self, robot: str, message: AnyMessage) -> None:
        with suppress(*_STRANGE):
            self.feed(robot, read_json(message.data, MAX_MESSAGE_SIZE))

    def _take(self, robot: str, source: _Source, batch: Mapping[str, Any]) -> None:
        if not (_is_time(batch["time"]) and type(batch["batch"]) is type(batch["session"]) is int):
            raise ValueError
        if self._is_foreign(robot, source, batch):
            return
        date, before = parse_datetime(str(batch["epoch"])), source.session
        if self.epoch is None:
            self.epoch = date
        shift = nanoseconds_between(self.epoch, date)
        if batch["session"] != source.session:
            source.session, source.synchronised, source.successor = batch["session"], False, -1
            back = self._writer.last - (batch["time"] + shift + self.ahead)
            if batch["time"] + shift < source.until and back > SECOND:  # its simulated time begins again
                self.ahead += back
        elif batch["batch"] != source.batch + 1:
            self.gaps[robot] = self.gaps.get(robot, 0) + max(1, batch["batch"] - source.batch - 1)
            source.synchronised = False
            source.lost += max(1, batch["batch"] - source.batch - 1)
        source.batch, source.time, source.until = batch["batch"], batch["time"], batch["time"] + shift
        source.heard = source.batched = self._scheduler.now
        ahead = shift + self.ahead
        if "begins" in batch:
            source.synchronised = True
            first = min((time for _, time, _ in batch["changes"]), default=batch["time"])
            if before != source.session:
                self.enter(first + shift, partial(self._restart, robot))
            self.enter(first + shift, partial(self._begin, robot, str(batch["begins"])))
        if source.synchronised:
            for channel, time, content in batch["changes"]:
                topic = _CHANNELS[channel]
                self.enter(time + shift, partial(self._change, topic, shift_times(topic, content, ahead)))
        elif "key" in batch:
            source.synchronised = True
            key = shift_times(KEY, {"robots": {robot: batch["key"]}}, ahead)["robots"][robot]
            self.enter(batch["time"] + shift, partial(self._synchronise, robot, key, source.lost))
            source.lost = 0

    def _is_foreign(self, robot: str, source: _Source, batch: Mapping[str, Any]) -> bool:
        """Whether a batch is of another protocol, which is said once; what the robot did before is over then."""
        text = differs(robot, int(batch.get("protocol", 1)))
        if not text:
            self.foreign.pop(robot, None)
        elif robot not in self.foreign:
            self.foreign[robot] = f"events of {robot} are not read: {text}"
            self._note(self.foreign[robot])
            source.synchronised = False
            self.enter(source.until, partial(self._restart, robot))
        return bool(text)

    def enter(self, time: int, action: Callable[[int], object]) -> None:
        """Call `action` in its turn: with this time (ns since `epoch`), or a later one if that has passed.

        Where simulated time has begun again, it goes on from the last time before. Raises ValueError for what is no
        time.
        """
        if not _is_time(time):
            raise ValueError
        number = next(self._numbers)
        heappush(self._waiting, (time + self.ahead, number, action))
        self._arrived[number] = self._scheduler.now
        if self._release is None:
            self._release = self._scheduler.after(self.delay, self._on_due)

    def _on_due(self) -> None:
        """Pass on the messages that have waited long enough, and all earlier ones."""
        self._release = None
        due = [time for time, number, _ in self._waiting if self._arrived[number] <= self._scheduler.now - self.delay]
        self._give(max(due, default=-1))
        if self._waiting:
            self._release = self._scheduler.at(min(self._arrived.values()) + self.delay, self._on_due)

    def pass_on(self) -> None:
        """Pass on all messages that wait for their turn."""
        if self._waiting:
            self._give(max(item[0] for item in self._waiting))

    def _give(self, until: int) -> None:
        """Pass on all messages up to a time."""
        while self._waiting and self._waiting[0][0] <= until:
            time, number, action = heappop(self._waiting)
            del self._arrived[number]
            try:
                action(max(time, self._writer.last, self._floor()))
            except _STRANGE as error:  # of a batch that looked right; said once, since more of the kind will come
                text = "is it of another build of FAME, though of the same protocol?"
                if not self._left_out:
                    self._note(f"something that a robot reported cannot be recorded ({error!r}): {text}")
                self._left_out = True

    def _begin(self, robot: str, process: str, time: int) -> None:
        """Note that a robot starts a process, perhaps after another: its batches are complete from now on."""
        self.restarted.pop(robot, None)
        gaps = {robot: 0} if robot in self.state.robots else None
        self.state.robots[robot] = RobotState(process=process)
        self._writer.key(max(time, self._writer.last + 1), gaps)

    def _restart(self, robot: str, time: int) -> None:
        """Note that the engine of a robot restarted, and does not know what the one before ran."""
        known = self.state.robots.get(robot, RobotState())
        if known == RobotState():
            return
        self.state.robots[robot] = RobotState()
        time = max(time, self._writer.last + 1)
        self._writer.key(time, {robot: 0})
        if known.tokens or any(status == "running" for _, status in known.instances.values()):  # it had not ended
            self.restarted[robot] = time
            self._report(robot, RESTARTED, time)

    def _synchronise(self, robot: str, key: Mapping[str, Any], lost: int, time: int) -> None:
        """Replace the state of a robot, of which `lost` batches have not arrived."""
        self.restarted.pop(robot, None)
        self.state.robots[robot] = RobotState.from_key(key)
        time = max(time, self._writer.last + 1)  # changes of the last instant are included already
        self._writer.key(time, {robot: lost})
        if lost:
            text = f"{lost} batch{'es' * (lost > 1)} of events lost: what happened before is not recorded"
            self._report(robot, text, time)

    def _report(self, robot: str, text: str, time: int) -> None:
        report = {"instance": 0, "scope": 0, "marks": [["", "report", text]]}
        self._change(EVENTS, {"robot": robot, "events": [report]}, time)

    def _change(self, topic: str, content: Mapping[str, Any], time: int) -> None:
        self._writer.change(time, topic, content)

    def close(self) -> None:
        """Pass on all remaining messages, and close all subscriptions."""
        self._discovery.cancel()
        if self._release is not None:
            self._release.cancel()
        self.pass_on()
        for source in self._sources.values():
            for end in source.ends:
                end.close()


def _is_time(value: object) -> bool:
    """Whether a value is a time in ns that a recording can hold."""
    return type(value) is int and abs(value) < 2**62


def now_since(epoch: datetime | None) -> int:
    """Return the real time in ns since an epoch; 0 before it is known."""
    return 0 if epoch is None else nanoseconds_between(epoch, datetime.now(UTC))
