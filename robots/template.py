"""Makes messages that are mostly alike: what does not change from one measurement to the next is shared.

Many times cheaper than to fill each message from a mapping, and it is the most frequent thing that a world does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

from fame.clock import SECOND
from fame.middleware import messages
from fame.middleware.interface import Message


def constructor(type: str) -> Callable[..., Message]:
    """The class of a message type: it takes fields in the order of ROS, and neither converts nor checks."""
    kind: Any = messages.message_type(type)
    return kind  # type: ignore[no-any-return]


def maker(template: Message, *fields: str) -> Callable[..., Message]:
    """The constructor of messages like `template` but for these `fields`, which it takes by name."""
    kept = {name: getattr(template, name) for name in template.__slots__ if name not in fields}
    return partial(template.__class__, **kept)


@cache
def header_maker(frame: str) -> Callable[[int], Message]:
    """A function of a time (ns) that gives a std_msgs/msg/Header with this stamp and frame."""
    header, time = constructor("std_msgs/msg/Header"), constructor("builtin_interfaces/msg/Time")
    return lambda now: header(time(now // SECOND, now % SECOND), frame)
