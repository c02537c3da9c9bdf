"""A simulated world in a process of its own: it makes the time that all others follow on `/clock`.

One step of the world is one entry of the wall clock's scheduler; between two of them messages come in. Time can be
stopped and let go by services of the names that Gazebo gave them, `/pause_physics` and `/unpause_physics`. It goes
`speed` times as fast as the wall clock, or slower if the machine cannot: what was missed is not made up for.

In lockstep nobody gets a message before its step: the world steps when every engine is done with the last one, and what
was said during a step is heard in the next. Then a run is the same every time, however fast the machine is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler, WallScheduler
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Message, Middleware, Node
from fame.middleware.simulated_time import (
    CLOCK,
    CLOCK_QOS,
    CLOCK_TYPE,
    STEP_DONE,
    STEP_DONE_TYPE,
    Lockstep,
    clock_message,
    nanoseconds,
)

if TYPE_CHECKING:
    from sim2d.config import WorldConfig


WORLD_STATE = "/world_state"
"""Topic of how things stand in a simulated world: std_msgs/msg/String, JSON as `sim2d.world.World.summary` gives."""
PAUSE, RESUME, EMPTY = "/pause_physics", "/unpause_physics", "std_srvs/srv/Empty"

_STRING = "std_msgs/msg/String"
_TELL = SECOND // 4  # ns of the wall clock between two words about how things stand
_LATE = SECOND // 10  # ns that time may fall behind before it is let go


class WorldNode:
    """A world that runs `speed` times as fast as reality and says what time it is; `paused`: when it is let go.

    With `steps` it waits after each step for the engines of the `team`. `speed` None: as fast as it can.
    """

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        scheduler: WallScheduler,
        middleware: Middleware,
        *,
        speed: float | None = 1.0,
        paused: bool = False,
        team: Sequence[str] = (),
        steps: Lockstep | None = None,
    ) -> None:
        from sim2d.world import World

        self.time, self.paused = Scheduler(), True
        self._scheduler, self._speed = scheduler, speed
        self._world = World(config, seed=seed, scheduler=self.time, middleware=middleware)
        self._steps, self._step = 0, config.step
        self._node = middleware.node("world")
        self._clock = self._node.publisher(CLOCK, CLOCK_TYPE, CLOCK_QOS)
        self._state = self._node.publisher(WORLD_STATE, _STRING, LATCHED)
        self._node.service(PAUSE, EMPTY, lambda request: self.pause())
        self._node.service(RESUME, EMPTY, lambda request: self.resume())
        self._next: Entry | None = None
        self._due = 0
        self._keeper, self._opened = steps, steps is None
        self._rounds = (
            LockstepRounds(team, scheduler, middleware, self._node, self._go_on) if steps is not None else None
        )
        if not paused:
            self.resume()
        self._tell()

    def pause(self) -> None:
        """Stop time. The clock is still said, so that who comes now knows it."""
        self.paused = True
        if self._next is not None:
            self._next.cancel()
            self._next = None

    def resume(self) -> None:
        """Let time go."""
        if self.paused:
            self.paused = False
            self._due = self._scheduler.now
            if self._rounds is None or not self._rounds.open:
                self._next = self._scheduler.soon(self._tick, Kind.WORLD)

    def stop(self) -> bool:
        """It is over at once."""
        return False

    def close(self) -> None:
        """Leave."""
        self.pause()
        self._telling.cancel()
        if self._rounds is not None:
            self._rounds.close()
        self._world.close()
        self._node.close()

    def _tick(self) -> None:
        """The step that is due; then the clock. Where all keep step, the first time is said before anything happens."""
        if self._opened:
            self._world.start()
            self.time.run(round(self._steps * self._step * SECOND))
            self._steps += 1
        self._opened, self._next = True, None
        wanted = self._due + round(self._step / self._speed * SECOND) if self._speed is not None else 0
        self._due = max(wanted, self._scheduler.now - _LATE)
        if self._keeper is not None:
            self._keeper.flush()
        self._clock.publish(clock_message(self.time.now))
        if self._rounds is not None:
            self._rounds.begin(self.time.now)
        else:
            self._go_on()

    def _go_on(self) -> None:
        """Everybody is done with it."""
        if self._keeper is not None:
            self._keeper.release(self.time.soon)
        if not self.paused:
            self._next = self._scheduler.at(self._due, self._tick, Kind.WORLD)

    def _tell(self) -> None:
        if self.paused and self._keeper is None:
            self._clock.publish(clock_message(self.time.now))
        said: dict[str, Any] = {**self._world.summary(), "paused": self.paused}
        self._state.publish(messages.create(_STRING, json.dumps(said)))
        self._telling = self._scheduler.after(_TELL, self._tell)


_LOOK = SECOND
"""How often it is looked whether an engine that is waited for has left (ns)."""


class LockstepRounds:
    """Who is waited for: the robots of the team, but those whose engine was there and left. `over` ends a round."""

    def __init__(
        self, team: Sequence[str], scheduler: Scheduler, middleware: Middleware, node: Node, over: Callable[[], object]
    ) -> None:
        self.team = dict.fromkeys(team)
        self._scheduler, self._middleware, self._over = scheduler, middleware, over
        self._seen: set[str] = set()
        self._waiting: set[str] = set()
        self._time = 0
        node.subscription(STEP_DONE, STEP_DONE_TYPE, self._heard)
        self._look = scheduler.after(_LOOK, self._drop_the_dead)

    @property
    def open(self) -> bool:
        """Whether somebody is waited for."""
        return bool(self._waiting)

    def begin(self, time: int) -> None:
        """Wait for everybody's word on `time` (ns)."""
        self._time, self._waiting = time, set(self.team)
        if not self._waiting:
            self._scheduler.soon(self._over)

    def close(self) -> None:
        """Wait no more."""
        self._look.cancel()
        self._waiting.clear()

    def _heard(self, message: Message) -> None:
        self._seen.add(message.frame_id)
        if nanoseconds(message.stamp) == self._time:
            self._finish(message.frame_id)

    def _finish(self, robot: str) -> None:
        if robot in self._waiting:
            self._waiting.remove(robot)
            if not self._waiting:
                self._over()

    def _drop_the_dead(self) -> None:
        if self._waiting & self._seen:
            ends = {name for info in self._middleware.graph() if info.name == STEP_DONE for name in info.publishers}
            there = {name.split("/")[1] for name in ends}
            for robot in self._seen - there:
                self.team.pop(robot, None)
                self._seen.discard(robot)
                self._finish(robot)
        self._look = self._scheduler.after(_LOOK, self._drop_the_dead)
