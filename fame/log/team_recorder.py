"""Record a team on the network: a node that writes the robots' events, their signals and the simulated world."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Protocol

from fame.clock import SECOND, Entry, Scheduler, date_text
from fame.closing import Closing
from fame.dataclasses import dataclass, field
from fame.errors import MessageError
from fame.log.channels import CLOCKS, GROUND, KEY, WORLD
from fame.log.clocks import DAY, ClockDoubts
from fame.log.live_team import DELAY, LiveTeam, now_since
from fame.log.recorder import LogTopics
from fame.log.recording import ModelRun
from fame.log.recording_file import Sink
from fame.middleware.interface import ENGINE, LATCHED, MAX_MESSAGE_SIZE, AnyMessage, Middleware, QoS, TopicInfo
from fame.middleware.messages import nanoseconds
from fame.middleware.qos import requested_of
from fame.middleware.simulated_time import CLOCK, CLOCK_TYPE
from fame.middleware.typesystem import STRING
from fame.properties import Judgement
from fame.robot.robot_state import EVENTS_TOPIC, MODEL_TOPIC
from fame.scripting.transforms import TOPICS as TF_TOPICS
from fame.text import read_json

WORLD_SCENE, WORLD_GROUND = "/world_scene", "/world_ground"
"""Topics on which a simulated world offers what recordings have on ``/fame/world`` and ``/fame/ground``."""

_DISCOVERY = SECOND // 2
"""Interval of the search for topics (ns)."""
_FLUSH = 2 * SECOND
"""Interval in which data are written to the file (ns): the most that a crash loses."""
_TICK = SECOND // 20
"""Interval in which bounds are noticed that have passed while nothing happened (ns)."""
_INTERNAL = (EVENTS_TOPIC, MODEL_TOPIC, "bpmn_status", "bpmn_process", "bpmn_task", "bpmn_clock")
"""Topics of engines that are not recorded as messages."""
_GENERAL = frozenset(("/rosout", "/parameter_events", CLOCK, "/clock_done", "/world_state", WORLD_SCENE, WORLD_GROUND))


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamRecorderOptions:
    """Options of a `TeamRecorder`.

    robots    those to record; by default all
    topics    which ones are recorded, and those for which `also` holds
    metadata  what the recording says of itself
    models    attach what each robot runs
    delay     how long batches wait for those of other robots (ns)
    """

    robots: frozenset[str] = frozenset()
    topics: LogTopics = "signals"
    also: Callable[[TopicInfo], bool] = lambda info: False
    metadata: Mapping[str, str] = field(default_factory=dict)
    models: bool = True
    delay: int = DELAY


class RecordingJudge(Protocol):
    """Judges what is recorded: a `fame.log.live_judge.LiveJudge`."""

    @property
    def now(self) -> int: ...
    @property
    def due(self) -> int | None: ...
    @property
    def judgements(self) -> Sequence[Judgement]: ...
    def over(self, sink: Sink) -> Sink: ...
    def on_model(self, robot: str, model: Mapping[str, Any]) -> None: ...
    def reads(self, info: TopicInfo) -> bool: ...
    def tick(self, time: int) -> None: ...
    def end(self, *, complete: bool) -> None: ...


class TeamRecorder(Closing):
    """Records the robots of a team until `close`. `note` gets lines for people, `on_model` what each robot runs.

    `open_file` is called before the first message. `judging` judges what is recorded, also the topics that it reads.
    """

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        open_file: Callable[[], Sink],
        options: TeamRecorderOptions | None = None,
        *,
        note: Callable[[str], object] = lambda text: None,
        on_model: Callable[[str, Mapping[str, Any]], object] = lambda robot, model: None,
        judging: RecordingJudge | None = None,
    ) -> None:
        self._options = options = options or TeamRecorderOptions()
        self._report_model, self._judging, self._note = on_model, judging, note
        self._middleware, self._scheduler, self._open_file = middleware, scheduler, open_file
        self._file: Sink | None = None
        self._attached: dict[tuple[str, str], str] = {}  # name and XML of a model -> its name in the recording
        self._runs: dict[str, list[ModelRun]] = {}
        self._seeds: dict[str, Any] = {}  # of the random numbers of each robot
        self._next: dict[str, Mapping[str, Any]] = {}  # models of robots that have done nothing in them so far
        self._topics: dict[str, int | None] = {}  # recorded topics -> number of their channel, once there is one
        self._noted: set[str] = set()
        self._clock: int | None = None  # simulated time, ns
        self._node = middleware.node("fame_recorder")
        self.team: LiveTeam = LiveTeam(
            self._node,
            middleware,
            scheduler,
            self._put,
            on_model=self._on_model,
            note=note,
            robots=options.robots,
            delay=options.delay,
            floor=lambda: judging.now if judging is not None else 0,
            now=lambda: self._clock,
        )
        self._node.subscription(CLOCK, CLOCK_TYPE, self._on_clock, QoS(reliability="best_effort", depth=1))
        self._node.subscription(WORLD_SCENE, STRING, partial(self._on_scene, WORLD))
        self._node.subscription(WORLD_GROUND, STRING, partial(self._on_scene, GROUND), LATCHED)
        self._clocks = ClockDoubts(self._node, scheduler, self.team, lambda: self._here, self._on_doubt)
        self._ticking: Entry | None = scheduler.after(_TICK, self._tick) if judging is not None else None
        self._discovery: Entry = scheduler.after(_DISCOVERY, self._discover)
        self._flushing: Entry = scheduler.after(_FLUSH, self._flush)

    @property
    def begun(self) -> bool:
        """Whether something was recorded."""
        return self._file is not None

    @property
    def now(self) -> int:
        """The time of the mission (ns since the team's epoch)."""
        here, ahead = self._here, self._clocks.ahead
        if ahead is None:  # no clock has answered yet
            latest = max(map(self.team.last_end, self.team.robots), default=here)
            return here if abs(here - latest) < DAY else latest
        return here + ahead

    @property
    def _here(self) -> int:
        """The time of the mission by the clock of this machine, or of the world."""
        return self._clock if self._clock is not None else now_since(self.team.epoch)

    def _begin(self) -> Sink:
        if self._file is None:
            file = self._open_file()
            self._file = file if self._judging is None else self._judging.over(file)
            self._file.describe({"clocks": "measured", **self._options.metadata, **self._dated()})
            for robot, model in self.team.models.items() if self._options.models else ():
                self._attach(robot, model, 0)
        return self._file

    def _dated(self) -> dict[str, str]:
        """The date of time 0, as far as it is known."""
        return {"epoch": date_text(self.team.epoch)} if self.team.epoch is not None else {}

    def _put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        file = self._begin()
        for robot in self._next.keys() & (data.get("gaps", {}).keys() if topic == KEY else {data.get("robot")}):
            self._attach(robot, self._next.pop(robot), time - 1)
        file.put(topic, time, data)

    def _on_model(self, robot: str, model: Mapping[str, Any]) -> None:
        self._note(f"records {robot}: {model.get('process', '')}")
        self._report_model(robot, model)
        if self._judging is not None:
            self._judging.on_model(robot, model)
        if self._options.models:
            self.team.enter(self.team.last_end(robot), lambda time: self._next.update({robot: model}))

    def _attach(self, robot: str, model: Mapping[str, Any], time: int) -> None:
        """Attach the models that a robot runs after a time (ns)."""
        assert self._file is not None
        names: list[str] = []
        for each in model.get("models", ()):
            known = str(each["name"]), str(each["xml"])
            if known not in self._attached:
                self._attached[known] = name = self._free_name(robot, known[0])
                self._file.attach(f"models/{name}", "application/bpmn+xml", known[1].encode())
            names.append(self._attached[known])
        runs, process = self._runs.setdefault(robot, []), str(model.get("process", ""))
        if not runs or runs[-1][1:] != (process, names):
            runs.append(ModelRun(time, process, names))
            self._file.describe({"models": json.dumps(self._runs)})
        if "seed" in model and self._seeds.get(robot) != model["seed"]:
            self._seeds[robot] = model["seed"]
            self._file.describe({"seeds": json.dumps(self._seeds)})

    def _free_name(self, robot: str, name: str) -> str:
        """A name for a model of a robot that no other one has."""
        name = name if name.endswith(".bpmn") else f"{robot}.bpmn"
        names = (name, f"{robot}-{name}", *(f"{robot}-{number}-{name}" for number in range(2, len(self._attached) + 2)))
        return next(each for each in names if each not in self._attached.values())

    # ---- messages ----------------------------------------------------------------------------------------------------

    def _on_clock(self, message: AnyMessage) -> None:
        if self._clock is None:  # until now it was that of this machine
            self._clocks.restart()
        self._clock = nanoseconds(message.clock)

    def _on_doubt(self, robot: str, doubt: int) -> None:
        data = {"robot": robot, "doubt": doubt}
        self.team.enter(self.team.last_end(robot), lambda due: self._begin().put(CLOCKS, due, data))

    def _tick(self) -> None:
        """Notice bounds that have passed, once what was sent until now had time to arrive."""
        assert self._judging is not None
        self._ticking = self._scheduler.after(_TICK, self._tick)
        if self._judging.due is not None and self._judging.due < self.now:
            self.team.enter(self.now, self._judging.tick)

    def _on_scene(self, topic: str, message: AnyMessage) -> None:
        with suppress(ValueError, TypeError, KeyError, IndexError):  # from a stranger
            scene = read_json(message.data, MAX_MESSAGE_SIZE)
            stamp = scene["entities"][0]["timestamp"]
            time = int(stamp["sec"]) * SECOND + int(stamp["nsec"])
            self.team.enter(time, lambda due: self._begin().put(topic, due, scene))

    def _discover(self) -> None:
        """Subscribe to topics that are new."""
        self._discovery = self._scheduler.after(_DISCOVERY, self._discover)
        for info in self._middleware.graph():
            if info.name not in self._topics and self._is_wanted(info):
                self._topics[info.name] = None
                try:
                    profile = requested_of(info.offered)
                    self._node.subscription(info.name, info.types[0], partial(self._on_message, info), profile)
                except MessageError as error:
                    self._note(f"{info.name} is not recorded: {error}")

    def _is_wanted(self, info: TopicInfo) -> bool:
        every = self._options.topics == "all"
        first, last = info.name.split("/")[1], info.name.rpartition("/")[2]
        if not info.publishers or not info.types or "/msg/" not in info.types[0]:
            return False
        if self._options.also(info) or (self._judging is not None and self._judging.reads(info)):
            return True
        if last in _INTERNAL or info.name in _GENERAL or (info.name in TF_TOPICS and not every):
            return False
        ends = (*info.publishers, *info.subscribers)
        engines = sum(name.endswith(f"/{ENGINE}") for name in ends)
        strangers = [name for name in ends if not name.endswith((f"/{ENGINE}", "/fame_recorder"))]
        if every:
            homes = {first, *(name.split("/")[1] for name in info.publishers)}
            return engines > 0 or not self._options.robots or not homes.isdisjoint(self.team.robots)
        return engines > 0 and not (first in self.team.robots and strangers)

    def _on_message(self, info: TopicInfo, message: AnyMessage) -> None:
        if self.team.epoch is None and self._clock is None:
            return  # the time is not known yet
        self.team.enter(self.now, lambda due: self._write(info, due, message))

    def _write(self, info: TopicInfo, time: int, message: AnyMessage) -> None:
        file, channel = self._begin(), self._topics[info.name]
        if channel is None:
            node = info.publishers[0] if len(set(info.publishers)) == 1 else ""
            channel = self._topics[info.name] = file.message_channel(info.name, info.types[0], node)
        file.message(channel, time, message)

    # ---- the end -----------------------------------------------------------------------------------------------------

    def _flush(self) -> None:
        self._flushing = self._scheduler.after(_FLUSH, self._flush)
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        """Write everything that waits, and the index, and close all endpoints."""
        self._discovery.cancel()
        self._flushing.cancel()
        self._clocks.close()
        if self._ticking is not None:
            self._ticking.cancel()
        self.team.close()
        self._node.close()
        if self._file is not None:
            for robot, model in self._next.items():
                self._attach(robot, model, self.team.last_end(robot))
            if self._judging is not None:
                self._judging.end(complete=not self.team.state.runs)
            self._file.describe({"lost_batches": json.dumps(self.team.gaps), **self._dated()})
            self._file.finish()
