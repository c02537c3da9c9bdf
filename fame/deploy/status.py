"""A robot's status on ``bpmn_status``, every second and whenever it answers somebody, and its engine's warnings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.dataclasses import asdict, dataclass
from fame.deploy.authentication import GONE
from fame.deploy.envelope import STRING, Envelope, Problem, Report
from fame.deploy.machine import boundary
from fame.deploy.request_verifier import RequestVerifier
from fame.deploy.signing import Identity
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, EndpointWarning, Middleware, Node, TopicInfo, known_topics
from fame.version import PROTOCOL, current

if TYPE_CHECKING:
    from fame.robot import RobotNode

_KEPT = 10
"""How many warnings a report has."""
_CAUSES = 20
"""How many causes are told apart within a second; all others count as one."""
_OTHER_CAUSE = ""
WAITS = 100
"""How many waiting tokens, and how many incidents, a report describes at most: it is made each second."""


class EngineWarnings:
    """The warnings of an engine: call it with one, and `warn` gets its text; a report shows the latest ones.

    `poll` takes the new warnings of the middleware and its losses. Those from before this object was made are old.
    """

    def __init__(self, middleware: Middleware, except_for: str, warn: Callable[[str], object]) -> None:
        self._middleware, self._except_for, self._warn = middleware, except_for, warn
        self._seen = len(middleware.warnings)
        self._losses: list[str] = []
        self._latest: deque[EndpointWarning] = deque(maxlen=_KEPT)

    def __call__(self, warning: EndpointWarning) -> None:
        self._latest.append(warning)
        self._warn(str(warning))

    def poll(self) -> list[EndpointWarning]:
        """Report the new warnings; return those about the topic `except_for` instead."""
        new = list(self._middleware.warnings[self._seen :])
        self._seen += len(new)
        for warning in new:
            if warning.topic != self._except_for:
                self(warning)
        before, self._losses = self._losses, self._middleware.losses()
        for text in self._losses:  # they grow: the latest is told, and the report shows each once
            if text not in before:
                self._warn(text)
        return [warning for warning in new if warning.topic == self._except_for]

    def lines(self) -> list[str]:
        """Return the latest warnings, for a report."""
        return [*self._losses[:_KEPT], *map(str, self._latest)]


class RateLimiter:
    """Passes a text on to `warn` at once, and more of the same cause at the end of each second, as one with a count."""

    def __init__(self, scheduler: Scheduler, warn: Callable[[str], object]) -> None:
        self._scheduler, self._pass_on = scheduler, warn
        self._held: dict[str, tuple[int, str]] = {}  # cause -> number held back, and the last of them
        self._timer: Entry | None = None

    def __call__(self, text: str, cause: str = "") -> None:
        """Pass a text on, now or with others of its cause; without one the text is its own cause."""
        cause = cause or text
        if cause not in self._held and len(self._held) >= _CAUSES:
            cause = _OTHER_CAUSE
        if cause in self._held:
            self._held[cause] = self._held[cause][0] + 1, text
            return
        self._held[cause] = 0, ""
        if self._timer is None:
            self._timer = self._scheduler.after(SECOND, self._end_second, Kind.TIMER)
        self._pass_on(text)

    def _end_second(self) -> None:
        """Pass on what was held back; its causes are held back for another second."""
        held = {cause: found for cause, found in self._held.items() if found[0]}
        self._held = dict.fromkeys(held, (0, ""))
        self._timer = self._scheduler.after(SECOND, self._end_second, Kind.TIMER) if held else None
        for count, text in held.values():
            self._pass_on(f"{text} ({count} like this within a second)" if count > 1 else text)

    def close(self) -> None:
        """Stop, and drop what is held back."""
        if self._timer is not None:
            self._timer.cancel()


HEARTBEAT = 1.0
"""How often a robot publishes its status (s)."""
_OTHERS = 100
"""How many other engines of the same name are remembered."""


@dataclass(slots=True)
class _Namesake:
    """Another engine of the name: when it was heard first and last (ns), whether it counts, and is `proved`."""

    first: int
    last: int
    proved: bool
    text: str
    counts: bool = False


class Namesakes:
    """Finds other engines that have the name of this one, as when a network that was split is whole again."""

    def __init__(self, robot: str, born: int) -> None:
        self._robot, self._born = robot, born
        self._heard: dict[str, _Namesake] = {}

    def hear(self, other: Report, proved: bool, now: int) -> str:
        """Take a report of another engine at `now` (ns); return a text when it counts for the first time.

        A younger one that runs nothing counts only if it has not left after `GONE` s.
        """
        if other.engine not in self._heard:
            self._heard = {name: each for name, each in self._heard.items() if _is_there(each, now)}
            if len(self._heard) >= _OTHERS:
                return ""
            self._heard[other.engine] = _Namesake(now, now, proved, self._text(other, proved))
        namesake = self._heard[other.engine]
        namesake.last, namesake.proved, before = now, proved, namesake.counts
        lasts = now - namesake.first > GONE * SECOND
        namesake.counts = before or lasts or other.born < self._born or other.state != "waiting"
        return namesake.text if namesake.counts and not before else ""

    def _text(self, other: Report, proved: bool) -> str:
        if not proved:
            why = "cannot tell it from a stranger: it does not prove its name"
        else:
            why = "runs a process" if other.born < self._born else "is older"
        age = "an older" if other.born < self._born else "another"
        return f"{age} engine has the name {self._robot!r}; this one continues, because it {why}"

    def texts(self, now: int) -> list[str]:
        """Return one text for each engine of this name that is there `now` (ns), without repetition."""
        return list(dict.fromkeys(each.text for each in self._heard.values() if each.counts and _is_there(each, now)))

    def is_contested(self, now: int) -> bool:
        """Return whether another one is there `now` (ns) that proves the name."""
        return any(each.counts and each.proved and _is_there(each, now) for each in self._heard.values())


def _is_there(namesake: _Namesake, now: int) -> bool:
    return now - namesake.last <= GONE * SECOND


class StatusPublisher:
    """The publisher of a robot's reports.

    `progress` gives what a `Report` has beside the answer. It refuses the messages that `warnings` returns, and listens
    to its own status: of two engines with one name the younger leaves, unless it runs something; while both are there
    each warns of the other. Where keys are used reports are signed by `identity`, and only an engine that proves its
    name to the `verifier` ends another.
    `on_refusal` gets reason, deployment (empty if it is not an answer) and cause of each refusal; `note` gets other
    texts, `on_report` each report without an answer.
    Refusals without a waiting sender are reported once a second for each cause.
    """

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        progress: Callable[[], Mapping[str, Any]],
        *,
        verifier: RequestVerifier,
        identity: Identity | None,
        warnings: EngineWarnings,
        on_refusal: Callable[[str, str, str], object],
        note: Callable[[str], object],
        on_report: Callable[[Report], object],
    ) -> None:
        self._verifier, self._identity, self._progress = verifier, identity, progress
        self._on_report, self._note = on_report, note
        self._key = identity.key if identity is not None else ""
        self._namesakes = Namesakes(verifier.robot, verifier.born)
        self._scheduler, self._on_refusal, self._warnings = scheduler, on_refusal, warnings
        self._garbage = RateLimiter(scheduler, lambda reason: self._publish_refusal("", reason, None, ""))
        self._out = node.publisher("bpmn_status", STRING, LATCHED)
        node.subscription(
            "bpmn_status", STRING, boundary(self._on_own_status, note)
        )  # without history: each report is repeated

    def begin(self) -> None:
        """Publish now, and every second from now on."""
        self.publish()
        self._refuse_other_types()
        self._pulse = self._scheduler.after(round(HEARTBEAT * SECOND), self.begin, Kind.TIMER)

    def publish(
        self,
        answer: str = "",
        deployment: str = "",
        reason: str = "",
        problem: Problem | None = None,
        *,
        migration: Mapping[str, Any] | None = None,
        repeated: bool = False,
        cause: str = "",
    ) -> None:
        """Publish a report, perhaps as an answer; one that is `repeated` goes only to the sender that asked.

        `cause` is that of a refusal: what refusals with different texts have in common.
        """
        if answer != "refused" or repeated:
            self._publish(answer, deployment, reason, problem, migration)
        elif deployment:
            self._publish_refusal(deployment, reason, problem, cause)
        else:
            self._garbage(reason, cause)

    def _publish_refusal(self, deployment: str, reason: str, problem: Problem | None, cause: str) -> None:
        self._publish("refused", deployment, reason, problem)
        self._on_refusal(reason, deployment, cause)

    def _publish(
        self,
        answer: str,
        deployment: str,
        reason: str,
        problem: Problem | None,
        migration: Mapping[str, Any] | None = None,
    ) -> None:
        progress = dict(self._progress())
        more = {name: progress.pop(name) for name in ("goals", "previous") if name in progress}
        said: dict[str, Any] = {"state": {"protocol": PROTOCOL, "fame": current(), **more}}
        report = Report(
            robot=self._verifier.robot,
            deployment=deployment,
            answer=answer,
            reason=reason,
            problem=asdict(problem) if problem is not None else {},
            migration=migration or ({} if deployment else said),
            born=self._verifier.born,
            time=self._scheduler.now / SECOND,
            key=self._key,
            voucher=self._identity.voucher if self._identity is not None else "",
            **{**progress, "warnings": [*self._namesakes.texts(self._scheduler.now), *progress.get("warnings", ())]},
        )
        if not answer:
            self._on_report(report)
        key = self._identity.private if self._identity is not None else None
        self._out.publish(messages.create(STRING, report.to_json(key)))

    def close(self) -> None:
        self._pulse.cancel()
        self._garbage.close()

    def _refuse_other_types(self) -> None:
        """Refuse messages of another type, which the middleware only warns of."""
        for warning in self._warnings.poll():
            self.publish("refused", reason=str(warning), cause=warning.kind)

    def _on_own_status(self, message: Any) -> None:
        """Raise FameError if an older engine proves that it is this robot, and nothing runs here."""
        other, born = Report.from_json(message.data), self._verifier.born
        if other is None or not other.born or other.engine == f"{born} {self._key}":
            return
        proved = self._verifier.proves_presence(other)
        if proved and other.born < born and self._progress()["state"] == "waiting":
            raise FameError(f"there is an engine {self._verifier.robot!r} already")
        if text := self._namesakes.hear(other, proved, self._scheduler.now):
            self._note(text)

    @property
    def is_contested(self) -> bool:
        """Whether another engine is there that proves to be this robot."""
        return self._namesakes.is_contested(self._scheduler.now)


class Absences:
    """Finds the robots of a team that have no engine any more."""

    def __init__(self) -> None:
        self._since: dict[str, int] = {}
        self._polled = -1

    def seen(self, team: Collection[str], now: int, engines: Callable[[], Collection[str]]) -> dict[str, float]:
        """For how long each has been absent (s) at `now` (ns); `engines` is called once a heartbeat."""
        if team and (self._polled < 0 or now - self._polled >= HEARTBEAT * SECOND):
            self._polled, there = now, engines()
            self._since = {robot: self._since.get(robot, now) for robot in team if robot not in there}
        return {robot: (now - since) / SECOND for robot, since in self._since.items() if robot in team}


_PATIENCE = 5.0
"""For how long a promised end of a topic may be gone before that is told (s): a robot that resumes takes a while."""


class LostEnds:
    """Finds promised ends of topics that are gone: their robots came back without the mission, or got another one."""

    def __init__(self) -> None:
        self._deployment, self._polled = "", -1
        self._since: dict[str, int] = {}
        self._robots: dict[str, list[str]] = {}  # who was seen at a topic

    def texts(self, envelope: Envelope | None, robot: str, now: int, middleware: Middleware) -> list[str]:
        """Return what to say at `now` (ns) of the ends that `robot` was promised; looks once a heartbeat."""
        if envelope is None or not envelope.promises:
            return []
        if envelope.deployment != self._deployment:
            self._deployment, self._polled, self._since, self._robots = envelope.deployment, -1, {}, {}
        if self._polled < 0 or now - self._polled >= HEARTBEAT * SECOND:
            self._polled = now
            there = {info.name: info for info in known_topics(middleware, envelope.promises)}
            for topic, end in envelope.promises.items():
                self._look(topic, _others(there.get(topic), end, robot), now)
        return [
            self._text(topic, envelope.promises[topic])
            for topic, since in self._since.items()
            if now - since > _PATIENCE * SECOND
        ]

    def _look(self, topic: str, robots: list[str], now: int) -> None:
        if robots:
            self._robots[topic] = robots
            self._since.pop(topic, None)
        else:
            self._since.setdefault(topic, now)

    def _text(self, topic: str, end: str) -> str:
        does = "publishes it" if end == "publisher" else "subscribes to it"
        known = ", ".join(self._robots.get(topic, ()))
        return f"{topic}: {known} no longer {does}" if known else f"{topic}: no other robot {does}"


def _others(info: TopicInfo | None, end: str, robot: str) -> list[str]:
    """The robots, or nodes, beside `robot` that have an end of a topic."""
    names = () if info is None else info.publishers if end == "publisher" else info.subscribers
    return sorted({name.strip("/").partition("/")[0] for name in names if not name.startswith(f"/{robot}/")})


def state_of(process: RobotNode | None) -> str:
    """Return the `Report.state` of a process."""
    if process is None:
        return "waiting"
    if process.engine.incidents:
        return "incident"
    if process.suspension.by:
        return "suspended"
    if process.engine.instances:
        return "running"
    return "failed" if process.failed else "idle"


def progress(process: RobotNode | None) -> dict[str, Any]:
    """Return the fields of a `Report` on a process."""
    if process is None:
        return {}
    try:
        return _described(process)
    except Exception as error:  # what cannot be described still runs
        return {"error": f"its state cannot be described: {type(error).__name__}: {error}"}


def _described(process: RobotNode) -> dict[str, Any]:
    errors = [instance.error for instance in process.instances if instance.error is not None]
    waiting = process.waiting_tokens(WAITS)
    return {
        "instances": len(process.engine.instances),
        "started": process.started,
        "completed": process.completed,
        "failed": process.failed,
        "elements": process.elements,
        "ahead": process.pending_starts,
        "waits": [
            {
                "element": wait.element,
                "for": wait.text,
                "since": wait.since / SECOND,
                "topics": dict(wait.topics),
                **({"place": wait.place} if wait.place not in ("", wait.element) else {}),
                **({"suspended": wait.suspended} if wait.suspended else {}),
            }
            for wait in waiting
        ],
        "more_waits": max(0, process.waiting.count(process.engine) - WAITS) if len(waiting) >= WAITS else 0,
        "untaken": process.untaken(),
        "offers": process.offers(),
        "error": str(errors[-1]) if errors else "",
        "suspended": process.suspension.to_json(),
        "goals": process.runner.cancelled.actions() if process.suspension.by else [],
        "incidents": [{"element": id, "code": code, "text": text} for id, code, text in process.incidents[:WAITS]],
        "errors": [{**error.to_json(), "name": error.name} for error in errors],
    }
