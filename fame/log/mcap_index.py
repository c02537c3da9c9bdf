"""The index of an MCAP file: its chunks, channels, metadata and attachments.

A whole file has an index at its end. One that was cut short has none: it is read from its beginning, up to where it is
whole.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Any, BinaryIO

from fame.errors import ConfigError

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

_RECORD = struct.Struct("<BQ")
"""The head of a record: opcode, length of the rest."""
_MESSAGE_OPCODE = 5
_MESSAGE, _MESSAGE_HEAD = struct.Struct("<H4xQ"), 22
"""The head of a message: channel, (sequence number,) log time (, publish time); and its length."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """A chunk: its place in the file, its times (ns), and the channels of its messages."""

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
        index = _read_summary(stream)
    except _broken():
        index = None
    if index is None:
        index = _scan(stream)
        index.warnings.append(f"{file}: is incomplete; it is read up to the damaged place")
    index.chunks = sorted(index.chunks, key=attrgetter("start"))
    return index


def chunk_messages(stream: BinaryIO, offset: int, file: str) -> Iterator[tuple[int, int, bytes]]:
    """Yield the messages of the chunk at an offset: ns, number of the channel, content.

    Raises ConfigError if it is damaged.
    """
    from mcap.stream_reader import StreamReader, get_chunk_data_stream

    try:
        stream.seek(offset)
        chunk: Any = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
        source, size = get_chunk_data_stream(chunk, validate_crc=True)
        yield from _messages(source.read(size))
    except _broken() as error:
        raise ConfigError(f"is damaged at byte {offset}: {error}", file=file) from None


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

    damaged = (McapError, ZstdError, zlib.error, struct.error, ValueError, KeyError)
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
            frozenset(each.message_index_offsets),
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


def _scan(stream: BinaryIO) -> McapIndex:
    """Index the undamaged part of a file, read from its beginning."""
    from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader, breakup_chunk

    index, counts, chunks = McapIndex(), Counter[int](), []
    stream.seek(0)
    size = os.fstat(stream.fileno()).st_size
    offset = 8
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if stream.tell() > size:
                break
            if isinstance(record, Chunk):
                channels: set[int] = set()
                for inner in breakup_chunk(record, validate_crc=True):
                    if isinstance(inner, Schema):
                        index.schemas[inner.id] = inner
                    elif isinstance(inner, Channel):
                        index.channels[inner.id] = inner
                    elif isinstance(inner, Message):
                        channels.add(inner.channel_id)
                        counts[inner.channel_id] += 1
                place = ChunkPlace(offset, record.message_start_time, record.message_end_time, frozenset(channels))
                chunks.append(place)
            elif isinstance(record, Metadata) and record.name == "fame":
                index.metadata.update(record.metadata)
            elif isinstance(record, Attachment):
                index.attachments[record.name] = record.data
            offset = stream.tell()
    except _broken():
        pass
    index.chunks, index.counts = chunks, counts
    return index
