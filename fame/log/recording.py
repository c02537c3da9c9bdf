"""Reads the recording of a run: events, the state at any time, the world, the messages (docs/recordings.md).

Messages are read chunk by chunk; those used last are kept. A file that was cut short, as by the crash of its recorder,
is read up to where it is whole: `Recording.warnings` says so.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from fame.clock import SECOND
from fame.closing import Closing
from fame.dataclasses import dataclass
from fame.errors import ConfigError, ModelError
from fame.log.channels import CHANNELS, EVENTS, FORMAT, GROUND, KEY, VARIABLES, WAITING, WORLD
from fame.log.mcap_index import ChunkPlace, McapIndex, chunk_messages, in_order, read_index
from fame.log.team_state import TeamState
from fame.robot.events import ENDED, Event
from fame.text import open_file, unreadable

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

    from fame.bpmn.model import Definitions

_KEPT_CHUNKS = 32
_OTHER_FORM = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Errors raised by content of another form."""


class RecordedMessage(NamedTuple):
    """A message of a recording: ns, topic, content (JSON or CDR); of a ROS 2 message the node that published it."""

    time: int
    topic: str
    data: bytes
    node: str = ""

    def json(self) -> Any:
        """Return the content of a message of FAME's own channels."""
        return json.loads(self.data)


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a recording: name of its schema, encoding of its messages, and how many there are."""

    name: str
    type: str
    encoding: str
    count: int


class ModelRun(NamedTuple):
    """A robot runs a process (id) after a time (ns); `models`: names of its model and of those that it calls."""

    time: int
    process: str
    models: list[str]


class Recording(Closing):
    """The recording of a run. To be closed, or used in a ``with`` block.

    file         its path
    metadata     format, seed, versions, command, epoch
    models       name -> XML of the models and called processes; `attachments` has all files
    topics       what was recorded, by name
    definitions  of the types of messages, by type
    robots       names of the robots
    start, end   ns of the first and the last message
    warnings     problems of the file, such as a missing end
    """

    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    topics: Mapping[str, RecordedTopic]
    definitions: Mapping[str, str]
    robots: Sequence[str]
    start: int
    end: int
    warnings: list[str]

    def __init__(self, path: str | Path) -> None:
        """Raises ConfigError for a file that cannot be read, is not a recording of FAME, or has a newer format."""
        self.file: str = str(path)
        try:
            self._stream: BinaryIO = open_file(Path(path))
            self._is_renewed = False  # whether it is a copy, of a file of an older format
        except OSError as error:
            raise ConfigError(unreadable(error), file=self.file) from None
        try:
            with self._as_written("content"):
                self._open()
        except BaseException:
            self._stream.close()
            raise

    def _open(self) -> None:
        self.warnings = self._read_index().warnings
        if torn := self.metadata.get("incomplete"):
            self.warnings.append(f"{self.file}: was merged of incomplete recordings ({torn})")
        self._check_format()
        if self.metadata.get("format") == "1":
            from fame.log.format_1 import renew

            with self._stream:
                renewed = renew(self)
            self._stream, self._is_renewed = renewed, True
            self._read_index()
        last = self.state(self.end)
        self.robots = sorted(last.robots)

    def _read_index(self) -> McapIndex:
        index = read_index(self._stream, self.file)
        self._chunks = index.chunks
        self._channels: Mapping[int, Channel] = index.channels
        self._schemas: Mapping[int, Schema] = index.schemas
        self.metadata, self.attachments = index.metadata, index.attachments
        self.topics = {
            channel.topic: RecordedTopic(
                channel.topic,
                index.schemas[channel.schema_id].name if channel.schema_id else "",
                channel.message_encoding,
                sum(index.counts.get(other, 0) for other, one in index.channels.items() if one.topic == channel.topic),
            )
            for channel in sorted(index.channels.values(), key=attrgetter("topic"))
        }
        self._types: set[str] = set()
        self.definitions = {
            schema.name: schema.data.decode() for schema in index.schemas.values() if schema.encoding == "ros2msg"
        }
        self.start = min((chunk.start for chunk in self._chunks), default=0)
        said = str(self.metadata.get("end", ""))  # of a run, which may end long after the last message
        ended = int(said) if said.isascii() and said.isdecimal() and len(said) < 20 else 0
        self.end = max([ended, *(chunk.end for chunk in self._chunks)])
        self._keep_chunks()
        return index

    def _keep_chunks(self) -> None:
        self._load: Callable[[ChunkPlace], list[RecordedMessage]] = lru_cache(_KEPT_CHUNKS)(self._read_chunk)

    def reopen(self) -> Recording:
        """Return the same recording for another thread, without reading its index again. To be closed as well.

        Raises ConfigError if the file cannot be read any more.
        """
        other = copy(self)
        try:
            other._stream = copy_of(self._stream) if self._is_renewed else open_file(Path(self.file))
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=self.file) from None
        other._keep_chunks()
        return other

    def _check_format(self) -> None:
        written = self.metadata.get("format", "1")
        if not written.isdecimal() or int(written) > FORMAT:
            by = self.metadata.get("fame", "")
            text = f"expected format {FORMAT} or older, got format {written}" + (f" of FAME {by}" if by else "")
            raise ConfigError(f"{text}: update FAME to read it", file=self.file)
        if self.warnings and not self._chunks:
            raise ConfigError("was cut short before anything was recorded", file=self.file)
        topics = {channel.topic for channel in self._channels.values()}
        if not topics & CHANNELS.keys() and "format" not in self.metadata:
            there = ", ".join(sorted(topics)[:5]) or "no topic"
            raise ConfigError(
                f"expected a recording of FAME, got an MCAP file without {EVENTS}; it has {there}", file=self.file
            )

    @contextmanager
    def _as_written(self, part: str = "messages") -> Iterator[None]:
        """Raise ConfigError if the block fails on a part of another form than a recorder writes."""
        try:
            yield
        except _OTHER_FORM as error:
            text = f"has {part} of another form: {error!r}"
            raise ConfigError(text, file=self.file) from None

    # ---- content -----------------------------------------------------------------------------------------------------

    @property
    def models(self) -> dict[str, bytes]:
        """The models of the run, the mission first: file name -> XML."""
        files = self.attachments.items()
        return {name.removeprefix("models/"): data for name, data in files if name.startswith("models/")}

    @property
    def runs(self) -> dict[str, list[ModelRun]]:
        """What each robot ran, by time; empty for a run in one process, which has one model.

        Raises ConfigError for metadata of another form.
        """
        with self._as_written("metadata `models`"):
            runs = json.loads(self.metadata.get("models", "{}"))
            return {
                str(robot): [ModelRun(int(time), str(id), list(map(str, names))) for time, id, names in saved]
                for robot, saved in runs.items()
            }

    @property
    def verdicts(self) -> list[dict[str, Any]]:
        """The judgement about each property at the end (`Judgement.to_json`). Raises ConfigError as `runs`."""
        with self._as_written("metadata `properties`"):
            return [{**each} for each in json.loads(self.metadata.get("properties", "[]"))]

    @property
    def ended(self) -> Event | None:
        """The event with which its run ended; None if it does not say how."""
        how = self.metadata.get(ENDED)
        return Event(int(self.metadata.get("end", self.end)), "", 0, 0, "", ENDED, how) if how is not None else None

    @property
    def lack(self) -> str:
        """What it lacks if it was cut off (``incomplete after 5.0 s``); else nothing."""
        return f"incomplete after {self.end / SECOND:.1f} s" if self.warnings else ""

    @property
    def duration(self) -> float:
        """Its duration, s."""
        return (self.end - self.start) / SECOND

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Messages in the order of time, from `start` to `end` (ns, both inclusive). `topics`: all by default."""
        first, last = self.start if start is None else start, self.end if end is None else end
        wanted = None if topics is None else frozenset(topics)
        chunks = (chunk for chunk in self._with(wanted) if chunk.end >= first and chunk.start <= last)
        for message in in_order(chunks, self._load):
            if message.time > last:
                break
            if message.time >= first and (wanted is None or message.topic in wanted):
                yield message

    def decode(self, message: RecordedMessage) -> dict[str, Any]:
        """Return the content of a message as plain data. Raises MessageError if it does not fit
        the type of its topic."""
        topic = self.topics[message.topic]
        if topic.encoding == "json":
            with self._as_written():
                content: dict[str, Any] = json.loads(message.data)
                return content
        from fame.middleware import codec, messages

        self.typestore(topic.type)
        return messages.to_mapping(codec.deserialize(message.data, topic.type))

    def typestore(self, type: str) -> Any:
        """Return the type store of rosbags with a type of its messages, as the recording defines
        it. Raises MessageError."""
        from fame.middleware import codec

        if type not in self._types:
            self._types.add(type)
            _register(type, self.definitions[type])
        return codec.typestore(type)

    def events(
        self, start: int | None = None, end: int | None = None, robots: Collection[str] | None = None
    ) -> Iterator[Event]:
        """Events in order, from `start` to `end` (ns, both inclusive)."""
        for message in self.messages((EVENTS,), start, end):
            with self._as_written():
                of_message = _events(message)
            if of_message and (robots is None or of_message[0].robot in robots):
                yield from of_message

    def state(self, time: int) -> TeamState:
        """Return the state of the team at the end of the instant `time` (ns)."""
        key = self.last(KEY, time)
        with self._as_written():
            state = TeamState(time) if key is None else TeamState.from_key(key.time, key.json())
            for message in self.messages((EVENTS, VARIABLES, WAITING), state.time if key is not None else None, time):
                state.apply(message.time, message.topic, message.json())
        state.time = time
        return state

    def world(self, time: int) -> dict[str, dict[str, Any]]:
        """Return the last appearance of the simulated robots up to `time` (ns), by name; empty without a world."""
        message = self.last(WORLD, time)
        with self._as_written():
            return dict(scene_values(message.json())) if message is not None else {}

    def ground(self, time: int) -> dict[str, Any]:
        """Return the objects on the ground at `time` (ns); empty without a world."""
        message = self.last(GROUND, time) or self.last(GROUND, self.end)
        with self._as_written():
            return dict(scene_values(message.json())).get("ground", {}) if message is not None else {}

    def scenes(self) -> Iterator[tuple[int, str, dict[str, Any]]]:
        """Yield the simulated world by time: ns, name of a robot or ``ground``, and what FAME's
        own view draws of it."""
        for message in self.messages((WORLD, GROUND)):
            with self._as_written():
                yield from ((message.time, *each) for each in list(scene_values(message.json())))

    def last(self, topic: str, time: int) -> RecordedMessage | None:
        """Return the last message of a topic until `time` (ns)."""
        best: RecordedMessage | None = None
        chunks = [chunk for chunk in self._with((topic,)) if chunk.start <= time]
        for chunk in sorted(chunks, key=attrgetter("end"), reverse=True):
            if best is not None and chunk.end < best.time:
                break
            for message in reversed(self._load(chunk)):
                if message.topic == topic and message.time <= time:
                    if best is None or message.time > best.time:
                        best = message
                    break
        return best

    # ---- chunks ------------------------------------------------------------------------------------------------------

    def _with(self, topics: Collection[str] | None) -> Iterator[ChunkPlace]:
        """Chunks with messages of some topics, or of any, by their starts."""
        numbers = {number for number, channel in self._channels.items() if topics is None or channel.topic in topics}
        return (chunk for chunk in self._chunks if chunk.channels & numbers)

    def channel(self, topic: str, node: str) -> tuple[Channel, Schema]:
        """Return the channel of the messages that a node has published on a topic, and its schema."""
        channel_of = next(
            one for one in self._channels.values() if (one.topic, one.metadata.get("node", "")) == (topic, node)
        )
        return channel_of, self._schemas[channel_of.schema_id]

    def _read_chunk(self, chunk: ChunkPlace) -> list[RecordedMessage]:
        """The messages of a chunk, by time."""
        ends = {number: (one.topic, one.metadata.get("node", "")) for number, one in self._channels.items()}
        messages = []
        for time, channel, data in chunk_messages(self._stream, chunk.offset, self.file):
            if channel not in ends:
                raise ConfigError(f"is damaged: a message of the unknown channel {channel}", file=self.file)
            topic, node = ends[channel]
            messages.append(RecordedMessage(time, topic, data, node))
        messages.sort(key=attrgetter("time"))
        return messages

    def close(self) -> None:
        self._stream.close()


def _events(message: RecordedMessage) -> list[Event]:
    """The events of a message. Raises what data of another form raise."""
    data, events = message.json(), []
    for group in data["events"]:
        for element, what, *detail in group["marks"]:
            if not (isinstance(element, str) and isinstance(what, str)):
                raise TypeError(f"expected an element and what happened, got {element!r}, {what!r}")
            where = message.time, str(data["robot"]), int(group["instance"]), int(group["scope"])
            events.append(Event(*where, element, what, *detail))
    return events


def copy_of(stream: BinaryIO) -> BinaryIO:
    """Return a copy of a temporary file, for another thread. To be closed."""
    other: Any = TemporaryFile()  # noqa: SIM115 (who gets it closes it)
    other.write(os.pread(stream.fileno(), os.fstat(stream.fileno()).st_size, 0))
    other.seek(0)
    copied: BinaryIO = other
    return copied


def _register(type: str, definition: str) -> None:
    """Add the types of a schema to those that are known, unless they are."""
    from fame.middleware import messages

    first, *others = definition.split("=" * 80 + "\n")
    heads = [text.partition("\n") for text in others]
    parts = [(type, first), *((head.removeprefix("MSG: "), text) for head, _, text in heads)]
    known = frozenset(messages.types())
    for name, text in parts:
        full = name if name.count("/") == 2 else name.replace("/", "/msg/")
        if full not in known:
            messages.register(text, full)


def scene_values(scene: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what FAME's own view draws of the entities of a scene: appearances of robots by name, and ``ground``."""
    for entity in scene["entities"]:
        values = (pair["value"] for pair in entity["metadata"] if pair["key"] in ("appearance", "ground"))
        yield entity["id"], json.loads(next(values, "{}"))


def team_order(robots: Iterable[str], bodies: Iterable[str] = ()) -> list[str]:
    """Return the robots of a team in the order that gives them their colours: those of a world (`bodies`) in its order,
    then the others by name, numbers in it as numbers."""
    return list(dict.fromkeys((*bodies, *sorted(robots, key=_by_number))))


def _by_number(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def models_of(recording: Recording) -> list[Definitions]:
    """Return the models in a recording; those that cannot be read are left out."""
    from fame.bpmn import read_bytes

    found = []
    for name, data in recording.models.items():
        with suppress(ModelError):
            found.append(read_bytes(data, file=name))
    return found
