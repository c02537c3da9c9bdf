"""What writes recordings, beside the writer of the package `mcap`: they write the same bytes."""

import zlib
from io import BytesIO
from types import SimpleNamespace

import mcap.writer
import pytest

from fame.log import mcap_writer
from fame.log.mcap_writer import McapWriter


def by_fame(stream: BytesIO, messages: int) -> None:
    """A file with all that a recording has."""
    writer = McapWriter(stream, "library")
    writer.metadata("fame", {"seed": "1"})
    writer.attachment("model", "application/xml", b"<xml/>")
    channels = [
        writer.channel("/a", "json", writer.schema("A", "jsonschema", b"{}"), {}),
        writer.channel("/b", "cdr", writer.schema("B", "ros2msg", b"int8 b"), {"node": "/REX"}),
    ]
    for number in range(messages):
        writer.message(channels[number % 3 % 2], 100 + (number * 7) % 5, b"x" * number)
        if number == 4:
            writer.flush()
            writer.flush()
    writer.finish()


def by_the_package(stream: BytesIO, messages: int) -> None:
    """The same file."""
    writer = mcap.writer.Writer(stream, chunk_size=mcap_writer.CHUNK)
    writer.start("", "library")
    writer.add_metadata("fame", {"seed": "1"})
    writer.add_attachment(0, 0, "model", "application/xml", b"<xml/>")
    channels = [
        writer.register_channel("/a", "json", writer.register_schema("A", "jsonschema", b"{}")),
        writer.register_channel("/b", "cdr", writer.register_schema("B", "ros2msg", b"int8 b"), {"node": "/REX"}),
    ]
    sent = [0, 0]
    for number in range(messages):
        which, time = number % 3 % 2, 100 + (number * 7) % 5
        sent[which] += 1
        writer.add_message(channels[which], time, b"x" * number, time, sent[which])
        if number == 4:
            writer.flush()  # type: ignore[no-untyped-call]
    writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("messages", [0, 1, 40])
def test_it_writes_what_the_package_writes(messages: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_writer, "CHUNK", 300)
    packed = SimpleNamespace(compress=zlib.compress)
    monkeypatch.setattr(mcap_writer, "ZstdCompressor", lambda level: packed)
    monkeypatch.setattr(mcap.writer, "zstandard", packed)
    ours, theirs = BytesIO(), BytesIO()
    by_fame(ours, messages)
    by_the_package(theirs, messages)
    assert ours.getvalue() == theirs.getvalue()
