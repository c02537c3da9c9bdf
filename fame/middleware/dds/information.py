"""What a participant tells the domain of its nodes, as CDR: ``rmw_dds_common/msg/ParticipantEntitiesInfo``.

By hand, not by the codec: everybody says it anew whenever a node changes and hears it of everybody, and it is all that
an engine without a process would need the codec for.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from fame.errors import MessageError
from fame.middleware.builtin_types import LITTLE, ORDERS, PARTICIPANT
from fame.middleware.interface import resolve

_GID = 16  # bytes


@dataclass(frozen=True, slots=True)
class NodeEntry:
    """A node as its participant announces it. `namespace` has no slashes around it."""

    name: str
    namespace: str
    readers: tuple[bytes, ...]
    writers: tuple[bytes, ...]

    @property
    def full_name(self) -> str:
        return resolve(self.name, self.namespace)

    @property
    def gids(self) -> frozenset[bytes]:
        """Those of its endpoints."""
        return frozenset((*self.readers, *self.writers))


def pack(participant: bytes, nodes: Iterable[NodeEntry]) -> bytes:
    """The gid of a participant and its nodes, as CDR."""
    parts = [_node(node) for node in nodes]
    return b"".join((LITTLE, participant, struct.pack("<I", len(parts)), *parts))


def unpack(data: bytes) -> tuple[bytes, tuple[NodeEntry, ...]]:
    """The inverse of `pack`. Raises MessageError for what another than a ROS node wrote."""
    try:
        return _unpack(data)
    except (KeyError, ValueError, struct.error) as error:
        raise MessageError(f"cannot read {len(data)} bytes of CDR: {error}", type=PARTICIPANT) from None


def _node(node: NodeEntry) -> bytes:
    """A node, padded to a multiple of 4 bytes, so that all begin where numbers may."""
    names = _text(f"/{node.namespace}") + _text(node.name)
    ends = (part for gids in (node.readers, node.writers) for part in (struct.pack("<I", len(gids)), *gids))
    return b"".join((names, *ends))


def _text(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def _unpack(data: bytes) -> tuple[bytes, tuple[NodeEntry, ...]]:
    unsigned = struct.Struct(f"{ORDERS[data[:2]]}I")
    at = len(LITTLE)

    def take(length: int) -> bytes:
        nonlocal at
        at += length
        if at > len(data):
            raise ValueError("it ends too early")
        return data[at - length : at]

    def number() -> int:
        take(-at % 4)
        value: int = unsigned.unpack(take(4))[0]
        return value

    def text() -> str:
        return take(number())[:-1].decode()

    def gids() -> tuple[bytes, ...]:
        return tuple([take(_GID) for _ in range(number())])

    participant = take(_GID)
    nodes = []
    for _ in range(number()):
        namespace, name = text().strip("/"), text()
        nodes.append(NodeEntry(name, namespace, gids(), gids()))
    return participant, tuple(nodes)
