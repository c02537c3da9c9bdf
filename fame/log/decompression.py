"""Compressed parts of recordings and bags, unpacked to no more bytes than they may have.

The size that the data themselves give is not trusted: a few bytes can unpack to gigabytes. A stream that was cut short
is an error: the packages would return its beginning, and nobody would notice that the rest is missing.
"""

from __future__ import annotations

from bz2 import BZ2Decompressor
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mmap import mmap

CHUNK_LIMIT = 1 << 27
"""Bytes that a chunk may unpack to: a hundred times those that ``ros2 bag record`` writes."""
_CUT = "the compressed data are cut short"
_SKIPPABLE = b"\x2a\x4d\x18"
"""Bytes 1 to 3 of the magic number of a frame of Zstandard that has no content; byte 0 is 0x50 to 0x5f."""
_RUN = 1
"""The type of a block of Zstandard that has one byte, however long it says to be."""


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
        head = data[place : place + 18]  # as long as the longest head of a frame
        if head[1:4] == _SKIPPABLE and head[0] >> 4 == 5:
            place, is_last = place + 8 + int.from_bytes(head[4:8], "little"), True
        else:
            place, is_last = place + frame_header_size(head), False
            while place < end and not is_last:
                block = int.from_bytes(data[place : place + 3], "little")  # last (1 bit), type (2), size (21)
                is_last, kind, size = bool(block & 1), block >> 1 & 3, block >> 3
                place += 3 + (1 if kind == _RUN else size)
            place += 4 * get_frame_parameters(head).has_checksum
        if place > end or not is_last:
            raise ValueError(_CUT)
