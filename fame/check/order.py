"""Who waits for whom: robots that wait for each other, and signals thrown before somebody can be there to catch them.

Nothing is said where a script names a topic that is computed: it may throw anything.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial

from fame.bpmn.model import Event, FlowNode, SubProcess, Task, TimerDefinition
from fame.bpmn.topics import topics_of
from fame.check.findings import Finding, Level
from fame.check.graph import graph, is_event
from fame.check.progress import Progress, Wait, progress
from fame.check.recursion import passes_at_once
from fame.check.scope import Subject, Unit
from fame.check.topics import End, Table, level_of, public_topics
from fame.iso8601 import parse_duration

_SAYS = re.compile(r"\b(?:signal|publish|createPublisher)\b")
_SAYS_LITERALLY = re.compile(
    r"""\bsignal\s*\(\s*["']|\bpublish\s*\(\s*["']|\bcreatePublisher\s*\(\s*["'`][\w/]+["'`]\s*,\s*["'`]"""
)
_AWAITS = re.compile(
    r"^(?:\w+\s*=\s*)?await\s+(?:receive|robot\.call|robot\.act|sleep\s*\(\s*0*\.?0*[1-9])", re.MULTILINE
)
"""A statement of a script, not inside another, that takes its time."""


def order_findings(subject: Subject, team: Sequence[Subject]) -> Iterator[Finding]:
    """Of the processes of a file; `team`: all files of the mission, this one among them."""
    units = [unit for one in team for unit in one.units]
    if not any(_may_throw_anything(node) for unit in units for node in unit.process.body.walk()):
        roots = [root for one in team for root in one.roots]
        public, level = public_topics(team), level_of(team)
        thrown = {name: ends for name, ends in public.items() if any(end.throws for end in ends)}
        found = (*_deadlocks(roots, thrown, level), *_too_early(roots, public, thrown, level))
        yield from (one for one in found if one.file in {unit.home.file for unit in subject.units})


def _may_throw_anything(node: FlowNode) -> bool:
    text = node.script.text if isinstance(node, Task) and node.script is not None else ""
    return len(_SAYS.findall(text)) > len(_SAYS_LITERALLY.findall(text))


# ---- robots that wait for each other ---------------------------------------------------------------------------------


def _deadlocks(roots: Sequence[Unit], thrown: Table, level: Level) -> Iterator[Finding]:
    found = progress(roots, thrown)
    for wait in found.waits:
        for name in sorted(wait.topics if not wait.escape else ()):
            causes = [cause for end in thrown[name] if end.throws for cause in _before(end, found)]
            if causes:
                yield wait.unit.finding(level, f"waits for {name}, {_cause(wait, causes[0])}", wait.node)


def _before(end: End, found: Progress) -> Iterator[Wait]:
    """Where the process that throws waits before it gets there."""
    return (wait for wait in found.waits if end.unit in wait.root.closure())


def _cause(wait: Wait, cause: Wait) -> str:
    if cause.root is wait.root:
        return f"which only {label(wait.root)} itself throws, later: it waits for ever"
    other = ", ".join(sorted(cause.topics))
    return f"but {label(cause.root)}, which throws it, waits for {other} before: they wait for each other"


def label(unit: Unit) -> str:
    """What people call a process: its pool's name, else its own."""
    pool = next((pool for pool in unit.home.participants if pool.process == unit.process.id), None)
    return (pool or unit.process).label


# ---- signals that are thrown too early -------------------------------------------------------------------------------


def _too_early(roots: Sequence[Unit], public: Table, thrown: Table, level: Level) -> Iterator[Finding]:
    """Signals that are only thrown as the mission begins, and whose catchers all have to wait for something before."""
    for name, ends in thrown.items():
        throws, catches = [end for end in ends if end.throws], [end for end in ends if not end.throws]
        kept = not catches or any(end.topic is None or end.topic.queue for end in catches)
        if not kept and all(
            _only_as_it_begins(roots, end) and _is_early(roots, public, end, catches) for end in throws
        ):
            text = f"throws {name} as the mission begins, before {catches[0].node.label} can wait for it"
            yield throws[0].finding(level, f"{text}: a signal is not kept, unless the catching event has a queue")


def _is_early(roots: Sequence[Unit], public: Table, thrown: End, catches: Sequence[End]) -> bool:
    """Whether no catching element can be reached at once, before a token is past the throw."""
    at_once = progress(roots, public, partial(_may_pass_before, thrown.node))
    return not any((end.unit, end.node.id) in at_once.reached for end in catches)


def _only_as_it_begins(roots: Sequence[Unit], end: End) -> bool:
    """Whether a process that starts by itself gets there at once, and never again."""
    scope = graph(end.unit.process.body)
    if end.unit not in roots or end.node.id not in scope.nodes:
        return False
    before = [scope.nodes[id] for id in scope.before(end.node.id)]
    starts = [node for node in scope.body.nodes if is_event(node, "start")]
    return (
        passes_at_once(end.node)
        and end.node not in before
        and all(passes_at_once(node) and not isinstance(node, SubProcess) for node in before)
        and not any(isinstance(node, Event) and node.definitions for node in starts)
    )


def _may_pass_before(throw: FlowNode, node: FlowNode) -> bool:
    """Whether a token may be past a node in the instant in which it came there, before one is past the throw.

    What drivers say takes its time.
    """
    if node is throw or any(topic.qualified.startswith("~/") and not throws for topic, throws in topics_of(node)):
        return False
    if isinstance(node, Event):
        return not any(isinstance(one, TimerDefinition) and _lasts(one) for one in node.definitions)
    if isinstance(node, Task):
        text = node.script.text if node.script is not None and node.script.language == "python" else ""
        return node.kind not in ("user", "manual") and not _AWAITS.search(text)
    return True


def _lasts(timer: TimerDefinition) -> bool:
    """Whether a timer takes its time for certain."""
    try:
        text = timer.expression.text if timer.expression is not None else "PT0S"
        return timer.kind == "duration" and parse_duration(text) != parse_duration("PT0S")
    except ValueError:
        return False
