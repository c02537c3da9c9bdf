"""Types, messages and quality of service in the words of rclpy, and back.

Messages cross as CDR: topics hand over the bytes as they are, services go through rclpy's own (de)serialization. So
there is one way to write a field, that of `fame.middleware.codec`.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from rclpy.duration import Duration, Infinite
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from fame.clock import SECOND
from fame.errors import MissingTypeError
from fame.middleware import codec
from fame.middleware.interface import UNKNOWN_NODE, Message, QoS, resolve

_OF_ACTIONS = {"SendGoal": "SendGoalService", "GetResult": "GetResultService", "FeedbackMessage": "FeedbackMessage"}
"""Where the class of an action (``NavigateToPose``) has the types that its topics and services carry."""


@cache
def ros_class(name: str) -> Any:
    """rclpy's class of a message or service type. Raises MissingTypeError if the sourced ROS does not have it.

    ``pkg/action/Name_SendGoal`` and the like are parts of an action, as `fame.middleware.actions` names them.
    """
    package, kind, short = name.split("/")
    action, _, part = short.rpartition("_")
    try:
        module = import_module(f"{package}.{kind}")
        if kind == "action":
            return getattr(getattr(module, action).Impl, _OF_ACTIONS[part])
        return getattr(module, short)
    except (ImportError, AttributeError):
        text = f"this ROS does not have it: install or build its package ({package}), and source it"
        raise MissingTypeError(text, type=name) from None


def to_ros(message: Message, kind: Any) -> Any:
    """A message as one of rclpy's class `kind`."""
    return deserialize_message(codec.serialize(message), kind)


def from_ros(message: Any, type: str) -> Message:
    """A message of rclpy as one of ours."""
    return codec.deserialize(serialize_message(message), type)


def profile(qos: QoS) -> QoSProfile:
    """The QoS profile of an endpoint."""
    return QoSProfile(
        history=HistoryPolicy[qos.history.upper()],
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
        liveliness_lease_duration=_duration(qos.lease_duration),
    )


def from_profile(found: QoSProfile) -> QoS:
    """The policies by which an endpoint matches others."""
    return QoS(
        reliability="best_effort" if found.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if found.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        deadline=_seconds(found.deadline),
        liveliness="manual_by_topic" if found.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC else "automatic",
        lease_duration=_seconds(found.liveliness_lease_duration),
    )


def owner(end: Any) -> str:
    """The full name of the node of an endpoint of the graph (rclpy's TopicEndpointInfo)."""
    if end.node_name == UNKNOWN_NODE.strip("/"):
        return UNKNOWN_NODE  # its namespace is of the same kind
    return resolve(end.node_name, end.node_namespace.strip("/"))


def _duration(seconds: float | None) -> Duration:
    return Infinite if seconds is None else Duration(nanoseconds=round(seconds * SECOND))


def _seconds(time: Duration) -> float | None:
    """None if there is no bound; ROS says that as infinite, and as 0 too."""
    return time.nanoseconds / SECOND if 0 < time.nanoseconds < Infinite.nanoseconds else None
