"""The types that are known without rosbags: they equal those of rosbags, to the byte."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from fame.errors import MessageError
from fame.middleware import codec, typesystem
from fame.middleware.messages import create

pytest.importorskip("cyclonedds")

from fame.middleware.dds import discovery
from fame.middleware.dds.discovery import NodeEntry

TEXTS = ("", "a", "drive", "tracteur à deux étages", "\U0001f69c", "x" * 1001)


def by_rosbags(message: Any) -> bytes:
    name = message.__msgtype__
    return bytes(codec.typestore(name).serialize_cdr(message, name, little_endian=True))


def test_the_definitions_are_those_of_jazzy() -> None:
    assert {name: typesystem._of_jazzy()[name] for name in typesystem.BUILTIN} == typesystem.BUILTIN


def test_the_table_of_jazzy_is_that_of_rosbags() -> None:
    of_rosbags = get_typestore(Stores.ROS2_JAZZY).fielddefs
    assert json.loads(typesystem._JAZZY.read_bytes()) == json.loads(json.dumps(of_rosbags))


def test_the_hashes_are_those_of_the_definitions() -> None:
    for name, known in typesystem.HASHES.items():
        store = Typestore()
        codec._describe(store, name, {})
        assert store.hash_rihs01(name) == known


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_packed_as_rosbags_does(text: str) -> None:
    data = codec.pack_text(text)
    assert data == by_rosbags(create(typesystem.STRING, text))
    assert codec.unpack_text(data) == codec.unpack_text(data + bytes(-len(data) % 4)) == text
    assert codec.unpack_text(bytes(codec.typestore(typesystem.STRING).serialize_cdr(
        create(typesystem.STRING, text), typesystem.STRING, little_endian=False
    ))) == text  # fmt: skip


def test_what_is_no_text_is_refused_as_rosbags_does() -> None:
    chance, store = random.Random(1), codec.typestore(typesystem.STRING)
    refused = 0
    for _ in range(2000):
        data = bytearray(codec.pack_text(chance.choice(TEXTS[:5])))
        data = data[: chance.randrange(len(data) + 1)] if chance.random() < 0.3 else data + bytes(chance.randrange(6))
        for _ in range(chance.randrange(3) if data else 0):
            data[chance.randrange(len(data))] = chance.randrange(256)
        try:
            message: Any = store.deserialize_cdr(bytes(data), typesystem.STRING)
        except SerdeError:
            refused += 1
            with pytest.raises(MessageError, match="cannot read"):
                codec.unpack_text(bytes(data))
        else:
            assert codec.unpack_text(bytes(data)) == message.data
    assert 500 < refused < 1900


def described(participant: bytes, nodes: list[NodeEntry]) -> bytes:
    """By the codec of all messages."""
    entries = [
        {
            "node_namespace": f"/{node.namespace}",
            "node_name": node.name,
            "reader_gid_seq": [{"data": gid} for gid in node.readers],
            "writer_gid_seq": [{"data": gid} for gid in node.writers],
        }
        for node in nodes
    ]
    return by_rosbags(create(typesystem.PARTICIPANT, {"gid": {"data": participant}, "node_entities_info_seq": entries}))


def some_nodes(chance: random.Random) -> list[NodeEntry]:
    def gids() -> tuple[bytes, ...]:
        return tuple(chance.randbytes(16) for _ in range(chance.randrange(4)))

    return [
        NodeEntry("n" * chance.randrange(1, 9), "r" * chance.randrange(9), gids(), gids())
        for _ in range(chance.randrange(4))
    ]


@pytest.mark.parametrize("seed", range(20))
def test_the_nodes_of_a_participant_are_packed_as_rosbags_does(seed: int) -> None:
    chance = random.Random(seed)
    participant, nodes = chance.randbytes(16), some_nodes(chance)
    data = discovery.pack_nodes(participant, nodes)
    assert data == described(participant, nodes)
    assert discovery.unpack_nodes(data) == (participant, tuple(nodes))


def test_bytes_that_tell_of_no_nodes_are_refused() -> None:
    data = discovery.pack_nodes(bytes(16), [NodeEntry("engine", "REX", (bytes(16),), ())])
    endless = data[:20] + b"\xff\xff\xff\x7f" + data[24:]
    for wrong in (b"", b"\7\7\0\0", *(data[:length] for length in range(len(data))), endless):
        with pytest.raises(MessageError, match="cannot read"):
            discovery.unpack_nodes(wrong)
