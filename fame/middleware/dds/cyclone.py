"""The internals of cyclonedds that FAME uses: its own interface lacks them. Verified with cyclonedds 11.0.1.

==================  ==================================================================================================
`policies_at`       its own conversion of the policies that discovery reads has one place for all threads where a value
                    lies until it is read: two participants of a process mix up what they see. It takes longer, too, and
                    never frees the user data
`KeyedWaitSet`      its own `WaitSet` tells how many entities have data, and not which: each would have to be asked
`delete`            it deletes an entity when Python does; a writer that somebody still holds stays visible to others
==================  ==================================================================================================

`benchmarks/cyclone.py` measures the first two. A version that lacks what is used here is refused when this is imported;
of a reader of discovery, when it is made.
"""

from __future__ import annotations

import ctypes
from importlib.metadata import version
from typing import Any

from cyclonedds.builtin import BuiltinDataReader
from cyclonedds.core import DDSException, Entity, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import dds_c_t
from cyclonedds.qos import _CQos
from cyclonedds.util import duration

from fame.clock import SECOND
from fame.errors import UnavailableError
from fame.middleware.interface import QoS

FOREVER: int = duration(infinite=True)
"""Cyclone's number for a time that never ends (ns)."""
_VOLATILE, _RELIABLE, _MANUAL_BY_TOPIC = 0, 1, 2
"""Cyclone's numbers of these kinds."""
_MAX_REPORTED = 64
_USED: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (_CQos, ("_get_reliability", "_get_durability", "_get_liveliness", "_get_deadline", "_get_userdata", "free")),
    (WaitSet, ("_waitset_attach", "_waitset_detach", "_waitset_wait")),
    (Entity, ("__del__",)),
    (dds_c_t, ("reliability", "durability", "liveliness", "duration")),
)


def check_version(used: tuple[tuple[Any, tuple[str, ...]], ...] = _USED) -> None:
    """Raise UnavailableError if cyclonedds lacks something that is used here: names of classes or objects."""
    lacking = [
        f"{getattr(owner, '__name__', type(owner).__name__)}.{name}"
        for owner, names in used
        for name in names
        if not hasattr(owner, name)
    ]
    if lacking:
        text = f"cyclonedds {version('cyclonedds')} has no {', '.join(lacking)}: pip install cyclonedds==11.0.1"
        raise UnavailableError(text)


check_version()


def policies_at(pointer: int) -> tuple[QoS, dict[str, str]]:
    """Return the policies by which an endpoint matches others, and the entries of its user data.
    `pointer` is Cyclone's."""
    get: Any = _CQos
    policies = ctypes.c_void_p(pointer)
    reliability, durability, liveliness = dds_c_t.reliability(), dds_c_t.durability(), dds_c_t.liveliness()
    blocking, deadline, lease = (dds_c_t.duration(FOREVER) for _ in range(3))
    get._get_reliability(policies, ctypes.byref(reliability), ctypes.byref(blocking))
    get._get_durability(policies, ctypes.byref(durability))
    get._get_liveliness(policies, ctypes.byref(liveliness), ctypes.byref(lease))
    get._get_deadline(policies, ctypes.byref(deadline))
    qos = QoS(
        reliability="reliable" if reliability.value == _RELIABLE else "best_effort",
        durability="volatile" if durability.value == _VOLATILE else "transient_local",
        deadline=_seconds(deadline.value),
        liveliness="manual_by_topic" if liveliness.value == _MANUAL_BY_TOPIC else "automatic",
        lease_duration=_seconds(lease.value),
    )
    data, size = ctypes.c_void_p(), ctypes.c_size_t()
    if not get._get_userdata(policies, ctypes.byref(data), ctypes.byref(size)) or not data:
        return qos, {}
    entries = user_data(ctypes.string_at(data, size.value))
    get.free(data)
    return qos, entries


def user_data(data: bytes) -> dict[str, str]:
    """Return the entries of the user data of a participant or endpoint: ``key=value;`` each."""
    return dict(entry.split("=", 1) for entry in data.decode("utf-8", "replace").split(";") if "=" in entry)


def _seconds(time: int) -> float | None:
    return None if time >= FOREVER else time / SECOND


def read_policies(reader: BuiltinDataReader) -> None:
    """Let a reader of discovery give the policies of an endpoint as `policies_at` does. Raises UnavailableError."""
    check_version(((reader, ("_cqos_conv",)),))  # each reader sets its own when it is made
    reader._cqos_conv = policies_at


class KeyedWaitSet:
    """Waits for entities, and tells which of them have something, by the key (>= 0) with which they were attached."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._waitset = WaitSet(participant)
        self._keys: Any = (ctypes.c_void_p * _MAX_REPORTED)()

    def attach(self, entity: Entity, key: int) -> None:
        """Wait for an entity, too. Raises DDSException, of one that is deleted or attached already."""
        _require(self._waitset._waitset_attach(self._waitset._ref, entity._ref, key), "attaching to a wait set")

    def detach(self, entity: Entity) -> None:
        """Wait for an entity no more. Raises DDSException, of one that is deleted or not attached."""
        _require(self._waitset._waitset_detach(self._waitset._ref, entity._ref), "detaching from a wait set")

    def wait(self, timeout: int) -> list[int]:
        """Return the keys of entities that have something, at most 64 at once, or none after `timeout` ns.

        Raises DDSException.
        """
        number = self._waitset._waitset_wait(self._waitset._ref, self._keys, _MAX_REPORTED, timeout)
        _require(number, "waiting for data")
        return [key or 0 for key in self._keys[: min(number, _MAX_REPORTED)]]  # 0 comes as None

    def close(self) -> None:
        """Delete the wait set."""
        delete(self._waitset)


def _require(result: int, action: str) -> None:
    """Raise DDSException for a negative result of a function of Cyclone."""
    if result < 0:
        raise DDSException(result, action)


def delete(entity: Entity) -> None:
    """Delete a DDS entity now."""
    entity.__del__()
