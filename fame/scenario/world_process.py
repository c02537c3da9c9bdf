"""A simulated world in its own process: the source of time on `/clock` for all engines.

Each step of the world is one entry of the scheduler on the wall clock; messages arrive between steps. Time is paused
and resumed by services with Gazebo's names, `/pause_physics` and `/unpause_physics`. It runs `speed` times as fast as
the wall clock, or slower if the machine is too slow: missed time is not made up for.

In lockstep the world steps when every engine is done with the last step, and messages sent during a step are delivered
in the next. A run is then repeatable, independent of the speed of the machine.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler, WallScheduler
from fame.fast_json import json_bytes
from fame.log.channels import GROUND
from fame.log.team_recorder import WORLD_GROUND, WORLD_SCENE
from fame.middleware import messages
from fame.middleware.interface import LATCHED, AnyMessage, Middleware, Node
from fame.middleware.simulated_time import (
    CLOCK,
    CLOCK_QOS,
    CLOCK_TYPE,
    STEP_DONE,
    STEP_DONE_TYPE,
    Lockstep,
    clock_message,
)

if TYPE_CHECKING:
    from sim2d.config import WorldConfig


WORLD_STATE = "/world_state"
"""Topic with the state of a simulated world: std_msgs/msg/String, the JSON of `sim2d.world.World.summary`."""
PAUSE, RESUME, EMPTY = "/pause_physics", "/unpause_physics", "std_srvs/srv/Empty"

_STRING = "std_msgs/msg/String"
_STATE_PERIOD = SECOND // 4  # ns of the wall clock between two messages with the state of the world
_REPEATS = 12  # messages with the state of the world with which a new subscriber gets the robots, too
_LATE = SECOND // 10  # ns that simulated time may fall behind before the delay is dropped


class WorldNode:
    """A world that runs at `speed` times wall-clock speed (None: as fast as possible) and publishes the clock.

    It starts `paused` if asked to. With `steps` it waits after each step for the engines of the `team` (lockstep).
    """

    time: Scheduler
    paused: bool

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
        self._publish_scenes()
        self._node.service(PAUSE, EMPTY, lambda request: self.pause())
        self._node.service(RESUME, EMPTY, lambda request: self.resume())
        self._next: Entry | None = None
        self._due = 0
        self._lockstep, self._opened = steps, steps is None
        self._rounds = (
            LockstepRounds(team, scheduler, middleware, self._node, self._go_on, self._publish_clock)
            if steps is not None
            else None
        )
        if not paused:
            self.resume()
        self._publish_state()

    def pause(self) -> None:
        """Stop time. The clock is still published for nodes that join now."""
        self.paused = True
        if self._next is not None:
            self._next.cancel()
            self._next = None

    def resume(self) -> None:
        """Resume time."""
        if self.paused:
            self.paused = False
            self._due = self._scheduler.now
            if self._rounds is None or not self._rounds.open:
                self._next = self._scheduler.soon(self._tick, Kind.WORLD)

    def _publish_scenes(self) -> None:
        """Publish the world for recordings: the ground, and the robots while there are subscribers."""
        from sim2d.scene import SceneRecorder

        self._scene = scene = self._node.publisher(WORLD_SCENE, _STRING)
        ground = self._node.publisher(WORLD_GROUND, _STRING, LATCHED)

        def put(topic: str, time: int, data: Mapping[str, Any]) -> None:
            (ground if topic == GROUND else scene).publish(messages.create(_STRING, json_bytes(data).decode()))

        self._scenes = SceneRecorder(self._world, put, wanted=lambda: scene.subscriber_count() > 0)
        self._receivers = self._repeats = 0

    def _repeat_scene(self) -> None:
        """Publish the robots for subscribers that are new, though nothing moves; again, until they are discovered."""
        before, self._receivers = self._receivers, self._scene.subscriber_count()
        self._repeats = _REPEATS if self._receivers > before else max(0, self._repeats - 1)
        if self._repeats:
            self._scenes.show(self._world)

    def close(self) -> None:
        """Close all endpoints and the world."""
        self.pause()
        self._next_state.cancel()
        if self._rounds is not None:
            self._rounds.close()
        self._world.close()
        self._node.close()

    def _tick(self) -> None:
        """Do the due step, then publish the clock. In lockstep, the initial time is published before the first step."""
        if self._opened:
            self._world.start()
            self.time.run(round(self._steps * self._step * SECOND))
            self._steps += 1
        self._opened, self._next = True, None
        wanted = self._due + round(self._step / self._speed * SECOND) if self._speed is not None else 0
        self._due = max(wanted, self._scheduler.now - _LATE)
        if self._lockstep is not None:
            self._lockstep.flush()
        self._publish_clock()
        if self._rounds is not None:
            self._rounds.begin(self.time.now)
        else:
            self._go_on()

    def _go_on(self) -> None:
        """Deliver held-back messages and schedule the next step: all engines are done with this one."""
        if self._lockstep is not None:
            self._lockstep.release(self.time.soon)
        if not self.paused:
            self._next = self._scheduler.at(self._due, self._tick, Kind.WORLD)

    def _publish_clock(self) -> None:
        self._clock.publish(clock_message(self.time.now))

    def _publish_state(self) -> None:
        if self.paused and self._lockstep is None:
            self._publish_clock()
        state: dict[str, Any] = {**self._world.summary(), "paused": self.paused}
        self._state.publish(messages.create(_STRING, json.dumps(state)))
        self._repeat_scene()
        self._next_state = self._scheduler.after(_STATE_PERIOD, self._publish_state)


_CHECK = SECOND
"""Interval between checks for engines that have left (ns)."""


class LockstepRounds:
    """Waits in each step for the engines of the team, except those that have left, then calls `over`.

    An engine that has come back did not get the step: `repeat` is called to publish it again. It belongs to the team as
    soon as it reports a step.
    """

    def __init__(
        self,
        team: Sequence[str],
        scheduler: Scheduler,
        middleware: Middleware,
        node: Node,
        over: Callable[[], object],
        repeat: Callable[[], object],
    ) -> None:
        self.team: dict[str, None] = dict.fromkeys(team)
        self._all, self._repeat = frozenset(team), repeat
        self._scheduler, self._middleware, self._over = scheduler, middleware, over
        self._seen: set[str] = set()
        self._waiting: set[str] = set()
        self._time = 0
        node.subscription(STEP_DONE, STEP_DONE_TYPE, self._on_step_done)
        self._check = scheduler.after(_CHECK, self._drop_missing)

    @property
    def open(self) -> bool:
        """Whether the round still waits for an engine."""
        return bool(self._waiting)

    def begin(self, time: int) -> None:
        """Wait until every engine is done with `time` (ns)."""
        self._time, self._waiting = time, set(self.team)
        if not self._waiting:
            self._scheduler.soon(self._over)

    def close(self) -> None:
        """Stop waiting."""
        self._check.cancel()
        self._waiting.clear()

    def _on_step_done(self, message: AnyMessage) -> None:
        self._seen.add(message.frame_id)
        if message.frame_id in self._all:
            self.team[message.frame_id] = None
        if messages.nanoseconds(message.stamp) == self._time:
            self._finish(message.frame_id)

    def _finish(self, robot: str) -> None:
        if robot in self._waiting:
            self._waiting.remove(robot)
            if not self._waiting:
                self._over()

    def _drop_missing(self) -> None:
        if self._waiting & self._seen:
            graph = self._middleware.graph()
            publishers = {name for info in graph if info.name == STEP_DONE for name in info.publishers}
            present = {name.split("/")[1] for name in publishers}
            for robot in sorted(self._seen - present):
                self.team.pop(robot, None)
                self._seen.discard(robot)
                self._finish(robot)
        if self._waiting & self._seen:
            self._repeat()
        self._check = self._scheduler.after(_CHECK, self._drop_missing)
