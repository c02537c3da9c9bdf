"""The index of an MCAP file: its chunks, channels, metadata and attachments.

A whole file has an index at its end, unless its writer was told to leave it out. One that was cut short has none: it is
read from its beginning, up to where it is whole.

The sizes that a file states are checked before memory is taken: those of its records by its own size, those of what its
chunks unpack to by `CHUNK_LIMIT`.
"""

from __future__ import annotations

import os
import struct
import zlib
from bisect import bisect_left
from bz2 import BZ2Decompressor
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, Schema

_M = TypeVar("_M", bound=tuple[Any, ...])
"""A message, as a tuple that begins with its time."""
CHUNK_LIMIT = 1 << 27
"""Bytes that a chunk may unpack to: a hundred times those that ``ros2 bag record`` writes."""
_RECORD = struct.Struct("<BQ")
"""The head of a record: opcode, length of the rest."""
_MESSAGE_OPCODE = 5
_MESSAGE, _MESSAGE_HEAD = struct.Struct("<H4xQ"), 22
"""The head of a message: channel, (sequence number,) log time (, publish time); and its length."""


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
    whole = False
    try:
        index = _read_summary(stream)
        whole = index is None or not index.chunks
    except _broken():
        index = None
    if index is None or not index.chunks:
        index, complete = _scan(stream)
        if not (whole and complete):
            index.warnings.append(f"{file}: is incomplete; it is read up to the damaged place")
    index.chunks = sorted(index.chunks, key=attrgetter("start"))
    return index


def chunk_messages(stream: BinaryIO, offset: int, file: str) -> Iterator[tuple[int, int, bytes]]:
    """Yield the messages of the chunk, or the one message, at an offset: ns, number of the channel, content.

    Raises ConfigError if it is damaged.
    """
    try:
        stream.seek(offset)
        record: Any = next(_records(stream, skip_magic=True))
        if hasattr(record, "channel_id"):
            yield record.log_time, record.channel_id, record.data
        else:
            yield from _messages(_unpacked(record).data)
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


def _records(stream: BinaryIO, *, skip_magic: bool = False) -> Iterator[Any]:
    """Read records; none is longer than the file."""
    from mcap.stream_reader import StreamReader

    size = os.fstat(stream.fileno()).st_size
    return StreamReader(stream, skip_magic=skip_magic, emit_chunks=True, record_size_limit=size).records


def _unpacked(chunk: Chunk) -> Chunk:
    """Return a chunk without compression. Raises ValueError if it is damaged, or would unpack to too much."""
    if chunk.compression not in ("", "zstd", "lz4"):
        raise ValueError(f"unknown compression {chunk.compression!r}")
    data = unpack(chunk.data, chunk.compression, chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"a chunk of {len(data)} bytes is said to have {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a checksum does not fit")
    return replace(chunk, compression="", data=data)


def unpack(data: bytes, compression: str, size: int = -1) -> bytes:
    """Unpack data to `size` bytes, if that is known, or one more: whatever the data state of themselves, no more memory
    is taken. Raises ValueError for more than `CHUNK_LIMIT`, and the errors of the packages for damaged data."""
    most = min(size, CHUNK_LIMIT) if size >= 0 else CHUNK_LIMIT
    if size > CHUNK_LIMIT:
        raise ValueError(f"{size / 1e6:.0f} MB in one chunk; at most {CHUNK_LIMIT / 1e6:.0f} MB are read")
    if compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            data = reader.read(most + 1)
    elif compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = bytes(LZ4FrameDecompressor().decompress(data, max_length=most + 1))
    elif compression == "bz2":
        data = BZ2Decompressor().decompress(data, max_length=most + 1)
    if len(data) > CHUNK_LIMIT:
        raise ValueError(f"more than {CHUNK_LIMIT / 1e6:.0f} MB in one chunk")
    return data


def _messages(records: bytes) -> Iterator[tuple[int, int, bytes]]:
    """The messages among the records of a chunk. (Those of the package `mcap` are many times slower to read.)"""
    begin = 0
    while begin < len(records):
        opcode, length = _RECORD.unpack_from(records, begin)
        begin += _RECORD.size
        end = begin + length
        if end > len(records):
            raise ValueError("a record is longer than its chunk")
        if opcode == _MESSAGE_OPCODE:
            channel, time = _MESSAGE.unpack_from(records, begin)
            yield time, channel, records[begin + _MESSAGE_HEAD : end]
        begin = end


def _broken() -> tuple[type[Exception], ...]:
    """Errors raised by reading damaged bytes."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    damaged = (McapError, ZstdError, zlib.error, struct.error, ValueError, KeyError, RuntimeError)  # that of lz4
    return *damaged, OSError, EOFError, StopIteration, MemoryError


def _read_summary(stream: BinaryIO) -> McapIndex | None:
    """The index at the end of the file; None without one."""
    from mcap.reader import SeekingReader

    stream.seek(0)
    reader = SeekingReader(stream)
    summary = reader.get_summary()
    if summary is None:
        return None
    index = McapIndex(channels=summary.channels, schemas=summary.schemas)
    index.chunks = [
        ChunkPlace(
            each.chunk_start_offset,
            each.message_start_time,
            each.message_end_time,
            frozenset(each.message_index_offsets or summary.channels),
        )
        for each in summary.chunk_indexes
    ]
    if summary.statistics is not None:
        index.counts = summary.statistics.channel_message_counts
    for metadata in reader.iter_metadata():
        if metadata.name == "fame":
            index.metadata.update(metadata.metadata)
    index.attachments = {item.name: item.data for item in reader.iter_attachments()}
    return index


def _scan(stream: BinaryIO) -> tuple[McapIndex, bool]:
    """Index the undamaged part of a file, read from its beginning, and return whether it has the mark of its end."""
    from mcap.records import Attachment, Chunk, DataEnd, Message, Metadata
    from mcap.stream_reader import breakup_chunk

    index, counts, chunks = McapIndex(), Counter[int](), []
    stream.seek(0)
    size = os.fstat(stream.fileno()).st_size
    offset, complete = 8, False
    try:
        for record in _records(stream):
            if stream.tell() > size:
                break
            if isinstance(record, Chunk):
                inner = breakup_chunk(_unpacked(record))
                for each in inner:
                    _declare(index, each)
                held = Counter(each.channel_id for each in inner if isinstance(each, Message))
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
            complete = complete or isinstance(record, DataEnd)
            offset = stream.tell()
    except _broken():
        pass
    index.chunks, index.counts = chunks, counts
    return index, complete


def _declare(index: McapIndex, record: Any) -> None:
    """Put a schema or a channel into the index."""
    from mcap.records import Channel, Schema

    if isinstance(record, Schema):
        index.schemas[record.id] = record
    elif isinstance(record, Channel):
        index.channels[record.id] = record
