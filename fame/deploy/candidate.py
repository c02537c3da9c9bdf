"""What happens around a process that is loaded: wait for its topics, for its sender, for the process before it.

Timers and endpoints only; `fame.deploy.robot_protocol` decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope
from fame.deploy.report_reader import ReportReader
from fame.deploy.robot_protocol import MATCHING
from fame.deploy.termination import Answered
from fame.middleware import messages
from fame.middleware.interface import Middleware, Node

if TYPE_CHECKING:
    from fame.robot import RobotNode

_POLL = 0.02
_LEAVING = 2.5  # s that scripts may take to leave, should their own clock stand


class Candidate:
    """A loaded `process` and the `envelope` it came with. `node` is what asks the other robots."""

    envelope: Envelope
    process: RobotNode

    def __init__(
        self, envelope: Envelope, process: RobotNode, *, node: Node, scheduler: Scheduler, middleware: Middleware
    ) -> None:
        self.envelope: Envelope = envelope
        self.process: RobotNode = process
        self._node, self._scheduler, self._middleware = node, scheduler, middleware
        self._next: Entry | None = None
        self._peers: Peers | None = None

    def match(self, done: Callable[[Sequence[str]], object]) -> None:
        """Wait until the promised other ends of its topics are there; `done` gets those missing after `MATCHING` s."""
        self._match(done, self._scheduler.now + round(MATCHING * SECOND))

    def _match(self, done: Callable[[Sequence[str]], object], until: int) -> None:
        self.process.connect()
        absent = _missing(self.envelope.promises, self.process.namespace, self._middleware)
        if (absent or self._middleware.connecting(self.process.node)) and self._scheduler.now < until:
            self._after(_POLL, partial(self._match, done, until))
        else:
            done(absent)

    def await_sender(self, seconds: float, silence: Callable[[], object]) -> None:
        """Call `silence` after so many seconds, unless this or `close` is called before."""
        self._cancel()
        self._after(seconds, silence)

    def ask_others(self, answered: Callable[[Answered], object]) -> None:
        """Ask the other robots of the deployment what became of it."""
        if self._peers is None:
            others = sorted(set(self.envelope.team) - {self.process.namespace})
            self._peers = Peers(self.envelope, others, self._node, answered)
        self._peers.ask()

    def replace(self, old: RobotNode | None, done: Callable[[], object]) -> None:
        """Cancel the old process, and call `done` when its scripts have left."""
        self._rest()
        if old is not None:
            old.stop()
        self._await_leaving(old, done, self._scheduler.now + round(_LEAVING * SECOND))

    def _await_leaving(self, old: RobotNode | None, done: Callable[[], object], until: int) -> None:
        if old is not None and old.leaving and self._scheduler.now < until:
            self._after(_POLL, partial(self._await_leaving, old, done, until))
        else:
            done()

    def close(self) -> None:
        """Close the process, all timers and endpoints."""
        self._rest()
        self.process.close()

    def _after(self, delay: float, action: Callable[[], object]) -> None:
        self._next = self._scheduler.after(round(delay * SECOND), action, Kind.TIMER)

    def _cancel(self) -> None:
        if self._next is not None:
            self._next.cancel()
            self._next = None

    def _rest(self) -> None:
        self._cancel()
        if self._peers is not None:
            self._peers.close()
            self._peers = None


class Peers:
    """Endpoints to the other robots of a deployment: `answered` gets what they say about it.

    A robot asks with the envelope that it got, without the model: where keys are used its signature proves that there
    is such a deployment.
    """

    def __init__(
        self, envelope: Envelope, others: Iterable[str], node: Node, answered: Callable[[Answered], object]
    ) -> None:
        self._envelope, self._answered = envelope, answered
        self._out = {robot: node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in others}
        self._in = [
            node.subscription(
                f"/{robot}/bpmn_status", STRING, partial(self._on_report, self._reader(robot)), STATUS_QOS
            )
            for robot in self._out
        ]

    def ask(self) -> None:
        """Ask all of them."""
        proof = asdict(self._envelope) | {"model": ""} if self._envelope.signature else {}
        for robot, out in self._out.items():
            question = Envelope(
                deployment=self._envelope.deployment,
                sequence=self._envelope.sequence,
                robot=robot,
                phase="ask",
                proof=proof,
            )
            out.publish(messages.create(STRING, question.to_json()))

    def close(self) -> None:
        """Close the endpoints."""
        for subscription in self._in:
            subscription.close()
        for publisher in self._out.values():
            publisher.close()

    def _reader(self, robot: str) -> ReportReader:
        vouched = self._envelope.engines.get(robot, "")
        return ReportReader(robot, signed=bool(self._envelope.signature), vouched=vouched)

    def _on_report(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data)
        if report is None:
            return
        if report.deployed == self._envelope.deployment:
            self._answered(Answered(reader.robot, "started"))
        elif report.deployment == self._envelope.deployment:
            self._answered(Answered(reader.robot, report.answer))


def _missing(promises: Mapping[str, str], robot: str, middleware: Middleware) -> Sequence[str]:
    """The promised ends that are not there, as ``topic (publisher)``; those of the robot itself do not count."""
    if not promises:
        return ()
    graph = {info.name: info for info in middleware.graph()}
    absent = []
    for topic, end in promises.items():
        info = graph.get(topic)
        ends = () if info is None else info.publishers if end == "publisher" else info.subscribers
        if all(name.startswith(f"/{robot}/") for name in ends):
            absent.append(f"{topic} ({end})")
    return absent
