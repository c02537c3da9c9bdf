"""Simulated time between processes: the world publishes the time on `/clock`, and all other processes follow it.

`ClockFollower` is the scheduler of a follower. Entries of the wall-clock scheduler process its queue: up to the time of
the clock whenever a clock message comes, and at once for entries that are due already. So messages and requests are
handled while time stands still, and nothing else moves. Work in wall-clock time (middleware, deployment, status) stays
in the wall-clock scheduler, and runs after each second of simulated time that had work.

A clock jumps when its world is killed and started again, or when there is a second world: it goes back, or further
ahead than any world can run. The follower's time then continues from its last value, so that each timer keeps its
remaining duration.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fame.clock import SECOND, Action, Entry, Kind, Scheduler
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, EndpointWarning, Node, QoS
from fame.middleware.wire_base import WireMiddleware, WireNode
from fame.worker import Worker

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
CLOCK_QOS = QoS(depth=10)
"""The quality of service of the clock's publisher."""
_FOLLOWER_QOS = QoS(reliability="best_effort", depth=1)
"""The quality of service of its subscriptions, as in ROS: keep only the latest time."""

STEP_DONE, STEP_DONE_TYPE = "/clock_done", "std_msgs/msg/Header"
"""Topic on which each robot (`frame_id`) reports that it has done a step (`stamp`), in lockstep."""


_SLICE = SECOND
"""Simulated time that is processed before wall-clock work gets its turn (ns)."""
_FASTEST = 1000
"""Maximum speed of a world, as a multiple of wall-clock time."""
_SLACK = 10 * SECOND
"""Tolerated additional advance of the clock (ns): only the last of several messages may arrive."""
_REPORT_PERIOD = SECOND
"""Jumps within this time (ns of the wall clock) after a reported one are not reported."""


class Lockstep:
    """Holds the nodes of a middleware that `holds` accepts, existing and new ones.

    It makes a run between processes repeatable. A held node queues incoming messages: `release` delivers them sorted by
    topic, sender and receiver, those of one sender in its order. `flush` ensures that the messages of held nodes have
    arrived when the next step begins. Services and actions are not held.
    """

    def __init__(self, middleware: WireMiddleware, holds: Callable[[WireNode], bool]) -> None:
        self._middleware = middleware
        middleware.hold(holds)

    def release(self, enter: Callable[[Callable[[], object]], object]) -> None:
        """Take all queued messages; `enter` gets an action that delivers each, in order."""
        found = [
            (subscription.topic, sender, node.full_name, number, partial(subscription.deliver, data))
            for node in list(self._middleware.nodes)
            if node.held
            for subscription in list(node.subscriptions)
            for number, (sender, data) in enumerate(subscription.drain())
        ]
        found.sort(key=lambda entry: entry[:4])
        for *_, deliver in found:
            enter(deliver)

    def flush(self) -> None:
        """Wait, for a while, until the other processes have received all sent messages."""
        self._middleware.flush()


class ClockFollower(Scheduler):
    """Simulated time that follows a clock. `wall` is the scheduler whose thread does all the work.

    `on_jump` is called with a warning when the clock jumps.
    """

    def __init__(self, wall: Scheduler, on_jump: Callable[[EndpointWarning], object] = lambda warning: None) -> None:
        super().__init__()
        self.on_jump: Callable[[EndpointWarning], object] = on_jump
        self._wall = wall
        self._last: int | None = None  # the last time of the clock, ns
        self._last_at = 0  # when it came, ns of the wall clock
        self._reported_at: int | None = None  # when a jump was reported, ns of the wall clock
        self._offset = 0  # how far our time is ahead of the clock, ns
        self._goal = 0  # how far our time may go, ns
        self._scheduled = self._in_lockstep = False

    @property
    def known(self) -> bool:
        """Whether a clock message has arrived."""
        return self._last is not None

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = super().at(time, action, kind)
        if entry.time <= self.now and not self._running:
            self._schedule()
        return entry

    def worker(self, name: str) -> Worker:
        """Return a worker: in lockstep its work takes no time, as the world waits; else the clock goes on meanwhile."""
        return super().worker(name) if self._in_lockstep else self._wall.worker(name)

    def on_clock(self, time: int) -> None:
        """Advance to the time of the clock (ns)."""
        last, passed = self._last, self._wall.now - self._last_at
        if last is None:  # the first time may be any, unless something waits already
            last, passed = (time if self.next_time() is None else 0), 0
        self._last, self._last_at = time, self._wall.now
        if not 0 <= time - last <= _SLACK + _FASTEST * passed:
            self._offset = self._goal - time
            self._report_jump(last, time)
        self._goal = time + self._offset
        self._catch_up()

    def subscribe(self, node: Node) -> None:
        """Follow the clock, by a subscription of this node."""
        node.subscription(
            CLOCK, CLOCK_TYPE, lambda message: self.on_clock(messages.nanoseconds(message.clock)), _FOLLOWER_QOS
        )

    def subscribe_in_lockstep(self, node: Node, lockstep: Lockstep) -> None:
        """Follow the clock step by step, and report each step as done. The first message only sets the time.

        A world repeats a step for an engine that has come back: engines that have done it report it again.
        """
        self._in_lockstep = True
        done = node.publisher(STEP_DONE, STEP_DONE_TYPE)
        last, begun = -1, False

        def step(message: AnyMessage) -> None:
            nonlocal last, begun
            time = messages.nanoseconds(message.clock)
            if last < 0:
                self.on_clock(time)
            elif time != last or not begun:  # the first step is at the initial time
                begun = True
                lockstep.release(lambda action: self.at(time + self._offset, action, Kind.MESSAGE))
                self.on_clock(time)
                self.run(self._goal)
            last = time
            lockstep.flush()
            done.publish(messages.create(STEP_DONE_TYPE, {"stamp": message.clock, "frame_id": node.namespace}))

        node.subscription(CLOCK, CLOCK_TYPE, step)

    def _catch_up(self) -> None:
        """Run due entries, a slice at a time."""
        self._scheduled = False
        due = self.next_time()
        self.run(self._goal if due is None else min(self._goal, due + _SLICE))
        if self.now < self._goal:
            self._schedule()

    def _schedule(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._wall.soon(self._catch_up)

    def _report_jump(self, last: int, time: int) -> None:
        if self._reported_at is None or self._wall.now - self._reported_at >= _REPORT_PERIOD:
            self._reported_at = self._wall.now
            way = "back" if time < last else "ahead"
            text = (
                f"{CLOCK} jumped {way} from {last / SECOND:.1f} to {time / SECOND:.1f} s: a world was started again, "
                "or there is a second one; timers wait for the rest of their time"
            )
            self.on_jump(EndpointWarning("", text, "clock"))


def clock_message(time: int) -> AnyMessage:
    """Return the message of the clock at `time` (ns)."""
    second, nanosecond = divmod(time, SECOND)
    return messages.create(CLOCK_TYPE, {"clock": {"sec": second, "nanosec": nanosecond}})
