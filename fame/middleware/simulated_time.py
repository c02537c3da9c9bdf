"""Simulated time between processes: the world says on `/clock` what time it is, and everybody else follows.

`SharedTime` is the scheduler of whoever follows. It has a queue of its own, worked by entries of the wall clock's
scheduler: as far as the clock has come whenever it is heard, and at once for what is due already. So messages and
people are served while time stands still, and nothing else moves. What must go on by the wall clock (middleware,
deployment, status) stays with that scheduler, and gets its turn after each second of simulated time with work in it.

A clock jumps when its world is killed and started again, or a second one speaks: it goes back, or further ahead than
any world is fast. Our time then goes on from where it was, so that each timer waits as long as it still had to.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from fame.clock import SECOND, Action, Entry, Kind, Scheduler
from fame.middleware import messages
from fame.middleware.interface import Message, Node, QoS

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
CLOCK_QOS = QoS(depth=10)
"""What the clock is published with."""
_HEARD = QoS(reliability="best_effort", depth=1)
"""As ROS listens to it: the latest time counts, and none that was missed."""

DONE, DONE_TYPE = "/clock_done", "std_msgs/msg/Header"
"""On which each robot (`frame_id`) says that it is done with a step (`stamp`), where all keep step."""


_SLICE = SECOND
"""How much simulated time is worked through before others get their turn (ns)."""
_FASTEST = 1000
"""How many times as fast as the wall clock a world may go."""
_SLACK = 10 * SECOND
"""How far a clock may go ahead at once beyond that (ns): several of its messages may be heard as one."""
_QUIET = SECOND
"""Jumps within this time (ns of the wall clock) after one that was told are not told."""


class Steps(Protocol):
    """What keeps messages for their step: `fame.middleware.dds.lockstep.Lockstep`."""

    def release(self, enter: Callable[[Callable[[], object]], object]) -> None: ...

    def flush(self) -> None: ...


class SharedTime(Scheduler):
    """Simulated time that others make. `wall` is the scheduler whose thread does all the work.

    `on_jump` is called with a text when the clock jumps.
    """

    def __init__(self, wall: Scheduler, on_jump: Callable[[str], object] = lambda text: None) -> None:
        super().__init__()
        self.on_jump = on_jump
        self._wall = wall
        self._heard: int | None = None  # what the clock said last, ns
        self._heard_at = 0  # ns of the wall clock
        self._told_at: int | None = None  # ns of the wall clock
        self._ahead = 0  # how far our time is ahead of the clock, ns
        self._goal = 0  # how far our time may go, ns
        self._roused = False

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = super().at(time, action, kind)
        if entry.time <= self.now and not self._running:
            self._rouse()
        return entry

    def follow(self, time: int) -> None:
        """The clock says `time` (ns)."""
        heard, passed = self._heard, self._wall.now - self._heard_at
        if heard is None:  # it may say any time first, unless something waits already
            heard, passed = (time if self.next_time() is None else 0), 0
        self._heard, self._heard_at = time, self._wall.now
        if not 0 <= time - heard <= _SLACK + _FASTEST * passed:
            self._ahead = self._goal - time
            self._tell_jump(heard, time)
        self._goal = time + self._ahead
        self._catch_up()

    def listen(self, node: Node) -> None:
        """Follow the clock that a node hears."""
        node.subscription(CLOCK, CLOCK_TYPE, lambda message: self.follow(nanoseconds(message.clock)), _HEARD)

    def keep_step(self, node: Node, steps: Steps) -> None:
        """Follow it step by step, and say after each that it is done. The first only waits for what was said before."""
        done = node.publisher(DONE, DONE_TYPE)
        begun = False

        def step(message: Message) -> None:
            nonlocal begun
            time = nanoseconds(message.clock)
            if begun:
                steps.release(lambda action: self.at(time + self._ahead, action, Kind.MESSAGE))
                self.follow(time)
                self.run(self._goal)
            begun = True
            steps.flush()
            done.publish(messages.create(DONE_TYPE, {"stamp": message.clock, "frame_id": node.namespace}))

        node.subscription(CLOCK, CLOCK_TYPE, step)

    def _catch_up(self) -> None:
        """Do what is due: a slice, if that is much."""
        self._roused = False
        due = self.next_time()
        self.run(self._goal if due is None else min(self._goal, due + _SLICE))
        if self.now < self._goal:
            self._rouse()

    def _rouse(self) -> None:
        if not self._roused:
            self._roused = True
            self._wall.soon(self._catch_up)

    def _tell_jump(self, heard: int, time: int) -> None:
        if self._told_at is None or self._wall.now - self._told_at >= _QUIET:
            self._told_at = self._wall.now
            way = "back" if time < heard else "ahead"
            self.on_jump(
                f"{CLOCK} jumped {way} from {heard / SECOND:.1f} to {time / SECOND:.1f} s: a world was started again, "
                "or a second one speaks; timers wait on for what was left"
            )


def nanoseconds(time: Message) -> int:
    """Of a builtin_interfaces/msg/Time."""
    return int(time.sec) * SECOND + int(time.nanosec)


def clock_message(time: int) -> Message:
    """What the clock says at `time` (ns)."""
    second, nanosecond = divmod(time, SECOND)
    said: dict[str, Any] = {"sec": second, "nanosec": nanosecond}
    return messages.create(CLOCK_TYPE, {"clock": said})
