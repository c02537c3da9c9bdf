"""The index of an MCAP file: its chunks, channels, metadata and attachments.

A whole file has an index at its end, unless its writer was told to leave it out, or parts of it. One that was cut short
has none: it is read from its beginning, up to where it is whole. So is a file whose index lacks something.

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
from io import BytesIO
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError

if TYPE_CHECKING:
    from mmap import mmap

    from mcap.records import Channel, Chunk, Schema, Statistics
    from mcap.summary import Summary

_CUT = "the compressed data are cut short"
_M = TypeVar("_M", bound=tuple[Any, ...])
"""A message, as a tuple that begins with its time."""
CHUNK_LIMIT = 1 << 27
"""Bytes that a chunk may unpack to: a hundred times those that ``ros2 bag record`` writes."""
_RECORD = struct.Struct("<BQ")
"""The head of a record: opcode, length of the rest."""
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE_OPCODE = 2, 3, 4, 5
_CONTENT = frozenset({_SCHEMA, _CHANNEL, _MESSAGE_OPCODE, 6, 9, 12, 15})
"""Opcodes of what a file has (chunk, attachment, metadata, end of the data), without its index and what is unknown."""
_MESSAGE, _MESSAGE_HEAD = struct.Struct("<H4xQ"), 22
"""The head of a message: channel, (sequence number,) log time (, publish time); and its length."""
_MESSAGE_INDEX, _ENTRY = 15, 16
"""Bytes of an empty record that tells the places of messages, and of one place in it."""


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
    index, whole = None, False
    try:
        index, whole = _read_summary(stream), True
    except _broken():
        pass
    if index is None:
        index, complete = _scan(stream)
        if not (whole and complete):
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
    """Read the records up to the footer; None for each that is no content. None is longer than the file."""
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


def unpack(data: bytes, compression: str, size: int = -1) -> bytes:
    """Unpack data to `size` bytes, if that is known, or one more: whatever the data state of themselves, no more memory
    is taken. Raises ValueError for more than `CHUNK_LIMIT`, for data that are cut short and for an unknown compression,
    and the errors of the packages for damaged data."""
    most = min(size, CHUNK_LIMIT) if size >= 0 else CHUNK_LIMIT
    if size > CHUNK_LIMIT:
        raise ValueError(f"{size / 1e6:.0f} MB in one chunk; at most {CHUNK_LIMIT / 1e6:.0f} MB are read")
    if compression == "zstd":
        from zstandard import ZstdDecompressor

        check_zstd(data)
        with ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            data = reader.read(most + 1)
    elif compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = _streams(data, LZ4FrameDecompressor, most)
    elif compression == "bz2":
        data = _streams(data, BZ2Decompressor, most)
    elif compression:
        raise ValueError(f"expected zstd, lz4, bz2 or no compression, got {compression!r}")
    if len(data) > CHUNK_LIMIT:
        raise ValueError(f"more than {CHUNK_LIMIT / 1e6:.0f} MB in one chunk")
    return data


def _streams(data: bytes, decompressor: Callable[[], Any], most: int) -> bytes:
    """Unpack one compressed stream after another, to `most` bytes or one more."""
    unpacked = bytearray()
    while True:
        stream = decompressor()
        unpacked += stream.decompress(data, max_length=most + 1 - len(unpacked))
        if len(unpacked) <= most and not stream.eof:
            raise ValueError(_CUT)
        data = stream.unused_data
        if len(unpacked) > most or not data:
            return bytes(unpacked)


def check_zstd(data: bytes | mmap) -> None:
    """Raise ValueError unless data are whole frames (RFC 8878, 3.1): what unpacks them does not mind a missing end."""
    from zstandard import frame_header_size, get_frame_parameters

    place, end = 0, len(data)
    while place < end or not end:
        head = data[place : place + 18]
        if head[1:4] == b"\x2a\x4d\x18" and head[0] >> 4 == 5:  # to be skipped
            place, last = place + 8 + int.from_bytes(head[4:8], "little"), 1
        else:
            place, last = place + frame_header_size(head), 0
            while place < end and not last:
                block = int.from_bytes(data[place : place + 3], "little")
                last, is_run = block & 1, block >> 1 & 3 == 1
                place += 3 + (1 if is_run else block >> 3)
            place += 4 * get_frame_parameters(head).has_checksum
        if place > end or not last:
            raise ValueError(_CUT)


def _messages(records: bytes) -> Iterator[tuple[int, int, bytes]]:
    """The messages among the records of a chunk. (Those of the package `mcap` are many times slower to read.)"""
    for opcode, begin, end in _split(records):
        if opcode == _MESSAGE_OPCODE:
            channel, time = _MESSAGE.unpack_from(records, begin)
            yield time, channel, records[begin + _MESSAGE_HEAD : end]


def _split(records: bytes) -> Iterator[tuple[int, int, int]]:
    """The records of a chunk: opcode, and the place of the rest."""
    begin = 0
    while begin < len(records):
        opcode, length = _RECORD.unpack_from(records, begin)
        begin += _RECORD.size
        end = begin + length
        if end > len(records):
            raise ValueError("a record is longer than its chunk")
        if opcode == _MESSAGE_OPCODE and length < _MESSAGE_HEAD:
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
            each.chunk_start_offset,
            each.message_start_time,
            each.message_end_time,
            frozenset(each.message_index_offsets or summary.channels),
        )
        for each in summary.chunk_indexes
    ]
    index.counts = statistics.channel_message_counts
    for metadata in reader.iter_metadata():
        if metadata.name == "fame":
            index.metadata.update(metadata.metadata)
    index.attachments = {item.name: item.data for item in reader.iter_attachments()}
    return index


def _is_complete(summary: Summary, statistics: Statistics) -> bool:
    """Whether an index has what the statistics of the file count, down to the places of all messages, in chunks."""
    places = sum(each.message_index_length - _MESSAGE_INDEX * len(each.message_index_offsets)
                 for each in summary.chunk_indexes)  # fmt: skip
    return (
        places == _ENTRY * statistics.message_count
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
    offset, complete = stream.seek(8), False
    try:
        for record in _records(stream):
            if isinstance(record, Chunk):
                records = _unpacked(record)
                for opcode, begin, end in _split(records):
                    if opcode in (_SCHEMA, _CHANNEL):
                        _declare(index, _parsed(records[begin - _RECORD.size : end]))
                held = Counter(channel for _, channel, _ in _messages(records))
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
