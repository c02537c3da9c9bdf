"""The reasons why the tokens of a robot wait, as text and by topic.

A wait for a message has two hints. One says that the last message came before a token waited for it. The other says
that its publisher was gone meanwhile: after a network partition or a restart a message may be lost, and a
healthy robot waits forever. Whoever polls what the robot waits for compares who publishes now with who did before.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import cached_property
from itertools import chain, islice
from typing import Any, NamedTuple

from fame.bpmn import model
from fame.clock import SECOND, Scheduler, date_at, date_text
from fame.dataclasses import dataclass, field
from fame.engine import Engine, waiting
from fame.engine.program import USER, Catch, Node as ProgramNode
from fame.engine.repair import INCIDENT
from fame.engine.state import Scope, Wait, joins_reached, scopes_of
from fame.errors import display_name
from fame.middleware.interface import UNKNOWN_NODE, Middleware, Node, TopicInfo, known_topics, resolve
from fame.robot.mission import Mission
from fame.robot.wait_sentences import sentence, value_text
from fame.scripting import Runner, effects_of
from fame.scripting.requests import Act, Call

A_PERSON = sentence("complete")
"""The reason of user and manual tasks."""


@dataclass(frozen=True, slots=True)
class WaitingToken:
    """A token that waits at an element, and what it waits for, in words.

    `since` (ns) is when it was first seen there; `topics` are those whose message would move it, by full name, each
    with the number of other publishers on it. `place` names the drawn activity, and the element inside a
    called process; `suspended` who suspends it, since when.
    """

    robot: str
    element: str
    text: str
    since: int = 0
    topics: Mapping[str, int] = field(default_factory=dict)
    place: str = ""
    suspended: str = ""

    @property
    def reason(self) -> str:
        """Why it does not move: ``for topic /go``, or ``suspended by "Emergency stop" since 8 s``."""
        return self.suspended or f"for {self.text}"

    def __str__(self) -> str:
        comma = "," if self.suspended or "inside it" in self.place else ""
        return f"{self.robot} waits at {self.place or self.element}{comma} {self.reason}"


class PublisherGap(NamedTuple):
    """A node that did not publish on a topic between two times (ns)."""

    node: str
    left: int
    back: int

    def text(self, now: int) -> str:
        """Return the gap in words, as seen at `now` (ns)."""
        return sentence("was_gone", node=self.node, time=_seconds(self.back - self.left), ago=_seconds(now - self.back))


class PublisherGaps:
    """Gaps on the topics that tokens wait for, as far as `update` has seen them."""

    def __init__(self) -> None:
        self._there: dict[str, set[str]] = {}  # topic -> who published on it at the last update
        self._left: dict[str, dict[str, int]] = {}  # topic -> who left it, and when
        self._last: dict[str, PublisherGap] = {}

    def update(self, now: int, publishers: Mapping[str, Collection[str]]) -> None:
        """Compare with the last update. `publishers`: awaited topic -> the other nodes that publish on it."""
        for known in (self._there, self._left, self._last):
            for topic in known.keys() - publishers.keys():
                del known[topic]
        for topic, names in publishers.items():
            there, left = set(names) - {UNKNOWN_NODE}, self._left.setdefault(topic, {})
            left.update(dict.fromkeys(sorted(self._there.get(topic, there) - there), now))
            for name in sorted(there & left.keys()):
                self._last[topic] = PublisherGap(name, left.pop(name), now)
            self._there[topic] = there

    def since(self, time: int, topics: Iterable[str]) -> PublisherGap | None:
        """Return the last gap on one of these topics that ended after a time (ns)."""
        gaps = [gap for topic in topics if (gap := self._last.get(topic)) is not None and gap.back > time]
        return max(gaps, key=lambda gap: gap.back, default=None)


class WaitingTokens:
    """The waiting tokens of one robot.

    missed        topic -> when its last message came too early (ns)
    uncorrelated  topic -> key of a wait -> when the last message came that does not match its correlation keys (ns)
    """

    def __init__(
        self, robot: str, mission: Mission, node: Node, middleware: Middleware, scheduler: Scheduler, runner: Runner
    ) -> None:
        self.missed: dict[str, int] = {}
        self.uncorrelated: dict[str, dict[int, int]] = {}
        self._graph: dict[str, tuple[str, ...]] = {}  # who else published on each topic at the last look
        self._robot, self._mission, self._node, self._runner = robot, mission, node, runner
        self._middleware, self._scheduler = middleware, scheduler
        self._topics: Sequence[TopicInfo] = ()  # what these were taken from
        self._listed: Sequence[TopicInfo] = ()  # what `_others` were taken from
        self._others: Mapping[str, Collection[str]] = {}
        self._warned = 0  # how many warnings there were then
        self._gaps = PublisherGaps()
        self._seen: dict[Hashable, int] = {}  # waiting token -> when `list` saw it first
        self.person: tuple[str, int] = ("", 0)  # who has suspended the mission, since when (ns)
        self._suspended: dict[int, int] = {}  # key of a handler that suspends its scope -> since when

    def on_message(self, topic: str, *, awaited: bool) -> None:
        """Record a message on a topic (its qualified name), and whether a token waited for it."""
        if awaited:
            self.missed.pop(topic, None)
        else:
            self.missed[topic] = self._scheduler.now

    def on_uncorrelated(self, topic: str, waits: Sequence[int]) -> None:
        """Record that a message did not match the correlation keys of these waits, which are all of its topic."""
        self.uncorrelated[topic] = dict.fromkeys(waits, self._scheduler.now)

    def mismatch(self, key: int) -> int | None:
        """When (ns) the last message came that does not match the correlation keys of a wait; None if none came."""
        return max((waits[key] for waits in self.uncorrelated.values() if key in waits), default=None)

    def state(self, wait: Wait) -> object:
        """Return a value that is cheap to compare: `details` differ only if it does."""
        key, runner = wait.key, self._runner
        server = runner.server_silence(key), runner.server_mismatch(key)
        return wait.paused, wait.due, self.person, runner.request(key), self.mismatch(key), *server

    def last_miss(self, wait: Wait) -> tuple[int, str] | None:
        """When (ns) the last message came that a token waits for, and why it did not count; None if none came."""
        if (mismatch := self.mismatch(wait.key)) is not None:
            return mismatch, sentence("mismatch")
        if not self.missed:
            return None
        topics = (node.catch.topic for node in (wait.node, *wait.catch.parts) if node.catch is not None)
        times = [self.missed[topic] for topic in topics if topic in self.missed]
        return (max(times), sentence("unawaited")) if times else None

    def since(self, wait: Wait, now: int) -> int:
        """When `list` saw a token first (ns), else `now`."""
        return min(now, self._seen.get(wait.key, now))

    def table(self, engine: Engine, epoch: int) -> dict[str, int]:
        """Return since when persons are waited for, as a table (`fame.robot.state_tables`); `epoch` is the date of
        time 0 (ns since 1970)."""
        people = [wait.key for wait in _waits(engine) if wait.catch.trigger is USER]
        return {str(key): self._seen.setdefault(key, self._scheduler.now) + epoch for key in people}

    def restore(self, table: Mapping[str, int], epoch: int) -> None:
        """Take from a table since when persons are waited for."""
        self._seen |= {int(key): since - epoch for key, since in table.items()}

    def refresh_publishers(self) -> bool:
        """Look up the publishers. Returns whether they or the warnings have changed; `details` differ then."""
        topics, warned = known_topics(self._middleware), len(self._middleware.warnings)
        if topics is self._topics and warned == self._warned:
            return False
        before, self._topics = (self._graph, self._warned), topics
        self._warned = warned
        self._graph = {topic: tuple(sorted(set(names))) for topic, names in self._publishers().items() if names}
        return (self._graph, warned) != before

    def list(self, engine: Engine, most: int | None = None) -> list[WaitingToken]:
        """Return the tokens that wait, at most `most`. Call it regularly: times and gaps are those between calls."""
        waits = list(islice(_waits(engine), most))
        joins = list(islice(_joins(engine), None if most is None else most - len(waits)))
        now, publishers = self._scheduler.now, self._publishers()
        self._note([*(wait.key for wait in waits), *((scope.key, join.id) for scope, join, _ in joins)], now)
        self.on_suspended(engine)
        awaited = [self._awaited(wait) for wait in waits]
        self._gaps.update(now, {topic: publishers.get(topic, ()) for topics in awaited for topic in topics})
        describe = _Describer(self._node.namespace, self._runner, self._conditions, self._missed_hint, publishers)
        waiting_tokens = []
        for wait, topics in zip(waits, awaited, strict=True):
            since = self._seen[wait.key]
            gap = self._gaps.since(since, topics)
            hint = gap.text(now) if gap is not None else self._server(wait)
            text = describe.wait(wait)[1] + (f" ({hint})" if hint else "")
            counts = {topic: len(publishers.get(topic, ())) for topic in topics}
            by = self._suspender(wait, now)
            waiting_tokens.append(WaitingToken(self._robot, wait.node.id, text, since, counts, self._place(wait), by))
        for scope, join, held in joins:
            empty = held.count(0)
            text = sentence("flows", open=empty, all=join.spec.need) if empty else sentence("activation")
            place = self._shown(join)
            waiting_tokens.append(WaitingToken(self._robot, join.id, text, self._seen[scope.key, join.id], place=place))
        return waiting_tokens

    def count(self, engine: Engine) -> int:
        """Return the number of tokens that wait."""
        return sum(1 for _ in _waits(engine)) + sum(1 for _ in _joins(engine))

    def on_suspended(self, engine: Engine) -> None:
        """Record since when scopes are suspended."""
        scopes = (scope for instance in engine.instances.values() for scope in scopes_of(instance.root))
        handlers = [scope.suspender.key for scope in scopes if scope.suspender is not None]
        self._suspended = {key: self._suspended.get(key, self._scheduler.now) for key in handlers}

    def _suspender(self, wait: Wait, now: int) -> str:
        """Who suspends a token, since when."""
        if not wait.paused:
            return ""
        handler, since = suspender(wait), ""
        if wait.due:
            handled = handler is not None
            end = sentence("handler_ends", handler=self._label(handler)) if handled else sentence("continues")
            return sentence("goes_on", why=_came_due(wait), end=end)
        begun = self._suspended.get(handler.key) if handler is not None else self.person[1] if self.person[0] else None
        if begun is not None:
            since = f" since {_seconds(now - begun)}"
        return sentence("suspended", by=self._label(handler)) + since

    def _label(self, handler: Scope | None) -> str:
        """The name of an event sub-process that suspends a token; without one a person, or the robot is on hold."""
        if handler is None or handler.node is None:
            return self.person[0] or sentence("hold")
        name = self._elements.get((handler.node.file, handler.node.id))
        return f'"{name.name}"' if name is not None and name.name else handler.node.id

    def _shown(self, node: ProgramNode) -> str:
        element = self._elements.get((node.file, node.id))
        return display_name(node.id, element.name if element is not None else "")

    def _place(self, wait: Wait) -> str:
        """The element of a token; in a called process the outermost call comes first, as that is what is drawn."""
        call, called = None, ""
        scope: Scope | None = wait.scope
        while scope is not None:
            node = scope.node
            if node is not None and isinstance(self._elements.get((node.file, node.id)), model.CallActivity):
                called = called or (scope.body.id if scope.body is not None else "")
                call = node
            scope = scope.parent
        if call is None:
            return self._shown(wait.node)
        return f"{self._shown(call)}, inside it {called} at {self._shown(wait.node)}"

    @cached_property
    def _elements(self) -> Mapping[tuple[str, str], model.FlowNode]:
        """The elements of the mission, by file and id."""
        return {(home.file, node.id): node for home, node in self._mission.flow_nodes()}

    def starts(
        self, engine: Engine, due: Mapping[int, int], *, epoch: datetime, by_message: bool
    ) -> Iterator[WaitingToken]:
        """Yield the start events that wait for their trigger. `due`: key of an armed timer start -> its time (ns).

        `epoch` is the date of time 0.
        """
        for key, time in due.items():
            start = engine.armed_starts[key]
            by_date = start.catch is not None and start.catch.timer == "date"
            moment = date_text(date_at(epoch, time)) if by_date else f"{time / SECOND:g} s"
            yield WaitingToken(self._robot, start.id, sentence("start_at", moment=moment))
        for start in engine.waiting_starts if engine.held is not None else ():
            yield WaitingToken(self._robot, start.id, sentence("due", why=sentence("came_due")))
        publishers = self._publishers() if by_message else {}
        for topic, nodes in engine.program.starts.items() if by_message else ():
            full = resolve(topic, self._node.namespace)
            text, counts = sentence("start", topic=_topic_text(full, publishers)), {full: len(publishers.get(full, ()))}
            for node in nodes:
                yield WaitingToken(self._robot, node.id, text, topics=counts)

    def details(self, wait: Wait) -> dict[str, Any]:
        """Return what a token waits for: its kind, in words, and the topics and condition that would move it."""
        catch = wait.catch
        describe = _Describer(self._node.namespace, self._runner, self._conditions, lambda topic: "", None)
        kind, text = describe.wait(wait)
        reasons: dict[str, Any] = {"kind": kind, "text": text}
        topics = self._awaited(wait)
        if topics:
            reasons["topics"] = list(topics)
            reasons["publishers"] = {topic: list(self._graph.get(topic, ())) for topic in topics}
            if apart := self._apart(topics):
                reasons["mismatches"] = apart
        if wait.paused:
            reasons["suspended"], reasons["by"] = True, self._label(suspender(wait))
        request = self._runner.request(wait.key)
        if isinstance(request, Act):
            reasons["action"] = resolve(request.action, self._node.namespace)
        elif isinstance(request, Call):
            reasons["service"] = resolve(request.service, self._node.namespace)
        if (silence := self._runner.server_silence(wait.key)) is not None:
            reasons |= {silence[0]: silence[1], "mismatches": self._mismatches(wait)}
        parts = [(node.file, node.id) for node in (wait.node, *catch.parts)]
        conditions = [condition for part in parts if (condition := self._conditions.get(part)) is not None]
        if conditions:
            reasons["conditions"] = [
                {"text": condition.text, "reads": sorted(effects_of(condition).reads)} for condition in conditions
            ]
        return reasons

    def _server(self, wait: Wait) -> str:
        """What is to be known of the server that a token waits for, in words; empty if it is at work."""
        silence = self._runner.server_silence(wait.key)
        if silence is None:
            return ""
        return "; ".join((silence_text(*silence, self._scheduler.now), *self._mismatches(wait)))

    def _mismatches(self, wait: Wait) -> Sequence[str]:
        """What keeps the endpoints of an awaited server apart."""
        request, warnings = self._runner.request(wait.key), self._middleware.warnings
        if not isinstance(request, Act | Call):
            return []
        server = self._runner.server_mismatch(wait.key)
        name = resolve(request.action if isinstance(request, Act) else request.service, self._node.namespace)
        topics = [each for each in warnings if each.kind == "mismatch" and f"{each.topic}/".startswith(f"{name}/")]
        return [*filter(None, [server]), *map(str, topics)]

    def _apart(self, topics: Iterable[str]) -> Sequence[str]:
        """What keeps publishers of awaited topics, if they are still there, from this robot."""
        mine = f"{self._node.full_name} receives nothing from"
        starts = tuple(f"{topic}: {mine} {by}: " for topic in topics for by in self._graph.get(topic, ()))
        warnings = (str(each) for each in self._middleware.warnings if each.kind == "mismatch")
        return [text for text in warnings if text.startswith(starts)]

    def _note(self, keys: Iterable[Hashable], now: int) -> None:
        self._seen = {key: self._seen.get(key, now) for key in keys}

    def _publishers(self) -> Mapping[str, Collection[str]]:
        """The other nodes that publish on each topic, once for each publisher."""
        topics, own = known_topics(self._middleware), self._node.full_name
        if topics is not self._listed:
            self._listed = topics
            self._others = {info.name: [name for name in info.publishers if name != own] for info in topics}
        return self._others

    def _awaited(self, wait: Wait) -> Collection[str]:
        """The topics whose message would move a token, by full name."""
        nodes = (wait.node, *wait.catch.parts)
        names = [node.catch.topic for node in nodes if node.catch is not None and node.catch.topic]
        if not names and (topic := self._runner.awaited_topic(wait.key)):
            names = [topic]
        return [resolve(name, self._node.namespace) for name in names]

    @cached_property
    def _conditions(self) -> Mapping[tuple[str, str], model.Expression]:
        """The conditions of conditional events, by file and id."""
        return {
            (home.file, node.id): definition.condition
            for home, node in self._mission.flow_nodes()
            for definition in node.defined(model.ConditionalDefinition)
            if definition.condition is not None
        }

    def _missed_hint(self, topic: str) -> str:
        if topic not in self.missed:
            return ""
        last = sentence("last", ago=_seconds(self._scheduler.now - self.missed[topic]))
        return f" ({last}, {sentence('before')})"


@dataclass(frozen=True, slots=True)
class _Describer:
    """Says in words what tokens wait for, at one moment."""

    namespace: str
    runner: Runner
    conditions: Mapping[tuple[str, str], model.Expression]
    missed_hint: Callable[[str], str]
    publishers: Mapping[str, Collection[str]] | None
    """By topic; None: whether somebody publishes is said elsewhere."""

    def wait(self, wait: Wait) -> tuple[str, str]:
        """Return what moves a token, as docs/recording_format.md has it (``topic``, ``timer`` ...), and in words."""
        catch, variables = wait.catch, wait.scope.variables
        if wait.due:
            return "due", sentence("due", why=_came_due(wait))
        if catch.trigger is INCIDENT:
            return "incident", sentence("repair")
        if catch.timer:
            return "timer", sentence("timer", kind=catch.timer)
        if catch.trigger is USER:
            return "user", A_PERSON
        if catch.parts:
            parts = [self._trigger(item, item.catch or catch, variables) for item in catch.parts]
            return "alternatives", (", or " if any("," in part for part in parts) else " or ").join(parts)
        kind = "topic" if catch.topic else "condition" if catch.trigger is waiting.CONDITION else "script"
        awaited = self.runner.awaited_topic(wait.key)
        if awaited is not None:
            return kind, sentence("receive", topic=_topic_text(resolve(awaited, self.namespace), self.publishers))
        return kind, self.runner.waits(wait.key) or self._trigger(wait.node, catch, variables)

    def _trigger(self, node: ProgramNode, catch: Catch, variables: Mapping[str, Any]) -> str:
        """What an event waits for."""
        if catch.topic:
            text = _topic_text(resolve(catch.topic, self.namespace), self.publishers)
            return text + self.missed_hint(catch.topic)
        if catch.trigger is waiting.CONDITION:
            return self._condition(node, variables)
        return catch.trigger.name

    def _condition(self, node: ProgramNode, variables: Mapping[str, Any]) -> str:
        """The condition, and the values that it reads."""
        condition = self.conditions.get((node.file, node.id))
        if condition is None:
            return waiting.CONDITION.name
        values = [value_text(name, variables, reprlib.repr) for name in sorted(effects_of(condition).reads)]
        return sentence("condition", text=condition.text) + (f" ({', '.join(values)})" if values else "")


def _waits(engine: Engine) -> Iterator[Wait]:
    return chain.from_iterable(instance.waits() for instance in engine.instances.values())


def _joins(engine: Engine) -> Iterator[tuple[Scope, ProgramNode, Sequence[int]]]:
    return chain.from_iterable(joins_reached(instance.root) for instance in engine.instances.values())


def silence_text(kind: str, since: int, now: int) -> str:
    """Return what `Runner.server_silence` says, in words, at `now` (ns)."""
    return sentence(kind, time=_seconds(max(0, now - since)))


def suspender(wait: Wait) -> Scope | None:
    """Return the scope of the event sub-process that suspends a token; None if the robot is on hold."""
    scope: Scope | None = wait.scope
    while scope is not None:
        if scope.suspender is not None and wait.key < scope.mark:
            return scope.suspender
        scope = scope.parent
    return None


def _came_due(wait: Wait) -> str:
    """Why a suspended token goes on as soon as it is no longer suspended."""
    return sentence("completed" if wait.catch.trigger in (USER, waiting.MESSAGE) else "came_due")


def _topic_text(topic: str, publishers: Mapping[str, Collection[str]] | None) -> str:
    return sentence("topic" if publishers is None or publishers.get(topic) else "nobody", topic=topic)


def _seconds(time: float) -> str:
    return f"{time / SECOND:.3g} s"
