"""What people do on a running robot: a `Done` on ``bpmn_task``, an answer on ``bpmn_status``.

A task that waits for somebody is completed, or an element of an open ad-hoc sub-process activated.

The same words again have no effect but the answer, so whoever asks may ask until it hears one. Where keys are used the
words are signed, as an envelope is: for one run of one robot's engine, and not long ago.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy import fields
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, Report
from fame.deploy.signing import sign
from fame.deploy.voice import Voice
from fame.errors import DeploymentError, FameError
from fame.middleware import messages
from fame.middleware.interface import Node

if TYPE_CHECKING:
    from fame.robot import RobotNode

SETTLE, AGAIN = 0.02, 0.3
"""Before the first word, and between two (s): see `fame.deploy.sender`."""
SIZE, _NAME = 1_000_000, 1000
"""The longest request, and its longest id, of itself and of an element (characters): both are kept for a while."""
_ANSWERS = 100
"""How many answers a robot remembers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """What somebody did: a task's `element`, `values` for its variables; `id` names the request.

    `act` is ``complete``; or ``activate``, where `element` is one of an ad-hoc sub-process and there are no values.
    `robot`, `born`, `issued` and `signature` are there where keys are used: as of `Envelope`.
    """

    id: str
    element: str
    values: Mapping[str, Any] = field(default_factory=dict)
    act: str = "complete"
    robot: str = ""
    born: int = 0
    issued: float = 0.0
    signature: str = ""

    def signed(self, robot: str, key: Any, *, born: int, now: float) -> Done:
        """It as a private key signs it `now` (s since 1970) for the engine of a robot that was `born` then."""
        done = replace(self, robot=robot, born=born, issued=now)
        return replace(done, signature=sign(asdict(done), key))

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self), sort_keys=True)


_DONE: dict[str, fields.Check] = {
    "id": fields.text(_NAME),
    "element": fields.text(_NAME),
    "values": lambda value: isinstance(value, dict),
    "act": fields.among("complete", "activate"),
    "robot": fields.text(_NAME),
    "born": fields.integer(0, 2**63),
    "issued": fields.number,
    "signature": fields.text(_NAME),
}


def read_done(text: str) -> Done:
    """What came in. Raises DeploymentError."""
    from fame.engine.data import is_variable

    if len(text) > SIZE:
        raise DeploymentError(f"{len(text)} characters for a task; at most {SIZE} are taken")
    try:
        said = json.loads(text)
        done = Done(**said) if fields.wrong(said, _DONE) is None else None
    except (ValueError, TypeError, AttributeError, RecursionError):
        done = None
    if done is None or not all(map(is_variable, done.values)) or (done.act == "activate" and done.values):
        raise DeploymentError(f'no task: {text[:60]!r}; {{"id": ..., "element": ..., "values": {{}}}} would be right')
    return done


class Tasks:
    """The robot's end. `running` is what it runs now, `report` says (answer, id of the request, reason).

    `check` raises DeploymentError for what does not come from whom it should.
    """

    def __init__(
        self,
        node: Node,
        running: Callable[[], RobotNode | None],
        report: Callable[[str, str, str], object],
        check: Callable[[Done], object] = lambda done: None,
    ) -> None:
        self._running, self._report, self._check = running, report, check
        self._answers: dict[str, tuple[str, str]] = {}
        self._end = node.subscription("bpmn_task", STRING, self._heard, PROCESS_QOS)
        self._end.limit = SIZE
        self._end.dropped = lambda text: report("refused", "", text)

    def close(self) -> None:
        """Hear no more."""
        self._end.close()

    def _heard(self, message: Any) -> None:
        try:
            done = read_done(message.data)
        except DeploymentError as error:
            self._report("refused", "", str(error))
            return
        try:
            self._check(done)
        except DeploymentError as error:
            self._report("refused", done.id, str(error))
            return
        if done.id not in self._answers:
            self._answers[done.id] = self._act(done)
            if len(self._answers) > _ANSWERS:
                del self._answers[next(iter(self._answers))]
        answer, reason = self._answers[done.id]
        self._report(answer, done.id, reason)

    def _act(self, done: Done) -> tuple[str, str]:
        node = self._running()
        if node is None:
            return "refused", f"{done.element}: the robot has no process yet"
        try:
            if done.act == "activate":
                node.activate(done.element)
            else:
                node.complete(done.element, done.values)
        except FameError as error:
            return "refused", str(error)
        return ("activated" if done.act == "activate" else "completed"), ""


class Asking:
    """The other end: tells a robot, again and again, until `answered` has been called with its report, or `close`.

    With a `key` what it says is signed, and only what the robot's engine signed is an answer.
    """

    def __init__(
        self,
        robot: str,
        done: Done,
        *,
        node: Node,
        scheduler: Scheduler,
        answered: Callable[[Report], object],
        key: Any = None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._done, self._scheduler, self._answered = done, scheduler, answered
        self._robot, self._key, self._wall_time = robot, key, wall_time
        self._born: int | None = None  # of the robot's engine, once it was heard
        self._voice = Voice(robot, signed=key is not None, trusted=[key.public_key()] if key is not None else [])
        self._out = node.publisher(f"/{robot}/bpmn_task", STRING, PROCESS_QOS)
        self._end = node.subscription(f"/{robot}/bpmn_status", STRING, self._heard, STATUS_QOS)
        self._next: Entry = scheduler.after(round(SETTLE * SECOND), self._ask, Kind.TIMER)

    def close(self) -> None:
        """Ask no more."""
        self._next.cancel()
        self._out.close()
        self._end.close()

    def _ask(self) -> None:
        if self._key is None:
            self._out.publish(messages.create(STRING, self._done.to_json()))
        elif self._born is not None:
            done = self._done.signed(self._robot, self._key, born=self._born, now=self._wall_time())
            self._out.publish(messages.create(STRING, done.to_json()))
        self._next = self._scheduler.after(round(AGAIN * SECOND), self._ask, Kind.TIMER)

    def _heard(self, message: Any) -> None:
        report = self._voice.hear(message.data)
        if report is not None:
            self._born = report.born
        if report is not None and report.answer and report.deployment == self._done.id:
            self._next.cancel()
            self._answered(report)
