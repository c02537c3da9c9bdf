"""Requests of people to one robot: complete a task, repair what runs, suspend or steer it, abort a deployment.

A `TaskRequest` goes to ``bpmn_task``: a task that waits for somebody is completed, an element of an open ad-hoc
sub-process activated, an incident retried, an element skipped, a variable set, a token moved, the mission suspended,
taken over and continued. An abort goes to ``bpmn_process``, as a sender's would. The answer is on ``bpmn_status``.

The same request again has no effect but the answer, so a client repeats it until it gets one. Where keys are used
requests are signed, as an envelope is: for one run of one robot's engine, and for `fame.deploy.signing.FRESH` s. As
long the robot remembers each of them: its bytes, sent again by anybody, are answered and not done.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated, Any, Self

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.dataclasses import dataclass, field, replace
from fame.deploy import fields
from fame.deploy.authentication import ReportReader
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope, Report, signed, unreadable
from fame.deploy.machine import unexpected
from fame.deploy.signing import ANOTHER_RUN, FRESH, with_signature
from fame.errors import DeploymentError, FameError, MissionError
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.text import printable, read_json
from fame.version import PROTOCOL

if TYPE_CHECKING:
    from fame.robot import RobotNode

SETTLE, REPEAT = 0.02, 0.3
"""Before the first request, and between two (s): see `fame.deploy.sender_protocol`."""
SIZE = 1_000_000
"""The longest request (characters)."""
_DONE = {
    "complete": "completed", "activate": "activated", "retry": "retried", "skip": "skipped", "set": "set",
    "move": "moved", "suspend": "suspended", "take_over": "taken over", "continue": "continued",
    "restart": "restarted", "fail": "made to fail", "note": "noted",
}  # fmt: skip
ACTS = tuple(_DONE)
_OF_TOKENS = ("complete", "retry", "skip", "move", "restart", "fail")
STILL_HELD = "no longer suspended"
"""The answer to ``continue`` if something else holds the robot: its mission does not go on."""
_ANSWERS = 100
"""How many answers to requests that were not signed a robot remembers."""
_REPLAYED = 2 * FRESH
"""How long a signed request could be repeated (s): it may have been signed by a clock that is ahead by `FRESH`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignedRequest:
    """What somebody asks of an engine; `id` names the request.

    `robot`, `born`, `issued` and `signature` are there where keys are used: as of `Envelope`.
    """

    id: fields.Name
    robot: fields.Name = ""
    born: fields.Birth = 0
    issued: fields.Number = 0.0
    signature: fields.Name = ""

    def signed(self, robot: str, key: Any, *, born: int, now: float) -> Self:
        """Return the request signed by a private key `now` (s since 1970) for the engine of a
        robot that was `born` then."""
        return with_signature(self, key, robot=robot, born=born, issued=now)

    def to_json(self) -> str:
        """Return the JSON text that is sent."""
        return json.dumps(fields.values(self), sort_keys=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskRequest(SignedRequest):
    """Complete a task (`element`) with `values` for its variables.

    `act` is ``complete``; ``activate``, where `element` is one of an ad-hoc sub-process and there are no values;
    ``retry`` of an element with an incident; ``skip`` of an element, which goes on without its results; ``set``, where
    there is no element; ``move`` of a token at `element` to the element `to`; ``suspend`` and ``continue`` of the whole
    mission; ``take_over``, by which a person holds the `lease` (again: for longer); ``restart`` of an element; ``fail``
    of one, after which a suspended mission continues; ``note`` of a text, `to`, in the log.
    `who` says whose request it is: what keys prove counts more.
    `fame` is the protocol, which a robot of protocol 1 is not told.
    """

    element: fields.Name
    values: Annotated[Mapping[str, Any], fields.is_object] = field(default_factory=dict)
    act: Annotated[str, fields.among(*ACTS)] = "complete"
    to: fields.Name = ""
    lease: fields.Name = ""
    who: fields.Name = ""
    fame: fields.Count = fields.later(1)


def read_request(text: str) -> TaskRequest:
    """Read a request. Raises DeploymentError."""
    from fame.engine.data import is_variable

    if len(text) > SIZE:
        raise DeploymentError(f"{len(text)} characters for a task; at most {SIZE} are accepted", cause="size")
    content: Any = None
    try:
        content = read_json(text, SIZE)
        request = fields.read(TaskRequest, content)
        if not all(map(is_variable, request.values)) or (request.act == "activate" and request.values):
            raise TypeError("field 'values'")
    except (ValueError, TypeError) as error:
        expected = 'no task, expected {"id": ..., "element": ..., "values": {}}'
        raise unreadable(expected, text, content, "id", error) from None
    return request


class TaskServer:
    """The robot's end. `running` gives its node, `report` publishes (answer, id of the request, reason,
    and the cause of a refusal by keyword). `answers` are those of before, by id, oldest first; an engine with a state
    stores them in the record of what they did.

    `check` raises DeploymentError for a request that no trusted key signed, and returns the fingerprint of the key, if
    there is one. `refuse` raises it for a request that cannot be met now: once refused, it is not carried out when it
    arrives again. While `resuming`, no request is answered: the engine before may have done it. `now` gives the seconds
    of a clock that is never set.
    """

    def __init__(
        self,
        node: Node,
        running: Callable[[], RobotNode | None],
        report: Callable[..., object],
        check: Callable[[TaskRequest], str] = lambda request: "",
        *,
        refuse: Callable[[TaskRequest], object] = lambda request: None,
        resuming: Callable[[], bool] = lambda: False,
        now: Callable[[], float],
        answers: dict[str, Any],
    ) -> None:
        self._running, self._report, self._check, self._now = running, report, check, now
        self._refuse, self._resuming = refuse, resuming
        self._answers = answers
        self._until: dict[str, float] = {}  # when those that were signed may be forgotten (s)
        self._end = node.subscription("bpmn_task", STRING, self._on_request, PROCESS_QOS)
        self._end.max_size = SIZE
        self._end.on_dropped = lambda warning: report("refused", "", str(warning), cause=warning.kind)

    def close(self) -> None:
        self._end.close()

    def _on_request(self, message: Any) -> None:
        id = ""
        try:
            request = read_request(message.data)
            id = request.id
            signer = self._check(request)
        except DeploymentError as error:
            self._report("refused", id or error.about, str(error), cause=error.cause)
            return
        except Exception as error:  # no message ends an engine
            self._report("refused", id, unexpected(error), cause="error")
            return
        if self._resuming():
            return  # it is asked again
        if signer:
            self._until[request.id] = self._now() + _REPLAYED
        if request.id not in self._answers:
            node = self._running()
            recorder = node.host.recorder if node is not None else None
            with nullcontext() if recorder is None else recorder.at_once():
                self._answers[request.id] = list(self._answer(request, signer))
                self._forget_oldest()
        answer, reason, cause = self._answers[request.id]
        self._report(answer, request.id, reason, cause=cause)

    def _forget_oldest(self) -> None:
        now = self._now()
        for old in [id for id in self._answers if self._until.get(id, 0.0) <= now][:-_ANSWERS]:
            del self._answers[old]
            self._until.pop(old, None)

    def _answer(self, request: TaskRequest, signer: str) -> tuple[str, str, str]:
        """Do what is requested, if that is possible now. Returns answer, reason, and the cause of a refusal."""
        try:
            self._refuse(request)
        except DeploymentError as error:
            return "refused", str(error), error.cause
        return *self._act(request, signer), ""

    def _act(self, request: TaskRequest, signer: str) -> tuple[str, str]:
        node = self._running()
        if node is None:
            reason = "the robot has no process yet"
            return "refused", f"{request.element}: {reason}" if request.element else reason
        name = printable(request.who)
        who = ", ".join(filter(None, (name, signer))) if signer else f"{name or 'unknown'} (unverified)"
        try:
            request = _with_ids(request, node)
            others = node.others_at(request.element, request.act) if request.act in _OF_TOKENS else 0
            said = [f"{request.element}: the first of {others + 1} there"] if others else []
            match request.act:
                case "activate":
                    node.activate(request.element)
                case "retry":
                    node.retry(request.element, request.values, who=who)
                case "set":
                    if new := node.set_variables(request.values, who=who):
                        said = [f"{', '.join(request.values)}; not a variable before: {', '.join(new)}"]
                case "move":
                    node.move(request.element, request.to, who=who)
                case "skip":
                    node.skip(request.element, who=who)
                case "suspend":
                    node.suspension.suspend(who)
                    if goals := node.runner.cancelled.actions():
                        said = [f"its goal still runs until its server has cancelled it: {', '.join(goals)}"]
                case "take_over":
                    node.suspension.take_over(who, request.lease)
                case "continue":
                    node.suspension.go_on(who, request.lease)
                    if holds := node.suspension.other_holds():
                        return STILL_HELD, f"no person suspends it, but it still holds for {holds}"
                case "restart":
                    node.restart(request.element, who=who)
                case "fail":
                    node.fail(request.element, request.lease, who=who)
                case "note":
                    node.note(request.element, f"{request.to} by {who}")
                case _:
                    without = node.left_out(request.element, request.values)
                    goes_on = node.complete(request.element, request.values)
                    if request.who:
                        node.note(request.element, f"completed by {who}")
                    for more in (without, "" if goes_on else "it goes on when what suspends it ends"):
                        said = [*(said or [request.element]), more] if more else said
        except FameError as error:
            return "refused", str(error)
        except Exception as error:
            return "refused", unexpected(error)
        return _DONE[request.act], "; ".join(said)


def _with_ids(request: TaskRequest, node: RobotNode) -> TaskRequest:
    """The request with the ids of the elements that it names by a label. Raises MissionError for one of several."""
    from fame.bpmn.model import ids_named

    if request.act not in (*_OF_TOKENS, "activate"):
        return request
    ids = []
    for name in (request.element, request.to):
        nodes = [one for _, one in node.mission.flow_nodes()]
        found = ids_named(nodes, name)
        close = get_close_matches(name, {word for one in nodes for word in (one.label, one.id)}, 1)
        if close and not found:
            raise MissionError(f"the mission has no such element; did you mean {close[0]!r}?", element=name)
        found = found or [name]
        if len(found) > 1:
            raise MissionError(f"is the label of {', '.join(found)}: use an id", element=name)
        ids += found
    return replace(request, element=ids[0], to=ids[1])


class TaskClient:
    """The person's end: repeat a request until `answered` has been called with the robot's report, or `close`.

    With a `key` the request is signed, and only what the robot's engine signed is an answer.
    """

    def __init__(
        self,
        robot: str,
        request: TaskRequest,
        *,
        node: Node,
        scheduler: Scheduler,
        answered: Callable[[Report], object],
        key: Any = None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._request, self._scheduler, self._answered = request, scheduler, answered
        self._robot, self._key, self._wall_time = robot, key, wall_time
        self._born: int | None = None  # of the robot's engine, once it has reported
        self._protocol = 1
        self.trouble: str = ""  # why there may be no answer
        self._reader = ReportReader.of_sender(robot, key)
        self._out = node.publisher(f"/{robot}/bpmn_task", STRING, PROCESS_QOS)
        self._end = node.subscription(f"/{robot}/bpmn_status", STRING, self._on_status, STATUS_QOS)
        self._next: Entry = scheduler.after(round(SETTLE * SECOND), self._ask, Kind.TIMER)

    def close(self) -> None:
        self._next.cancel()
        self._out.close()
        self._end.close()

    def ask(self, request: TaskRequest) -> None:
        """Make another request, by the same endpoints."""
        self._next.cancel()
        self._request = request
        self._ask()

    def _ask(self) -> None:
        request = self._request if self._protocol == 1 else replace(self._request, fame=PROTOCOL)
        if self._key is None:
            self._out.publish(messages.create(STRING, request.to_json()))
        elif self._born is not None:
            request = request.signed(self._robot, self._key, born=self._born, now=self._wall_time())
            self._out.publish(messages.create(STRING, request.to_json()))
        self._next = self._scheduler.after(round(REPEAT * SECOND), self._ask, Kind.TIMER)

    def _on_status(self, message: Any) -> None:
        report = self._reader.read(message.data)
        if report is None:
            self.trouble = self._reader.strange or self.trouble
            return
        self._born = report.born
        if not report.deployment:
            self._protocol = report.protocol
            refused = f"it refused a message: {report.reason}" if report.answer == "refused" else ""
            self.trouble = refused or self.trouble or report.differs
        elif report.deployment == self._request.id and report.reason == ANOTHER_RUN:
            self.trouble = report.reason  # this engine was started meanwhile: it is asked next
        elif report.answer and report.deployment == self._request.id:
            self._next.cancel()
            self._answered(report)


class AbortClient:
    """Abort what a robot holds: it keeps what it had, whatever became of the deployment at the others.

    The request is repeated until `ended` has been called with answer and reason, or `close`. The answer is ``aborted``,
    ``refused``, ``ready`` if it starts as soon as its disk lets it, ``started`` if the robot has meanwhile started a
    deployment, or ``idle`` if none is loading or ready there.
    """

    def __init__(
        self,
        robot: str,
        *,
        node: Node,
        scheduler: Scheduler,
        ended: Callable[[str, str], object],
        key: Any = None,
    ) -> None:
        self._robot, self._scheduler, self._ended, self._key = robot, scheduler, ended, key
        self._reader = ReportReader.of_sender(robot, key)
        self._deployment = self._before = ""
        self._next: Entry | None = None
        self._out = node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS)
        self._in = node.subscription(f"/{robot}/bpmn_status", STRING, self._on_status, STATUS_QOS)

    def close(self) -> None:
        if self._next is not None:
            self._next.cancel()
        self._in.close()
        self._out.close()

    def _on_status(self, message: Any) -> None:
        report = self._reader.read(message.data)
        if report is None:
            return
        answered = report.answer in ("aborted", "refused") or (report.answer == "ready" and report.reason)
        if self._deployment and report.deployment == self._deployment and answered:
            self._end(report.answer, report.reason)
        elif not report.candidate and self._deployment and report.deployed != self._before:
            self._end("started", f"it runs deployment {report.deployed} now")
        elif not report.candidate:
            self._end("aborted" if self._deployment else "idle", "")
        elif self._next is None:
            self._deployment, self._before = report.candidate, report.deployed
            self._send(report)

    def _send(self, report: Report) -> None:
        envelope = Envelope(deployment=self._deployment, sequence=0, robot=self._robot, phase="abort")
        signed_envelope = signed(envelope, self._key, born=report.born, now=time.time())
        self._out.publish(messages.create(STRING, signed_envelope.to_json()))
        self._next = self._scheduler.after(round(REPEAT * SECOND), lambda: self._send(report), Kind.TIMER)

    def _end(self, answer: str, reason: str) -> None:
        ended, self._ended = self._ended, lambda answer, reason: None
        if self._next is not None:
            self._next.cancel()
        ended(answer, reason)
