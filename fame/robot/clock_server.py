"""Tells others the engine's time: questions and answers on ``/<robot>/bpmn_clock``, as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime

from fame.clock import date_text
from fame.fast_json import json_bytes
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node
from fame.text import read_json
from fame.version import PROTOCOL, current as fame_version

STRING, CLOCK_TOPIC = "std_msgs/msg/String", "bpmn_clock"


class ClockServer:
    """Answers questions on ``/<robot>/bpmn_clock``: the time `now` (ns) since the date `epoch`, FAME's version, and
    what `more` gives."""

    def __init__(
        self,
        node: Node,
        now: Callable[[], int],
        epoch: datetime,
        more: Callable[[], Mapping[str, str | int]] = lambda: {},
    ) -> None:
        self._now, self._epoch, self._more = now, date_text(epoch), more
        self._publisher = node.publisher(CLOCK_TOPIC, STRING)
        node.subscription(CLOCK_TOPIC, STRING, self._on_question)

    def _on_question(self, message: AnyMessage) -> None:
        with suppress(ValueError, TypeError, AttributeError):  # from a stranger
            question = read_json(message.data, 1000).get("ask")
            if isinstance(question, str):
                answer = {"answer": question, "time": self._now(), "epoch": self._epoch, "fame": fame_version()}
                answer["protocol"] = PROTOCOL
                self._publisher.publish(messages.create(STRING, json_bytes({**self._more(), **answer}).decode()))
