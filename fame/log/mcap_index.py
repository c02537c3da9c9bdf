"""The index of an MCAP file: its chunks, channels, metadata and attachments (https://mcap.dev/spec).

A file is a sequence of records: a byte for the kind (opcode), eight for the length, the rest. Schemas, channels and
messages may be in chunks, which are compressed. At the end are a summary, which repeats schemas and channels and has
the places of chunks, metadata and attachments, and statistics.

`read_index` takes the summary if it has everything that the statistics count (`_read_summary`). A writer may leave it
out, or parts of it, and a file that was cut short has none: then all records are read, up to the damaged one (`_scan`).

The sizes that a file states are checked before memory is taken: those of its records by its own size, those of what its
chunks unpack to by `fame.log.decompression.CHUNK_LIMIT`.
"""

from __future__ import annotations

import os
import struct
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.log.decompression import unpack

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, Schema, Statistics
    from mcap.summary import Summary

_M = TypeVar("_M", bound=tuple[Any, ...])
"""A message, as a tuple that begins with its time."""
_MAGIC_SIZE = 8
_RECORD = struct.Struct("<BQ")
"""The head of a record: opcode, length of the rest."""
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END = 2, 3, 4, 5, 6, 9, 12, 15
_CONTENT = frozenset({_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END})
"""Opcodes of what a file has, without its index and what is unknown."""
_MESSAGE_HEAD, _MESSAGE_HEAD_SIZE = struct.Struct("<H4xQ"), 22
"""The head of a message: channel, (sequence number,) log time (, publish time); and its length."""
_INDEX_SIZE, _INDEX_ENTRY_SIZE = 15, 16
"""Bytes of an empty record of the places of one channel's messages in a chunk, and of one place in it."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """A chunk, or a message outside of chunks: its place in the file, its times (ns), the channels of its messages."""

    offset: int
    start: int
    end: int
    channels: frozenset[int]


@dataclass(slots=True)
class McapIndex:
    """The content of a file. `counts`: messages by channel number; chunks are in the order of their starts."""

    chunks: Sequence[ChunkPlace] = ()
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: Mapping[int, int] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def read_index(stream: BinaryIO, file: str) -> McapIndex:
    """Return the index of a file. Raises ConfigError if it is not MCAP."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.stream_reader import read_magic

    try:
        read_magic(ReadDataStream(stream))
    except (McapError, struct.error):
        raise ConfigError("is not an MCAP file", file=file) from None
    try:
        index, damaged = _read_summary(stream), False
    except _broken():  # what is before it may be whole: all of that is read
        index, damaged = None, True
    if index is None:
        index, ended = _scan(stream)
        if damaged or not ended:
            index.warnings.append(f"{file}: is incomplete; it is read up to the damaged place")
    index.chunks = sorted(index.chunks, key=attrgetter("start"))
    return index


def chunk_messages(stream: BinaryIO, offset: int, file: str) -> Iterator[tuple[int, int, bytes]]:
    """Yield the messages of the chunk, or the one message, at an offset: ns, number of the channel, content.

    Raises ConfigError if it is damaged.
    """
    from mcap.records import Chunk, Message

    try:
        stream.seek(offset)
        record: Any = next(_records(stream))
        if isinstance(record, Message):
            yield record.log_time, record.channel_id, record.data
        elif isinstance(record, Chunk):
            yield from _messages(_unpacked(record))
        else:
            raise ValueError("expected a chunk or a message")
    except _broken() as error:
        raise ConfigError(f"is damaged at byte {offset}: {error}", file=file) from None


def in_order(chunks: Iterable[ChunkPlace], load: Callable[[ChunkPlace], list[_M]]) -> Iterator[_M]:
    """Yield messages by time; `load` returns those of a chunk by time. Chunks that overlap are in memory together."""
    waiting: list[_M] = []
    for chunk in chunks:  # by their starts
        passed = bisect_left(waiting, chunk.start, key=itemgetter(0))
        yield from waiting[:passed]
        waiting = [*waiting[passed:], *load(chunk)]
        waiting.sort(key=itemgetter(0))
    yield from waiting


def _records(stream: BinaryIO) -> Iterator[Any]:
    """Yield the records up to the footer; None for each that is no content. Raises ValueError for one that says to be
    longer than the file."""
    size, opcode = os.fstat(stream.fileno()).st_size, 0
    while opcode != _FOOTER:
        head = stream.read(_RECORD.size)
        opcode, length = _RECORD.unpack(head)
        if length > size - stream.tell():
            raise ValueError("a record is longer than its file")
        record = head + stream.read(length)
        yield _parsed(record) if opcode in _CONTENT else None


def _parsed(record: bytes) -> Any:
    """Return a record of its bytes; one that is too short for its kind is not read on into the next one."""
    from mcap.stream_reader import StreamReader

    return next(StreamReader(BytesIO(record), skip_magic=True, emit_chunks=True).records)


def _unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk. Raises ValueError if it is damaged, or would unpack to too much."""
    data = unpack(chunk.data, chunk.compression, chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"a chunk of {len(data)} bytes is said to have {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a checksum does not fit")
    return data


def _messages(records: bytes) -> Iterator[tuple[int, int, bytes]]:
    """The messages among the records of a chunk. (Those of the package `mcap` are many times slower to read.)"""
    for opcode, begin, end in _split(records):
        if opcode == _MESSAGE:
            channel, time = _MESSAGE_HEAD.unpack_from(records, begin)
            yield time, channel, records[begin + _MESSAGE_HEAD_SIZE : end]


def _split(records: bytes) -> Iterator[tuple[int, int, int]]:
    """The records of a chunk: opcode, and the place of the rest."""
    begin = 0
    while begin < len(records):
        opcode, length = _RECORD.unpack_from(records, begin)
        begin += _RECORD.size
        end = begin + length
        if end > len(records):
            raise ValueError("a record is longer than its chunk")
        if opcode == _MESSAGE and length < _MESSAGE_HEAD_SIZE:
            raise ValueError(f"a message of {length} bytes is shorter than its head")
        yield opcode, begin, end
        begin = end


def _broken() -> tuple[type[Exception], ...]:
    """Errors raised by reading damaged bytes."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    damaged = (McapError, ZstdError, zlib.error, struct.error, ValueError, KeyError, RuntimeError)  # that of lz4
    return *damaged, OSError, EOFError, StopIteration, MemoryError


def _read_summary(stream: BinaryIO) -> McapIndex | None:
    """The index at the end of the file; None without one that has everything."""
    from mcap.reader import SeekingReader

    stream.seek(0)
    reader = SeekingReader(stream)
    summary = reader.get_summary()
    statistics = None if summary is None else summary.statistics
    if summary is None or statistics is None or not _is_complete(summary, statistics):
        return None
    index = McapIndex(channels=summary.channels, schemas=summary.schemas)
    index.chunks = [
        ChunkPlace(
            chunk.chunk_start_offset,
            chunk.message_start_time,
            chunk.message_end_time,
            frozenset(chunk.message_index_offsets or summary.channels),
        )
        for chunk in summary.chunk_indexes
    ]
    index.counts = statistics.channel_message_counts
    for metadata in reader.iter_metadata():
        if metadata.name == "fame":
            index.metadata.update(metadata.metadata)
    index.attachments = {item.name: item.data for item in reader.iter_attachments()}
    return index


def _is_complete(summary: Summary, statistics: Statistics) -> bool:
    """Whether an index has what the statistics of the file count, down to the places of all messages, in chunks."""
    places = sum(
        chunk.message_index_length - _INDEX_SIZE * len(chunk.message_index_offsets) for chunk in summary.chunk_indexes
    )
    return (
        places == _INDEX_ENTRY_SIZE * statistics.message_count
        and len(summary.chunk_indexes) >= statistics.chunk_count
        and len(summary.channels) >= statistics.channel_count
        and len(summary.schemas) >= statistics.schema_count
        and len(summary.metadata_indexes) >= statistics.metadata_count
        and len(summary.attachment_indexes) >= statistics.attachment_count
    )


def _scan(stream: BinaryIO) -> tuple[McapIndex, bool]:
    """Index the undamaged part of a file, read from its beginning, and return whether it has the mark of its end."""
    from mcap.records import Attachment, Chunk, DataEnd, Message, Metadata

    index, counts, chunks = McapIndex(), Counter[int](), []
    offset, ended = stream.seek(_MAGIC_SIZE), False
    try:
        for record in _records(stream):
            if isinstance(record, Chunk):
                held = _scan_chunk(record, index)
                counts += held
                times = record.message_start_time, record.message_end_time
                chunks.append(ChunkPlace(offset, *times, frozenset(held)))
            elif isinstance(record, Message):
                counts[record.channel_id] += 1
                chunks.append(ChunkPlace(offset, record.log_time, record.log_time, frozenset((record.channel_id,))))
            elif isinstance(record, Metadata) and record.name == "fame":
                index.metadata.update(record.metadata)
            elif isinstance(record, Attachment):
                index.attachments[record.name] = record.data
            _declare(index, record)
            ended = ended or isinstance(record, DataEnd)
            offset = stream.tell()
    except _broken():  # the end of what is whole; `read_index` says so
        pass
    index.chunks, index.counts = chunks, counts
    return index, ended


def _scan_chunk(chunk: Chunk, index: McapIndex) -> Counter[int]:
    """Declare the schemas and channels of a chunk, and return the number of its messages by channel."""
    records = _unpacked(chunk)
    for opcode, begin, end in _split(records):
        if opcode in (_SCHEMA, _CHANNEL):
            _declare(index, _parsed(records[begin - _RECORD.size : end]))
    return Counter(channel for _, channel, _ in _messages(records))


def _declare(index: McapIndex, record: Any) -> None:
    """Put a schema or a channel into the index."""
    from mcap.records import Channel, Schema

    if isinstance(record, Schema):
        index.schemas[record.id] = record
    elif isinstance(record, Channel):
        index.channels[record.id] = record
