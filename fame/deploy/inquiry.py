"""Asking the other robots of a deployment what became of it: see `fame.deploy.termination`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import partial
from typing import Any

from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope
from fame.deploy.termination import Answered
from fame.deploy.voice import Voice
from fame.middleware import messages
from fame.middleware.interface import Node


class Inquiry:
    """Ends to the other robots that got an envelope's deployment; `heard` is told what they say about it.

    What a robot asks with is the envelope that it got, without the model: where keys are used its signature shows that
    there is such a deployment.
    """

    def __init__(
        self, envelope: Envelope, others: Iterable[str], node: Node, heard: Callable[[Answered], object]
    ) -> None:
        self._envelope, self._told = envelope, heard
        self._out = {robot: node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in others}
        self._in = [
            node.subscription(f"/{robot}/bpmn_status", STRING, partial(self._heard, self._voice(robot)), STATUS_QOS)
            for robot in self._out
        ]

    def ask(self) -> None:
        """Ask all of them."""
        proof = asdict(self._envelope) | {"model": ""} if self._envelope.signature else {}
        for robot, out in self._out.items():
            said = Envelope(
                deployment=self._envelope.deployment,
                sequence=self._envelope.sequence,
                robot=robot,
                phase="ask",
                proof=proof,
            )
            out.publish(messages.create(STRING, said.to_json()))

    def _voice(self, robot: str) -> Voice:
        vouched = self._envelope.engines.get(robot, "")
        return Voice(robot, signed=bool(self._envelope.signature), vouched=vouched)

    def _heard(self, voice: Voice, message: Any) -> None:
        report = voice.hear(message.data)
        if report is None:
            return
        if report.deployed == self._envelope.deployment:
            self._told(Answered(voice.robot, "started"))
        elif report.deployment == self._envelope.deployment:
            self._told(Answered(voice.robot, report.answer))

    def close(self) -> None:
        """Listen no more."""
        for heard in self._in:
            heard.close()
        for out in self._out.values():
            out.close()
        self._in, self._out = [], {}
