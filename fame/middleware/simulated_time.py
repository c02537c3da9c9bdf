"""Simulated time between processes: the world says on `/clock` what time it is, and everybody else follows.

`SharedTime` is the scheduler of whoever follows. It has a queue of its own, worked by entries of the wall clock's
scheduler: as far as the clock has come whenever it is heard, and at once for what is due already. So messages and
people are served while time stands still, and nothing else moves. What must go on by the wall clock (middleware,
deployment, status) stays with that scheduler.
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


class Steps(Protocol):
    """What keeps messages for their step: `fame.middleware.dds.lockstep.Lockstep`."""

    def release(self, enter: Callable[[Callable[[], object]], object]) -> None: ...

    def flush(self) -> None: ...


class SharedTime(Scheduler):
    """Simulated time that others make. `wall` is the scheduler whose thread does all the work."""

    def __init__(self, wall: Scheduler) -> None:
        super().__init__()
        self._wall = wall
        self._heard = self._ahead = 0  # what the clock said last; how far we are ahead of it, ns
        self._roused = False

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = super().at(time, action, kind)
        if entry.time <= self.now and not (self._running or self._roused):
            self._roused = True
            self._wall.soon(self._catch_up)
        return entry

    def follow(self, time: int) -> None:
        """The clock says `time` (ns). If that is back in the past, the world began anew: our time just goes on."""
        if time < self._heard:
            self._ahead = self.now - time
        self._heard = time
        self.run(time + self._ahead)

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
            begun = True
            steps.flush()
            done.publish(messages.create(DONE_TYPE, {"stamp": message.clock, "frame_id": node.namespace}))

        node.subscription(CLOCK, CLOCK_TYPE, step)

    def _catch_up(self) -> None:
        self._roused = False
        self.run(self.now)


def nanoseconds(time: Message) -> int:
    """Of a builtin_interfaces/msg/Time."""
    return int(time.sec) * SECOND + int(time.nanosec)


def clock_message(time: int) -> Message:
    """What the clock says at `time` (ns)."""
    second, nanosecond = divmod(time, SECOND)
    said: dict[str, Any] = {"sec": second, "nanosec": nanosecond}
    return messages.create(CLOCK_TYPE, {"clock": said})
