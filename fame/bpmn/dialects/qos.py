"""Quality of service as files write it, to the names and values of ROS 2."""

from __future__ import annotations

import re
from collections.abc import Mapping

from fame.bpmn.context import Context
from fame.bpmn.xml import Node

CHOICES: Mapping[str, tuple[str, ...]] = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("best_effort", "reliable"),
    "durability": ("transient_local", "volatile"),
    "liveliness": ("automatic", "manual_by_topic"),
}
"""Policies with named values, in the order of the original FaMe's codes 0 and 1."""
DURATIONS = ("deadline", "lifespan", "lease_duration")
"""In seconds."""


def policy(context: Context, element: Node, name: str, text: str) -> tuple[str, str]:
    """(policy, value): ``("reliability", "best_effort")``, ``("depth", "10")``, ``("deadline", "0.5")``.

    Raises ModelError for a policy or value that there is not.
    """
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip()).lower()
    value = re.sub(r"(?<=[a-z])(?=[A-Z])|[ -]", "_", text.strip()).lower()
    if name in CHOICES:
        choices = CHOICES[name]
        if value in ("0", "1"):
            return name, choices[int(value)]
        if value in choices:
            return name, value
        raise context.error(element, f"qos.{name}={text!r}: expected {' or '.join(choices)}")
    if name == "depth":
        if value.isdecimal() and int(value) > 0:
            return name, value
        raise context.error(element, f"qos.depth={text!r}: expected a whole number, 1 or more")
    if name in DURATIONS:
        if re.fullmatch(r"\d+(\.\d*)?|\.\d+", value):
            return name, value
        raise context.error(element, f"qos.{name}={text!r}: expected a time in seconds")
    known = ", ".join((*CHOICES, "depth", *DURATIONS))
    raise context.error(element, f"qos policy {name!r} is not known: {known} are")
