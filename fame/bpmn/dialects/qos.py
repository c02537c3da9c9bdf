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


def policy(context: Context, element: Node, name: str, text: str) -> tuple[str, str] | None:
    """(policy, value): ``("reliability", "best_effort")``, ``("depth", "10")``, ``("deadline", "0.5")``.

    None for a policy or value that there is not, a fault.
    """
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip()).lower()
    value = re.sub(r"(?<=[a-z])(?=[A-Z])|[ -]", "_", text.strip()).lower()
    choices = CHOICES.get(name, ())
    if choices and value in ("0", "1"):
        return name, choices[int(value)]
    if choices:
        fits, right = value in choices, " or ".join(choices)
    elif name == "depth":
        fits, right = value.isdecimal() and int(value) > 0, "a whole number, 1 or more"
    elif name in DURATIONS:
        fits, right = re.fullmatch(r"\d+(\.\d*)?|\.\d+", value) is not None, "a time in seconds"
    else:
        context.fault(element, f"qos policy {name!r} is not known: {', '.join((*CHOICES, 'depth', *DURATIONS))} are")
        return None
    if not fits:
        context.fault(element, f"qos.{name}={text!r}: expected {right}")
    return (name, value) if fits else None
