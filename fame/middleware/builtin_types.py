"""The types that every process needs from its start, known without rosbags and numpy.

To import those and to read the table of all types takes a third of the start of an engine, which needs them only for
the first process that it gets. So the type of texts, in which processes and statuses are sent, and the type that
announces nodes (`fame.middleware.dds.discovery`) are defined here; `std_msgs/msg/String` is packed here, too.
"""

from __future__ import annotations

import struct
from types import MappingProxyType

from fame.errors import MessageError
from fame.middleware.definitions import Definition, Field

STRING = "std_msgs/msg/String"
GID, NODE = "rmw_dds_common/msg/Gid", "rmw_dds_common/msg/NodeEntitiesInfo"
PARTICIPANT = "rmw_dds_common/msg/ParticipantEntitiesInfo"


def _definition(name: str, *fields: Field) -> Definition:
    return Definition(name, fields, MappingProxyType({}), MappingProxyType({}))


DEFINITIONS = {
    content.name: content
    for content in (
        _definition(STRING, Field("data", "data", "string", "single")),
        _definition(GID, Field("data", "data", "uint8", "array", 16)),
        _definition(
            NODE,
            Field("node_namespace", "node_namespace", "string", "single", bound=256),
            Field("node_name", "node_name", "string", "single", bound=256),
            Field("reader_gid_seq", "reader_gid_seq", GID, "sequence"),
            Field("writer_gid_seq", "writer_gid_seq", GID, "sequence"),
        ),
        _definition(
            PARTICIPANT,
            Field("gid", "gid", GID, "single"),
            Field("node_entities_info_seq", "node_entities_info_seq", NODE, "sequence"),
        ),
    )
}
HASHES = {
    STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    PARTICIPANT: "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
}
"""As `fame.middleware.codec.type_hash` would compute them."""

LITTLE = b"\0\1\0\0"
"""The encapsulation header of little-endian CDR."""
ORDERS = {b"\0\0": ">", b"\0\1": "<"}
"""First bytes of CDR -> byte order, for `struct`."""
_LENGTH = struct.Struct("<I")


def pack_text(text: str) -> bytes:
    """`std_msgs/msg/String` as CDR."""
    data = text.encode()
    return b"".join((LITTLE, _LENGTH.pack(len(data) + 1), data, b"\0"))


def unpack_text(data: bytes | memoryview) -> str:
    """The text of a `std_msgs/msg/String`. Raises MessageError if the data do not hold one."""
    data = bytes(data)
    order = ORDERS.get(data[:2])
    if order is not None and len(data) >= 8:
        (length,) = struct.unpack_from(f"{order}I", data, 4)
        end = 7 + length
        if length and data[end : end + 1] == b"\0" and len(data) <= end + 4:  # padded to a multiple of 4
            try:
                return data[8:end].decode()
            except UnicodeDecodeError as error:
                raise MessageError(f"cannot read {len(data)} bytes of CDR: {error}", type=STRING) from None
    raise MessageError(f"cannot read {len(data)} bytes of CDR: they hold no text", type=STRING)
