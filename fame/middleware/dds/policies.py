"""Quality of service in the words of Cyclone, and back."""

from __future__ import annotations

import ctypes
from typing import Any

from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.util import duration

from fame.clock import SECOND
from fame.middleware.interface import QoS

_RELIABLE: Any = Policy.Reliability.Reliable
_FOREVER = duration(infinite=True)
_PATIENCE = SECOND // 10
"""How long a write waits for subscribers that do not keep up (ns)."""


def to_dds(qos: QoS, user_data: str, writes: bool) -> Qos:
    """The policies of a writer or reader. `user_data` is what ROS reads of it: ``typehash=RIHS01_...;``."""
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
        if qos.durability == "transient_local":  # else whoever comes late gets one message
            policies.append(Policy.DurabilityService(0, _history(qos), -1, -1, -1))
    return Qos(*policies)


def from_dds(pointer: int) -> tuple[QoS, dict[str, str]]:
    """What decides on whether an endpoint matches others, and the entries of its user data.

    `pointer` is Cyclone's. cyclonedds' own conversion is four times as slow, and never frees the user data.
    """
    get: Any = _CQos
    policies = ctypes.c_void_p(pointer)
    liveliness, deadline = get._get_p_liveliness(policies), get._get_p_deadline(policies)
    qos = QoS(
        reliability="reliable" if isinstance(get._get_p_reliability(policies), _RELIABLE) else "best_effort",
        durability="volatile" if get._get_p_durability(policies) == Policy.Durability.Volatile else "transient_local",
        deadline=_seconds(deadline.deadline) if deadline else None,
        liveliness="manual_by_topic" if isinstance(liveliness, Policy.Liveliness.ManualByTopic) else "automatic",
        lease_duration=_seconds(liveliness.lease_duration) if liveliness else None,
    )
    data, size = ctypes.c_void_p(), ctypes.c_size_t()
    if not get._get_userdata(policies, ctypes.byref(data), ctypes.byref(size)) or not data:
        return qos, {}
    entries = user_data(ctypes.string_at(data, size.value))
    get.free(data)
    return qos, entries


def user_data(data: bytes) -> dict[str, str]:
    """The entries of the user data of a participant or endpoint: ``key=value;`` each."""
    return dict(entry.split("=", 1) for entry in data.decode("utf-8", "replace").split(";") if "=" in entry)


def _history(qos: QoS) -> Any:
    return Policy.History.KeepAll if qos.history == "keep_all" else Policy.History.KeepLast(qos.depth)


def _liveliness(qos: QoS) -> Any:
    manual = qos.liveliness == "manual_by_topic"
    kind = Policy.Liveliness.ManualByTopic if manual else Policy.Liveliness.Automatic
    return kind(_time(qos.lease_duration))


def _time(seconds: float | None) -> int:
    return _FOREVER if seconds is None else round(seconds * SECOND)


def _seconds(time: int) -> float | None:
    return None if time >= _FOREVER else time / SECOND
