"""What every backend refuses, and warns of, in the same words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fame.bpmn.ros_names import NAMES, is_ros_name
from fame.errors import MessageError
from fame.middleware.primitives import describe

_LONGEST = 247
"""Characters of a name, as in ROS 2 (`RMW_TOPIC_MAX_NAME_LENGTH`); Cyclone ends the process at far longer ones."""


def check_name(name: str) -> None:
    """Raise MessageError if ROS 2 refuses a full name."""
    if not is_ros_name(name):
        raise MessageError(f"{name}: ROS 2 refuses this name: {NAMES}")
    if len(name) > _LONGEST:
        raise MessageError(f"{name[:40]}...: ROS 2 refuses a name of {len(name)} characters; it may have {_LONGEST}")


def unpublishable(publisher: Any, message: object, *, closed: bool) -> MessageError:
    """A publisher is closed, or the message is none of its type."""
    if closed:
        return MessageError(f"the publisher on {publisher.topic} is closed", type=publisher.type)
    return MessageError(f"found {describe(message)} to publish on {publisher.topic}", type=publisher.type)


def second_type(topic: str, used: str, users: Iterable[str], type: str) -> MessageError:
    """A topic has another type already, at nodes of these names."""
    names = ", ".join(dict.fromkeys(users))
    return MessageError(f"topic {topic} is in use with {used}, by {names}: it has one type", type=type)


def second_service(name: str, owner: str, type: str) -> MessageError:
    """A node offers a service of that name already."""
    return MessageError(f"the service {name} is offered by {owner} already", type=type)


def unavailable(name: str, request_type: str, offered: Iterable[str]) -> MessageError:
    """A service cannot be asked such a thing; `offered` are the types of service with which it is there."""
    type = request_type.removesuffix("_Request")
    for other in offered:
        if other != type:
            return MessageError(f"the service {name} is of type {other}", type=type)
    return MessageError(f"nobody offers the service {name}: wait until it is available", type=type)


def unanswered(name: str, node: str) -> str:
    """What is said when a service has left its client without an answer."""
    return f"{name}: the service was closed before it answered {node}"


def loss(topic: str, node: str, count: int) -> str:
    """What is said when a subscription of a node has lost messages."""
    return f"{topic}: {node} lost {count} messages or more, which came faster than it takes them or not at all"


def unread(topic: str, node: str, count: int) -> str:
    """What is said when a subscription of a node got more than one message that it could not read."""
    return f"{topic}: {node} could not read {count} more messages"
