"""The mapping to Cyclone DDS: names and types as ROS 2 mangles them, quality of service, writers and readers.

Cyclone transports CDR, which `fame.middleware.codec` packs and unpacks. To check received data it also needs the fields
of a type, so each type is declared with its true fields (keyless, final).

Topics are made once and stay until the participant is deleted. A topic without endpoints is invisible to others, but
each one that is made costs memory that cyclonedds does not give back, and Cyclone 11.0.1 crashes now and then when a
type is declared after others of this process were deleted: its tree of type dependencies has entries that were freed
(`gv->typedeps`; eclipse-cyclonedds/cyclonedds, issue 2426). Types that other processes delete do no harm. So a
participant that closes while others of this process stay in the domain hands its types over to them.
"""

from __future__ import annotations

import time
from functools import cache
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import codec, typesystem
from fame.middleware.dds.cyclone import FOREVER
from fame.middleware.definitions import EMPTY_FIELD, Field
from fame.middleware.errors import check_name
from fame.middleware.interface import QoS
from fame.middleware.typesystem import dds_type

# ---- names and types -------------------------------------------------------------------------------------------------

idl: Any = types  # for mypy: its types are made by indexing instances
TOPIC, REQUEST, REPLY = "rt", "rq", "rr"
"""Prefixes of DDS topics: of a ROS topic, of the requests to a service, of its responses."""

HEADER = 4
"""Length of the encapsulation header of CDR (bytes)."""

_LARGEST_BOUND = 65535


def dds_topic(name: str, kind: str = TOPIC, ending: str = "") -> str:
    """Return the DDS topic of a full name. Raises MessageError for a name that ROS 2 and DDS refuse.

    >>> dds_topic("/REX/odom"), dds_topic("/grip", REQUEST, "Request")
    ('rt/REX/odom', 'rq/gripRequest')
    """
    check_name(name)
    return f"{kind}{name}{ending}"


def service_of(topic: str) -> str:
    """Return the service (full name) whose requests go to a DDS topic; empty for another topic.

    >>> service_of("rq/gripRequest"), service_of("rt/odom")
    ('/grip', '')
    """
    name = topic.removeprefix(REQUEST)
    return name.removesuffix("Request") if name != topic and name.endswith("Request") else ""


def type_hash(name: str) -> str:
    """Return the entry of the USER_DATA of an endpoint by which ROS 2 compares the types of two endpoints."""
    return f"typehash={codec.type_hash(name)};"


def handle(value: int) -> int:
    """Return the instance handle of an entity. cyclonedds gives it signed in some places and unsigned in others."""
    return value & 0xFFFF_FFFF_FFFF_FFFF


@cache
def declared(name: str, header: bool) -> Any:
    """Return the class that declares a type to Cyclone: ``declared(...)(data)`` holds CDR, which
    is its attribute `data`.

    `header` puts the two numbers of a service's request or response before the fields.
    """
    content = typesystem.definition(name)
    fields: dict[str, Any] = {"guid": idl.uint64, "sequence_number": idl.int64} if header else {}
    fields |= {field.name: _member(field) for field in content.fields}
    cls = make_idl_struct(
        content.name.rpartition("/")[2],
        dds_type(content.name),
        fields or {EMPTY_FIELD: idl.uint8},
        dataclassify=False,
    )
    # Not by inheritance, which would become part of the type.
    for method, function in _CDR_METHODS.items():
        setattr(cls, method, function)
    return cls


def _set_data(self: Any, data: bytes) -> None:
    self.data = data


def _get_data(self: Any, *args: Any, **options: Any) -> bytes:
    return self.data  # type: ignore[no-any-return]


def _from_data(cls: Any, data: bytes, *args: Any, **options: Any) -> Any:
    return cls(data)


_CDR_METHODS = {
    "__init__": _set_data,
    "serialize": _get_data,
    "deserialize": classmethod(_from_data),
    "deserialize_key": classmethod(_from_data),
}


def _member(field: Field) -> Any:
    single = declared(field.base, False) if field.is_message else _primitive(field)
    if field.shape == "single":
        return single
    if field.shape == "array":
        return idl.array[single, field.size]
    bounded = 0 < field.size <= _LARGEST_BOUND
    return idl.sequence[single, field.size] if bounded else idl.sequence[single]


def _primitive(field: Field) -> Any:
    if field.base == "string":
        return idl.bounded_str[field.bound] if field.bound else str
    return bool if field.base == "bool" else getattr(idl, field.base)


# ---- writers and readers ---------------------------------------------------------------------------------------------

_PATIENCE = SECOND // 10
"""Time that a write waits for subscriptions that do not keep up (ns)."""
NUMBERED = "numbered=2;"
"""The entry of the USER_DATA of a publisher that writes each message at its `numbered_time`; 1: without `to_all`."""
ACKNOWLEDGED = "acknowledged=1;"
"""The entry of the USER_DATA of a publisher whose `QoS` is acknowledged."""
_NUMBERS = 2**20
_KEPT = "kept"
"""Topics with this prefix exist for their types alone."""
_of_process: dict[int, list[Entities]] = {}
"""Domain -> the entities of each participant of this process."""


class Entities:
    """Makes the writers and readers of a participant, until `close`."""

    def __init__(self, participant: DomainParticipant, domain: int) -> None:
        self.participant = participant
        self._topics: dict[tuple[str, str, bool], Topic[Any]] = {}
        self._others = _of_process.setdefault(domain, [])
        self._others.append(self)

    @property
    def types(self) -> set[str]:
        """The types that Cyclone keeps as long as the participant exists."""
        return {type for _, type, _ in self._topics}

    def close(self) -> None:
        """Hand the types over to another participant of the process, if there is one, before this one is deleted."""
        self._others.remove(self)
        if self._others:
            for _, type, header in self._topics:
                self._others[0].topic(f"{_KEPT}/{type}/{header}", type, header)

    def writer(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataWriter[Any]:
        """Return a writer on a DDS topic (``rt/odom``) of a ROS type. Raises MessageError if Cyclone refuses it.

        `header` is for the topics of services, see `declared`.
        """
        try:
            shared = self.topic(topic, type, header)
            return DataWriter(self.participant, shared, to_dds(qos, user_data, True))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def reader(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataReader[Any]:
        """Return a reader on a DDS topic. Raises as `writer`."""
        try:
            shared = self.topic(topic, type, header)
            return DataReader(self.participant, shared, to_dds(qos, user_data, False))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def topic(self, name: str, type: str, header: bool) -> Topic[Any]:
        key = name, type, header
        if key not in self._topics:
            self._topics[key] = Topic(self.participant, name, declared(type, header))
        return self._topics[key]


def matched(end: DataWriter[Any] | DataReader[Any]) -> list[int]:
    """Return the instance handles of all endpoints that one is connected to now.

    cyclonedds asks for their number, and then for that many: if one is added in between, it reads beyond its array.
    """
    find = end.get_matched_subscriptions if isinstance(end, DataWriter) else end.get_matched_publications
    while True:
        try:
            return find()
        except IndexError:
            continue


def numbered_time(number: int, to_all: bool) -> int:
    """Return the source time (ns) of a message, whose last 20 bits (1 ms) number the messages of a publisher.

    DDS numbers them too, but Cyclone does not tell the numbers, nor that messages are missing. The bit before them is
    set if all before this one went `to_all` subscriptions that this one goes to: none has been matched since the first.
    """
    return time.time_ns() & -2 * _NUMBERS | to_all * _NUMBERS | number % _NUMBERS


def sent_before(time: int) -> tuple[int, bool]:
    """Return how many messages a publisher that is `NUMBERED` sent before one of this source time, and `to_all`."""
    return time % _NUMBERS, bool(time & _NUMBERS)


def missing(last: int, now: int) -> int:
    """Return how many messages are missing between two source times of a publisher that is `NUMBERED`."""
    return (now - last - 1) % _NUMBERS


def _refused(topic: str, type: str, error: DDSException) -> MessageError:
    return MessageError(f"Cyclone DDS refuses an endpoint on {topic}: {error}", type=type)


# ---- quality of service ----------------------------------------------------------------------------------------------


def to_dds(qos: QoS, user_data: str, writes: bool) -> Qos:
    """Return the policies of a writer or reader. `user_data` is what ROS reads of it: ``typehash=RIHS01_...;``."""
    policies = [
        Policy.Reliability.Reliable(_PATIENCE) if qos.reliability == "reliable" else Policy.Reliability.BestEffort,
        _history(qos),
        Policy.Deadline(_time(qos.deadline)),
        _liveliness(qos),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    ]
    if qos.durability == "transient_local":
        policies.append(Policy.Durability.TransientLocal)
    if writes:
        policies += [Policy.Lifespan(_time(qos.lifespan)), Policy.WriterDataLifecycle(autodispose=False)]
        if qos.durability == "transient_local":  # else a late subscriber gets one message
            policies.append(Policy.DurabilityService(0, _history(qos), -1, -1, -1))
    return Qos(*policies)


def _history(qos: QoS) -> Any:
    return Policy.History.KeepAll if qos.history == "keep_all" else Policy.History.KeepLast(qos.depth)


def _liveliness(qos: QoS) -> Any:
    manual = qos.liveliness == "manual_by_topic"
    kind = Policy.Liveliness.ManualByTopic if manual else Policy.Liveliness.Automatic
    return kind(_time(qos.lease_duration))


def _time(seconds: float | None) -> int:
    return FOREVER if seconds is None else round(seconds * SECOND)
