"""The wire format of rmw_zenoh: key expressions of topics, liveliness tokens, attachments of samples.

A message on ``/REX/odom`` of domain 0 has the key ``0/REX/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_...``. Each node
and each endpoint has a liveliness token, which is there as long as its session lives::

    @ros2_lv/<domain>/<session>/<node id>/<id>/<kind>/<enclave>/<namespace>/<node>[/<topic>/<type>/<hash>/<QoS>]

with ``%`` for each slash in a name. The gid of an endpoint is the XXH3 hash (128 bits) of its token. Each message,
request and response carries an attachment: its number, when it was sent, and the gid of the endpoint that sent it; a
response has the number and gid of its request. (ros2/rmw_zenoh, docs/design.md and liveliness_utils.cpp, Jazzy to
Rolling, which are alike in this.)
"""

from __future__ import annotations

import struct
import time
from functools import lru_cache
from typing import Literal, NamedTuple, cast, get_args

import xxhash

from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.errors import MessageError
from fame.middleware.interface import SIGNAL, QoS, resolve
from fame.middleware.typesystem import dds_type, ros_type

EntityKind = Literal["NN", "MP", "MS", "SS", "SC"]
NODE, PUBLISHER, SUBSCRIPTION, SERVICE, CLIENT = KINDS = get_args(EntityKind)
ROOT = "@ros2_lv"
"""First part of each token."""

_GID = 16  # bytes
_ATTACHMENT = struct.Struct(f"<qqB{_GID}s")
_INFINITE = 9223372036
"""Seconds from which on a time is infinite (RMW_DURATION_INFINITE)."""
_DEPTH = 42
"""The depth that a token leaves out."""
_MAX_TOKEN = 2000
"""Characters of the longest token that is read: two names of 255 characters, a type, a hash."""


class Attachment(NamedTuple):
    """The attachment of a message: its number (from 1 on), time of sending (ns since 1970), and endpoint."""

    number: int
    time: int
    gid: bytes

    def pack(self) -> bytes:
        return _ATTACHMENT.pack(self.number, self.time, _GID, self.gid)


def attachment(number: int, gid: bytes) -> bytes:
    """Return the attachment of a message that is sent now."""
    return _ATTACHMENT.pack(number, time.time_ns(), _GID, gid)


ACKNOWLEDGED = 2**62
"""Where the numbers of a publisher whose `QoS` is acknowledged begin."""


def read_attachment(data: bytes) -> Attachment:
    """Return the attachment that `data` hold. Raises MessageError if ROS does not write such data."""
    if len(data) != _ATTACHMENT.size or data[16] != _GID:
        raise MessageError(f"expected an attachment of {_ATTACHMENT.size} bytes as ROS has it, got {len(data)} bytes")
    number, sent, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(number, sent, gid)


@dataclass(frozen=True, slots=True)
class Entity:
    """A node or an endpoint. `node` is the full name of its node; `name` and `type` are ROS's; a node has none."""

    token: str
    session: str
    node_id: str
    kind: EntityKind
    namespace: str
    node: str
    gid: bytes
    name: str = ""
    type: str = ""
    type_hash: str = ""
    qos: QoS = SIGNAL

    @property
    def owner(self) -> tuple[str, str]:
        """The identity shared by the endpoints of one node."""
        return self.session, self.node_id


def topic_key(domain: int, name: str, type: str, type_hash: str) -> str:
    """Return the key expression of the messages on a topic, or of the requests to a service (full name).

    >>> topic_key(0, "/chatter", "std_msgs/msg/String", "RIHS01_df66")
    '0/chatter/std_msgs::msg::dds_::String_/RIHS01_df66'
    """
    return f"{domain}/{name[1:]}/{dds_type(type)}/{type_hash}"


def node_token(domain: int, session: str, node_id: int, namespace: str, name: str) -> str:
    """Return the token of a node.

    >>> node_token(0, "af1", 0, "REX", "engine")
    '@ros2_lv/0/af1/0/0/NN/%/%REX/engine'
    """
    return f"{ROOT}/{domain}/{session}/{node_id}/{node_id}/{NODE}/%/%{namespace.replace('/', '%')}/{name}"


def pattern(domain: int, kind: str = "*", name: str = "") -> str:
    """Return the key expression of the tokens of a kind; with `name`, of the endpoints of such topics and services.

    A ``*`` stands for any kind and, in a name, for any characters.

    >>> pattern(0, NODE), pattern(0, PUBLISHER, "/*/bpmn_status")
    ('@ros2_lv/0/*/*/*/NN/**', '@ros2_lv/0/*/*/*/MP/*/*/*/%$*%bpmn_status/**')
    """
    place = f"*/*/*/{name.replace('/', '%').replace('*', '$*')}/" if name else ""
    return f"{ROOT}/{domain}/*/*/*/{kind}/{place}**"


def endpoint_token(node: str, kind: EntityKind, id: int, name: str, type: str, type_hash: str, qos: QoS) -> str:
    parts = node.split("/")
    parts[4:6] = str(id), kind
    return "/".join((*parts, name.replace("/", "%"), dds_type(type), type_hash, qos_text(qos)))


def read_token(token: str) -> Entity | None:
    """Return the node or endpoint of a token; None for a token that is not one of ROS."""
    parts = token.split("/")
    if len(parts) < 9 or len(token) > _MAX_TOKEN or parts[0] != ROOT or parts[5] not in KINDS:
        return None
    _, _, session, node_id, _, _, _, namespace, name = parts[:9]
    kind = cast(EntityKind, parts[5])
    namespace = namespace.replace("%", "/").strip("/")
    node = resolve(name.replace("%", "/").strip("/"), namespace)
    gid = gid_of(token)
    if kind == NODE:
        return Entity(token, session, node_id, NODE, namespace, node, gid)
    if len(parts) < 13:
        return None
    try:
        qos = read_qos(parts[12])
    except ValueError:
        return None
    topic, type = parts[9].replace("%", "/"), ros_type(parts[10])
    return Entity(token, session, node_id, kind, namespace, node, gid, topic, type, parts[11], qos)


def entity(token: str) -> Entity:
    """Return the node or endpoint of a token that was made here."""
    found = read_token(token)
    assert found is not None, token
    return found


def gid_of(token: str) -> bytes:
    """Return the gid of an endpoint: both halves of the hash begin with their lowest byte."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


# ---- quality of service ----------------------------------------------------------------------------------------------


def qos_text(qos: QoS) -> str:
    """Return the quality of service in a token: ROS's numbers of the policies, where they differ from its defaults.

    >>> qos_text(QoS(depth=7)), qos_text(QoS(reliability="best_effort", depth=5, deadline=0.5))
    ('::,7:,:,:,,', '2::,5:0,500000000:,:,,')
    """
    reliability = "2" if qos.reliability == "best_effort" else ""
    durability = "1" if qos.durability == "transient_local" else ""
    history = "2" if qos.history == "keep_all" else ""
    liveliness = "3" if qos.liveliness == "manual_by_topic" else ""
    deadline, lifespan, lease = map(_time_text, (qos.deadline, qos.lifespan, qos.lease_duration))
    return f"{reliability}:{durability}:{history},{qos.depth}:{deadline}:{lifespan}:{liveliness},{lease}"


@lru_cache(maxsize=1000)
def read_qos(text: str) -> QoS:
    """Return the inverse of `qos_text`. Raises ValueError."""
    reliability, durability, history, deadline, lifespan, liveliness = text.split(":")[:6]
    kind, _, depth = history.partition(",")
    alive, _, lease = liveliness.partition(",")
    return QoS(
        reliability="best_effort" if reliability == "2" else "reliable",
        durability="transient_local" if durability == "1" else "volatile",
        history="keep_all" if kind == "2" else "keep_last",
        depth=int(depth or _DEPTH),
        deadline=_seconds(deadline),
        lifespan=_seconds(lifespan),
        liveliness="manual_by_topic" if alive == "3" else "automatic",
        lease_duration=_seconds(lease),
    )


def _time_text(seconds: float | None) -> str:
    return "," if seconds is None else ",".join(map(str, divmod(round(seconds * SECOND), SECOND)))


def _seconds(text: str) -> float | None:
    """None if there is no bound; ROS says that as infinite, and as 0 too."""
    whole, _, rest = text.partition(",")
    time = int(whole or _INFINITE) + int(rest or 0) / SECOND
    return time if 0 < time < _INFINITE else None
