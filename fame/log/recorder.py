"""Writes the recording of a run: one MCAP file with everything that a replay needs (docs/recordings.md).

A `Recorder` is an observer of robots in one process. Of each instant it writes what changed in each robot, in this
order: events, variables, waiting tokens. A key message comes before the first change after each second: everything as
it was until then.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

from fame.bpmn.model import Definitions
from fame.clock import SECOND, Kind, Scheduler
from fame.engine.state import Trail
from fame.log.channels import CHANNELS, FORMAT
from fame.middleware import codec
from fame.robot.changes import ChangeTracker
from fame.robot.events import Event

if TYPE_CHECKING:
    from mcap.writer import Writer

    from fame.robot import RobotNode

_CHUNK = 1 << 18
"""Bytes of a chunk before it is compressed: what a crash may lose, and what a seek has to read."""


ENGINE_NODE = "fame_engine"
"""The name of every robot's engine node."""


@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """What a recording says of itself. `attachments` are further files: (name, media type, content)."""

    metadata: Mapping[str, str] = field(default_factory=dict)
    attachments: Sequence[tuple[str, str, bytes]] = ()


class RecordingFile:
    """An MCAP file with the channels of a recording, written message by message."""

    def __init__(self, stream: BinaryIO) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer: Writer = Writer(stream, chunk_size=_CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"fame {_version()}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write what the recording says of itself."""
        whole = {"format": str(FORMAT), "fame": _version(), "python": sys.version.split()[0], **metadata}
        self._writer.add_metadata("fame", whole)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the recording."""
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        """The number of a new channel for messages of a ROS 2 type that `node` (full name) publishes, as CDR."""
        schema = self._schemas.get(type)
        if schema is None:
            text = codec.typestore(type).generate_msgdef(type, ros_version=2)[0]
            schema = self._schemas[type] = self._writer.register_schema(type, "ros2msg", text.encode())
        return self._writer.register_channel(topic, "cdr", schema, {"node": node})

    def put(self, topic: str, time: int, text: str) -> None:
        """Write a message of one of `CHANNELS`: JSON, at a time (ns)."""
        channel = self._channels.get(topic)
        if channel is None:
            name, schema = CHANNELS[topic]
            schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self.write(channel, time, text.encode("utf-8", "backslashreplace"))

    def write(self, channel: int, time: int, data: bytes) -> None:
        """Write a message."""
        sequence = self._sequences[channel] = self._sequences.get(channel, 0) + 1
        self._writer.add_message(channel, time, data, time, sequence)

    def flush(self) -> None:
        """Write what was recorded so far to the file: it can be read if this process ends now."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]


def _version() -> str:
    """The version of FAME; empty where it is not installed."""
    try:
        return version("fame-robots")
    except PackageNotFoundError:
        return ""


LogTopics = Literal["signals", "all"]
"""Messages to record: those of the topics that models name, without sensors and motors; or all."""


class TopicRecorder:
    """Records messages as CDR as they are published. `begin` gives the file."""

    def __init__(self, begin: Callable[[], RecordingFile], *, every: bool) -> None:
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
        """What records the messages of a publisher; it is chosen at its first message, when all endpoints exist."""
        chosen: list[tuple[RecordingFile, int] | None] = []
        if "/msg/" not in publisher.type:  # feedback of an action: rosbags cannot write the definition of its type
            return None

        def on_message(message: Any) -> None:
            if not chosen:
                wanted = self._every or self._is_signal(publisher.topic)
                if wanted:
                    file = self._begin()
                    channel = file.message_channel(publisher.topic, publisher.type, publisher.node.full_name)
                    chosen.append((file, channel))
                else:
                    chosen.append(None)
            if chosen[0] is not None:
                file, channel = chosen[0]
                file.write(channel, self._middleware.scheduler.now, codec.serialize(message))

        return on_message

    def _is_signal(self, topic: str) -> bool:
        """Whether a topic is no sensor or motor: in a robot's namespace, none but engines have an endpoint on it."""
        info = self._middleware.topics[topic].info()
        if topic.split("/")[1] not in self._robots:
            return True
        return all(name.endswith(f"/{ENGINE_NODE}") for name in (*info.publishers, *info.subscribers))


class Recorder:
    """An observer that writes a recording. `start` is called before the first message, and gives the file.

    `topics`: the messages of which topics are recorded (`LogTopics`).
    """

    def __init__(self, start: Callable[[], RecordingFile], topics: LogTopics = "signals") -> None:
        self._start = start
        self._topics = TopicRecorder(self.begin, every=topics == "all")
        self._file: RecordingFile | None = None
        self._trackers: dict[str, ChangeTracker] = {}
        self._changed: dict[str, ChangeTracker] = {}
        self._scheduler: Scheduler | None = None
        self._next_key = self._last = -1

    @property
    def begun(self) -> bool:
        """Whether the file is being written."""
        return self._file is not None

    def begin(self) -> RecordingFile:
        """Start writing, and return the file."""
        if self._file is None:
            self._file = self._start()
        return self._file

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Record this robot."""
        tracker = ChangeTracker(node, lambda channel, time, text: self.begin().put(f"/fame/{channel}", time, text))
        self._trackers[node.name], self._scheduler = tracker, node.scheduler
        self._topics.add(node)
        return partial(self._mark, tracker)

    def watch_world(self, record: Callable[[Callable[[str, int, str], object]], object]) -> None:
        """Record a simulated world: `record` is called with a function that takes topic, time (ns) and JSON."""
        record(lambda topic, time, text: self.begin().put(topic, time, text))

    def __call__(self, event: Event) -> None:
        tracker = self._trackers.get(event.robot)
        if tracker is not None:
            tracker.event(event)
            self._mark(tracker)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Record what happened at one instant."""
        tracker = self._trackers[robot]
        tracker.trail(trail)
        self._mark(tracker)

    def _mark(self, tracker: ChangeTracker) -> None:
        """Something may have changed: write it when the instant is over."""
        if not self._changed:
            assert self._scheduler is not None
            self._scheduler.soon(self._flush, Kind.WORLD)
        self._changed[tracker.robot] = tracker

    def _flush(self) -> None:
        if not self._changed:
            return
        assert self._scheduler is not None
        time = self._scheduler.now
        if time >= self._next_key and time > self._last:
            self._put_key(time)
        self._last = time
        changed, self._changed = self._changed, {}
        for tracker in changed.values():
            tracker.flush(time)

    def _put_key(self, time: int) -> None:
        robots = ",".join(f"{json.dumps(name)}:{tracker.key()}" for name, tracker in self._trackers.items())
        self.begin().put("/fame/key", time, f'{{"robots":{{{robots}}}}}')
        self._next_key = time + SECOND

    def finish(self) -> None:
        """Write what has not been written, and the index."""
        self._flush()
        self.begin().finish()


@contextmanager
def recording_to(
    open_stream: Callable[[], BinaryIO], files: Iterable[Definitions], about: About, topics: LogTopics
) -> Iterator[Recorder]:
    """An observer that writes a recording. `open_stream` is called before the first message."""
    with ExitStack() as stack:

        def start() -> RecordingFile:
            file = RecordingFile(stack.enter_context(open_stream()))
            file.describe(about.metadata)
            for name, media_type, data in (*model_attachments(files), *about.attachments):
                file.attach(name, media_type, data)
            return file

        recorder = Recorder(start, topics)
        try:
            yield recorder
        finally:
            if recorder.begun:
                recorder.finish()


def model_attachments(files: Iterable[Definitions]) -> Iterator[tuple[str, str, bytes]]:
    """The models of a run as attachments: name, media type, content."""
    used: set[str] = set()
    for definitions in files:
        path, number = Path(definitions.file), 1
        name = f"models/{path.name or 'model.bpmn'}"
        while name in used:
            number += 1
            name = f"models/{path.stem}-{number}{path.suffix}"
        used.add(name)
        yield name, "application/bpmn+xml", definitions.source
