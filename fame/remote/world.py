"""A simulated world in a process of its own: it makes the time that all others follow on `/clock`.

One step of the world is one entry of the wall clock's scheduler; between two of them messages come in. Time can be
stopped and let go by services of the names that Gazebo gave them, `/pause_physics` and `/unpause_physics`. It goes
`speed` times as fast as the wall clock, or slower if the machine cannot: what was missed is not made up for.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler, WallScheduler
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware
from fame.middleware.simulated_time import CLOCK, CLOCK_QOS, CLOCK_TYPE, clock_message

if TYPE_CHECKING:
    from sim2d.config import WorldConfig

WORLD_STATE = "/world_state"
"""Topic of how things stand in a simulated world: std_msgs/msg/String, JSON as `sim2d.world.World.summary` gives."""
PAUSE, RESUME, EMPTY = "/pause_physics", "/unpause_physics", "std_srvs/srv/Empty"

_STRING = "std_msgs/msg/String"
_TELL = SECOND // 2  # ns of the wall clock between two words about how things stand
_LATE = SECOND // 10  # ns that time may fall behind before it is let go


class WorldPart:
    """A world that runs `speed` times as fast as reality and says what time it is; `paused`: when it is let go."""

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        scheduler: WallScheduler,
        middleware: Middleware,
        *,
        speed: float = 1.0,
        paused: bool = False,
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
            self._world.start()
            self._due = self._scheduler.now
            self._next = self._scheduler.soon(self._tick, Kind.WORLD)

    def stop(self) -> bool:
        """It is over at once."""
        return False

    def close(self) -> None:
        """Leave."""
        self.pause()
        self._telling.cancel()
        self._world.close()
        self._node.close()

    def _tick(self) -> None:
        """The step that is due; then the clock."""
        self.time.run(round(self._steps * self._step * SECOND))
        self._steps += 1
        self._clock.publish(clock_message(self.time.now))
        self._due = max(self._due + round(self._step / self._speed * SECOND), self._scheduler.now - _LATE)
        self._next = self._scheduler.at(self._due, self._tick, Kind.WORLD)

    def _tell(self) -> None:
        if self.paused:
            self._clock.publish(clock_message(self.time.now))
        said: dict[str, Any] = {**self._world.summary(), "paused": self.paused}
        self._state.publish(messages.create(_STRING, json.dumps(said)))
        self._telling = self._scheduler.after(_TELL, self._tell)
