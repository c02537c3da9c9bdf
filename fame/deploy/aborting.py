"""A person aborts what a robot holds: it keeps what it had, whatever became of the deployment at the others."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope, Report, signed
from fame.deploy.voice import Voice
from fame.middleware import messages
from fame.middleware.interface import Node

AGAIN = 0.3
"""Between two words (s)."""


class Aborting:
    """Tells a robot to abort, again and again, until `ended` was called with the answer, or `close`.

    The answer is ``aborted``, ``refused``, or ``idle`` if no deployment is loading or ready there; with the reason.
    """

    def __init__(
        self,
        robot: str,
        *,
        node: Node,
        scheduler: Scheduler,
        ended: Callable[[str, str], object],
        key: Any = None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._robot, self._scheduler, self._ended = robot, scheduler, ended
        self._key, self._wall_time = key, wall_time
        self._voice = Voice(robot, signed=key is not None, trusted=[key.public_key()] if key is not None else [])
        self._deployment = ""
        self._next: Entry | None = None
        self._out = node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS)
        self._in = node.subscription(f"/{robot}/bpmn_status", STRING, self._heard, STATUS_QOS)

    def close(self) -> None:
        """Say no more."""
        if self._next is not None:
            self._next.cancel()
        self._in.close()
        self._out.close()

    def _heard(self, message: Any) -> None:
        report = self._voice.hear(message.data)
        if report is None:
            return
        if self._deployment and report.deployment == self._deployment and report.answer in ("aborted", "refused"):
            self._end(report.answer, report.reason)
        elif not report.candidate:
            self._end("aborted" if self._deployment else "idle", "")
        elif self._next is None:
            self._deployment = report.candidate
            self._say(report)

    def _say(self, report: Report) -> None:
        envelope = Envelope(deployment=self._deployment, sequence=0, robot=self._robot, phase="abort")
        said = signed(envelope, self._key, born=report.born, now=self._wall_time())
        self._out.publish(messages.create(STRING, said.to_json()))
        self._next = self._scheduler.after(round(AGAIN * SECOND), lambda: self._say(report), Kind.TIMER)

    def _end(self, answer: str, reason: str) -> None:
        ended, self._ended = self._ended, lambda answer, reason: None
        if self._next is not None:
            self._next.cancel()
        ended(answer, reason)
