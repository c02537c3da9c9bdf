"""Records a run in this process: an observer that collects what a recording has (docs/recordings.md).

Of each instant it takes what changed in each robot, in this order: events, variables, waiting tokens. A key message
comes before the first change of each second: everything as it was until then.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from fame.bpmn.model import Definitions
from fame.clock import SECOND, Kind, Scheduler, WallScheduler
from fame.dataclasses import dataclass, field
from fame.engine.state import Trail
from fame.log.recording_file import Sink
from fame.log.team_state import KeyWriter, Put
from fame.middleware.interface import ENGINE
from fame.robot.changes import ChangeTracker
from fame.robot.events import ENDED, Event, Observer
from fame.robot.live import distinct_names
from fame.scripting.transforms import TOPICS as TF_TOPICS

if TYPE_CHECKING:
    from fame.robot import RobotNode


@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """The metadata of a recording. `attachments` are further files: (name, media type, content)."""

    metadata: Mapping[str, str] = field(default_factory=dict)
    attachments: Sequence[tuple[str, str, bytes]] = ()


_FLUSH = 2 * SECOND
"""Longest time of the wall clock for which changes are not written to the file, unless nothing follows (ns)."""
LogTopics = Literal["signals", "all"]
"""Messages to record: those of the topics that models name, without sensors and motors; or all."""


class TopicRecorder:
    """Records messages as they are published. `begin` gives the file."""

    def __init__(self, begin: Callable[[], Sink], *, every: bool) -> None:
        self._begin, self._every = begin, every
        self._middleware: Any = None
        self._robots: set[str] = set()

    def add(self, node: RobotNode) -> None:
        """Record the topics of a robot."""
        self._robots.add(node.namespace)
        if self._middleware is None and hasattr(node.middleware, "tap"):
            self._middleware = node.middleware
            node.middleware.tap(self._tap)

    def _tap(self, publisher: Any) -> Callable[[Any], object] | None:
        """The recorder of a publisher's messages, chosen at the first message, when all endpoints exist."""
        chosen: list[int] = []
        if "/msg/" not in publisher.type:  # feedback of an action: rosbags cannot write the definition of its type
            return None

        def on_message(message: Any) -> None:
            if not chosen:
                if not (self._every or self._is_signal(publisher.topic)):
                    publisher.remove_tap(on_message)  # a message that nobody gets need not even be checked
                    return
                node = publisher.node.full_name
                chosen.append(self._begin().message_channel(publisher.topic, publisher.type, node))
            self._begin().message(chosen[0], self._middleware.scheduler.now, message)

        return on_message

    def _is_signal(self, topic: str) -> bool:
        """Whether a topic is no sensor or motor: in a robot's namespace, none but engines have an endpoint on it."""
        info = self._middleware.topics[topic].info()
        if topic in TF_TOPICS:
            return False
        if topic.split("/")[1] not in self._robots:
            return True
        return all(name.endswith(f"/{ENGINE}") for name in (*info.publishers, *info.subscribers))


class Recorder(Observer):
    """An observer that writes a recording. `start` is called before the first message, and gives the file.

    `topics`: the messages of which topics are recorded (`LogTopics`). `files`: the paths of the models in the file, by
    default those of each robot.
    """

    files: list[str]

    def __init__(self, start: Callable[[], Sink], topics: LogTopics = "signals", files: Sequence[str] = ()) -> None:
        self._start, self.files = start, [*files]
        self._topics = TopicRecorder(self.begin, every=topics == "all")
        self._file: Sink | None = None
        self._writer = KeyWriter(lambda topic, time, data: self.begin().put(topic, time, data))
        self._trackers: dict[str, ChangeTracker] = {}
        self._changed: dict[str, ChangeTracker] = {}
        self._latest: ChangeTracker | None = None
        self._scheduler: Scheduler | None = None
        self._flush_due = _FLUSH
        self._verdicts: list[Any] = []

    @property
    def begun(self) -> bool:
        """Whether something was recorded."""
        return self._file is not None

    def begin(self) -> Sink:
        """Start writing, and return the file."""
        if self._file is None:
            self._file = self._start()
        return self._file

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Record this robot."""
        files = self.files or [*node.mission.files]
        tracker = self._trackers[node.name] = ChangeTracker(node, self._writer.change, files)
        self._writer.state.robots[node.name] = tracker.begin()
        self._scheduler = node.scheduler
        self._topics.add(node)
        return partial(self._mark, tracker)

    def add_channels(self, record: Callable[[Put], object]) -> None:
        """Record other channels, as of a world: `record` is called with a function that takes their messages."""
        record(lambda topic, time, data: self.begin().put(topic, time, data))

    def take_over(self, robots: Iterable[str]) -> None:
        """Write the whole state of robots whose node is another one now, which is watched already."""
        assert self._scheduler is not None
        self._writer.key(self._scheduler.now, dict.fromkeys(robots, 0))

    def __call__(self, event: Event) -> None:
        if event.what == "verdict":
            self._verdicts.append(event.detail)
        if event.what == ENDED:
            self._flush()
            verdicts = {"properties": json.dumps(self._verdicts)} if self._verdicts else {}
            self.begin().describe({**verdicts, ENDED: event.detail, "end": str(event.time)})
        tracker = self._trackers.get(event.robot)
        if tracker is not None:
            tracker.event(event)
            self._mark(tracker)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Record what happened at one instant."""
        tracker = self._trackers[robot]
        if self._latest is not None and self._latest is not tracker:  # robots act on each other at one instant
            self._latest.give_events(time)
        self._latest = tracker
        tracker.trail(trail)
        if robot not in self._changed:
            self._mark(tracker)

    def _mark(self, tracker: ChangeTracker) -> None:
        """Write possible changes at the end of the current instant."""
        if not self._changed:
            assert self._scheduler is not None
            self._scheduler.soon(self._flush, Kind.WORLD)
        self._changed[tracker.robot] = tracker

    def _flush(self) -> None:
        if not self._changed:
            return
        assert self._scheduler is not None
        now = self._scheduler.now
        changed, self._changed, self._latest = self._changed, {}, None
        for tracker in changed.values():
            tracker.flush(now)
        if isinstance(self._scheduler, WallScheduler) and now >= self._flush_due:
            self._flush_due = now + _FLUSH
            self.begin().flush()

    def finish(self) -> None:
        """Write what has not been written, and the index; what comes later is dropped."""
        self._flush()
        self.begin().finish()
        self._file = Sink()


@contextmanager
def recording_to(
    start: Callable[[], Sink], files: Iterable[Definitions], about: About, topics: LogTopics
) -> Iterator[Recorder]:
    """An observer that writes a recording. `start` is called before the first message."""
    models = [*files]

    def begin() -> Sink:
        writer = start()
        writer.describe(about.metadata)
        for name, media_type, data in (*model_attachments(models), *about.attachments):
            writer.attach(name, media_type, data)
        return writer

    recorder = Recorder(begin, topics, [model.file for model in models])
    try:
        yield recorder
    finally:
        if recorder.begun:
            recorder.finish()


def model_attachments(files: Sequence[Definitions]) -> Iterator[tuple[str, str, bytes]]:
    """Yield the models of a run as attachments: name, media type, content."""
    for name, definitions in zip(distinct_names(each.file for each in files), files, strict=True):
        yield f"models/{name}", "application/bpmn+xml", definitions.source
