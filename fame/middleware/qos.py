"""Quality of service: reading policies from a model, and whether two endpoints of a topic match."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from fame.errors import MessageError
from fame.middleware.interface import SIGNAL, QoS

_CHOICES: dict[str, tuple[str, str]] = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("best_effort", "reliable"),
    "durability": ("transient_local", "volatile"),
    "liveliness": ("automatic", "manual_by_topic"),
}
"""The values of each policy. Their position is their code in models of the original FaMe's web modeler."""

_DEEPEST = 2**31 - 1

_TIMES = ("deadline", "lifespan", "lease_duration")
_SPELLINGS = {"leaseduration": "lease_duration"}


def parse(policies: Mapping[str, Any], base: QoS = SIGNAL) -> QoS:
    """Return the policies of `base`, with those that a model names: ``{"reliability": "best_effort", "depth": "5"}``.

    Names may begin with ``qos.``; values are text or numbers. A choice is a name (in any case) or its code, a depth an
    integer from 1 on, a time in s (0 or ``infinite``: no bound). Raises MessageError that says what is accepted.
    """
    return replace(base, **dict(_policy(name, value) for name, value in policies.items()))


def compatible(offered: QoS, requested: QoS) -> str | None:
    """Return why a publisher that offers the one and a subscription that requests the other do not
    match; None if they do.

    The rule is "requested versus offered" of DDS 1.4, section 2.2.3. History, depth and lifespan play no part in it.
    """
    if requested.reliability == "reliable" and offered.reliability == "best_effort":
        return "reliability: offered best_effort, requested reliable"
    if requested.durability == "transient_local" and offered.durability == "volatile":
        return "durability: offered volatile, requested transient_local"
    if requested.liveliness == "manual_by_topic" and offered.liveliness == "automatic":
        return "liveliness: offered automatic, requested manual_by_topic"
    for name in ("deadline", "lease_duration"):
        promise, demand = getattr(offered, name), getattr(requested, name)
        if demand is not None and (promise is None or promise > demand):
            return f"{name}: offered {_seconds(promise)}, requested {_seconds(demand)}"
    return None


def requested_of(offered: Sequence[QoS]) -> QoS:
    """Return the QoS of a subscription that matches all publishers and gets all that each of them can give."""
    reliable = all(one.reliability == "reliable" for one in offered)
    latched = bool(offered) and all(one.durability == "transient_local" for one in offered)
    return QoS("reliable" if reliable else "best_effort", "transient_local" if latched else "volatile")


class Discovered(Protocol):
    """A discovered endpoint of any process: its type in ROS, the hash of the type (or ""), and its policies."""

    @property
    def type(self) -> str: ...
    @property
    def type_hash(self) -> str: ...
    @property
    def qos(self) -> QoS: ...


def mismatch(writer: Discovered, reader: Discovered) -> str | None:
    """Return why a reader and a writer do not match; None if they do."""
    if writer.type != reader.type:
        return f"type: offered {writer.type}, requested {reader.type}"
    if writer.type_hash and reader.type_hash and writer.type_hash != reader.type_hash:
        return f"type: they have different definitions of {writer.type}"
    return compatible(writer.qos, reader.qos)


def one_deeper(qos: QoS) -> QoS:
    """Return the policies with a queue of one message more, so that an overflow can be noticed."""
    return replace(qos, depth=min(qos.depth + 1, _DEEPEST))


def counts_losses(requested: QoS) -> bool:
    """Return whether a subscription requests every message, so that a missing one is a loss."""
    return requested.reliability == "reliable" and requested.depth > 1


def _policy(name: str, value: Any) -> tuple[str, Any]:
    policy = name.strip().lower().removeprefix("qos.").replace("-", "_")
    policy = _SPELLINGS.get(policy, policy)
    text = str(value).strip().lower()
    if policy in _CHOICES:
        return policy, _choice(policy, text)
    if policy == "depth":
        return policy, _depth(text)
    if policy in _TIMES:
        return policy, _time(policy, text)
    known = ", ".join((*_CHOICES, "depth", *_TIMES))
    raise MessageError(f"there is no such policy; the policies are {known}", field=f"qos.{policy}")


def _choice(policy: str, text: str) -> str:
    choices = _CHOICES[policy]
    name = text.replace("-", "_").replace(" ", "_")
    if name in choices:
        return name
    if text in ("0", "1"):
        return choices[int(text)]
    raise _refused(policy, text, f"{choices[0]} (0) or {choices[1]} (1)")


def _depth(text: str) -> int:
    if text.isascii() and text.isdigit() and len(text) <= 10 and 1 <= int(text) <= _DEEPEST:
        return int(text)
    raise _refused("depth", text, "a number of messages, from 1 on")


def _time(policy: str, text: str) -> float | None:
    if text == "infinite":
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not seconds >= 0:
        raise _refused(policy, text, "a time in seconds, or infinite")
    return None if seconds in (0, math.inf) else seconds


def _seconds(time: float | None) -> str:
    return "infinite" if time is None else f"{time:g} s"


def _refused(policy: str, text: str, accepted: str) -> MessageError:
    return MessageError(f"expected {accepted}, got {text!r}", field=f"qos.{policy}")
