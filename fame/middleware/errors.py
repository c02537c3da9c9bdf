"""Errors and warnings of all backends."""

from __future__ import annotations

from collections.abc import Iterable

from fame.errors import MessageError
from fame.middleware.interface import EndpointWarning
from fame.middleware.primitives import describe
from fame.text import NAMES, is_ros_name

_MAX_LENGTH = 247
"""Characters of a name, as in ROS 2 (`RMW_TOPIC_MAX_NAME_LENGTH`); Cyclone ends the process at far longer ones."""

FOREIGN = (
    "which is on another DDS than Cyclone. No two understand each other's services and actions: "
    "start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or FAME with --middleware ros"
)
"""Why a service or action cannot be called, after the name of the node."""


def check_name(name: str) -> None:
    """Raise MessageError if ROS 2 refuses a full name."""
    if not is_ros_name(name):
        raise MessageError(f"{name}: ROS 2 refuses this name: {NAMES}")
    if len(name) > _MAX_LENGTH:
        raise MessageError(f"{name[:40]}...: ROS 2 refuses a name of {len(name)} characters; it may have {_MAX_LENGTH}")


def publish_error(topic: str, type: str, message: object, *, closed: bool) -> MessageError:
    """Return the error of a publisher that is closed, or of a message that is not of its type."""
    if closed:
        return MessageError(f"the publisher on {topic} is closed", type=type)
    return MessageError(f"{topic}: expected a message, got {describe(message)}", type=type)


def type_conflict(topic: str, used: str, users: Iterable[str], type: str) -> MessageError:
    """Return the error of a topic that has another type already, at nodes of these names."""
    names = ", ".join(dict.fromkeys(users))
    return MessageError(f"topic {topic} is in use with {used}, by {names}: it has one type", type=type)


def service_conflict(name: str, owner: str, type: str) -> MessageError:
    """Return the error of a service whose name another node offers already."""
    return MessageError(f"the service {name} is offered by {owner} already", type=type)


def unavailable_error(name: str, request_type: str, offered: Iterable[str]) -> MessageError:
    """Return the error of a service that no node offers with this type; `offered` are the types
    with which it is offered."""
    type = request_type.removesuffix("_Request")
    for other in offered:
        if other != type:
            return MessageError(f"the service {name} is of type {other}", type=type)
        return MessageError(f"the service {name} cannot be reached: its quality of service differs", type=type)
    return MessageError(f"no node offers the service {name}: wait until it is available", type=type)


def unfit_text(name: str, request_type: str, offered: Iterable[str]) -> str:
    """Return why a client is not connected to a service that is offered with these types; empty without one."""
    found = list(offered)
    return str(unavailable_error(name, request_type, found)) if found else ""


def mismatch_warning(topic: str, subscriber: str, publisher: str, reason: str) -> EndpointWarning:
    """Return the warning that two endpoints are not connected."""
    return EndpointWarning(topic, f"{subscriber} receives nothing from {publisher}: {reason}", "mismatch")


def unanswered_warning(name: str, node: str) -> EndpointWarning:
    """Return the warning that a service was closed while a client waited for its response."""
    return EndpointWarning(name, f"the service was closed before it answered {node}", "unanswered")


def unheard_warning(name: str, node: str) -> EndpointWarning:
    """Return the warning that a client was closed before it could tell its server something."""
    text = f"{node} closed while the server was away: what was to be cancelled may still run"
    return EndpointWarning(name, text, "unanswered")


def dropped_warning(topic: str, reason: str) -> EndpointWarning:
    """Return the warning that a message could not be read."""
    return EndpointWarning(topic, f"dropped a message: {reason}", "dropped")


def lost_text(topic: str, node: str, count: int, more: bool = False) -> str:
    """Return the text that a subscription of a node has lost messages; `more`: perhaps others,
    which nobody could count."""
    number = f"at least {count}" if more else f"{count}"
    return f"{topic}: {node} lost {number} messages, which came faster than it takes them or not at all"


def unreadable_text(topic: str, node: str, count: int) -> str:
    """Return the text that a subscription of a node has got more than one message that it could not read."""
    return f"{topic}: {node} could not read {count} more messages"
