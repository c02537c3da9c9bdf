"""Reads the bags of ROS 1 and 2: a folder of rosbag2 in either storage, one file of it (MCAP, SQLite), or a rosbag1.

Only the topics that are asked for are parsed: whatever else a bag holds (JSON, Protobuf, definitions that nobody can
read) does not concern who reads it. MCAP is read by `fame.log.mcap_index`, the rest by rosbags; what is compressed
unpacks to bounded sizes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from heapq import merge
from mmap import ACCESS_READ, mmap
from operator import itemgetter
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

import yaml

from fame.errors import ConfigError, FameError, MessageError
from fame.log.decompression import CHUNK_LIMIT, check_zstd, unpack
from fame.log.mcap_index import ChunkPlace, chunk_messages, in_order, read_index
from fame.middleware.definitions import Definition, check_size, check_text, from_rosbags
from fame.text import open_file

_METADATA_LIMIT = 10_000_000
_FILE_LIMIT = 1 << 34
"""Bytes of a metadata.yaml, and of a compressed file of a bag when it is unpacked to disk."""
_Raw = tuple[int, Any, bytes]


def is_bag(path: Path) -> bool:
    return (path / "metadata.yaml").is_file()


class BagTopic(NamedTuple):
    """A topic of a file: its number there, its name, type, encoding, and the definition of the type with its format."""

    number: Any
    name: str
    type: str
    encoding: str
    definition: bytes = b""
    format: str = ""


class _Storage(NamedTuple):
    """A file of a bag: its topics, and what reads messages (ns, number of the topic, content) of some of them."""

    topics: list[BagTopic]
    messages: Callable[[Collection[Any]], Iterator[_Raw]]


class BagReader:
    """An open bag. `topics`: name -> topic; of a bag of several files that of the first that has it."""

    def __init__(self, file: str, storages: list[_Storage]) -> None:
        self.file: str = file
        self._storages = storages
        self.topics: dict[str, BagTopic] = {}
        for topic in (each for storage in storages for each in storage.topics):
            self.topics.setdefault(topic.name, topic)
        self._read: dict[str, Callable[[bytes], Any]] = {}

    def messages(self, names: Collection[str]) -> Iterator[tuple[int, str, Any]]:
        """Yield the messages of some topics by time: ns, topic, message. Raises ConfigError for what cannot be read."""
        for time, name, data in self.contents(names):
            yield time, name, self.message(name, data)

    def contents(self, names: Collection[str]) -> Iterator[_Raw]:
        """Yield messages as `messages`, but unparsed, for `message`."""
        streams = [_named(storage, names) for storage in self._storages]
        with _readable(self.file):
            yield from merge(*streams, key=itemgetter(0))

    def message(self, name: str, data: bytes) -> Any:
        """Return a message of a topic from its bytes. Raises ConfigError."""
        if name not in self._read:
            self._read[name] = self._reader(self.topics[name])
        try:
            return self._read[name](data)
        except Exception as error:  # whatever the bytes make the generated code raise
            raise ConfigError(f"a message on {name} cannot be read: {error}", file=self.file) from None

    def _reader(self, topic: BagTopic) -> Callable[[bytes], Any]:
        """Return what reads the messages of a topic. Raises ConfigError."""
        if topic.encoding not in ("cdr", "ros1"):
            raise ConfigError(f"expected messages in CDR on {topic.name}, got {topic.encoding!r}", file=self.file)
        try:
            store = _typestore(topic)
        except MessageError as error:
            raise ConfigError(f"the definition of {topic.type} on {topic.name}: {error}", file=self.file) from None
        return partial(
            store.deserialize_ros1 if topic.encoding == "ros1" else store.deserialize_cdr, typename=topic.type
        )


def _named(storage: _Storage, names: Collection[str]) -> Iterator[_Raw]:
    """Yield the messages of some topics with their names."""
    numbers = {each.number: each.name for each in storage.topics if each.name in names}
    return ((time, numbers[number], data) for time, number, data in storage.messages(numbers)) if numbers else iter(())


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Open a bag. Raises ConfigError for a file that is not one, or cannot be read."""
    with ExitStack() as stack:
        with _readable(str(path)):
            storages = [_bag_file(each, stack, compression) for each, compression in _files(path, stack)]
        yield BagReader(str(path), storages)


@contextmanager
def _readable(file: str) -> Iterator[None]:
    """Raise ConfigError for whatever damaged bytes make the readers in the block raise: those of four packages."""
    try:
        yield
    except FameError:
        raise
    except Exception as error:
        why = str(error).partition("\n")[0][:200] or type(error).__name__
        raise ConfigError(f"is not a readable bag: {why}", file=file) from None


def _bag_file(path: Path, stack: ExitStack, compression: str) -> _Storage:
    """Open a file of a bag by its first bytes; `compression` of each message."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    stream = stack.enter_context(open_file(path))
    begin = stream.read(7)
    if begin == b"#ROSBAG":
        bag = stack.enter_context(Reader(path))
        for place, chunk in bag.chunks.items():
            kind = next((name for name in ("bz2", "lz4") if name in chunk.decompressor.__module__), "")
            bag.chunks[place] = chunk._replace(decompressor=partial(unpack, compression=kind))
        storage = _of_rosbags(bag)
    elif begin == b"SQLite ":
        reader = Sqlite3Reader(path)
        with _bounded_values():
            reader.open()
        stack.callback(reader.close)
        storage = _of_rosbags(reader)
    elif not b"\x89MCAP0\r".startswith(begin or b"-"):
        raise ValueError("expected MCAP, SQLite or a rosbag1")
    else:
        storage = _of_mcap(stream, str(path))
    if not compression:
        return storage
    messages = storage.messages
    return storage._replace(messages=lambda wanted: (
        (time, number, unpack(data, compression)) for time, number, data in messages(wanted)
    ))  # fmt: skip


@contextmanager
def _bounded_values() -> Iterator[None]:
    """Bound a value of the databases that this block opens: a generated column may state one of any size."""
    from rosbags.rosbag2 import storage_sqlite3

    apsw: Any = getattr(storage_sqlite3, "apsw", None)
    if apsw is None:  # releases of rosbags that read SQLite with Python's own module
        yield
        return

    def bound(connection: Any) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, CHUNK_LIMIT)

    apsw.connection_hooks.append(bound)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(bound)


def _of_mcap(stream: BinaryIO, file: str) -> _Storage:
    stream.seek(0)
    index = read_index(stream, file)
    if index.warnings:
        raise ConfigError("is cut short or damaged; ros2 bag reindex or mcap recover restores what it holds", file=file)
    topics = []
    for number, channel in index.channels.items():
        schema = index.schemas.get(channel.schema_id)
        name, data, format = (schema.name, schema.data, schema.encoding) if schema is not None else ("", b"", "")
        topics.append(BagTopic(number, channel.topic, name, channel.message_encoding, data, format))

    def messages(wanted: Collection[Any]) -> Iterator[_Raw]:
        def load(chunk: ChunkPlace) -> list[_Raw]:
            found = [each for each in chunk_messages(stream, chunk.offset, file) if each[1] in wanted]
            return sorted(found, key=itemgetter(0))

        return in_order((chunk for chunk in index.chunks if not chunk.channels.isdisjoint(wanted)), load)

    return _Storage(topics, messages)


def _of_rosbags(reader: Any) -> _Storage:
    """Return an open reader of rosbags as a storage."""
    from rosbags.interfaces import MessageDefinitionFormat

    formats = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
    topics = [
        BagTopic(
            each.id, each.topic, each.msgtype, getattr(each.ext, "serialization_format", "ros1"),
            each.msgdef.data.encode(), formats.get(each.msgdef.format, ""),
        )
        for each in reader.connections
    ]  # fmt: skip

    def messages(wanted: Collection[Any]) -> Iterator[_Raw]:
        chosen = [each for each in reader.connections if each.id in wanted]
        return ((time, each.id, data) for each, time, data in reader.messages(chosen))

    return _Storage(topics, messages)


def _files(folder: Path, stack: ExitStack) -> Iterator[tuple[Path, str]]:
    """Yield the files of a bag, those of a folder by its metadata.yaml, unpacked, each with the compression of its
    messages. Raises ValueError or OSError."""
    if not folder.is_dir():
        yield folder, ""
        return
    metadata = folder / "metadata.yaml"
    if metadata.stat().st_size > _METADATA_LIMIT:
        raise ValueError(f"metadata.yaml has more than {_METADATA_LIMIT / 1e6:.0f} MB")
    try:
        about = yaml.load(metadata.read_text("utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        about = about["rosbag2_bagfile_information"]
        names = [PurePath(name).name for name in about["relative_file_paths"]]
        mode, format = (str(about.get(f"compression_{key}") or "").lower() for key in ("mode", "format"))
    except (yaml.YAMLError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"metadata.yaml is not that of a bag: {error!r}") from None
    if mode not in ("", "none") and format != "zstd":
        raise ValueError(f"compressed by {format!r}; expected zstd")
    for name in names:
        if mode == "file":
            unpacked = Path(stack.enter_context(TemporaryDirectory(prefix="fame-bag-")), "file")
            _unpack_file(folder / name, unpacked)
            yield unpacked, ""
        else:
            yield folder / name, "zstd" if mode == "message" else ""


def _unpack_file(path: Path, target: Path) -> None:
    import zstandard

    with (
        open_file(path) as packed,
        mmap(packed.fileno(), 0, access=ACCESS_READ) as content,
        target.open("wb") as file,
        zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as data,
    ):
        check_zstd(content)
        while part := data.read(1 << 20):
            file.write(part)
            if file.tell() > _FILE_LIMIT or file.tell() > shutil.disk_usage(target.parent).free:
                raise ValueError(f"{path.name} would unpack to more than {file.tell() / 1e9:.0f} GB")


def _typestore(topic: BagTopic) -> Any:
    """Return a type store of rosbags with the type of a topic and what that contains: by the bag's own definition, and
    of what that lacks as in ROS 2 Jazzy. Raises MessageError for one that cannot be read, or is too large."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    text = topic.definition.decode(errors="replace").replace("\r\n", "\n")
    check_text(text, topic.type)
    known = dict(get_typestore(Stores.ROS2_JAZZY).fielddefs)

    def find(name: str) -> Definition | None:
        constants, fields = known.get(name, ((), None))
        return None if fields is None else from_rosbags(name, constants, fields, {})

    try:
        if topic.format == "ros2msg":
            known.update(get_types_from_msg(text, topic.type))
        for idl in _idls(text) if topic.format.endswith("idl") else ():
            known.update(get_types_from_idl(idl))
        store = get_typestore(Stores.EMPTY)
        store.register({name: known[name] for name in check_size(topic.type, find, {})})
    except MessageError:
        raise
    except Exception as error:  # whatever a text makes the parsers raise
        why = str(error).strip().partition("\n")[0][:200] or type(error).__name__
        raise MessageError(f"cannot be read: {why}", type=topic.type) from None
    return store


def _idls(text: str) -> Iterator[str]:
    """Yield the files of an IDL definition, without the lines that part them."""
    for part in text.split("=" * 80 + "\n"):
        if part.strip():
            yield part.partition("\n")[2] if part.startswith("IDL: ") else part
