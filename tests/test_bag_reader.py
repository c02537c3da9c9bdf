"""Bags: only what is asked for is parsed, and what a file states of its sizes is bounded before memory is taken."""

from __future__ import annotations

import bz2
import sqlite3
import struct
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zstandard
from lz4.frame import compress as lz4_compress
from mcap.writer import CompressionType, IndexType, Writer

pytest.importorskip("rosbags")

from fame.errors import ConfigError, MessageError
from fame.log import decompression, mcap_index
from fame.log.bag_reader import open_bag
from fame.middleware import codec, messages, typesystem
from fame.middleware.definitions import from_text

STATE, START = "sensor_msgs/msg/JointState", 1_700_000_000_000_000_000
LINE = "=" * 80 + "\n"


def definition() -> str:
    text: str = codec.typestore(STATE).generate_msgdef(STATE, ros_version=2)[0]
    return text


def bag(
    path: Path, text: str | bytes | None = None, others: Sequence[tuple[str, str, bytes, str]] = (), *,
    type: str = STATE, encoding: str = "cdr", data: bytes | None = None, **options: Any,
) -> Path:  # fmt: skip
    """Three joint states in MCAP; `others`: topics besides, as (type, format, definition, encoding)."""
    text = definition() if text is None else text
    with path.open("wb") as stream:
        writer = Writer(stream, **{"compression": CompressionType.ZSTD, **options})
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(type, "ros2msg", text if isinstance(text, bytes) else text.encode())
        channel = writer.register_channel("/joint_states", encoding, schema)
        for number, (name, format, content, kind) in enumerate(others):
            other = writer.register_channel(f"/other_{number}", kind, writer.register_schema(name, format, content))
            writer.add_message(other, START, b"{}", START)
        for number in range(3):
            sent = data or codec.serialize(messages.create(STATE, {"name": ["a"], "position": [float(number)]}))
            writer.add_message(channel, START + number, sent, START)
        writer.finish()
    return path


def positions(path: Path) -> list[float]:
    with open_bag(path) as reader:
        return [message.position[0] for _, _, message in reader.messages(["/joint_states"])]


@pytest.mark.parametrize(
    "other",
    [
        ("thing", "jsonschema", b"{}", "json"),
        ("foxglove.Log", "protobuf", b"\x0a\x00", "protobuf"),
        ("acme_msgs/Old", "ros1msg", b"int32 x\n", "ros1"),
        ("acme_msgs/msg/Crlf", "ros2msg", b"int32 x\r\nint32 y\r\n", "cdr"),
        ("acme_msgs/msg/Latin", "ros2msg", b"# h\xf6he\nint32 x\n", "cdr"),
        ("acme_msgs/msg/Idl", "ros2idl", b"no idl at all", "cdr"),
        ("acme_msgs/msg/Lacking", "ros2msg", b"acme_msgs/None x\n", "cdr"),
        ("acme_msgs/msg/Huge", "ros2msg", b"uint8[4000000000] x\n", "cdr"),
    ],
)
def test_other_topics_are_not_parsed(other: tuple[str, str, bytes, str], tmp_path: Path) -> None:
    path = bag(tmp_path / "a.mcap", others=[other])
    assert positions(path) == [0.0, 1.0, 2.0]
    with open_bag(path) as reader, pytest.raises(ConfigError, match=r"a\.mcap: .*/other_0"):
        list(reader.messages(["/other_0"]))


@pytest.mark.parametrize(
    "text", [definition().replace("\n", "\r\n"), definition().partition("=" * 80)[0], "# h\xf6he\n" + definition()]
)
def test_a_definition_may_have_other_line_ends_letters_and_leave_out_what_ros_has(text: str, tmp_path: Path) -> None:
    assert positions(bag(tmp_path / "a.mcap", text.encode("latin-1"))) == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    "options",
    [{"index_types": IndexType.CHUNK}, {"index_types": IndexType.NONE}, {"use_chunking": False},
     {"compression": CompressionType.LZ4}, {"use_summary_offsets": False, "use_statistics": False}],
)  # fmt: skip
def test_a_bag_is_read_whatever_indexes_and_chunks_it_has(options: dict[str, Any], tmp_path: Path) -> None:
    assert positions(bag(tmp_path / "a.mcap", **options)) == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    "options",
    [{"repeat_channels": False, "repeat_schemas": False}, {"repeat_schemas": False},
     {"index_types": IndexType.CHUNK | IndexType.MESSAGE, "use_statistics": False},
     {"index_types": IndexType.ALL & ~IndexType.ATTACHMENT}, {"index_types": IndexType.ALL & ~IndexType.METADATA}, {}],
)  # fmt: skip
def test_what_an_index_leaves_out_is_found_in_the_file(options: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("w+b") as stream:
        writer = Writer(stream, **options)
        writer.start()
        channel = writer.register_channel("/a", "cdr", writer.register_schema("A", "ros2msg", b"int8 x"))
        writer.add_message(channel, 5, b"abc", 5)
        writer.add_attachment(0, 0, "file", "text/plain", b"content")
        writer.add_metadata("fame", {"format": "2"})
        writer.finish()
        stream.seek(0)
        index = mcap_index.read_index(stream, str(path))
    assert (index.channels[channel].topic, index.schemas[1].name, index.counts) == ("/a", "A", {channel: 1})
    assert (index.attachments, index.metadata, index.warnings) == ({"file": b"content"}, {"format": "2"}, [])


def test_messages_come_by_time_across_chunks(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            "/joint_states", "cdr", writer.register_schema(STATE, "ros2msg", definition().encode())
        )
        for number in (2, 0, 1):
            sent = codec.serialize(messages.create(STATE, {"position": [float(number)]}))
            writer.add_message(channel, START + number, sent, START)
        writer.finish()
    assert positions(tmp_path / "a.mcap") == [0.0, 1.0, 2.0]


def test_a_bag_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    whole = bag(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match=r"a\.mcap: is cut short or damaged"):
        positions(tmp_path / "a.mcap")


# ---- sizes -----------------------------------------------------------------------------------------------------------


def chunk(compression: str, data: bytes, size: int) -> bytes:
    """A file of one chunk, without an index."""
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    records = [(1, struct.pack("<I", 4) + b"ros2" + bytes(4)), (6, content), (15, bytes(4)), (2, bytes(20))]
    magic = b"\x89MCAP0\r\n"
    return magic + b"".join(struct.pack("<BQ", code, len(body)) + body for code, body in records) + magic


@pytest.mark.parametrize("stated", [20_000, 100, 3_000_000_000])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_would_unpack_to_too_much_or_to_another_size_is_refused(
    compression: str, stated: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decompression, "CHUNK_LIMIT", 10_000)
    packed = {"zstd": zstandard.compress, "lz4": lz4_compress}[compression](bytes(20_000))
    (tmp_path / "a.mcap").write_bytes(chunk(compression, packed, stated))
    with pytest.raises(ConfigError, match="is cut short or damaged"):
        positions(tmp_path / "a.mcap")
    with pytest.raises(ValueError, match="in one chunk"):
        decompression.unpack(packed, compression)
    assert len(decompression.unpack(packed, compression, 100)) == 101


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.ZstdCompressor(write_checksum=True).compress, "lz4": lz4_compress, "bz2": bz2.compress
}  # fmt: skip


@pytest.mark.parametrize("compression", PACKERS)
def test_compressed_data_are_read_to_their_end_or_refused(compression: str) -> None:
    pack = PACKERS[compression]
    once, twice = pack(b"a" * 300_000), pack(b"a" * 300_000) + pack(b"") + pack(b"b")
    assert decompression.unpack(twice, compression) == b"a" * 300_000 + b"b"
    for cut in {*range(len(twice))} - {len(once), len(once + pack(b""))}:
        with pytest.raises((ValueError, zstandard.ZstdError)):
            decompression.unpack(twice[:cut], compression)


def test_frames_of_zstd_that_are_to_be_skipped_are() -> None:
    skipped = struct.pack("<II", 0x184D2A53, 3) + b"abc"
    assert decompression.unpack(skipped + PACKERS["zstd"](b"a") + skipped, "zstd") == b"a"


def test_an_unknown_compression_is_refused() -> None:
    with pytest.raises(ValueError, match="expected zstd, lz4, bz2 or no compression, got 'gzip'"):
        decompression.unpack(b"abc", "gzip")


@pytest.mark.parametrize("in_chunk", [True, False])
def test_a_message_shorter_than_its_head_is_not_read_on_into_the_next(in_chunk: bool, tmp_path: Path) -> None:
    records = struct.pack("<BQI", 5, 4, 1) + struct.pack("<BQHIQQ", 5, 25, 1, 0, 7, 7) + b"abc"
    content = chunk("", records, len(records))
    place = 8 + 9 + 12 if in_chunk else content.index(records)  # after the magic bytes and the header of the file
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with path.open("rb") as stream:
        with pytest.raises(ConfigError, match=rf"a\.mcap: is damaged at byte {place}: .* 4 bytes"):
            list(mcap_index.chunk_messages(stream, place, str(path)))
        stream.seek(0)
        assert mcap_index.read_index(stream, str(path)).warnings


def nested(*, depth: int, times: int = 1) -> str:
    """A type that contains a type, and so on, each so many times."""
    parts = [f"acme_msgs/T{number} {name}" for number in range(depth) for name in "abcdefgh"[:times]]
    texts = ["\n".join(parts[number * times : (number + 1) * times]) + "\n" for number in range(depth)]
    return texts[0] + "".join(
        f"{LINE}MSG: acme_msgs/T{number}\n{text}" for number, text in enumerate([*texts[1:], "uint8 x\n"])
    )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("uint8[4000000000] x\n", r"4,000,000,200 bytes; at most 100,000,000"),
        ("".join(f"uint8 x{number}\n" for number in range(5001)), r"in 5,002 lines; at most"),
        (f"uint8 {'x' * 1_000_000}\n", r"has 1,000,007 characters"),
        (nested(depth=40), "33 levels; at most 32"),
        (nested(depth=26, times=2), "fields; at most 100,000"),
    ],
    ids=["array", "fields", "long", "deep", "doubling"],
)
def test_a_definition_of_messages_that_are_too_large_is_refused(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=why):
        positions(bag(tmp_path / "a.mcap", text, type="acme_msgs/msg/Top"))


def test_types_of_files_are_bounded_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typesystem, "_definitions", dict(typesystem._table()))  # not for all other tests
    texts = {"Top0": "uint8[4000000000] x\n", "Nested": f"uint8[] x {'[' * 3000}{']' * 3000}\n"}
    texts |= {f"Twice{k}": f"big_msgs/Twice{k + 1} a\nbig_msgs/Twice{k + 1} b\n" for k in range(26)}
    texts |= {f"Deep{k}": f"big_msgs/Deep{k + 1} a\n" for k in range(40)}
    texts |= {"Twice26": "uint8 x\n", "Deep40": "uint8 x\n"}
    (tmp_path / "big_msgs").mkdir()
    for name, text in texts.items():
        (tmp_path / "big_msgs" / f"{name}.msg").write_text(text)
    messages.register_files(tmp_path)
    for name in ("Top0", "Nested", "Twice0", "Deep0"):
        with pytest.raises(MessageError, match=rf"big_msgs/msg/{name}: .*(at most|more than 32)"):
            messages.create(f"big_msgs/msg/{name}")
    assert messages.create("big_msgs/msg/Twice25").a.x == 0


def test_brackets_without_end_are_refused_where_they_stand() -> None:
    with pytest.raises(MessageError, match="nested more than 32 deep"):
        from_text(f"uint8[] x {'[' * 3000}{']' * 3000}", "big_msgs/msg/Nested")


def test_a_chunk_of_a_rosbag1_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(tmp_path / "a.bag")
    writer.set_compression(Writer1.CompressionFormat.BZ2)
    with writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"](data="x" * 20_000)
        writer.write(connection, START, store.serialize_ros1(text, "std_msgs/msg/String"))
    with open_bag(tmp_path / "a.bag") as reader:
        assert [message.data[:3] for _, _, message in reader.messages(["/text"])] == ["xxx"]
    monkeypatch.setattr(decompression, "CHUNK_LIMIT", 10_000)
    with (
        open_bag(tmp_path / "a.bag") as reader,
        pytest.raises(ConfigError, match=r"a\.bag: is not a readable bag: more"),
    ):
        list(reader.messages(["/text"]))


@pytest.mark.parametrize("compression", ["none", "file", "message"])
def test_a_folder_is_read_by_its_files_whatever_it_says_of_its_storage(compression: str, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    sent = codec.serialize(messages.create(STATE, {"position": [1.0]}))
    data = zstandard.compress(sent) if compression == "message" else sent
    content = bag(folder / "bag_0.mcap", data=data).read_bytes()
    if compression == "file":
        frames = [zstandard.compress(content[:100]), zstandard.compress(content[100:])]
        (folder / "bag_0.mcap").write_bytes(b"".join(frames))
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  storage_identifier: ''\n  relative_file_paths: [bag_0.mcap]\n"
        f"  compression_mode: {compression}\n  compression_format: zstd\n"
    )
    assert positions(folder) == [1.0, 1.0, 1.0]
    (folder / "metadata.yaml").write_text("relative_file_paths: 3\n")
    with pytest.raises(ConfigError, match=r"metadata\.yaml is not that of a bag"):
        positions(folder)


def test_a_value_that_a_database_would_have_to_compute_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    with closing(sqlite3.connect(path)) as base:
        base.executescript(
            "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT,"
            " offered_qos_profiles TEXT);"
            "CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER, id INTEGER PRIMARY KEY,"
            " data BLOB AS (zeroblob(300000000)));"
            f"INSERT INTO topics VALUES(1, '/joint_states', '{STATE}', 'cdr', '');"
            "INSERT INTO messages VALUES(1, 1, 1);"
        )
    with pytest.raises(ConfigError, match=r"bag\.db3: is not a readable bag: string or blob too big"):
        positions(path)


def test_what_is_said_of_a_name_of_megabytes_has_an_end() -> None:
    assert len(str(ConfigError(f"unknown type {'a' * 10**7}, known are: b", file="x"))) < 10_000
