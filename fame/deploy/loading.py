"""Load a process beside the running mission, and wait for its topics, its sender, and the end of the old process.

A task is a generator. What it does between two ``yield``s is done in the scheduler's thread; what it yields is a
function, done by a worker of the scheduler (`fame.worker`), whose result (or error) comes back to the ``yield``.

Python runs one thread at a time and changes between them every few milliseconds, so the mission hardly notices.
Collecting garbage would stop all threads, the longer the more is being made: it waits until the work is done.

A loaded process is a `LoadedCandidate` until it runs: timers and endpoints only; `fame.deploy.robot_protocol` decides.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from fame import rooms
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy import fields
from fame.deploy.authentication import ReportReader
from fame.deploy.envelope import PROCESS_QOS, STRING, Envelope
from fame.deploy.machine import boundary
from fame.deploy.termination import PeerAnswered
from fame.errors import FameError, ModelError
from fame.gc_tuning import uncollected
from fame.middleware import messages
from fame.middleware.interface import Middleware, Node, known_topics

if TYPE_CHECKING:
    from fame.deploy.options import EngineOptions
    from fame.robot import Mission, RobotNode


_Result = TypeVar("_Result")
LoadingTask = Generator[Callable[[], Any], Any, _Result]

LIMIT = 60.0
"""How long the work of a task may take (s)."""
KEPT = 10
"""How many instances that have ended an engine remembers."""
_STEP = 0.15  # s between two steps of preloading, for each engine: all may be on one machine that starts them


class Work(Generic[_Result]):
    """A running task. `done` is called once, in the scheduler's thread, with its result or its FameError."""

    def __init__(
        self, scheduler: Scheduler, task: LoadingTask[_Result], done: Callable[[_Result | FameError], object]
    ) -> None:
        self._task, self._done = task, done
        self._worker = scheduler.worker("fame load")
        self._over = False
        self._limit: Entry | None = None
        self._go_on(None, None)
        if not self._over:
            self._limit = scheduler.after(round(LIMIT * SECOND), self._give_up, Kind.TIMER)

    def _go_on(self, value: Any, error: Exception | None) -> None:
        """Do the task up to its next function."""
        if self._over:
            return  # given up
        try:
            function = self._task.send(value) if error is None else self._task.throw(error)
        except StopIteration as end:
            self._end(end.value)
        except FameError as error:
            self._end(error)
        else:
            self._worker.call(uncollected()(function), self._go_on)

    def _give_up(self) -> None:
        self._over = True
        self._worker.interrupt()
        self._task.close()
        self._done(ModelError(f"takes more than {LIMIT:g} s to be read and checked"))

    def _end(self, outcome: _Result | FameError) -> None:
        self._over = True
        if self._limit is not None:
            self._limit.cancel()
        self._worker.close()
        self._done(outcome)


# ---- a model that was sent -------------------------------------------------------------------------------------------


def load(
    model: str, robot: str, options: EngineOptions, *, scheduler: Scheduler, middleware: Middleware
) -> LoadingTask[RobotNode]:
    """Yield a robot's node with the process of a .bpmn text, its endpoints made.

    If its `state` is to be kept on disk, a model is refused whose state cannot be stored.

    A task of `Work`: the text is read, checked and compiled in a thread. Raises ModelError, MessageError, ConfigError,
    also for what would fail only when a token gets there; any other exception becomes a ModelError, since what runs
    must not end for a model that is to take its place.
    """
    try:
        return (yield from _load(model, robot, options, scheduler, middleware))
    except FameError:
        raise
    except Exception as error:
        raise ModelError(f"cannot be loaded: {type(error).__name__}: {error}", file=f"{robot}.bpmn") from error


def _load(
    model: str, robot: str, options: EngineOptions, scheduler: Scheduler, middleware: Middleware
) -> LoadingTask[RobotNode]:
    mission = yield partial(_read, model, robot, options)
    from fame.robot import RobotNode

    options = replace(options, keep=KEPT)
    node = RobotNode(robot, mission, scheduler=scheduler, middleware=middleware, options=options, compiled=False)
    try:
        node.assemble((yield node.compile_process))
        node.load()
    except BaseException:
        node.close()
        raise
    return node


def _read(model: str, robot: str, options: EngineOptions) -> Mission:
    from fame.bpmn.library import Library
    from fame.bpmn.reader import read_text
    from fame.check.gate import refuse_literals
    from fame.robot import make_mission
    from fame.simulation import choose_process

    library = options.library or Library()
    definitions = read_text(model, file=f"{robot}.bpmn", sent=True)
    pools = [pool for pool in definitions.participants if pool.process]
    process = choose_process(definitions, pools[0].process if len(pools) == 1 else None)
    refuse_literals(definitions, [process], library, folder=options.files)
    mission = make_mission(definitions, process, library=library, services=options.services)
    if options.state is not None:
        from fame.robot.stored_values import refuse_unstorable

        refuse_unstorable(mission)
    return mission


# ---- before the first model ------------------------------------------------------------------------------------------


def preload(scheduler: Scheduler, waits: Callable[[], bool], engines: Callable[[], int]) -> None:
    """Load what any process needs, step by step, as long as the engine `waits` for its first one.

    A process that comes meanwhile waits for one step at most. `engines` gives the number of engines: the more there
    are, the slower, since engines that start at once on one machine have to find each other first.
    """
    steps = _steps()

    def wait() -> None:
        scheduler.after(round(_STEP * SECOND) * engines(), go_on, Kind.TIMER)

    def go_on() -> None:
        if waits() and _preload(steps):
            wait()

    wait()


def preload_all() -> None:
    """Load what any process needs, now."""
    for _ in _steps():
        pass


def _preload(steps: Iterator[str]) -> bool:
    """Do the next step. Returns whether more may follow. No garbage collection looks at what was loaded."""
    with uncollected(stays=True):
        return next(steps, None) is not None


def _steps() -> Iterator[str]:
    """Load one part after the other; the name of each but the last."""
    import fame.bpmn.reader

    yield "reader"
    import fame.check.gate

    yield "check"
    import fame.robot.node
    import fame.simulation  # noqa: F401

    yield "interpreter"
    from fame.middleware import codec, typesystem

    typesystem.names()
    yield "types"
    codec.typestore("std_msgs/msg/Bool")
    yield "codec"
    if "fame.middleware.dds" in sys.modules:
        declared = rooms.load(rooms.DDS_TYPE)("std_msgs/msg/Bool", False)
        declared.__idl__.fill_type_data()  # what all descriptions are made with
    yield "descriptions"


_POLL = 0.02
_SURE = 3 * SECOND
"""After how long a mismatch that was known before still holds, if its topic is not connected yet (ns)."""
LEAVING = round(2.5 * SECOND)
"""How long scripts may take to leave, should their own clock stand (ns)."""


class LoadedCandidate:
    """A loaded `process` and the `envelope` it came with. `node` is what asks the other robots.

    `apart` says what keeps its topics from ends that are there: for each topic of which that is known.
    """

    def __init__(
        self, envelope: Envelope, process: RobotNode, *, node: Node, scheduler: Scheduler, middleware: Middleware
    ) -> None:
        self.envelope: Envelope = envelope
        self.process: RobotNode = process
        self._node, self._scheduler, self._middleware = node, scheduler, middleware
        self.apart: Mapping[str, str] = {}
        self._known, self._sure = len(middleware.warnings), scheduler.now + _SURE  # older ones may be outdated
        self._next: Entry | None = None
        self._peers: Peers | None = None

    def match(self, done: Callable[[Sequence[str]], object]) -> None:
        """Wait for the promised other ends of its topics; `done` gets those missing after `Envelope.matching` s.

        Ends that do not match are not waited for, as soon as that is known: see `apart`.
        """
        self._match(done, self._scheduler.now + round(self.envelope.matching * SECOND))

    def _match(self, done: Callable[[Sequence[str]], object], until: int) -> None:
        self.process.connect()
        promises = self.envelope.promises
        absent = _missing(promises, self.process.namespace, self._middleware)
        connecting, late = self._middleware.connecting(self.process.node), self._scheduler.now >= until
        apart = self._mismatches(0 if late or self._scheduler.now >= self._sure else self._known)
        if (absent or any(topic not in apart for topic in connecting)) and not late:
            self._after(_POLL, partial(self._match, done, until))
            return
        self.apart = {topic: apart[topic] for topic in connecting if topic in apart}
        done(absent)

    def _mismatches(self, first: int) -> Mapping[str, str]:
        """What keeps its node from an end of a topic, by topic, from that warning of the middleware on."""
        name, warnings = self.process.node.full_name, self._middleware.warnings[first:]
        return {each.topic: str(each) for each in warnings if each.kind == "mismatch" and name in each.text}

    def await_sender(self, seconds: float, silence: Callable[[], object]) -> None:
        """Call `silence` after this many seconds, unless this method or `close` is called before."""
        self._cancel()
        self._after(seconds, silence)

    def ask_others(self, answered: Callable[[PeerAnswered], object]) -> None:
        """Ask the other robots of the deployment for its outcome."""
        if self._peers is None:
            others = sorted(set(self.envelope.team) - {self.process.namespace})
            self._peers = Peers(self.envelope, others, self._node, answered, partial(self.process.host.report, ""))
        self._peers.ask()

    def replace(self, old: RobotNode | None, done: Callable[[], object], *, stop: bool = True) -> None:
        """Cancel the old process, unless it is not to `stop`, and call `done` when its scripts have left."""
        self._rest()
        if old is not None and stop:
            old.stop()
        await_leaving = partial(self._await_leaving, old, done, self._scheduler.now + LEAVING)
        self._next = self._scheduler.soon(await_leaving, Kind.RESUMPTION)  # not inside the handler of a message

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
        self,
        envelope: Envelope,
        others: Iterable[str],
        node: Node,
        answered: Callable[[PeerAnswered], object],
        log: Callable[[str], object],
    ) -> None:
        self._envelope, self._answered = envelope, answered
        self._out = {robot: node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in others}
        self._in = [
            # Without history: each robot repeats its report, and of a large team each would ask each for it.
            node.subscription(f"/{robot}/bpmn_status", STRING, self._listener(robot, log))
            for robot in self._out
        ]

    def ask(self) -> None:
        proof = fields.values(self._envelope) | {"model": ""} if self._envelope.signature else {}
        for robot, out in self._out.items():
            question = Envelope(
                deployment=self._envelope.deployment,
                sequence=self._envelope.sequence,
                robot=robot,
                phase="ask",
                born=_born(self._envelope.engines.get(robot, "")),
                proof=proof,
            )
            out.publish(messages.create(STRING, question.to_json()))

    def close(self) -> None:
        for subscription in self._in:
            subscription.close()
        for publisher in self._out.values():
            publisher.close()

    def _listener(self, robot: str, log: Callable[[str], object]) -> Callable[[Any], None]:
        signed = bool(self._envelope.signature)  # without keys nobody vouches, and a robot that was started anew counts
        vouched = self._envelope.engines.get(robot, "") if signed else ""
        reader = ReportReader(robot, signed=signed, vouched=vouched)
        return boundary(partial(self._on_report, reader), lambda reason: log(f"report of {robot}: {reason}"))

    def _on_report(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data)
        if report is None:
            return
        if report.deployed == self._envelope.deployment:
            self._answered(PeerAnswered(reader.robot, "started"))
        elif report.deployment == self._envelope.deployment:
            self._answered(PeerAnswered(reader.robot, report.answer))


def _born(engine: str) -> int:
    """The birth in a `Report.engine`; 0 if it is not known."""
    text = engine.partition(" ")[0]
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 and int(text) < 2**63 else 0


def _missing(promises: Mapping[str, str], robot: str, middleware: Middleware) -> Sequence[str]:
    """The promised ends that are not there, as ``topic (publisher)``; those of the robot itself do not count."""
    if not promises:
        return ()
    graph = {info.name: info for info in known_topics(middleware, promises) if info.name in promises}
    absent = []
    for topic, end in promises.items():
        info = graph.get(topic)
        ends = () if info is None else info.publishers if end == "publisher" else info.subscribers
        if all(name.startswith(f"/{robot}/") for name in ends):
            absent.append(f"{topic} ({end})")
    return absent
