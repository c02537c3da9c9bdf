"""Assign the pools of a model to robots, find the topics that connect them, and map places in what they are sent.

A robot gets its process with everything that this calls as one file, named after the robot. Both sides have the same
processes with the same elements and texts in the same order, so a line of one is found in the other: that of an
element, or any line of a text.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.pools import Pool, assign_pools, expected_robots, matches, pools_of, shared_topics
from fame.bpmn.reader import read_text
from fame.bpmn.topics import TopicUse
from fame.check.expressions import expressions_in
from fame.deploy.envelope import Report
from fame.errors import DeploymentError, MissionError, ModelError
from fame.robot.endpoints import direct_topic
from fame.text import suggestion


def assign_robots(
    definitions: Definitions, robots: Sequence[str], *, found: bool, only: Sequence[str]
) -> dict[str, Pool]:
    """Return the pool of each robot. Of `robots` that were `found`, not named, some may belong to another model; with
    `only` some of them, pools may stay without a robot.

    Raises DeploymentError and ConfigError for robots that are missing, ModelError for pools that cannot be assigned.
    """
    pools, others = pools_of(definitions), list[str]()
    if found:
        others = [robot for robot in robots if not any(matches(robot, pool) for pool in pools)]
        robots = [robot for robot in robots if robot not in others]
    unknown = [name for name in only if name not in robots]
    wanted = ", ".join(expected_robots(pool) for pool in pools)
    if foreign := ", ".join(name for name in unknown if name in others):
        raise DeploymentError(f"the model has no pool for {foreign}: it is for {wanted}")
    if unknown:
        there = suggestion(unknown[0], [*robots, *others]) if robots or others else "no robot was found"
        raise DeploymentError(f"no engine of a robot named {', '.join(unknown)} (the model is for {wanted}); {there}")
    if only:
        pools = [pool for pool in pools if any(matches(robot, pool) for robot in robots)]
    assigned = assign_pools(pools, robots, file=definitions.file, others=others)
    if not assigned:
        raise DeploymentError(f"found no engine for the robots of this model: {wanted}")
    return assigned


def promises(definitions: Definitions, assigned: Mapping[str, Pool], library: Library) -> dict[str, dict[str, str]]:
    """For each robot, the public topics at which another robot of the collaboration has the opposite end.

    Each topic comes with that end: ``publisher`` or ``subscriber``.
    """
    users: dict[str, dict[str, TopicUse]] = {}  # topic -> robot -> how it uses it
    for robot, pool in assigned.items():
        for topic, use in shared_topics(definitions, [pool], library).items():
            if not topic.startswith("~/"):
                users.setdefault(topic, {})[robot] = use
    promised: dict[str, dict[str, str]] = {robot: {} for robot in assigned}
    for topic, uses in users.items():
        for robot, use in uses.items():
            others = {other: theirs for other, theirs in uses.items() if other != robot}
            promised[robot] |= _promised(topic, use, others)
    return promised


def late_starts(
    definitions: Definitions, assigned: Mapping[str, Pool], library: Library, running: Collection[str]
) -> list[str]:
    """Say of each robot that begins anew, and waits for a signal to start, which of the `running` ones throw it: those
    continue from where they were, and may have thrown it already."""
    uses = {robot: shared_topics(definitions, [pool], library) for robot, pool in assigned.items()}
    warnings = []
    for robot in sorted(assigned.keys() - set(running)):
        starts = assigned[robot].process.body.events("start")
        if any(not start.definitions for start in starts):
            continue
        for name, use in uses[robot].items():
            others = [one for one in sorted(running) if name in uses.get(one, ()) and uses[one][name].throws]
            if others and {end.node.id for end in use.catches} & {start.id for start in starts}:
                warnings.append(f"{robot} waits for {name} to start, which {', '.join(others)} may have thrown already")
    return warnings


def receivers(
    definitions: Definitions, assigned: Mapping[str, Pool], library: Library
) -> dict[str, dict[str, list[str]]]:
    """For each robot, the topics with acknowledgements that it throws, with the other robots that catch them."""
    uses = {robot: shared_topics(definitions, [pool], library) for robot, pool in assigned.items()}
    return {
        robot: {
            name: [one for one, its in uses.items() if one != robot and name in its and its[name].catches]
            for name, use in own.items()
            if use.ttl and use.throws
        }
        for robot, own in uses.items()
    }


def _promised(topic: str, use: TopicUse, others: Mapping[str, TopicUse]) -> dict[str, str]:
    """The opposite ends that others have at a topic of one robot, and at those on which it addresses one of them."""
    ends: dict[str, str] = {}
    if use.addresses:
        ends |= {direct_topic(topic, other): "subscriber" for other in sorted(others) if others[other].takes_messages}
    if use.throws and any(theirs.catches for theirs in others.values()):
        ends[topic] = "subscriber"
    elif use.catches and not use.throws and any(theirs.throws for theirs in others.values()):
        ends[topic] = "publisher"
    return ends


_Place = tuple[str, int]
"""A file, and a line of it (from 1; 0 if unknown)."""


class SourceMap:
    """Maps places of the file that a robot was `sent` to the files of `definitions`, of which `process` is its part."""

    def __init__(self, robot: str, definitions: Definitions, process: Process, library: Library, sent: str) -> None:
        self._robot, self._definitions, self._process = robot, definitions, process
        self._library, self._sent = library, sent

    def place(self, file: str, line: int) -> _Place:
        """Return the place in the sender's files; an unknown one stays as it is."""
        if file != f"{self._robot}.bpmn":
            return file, line
        return self._places.get(line, (file, line)) if line else (self._definitions.file, 0)

    def report(self, report: Report) -> Report:
        """Return a report with the places of its errors, and the texts made of them, in the sender's files."""
        if not (report.errors or report.problem):
            return report
        errors = [self._located(error) for error in report.errors]
        problem = self._located(report.problem)
        return replace(
            report,
            problem=problem,
            reason=str(ModelError(**problem)) if problem else report.reason,
            errors=errors,
            error=str(MissionError(**errors[-1], robot=report.robot)) if report.error and errors else report.error,
        )

    def _located(self, error: Mapping[str, Any]) -> dict[str, Any]:
        if not error:
            return {}
        file, line = self.place(error.get("file", ""), error.get("line", 0))
        known = {name: error[name] for name in ("text", "element", "name", "code") if name in error}
        return {"text": "", **known, "file": file, "line": line}

    @cached_property
    def _places(self) -> dict[int, _Place]:
        """The place of each line that is known."""
        places: dict[int, _Place] = {}
        there = read_text(self._sent).processes
        own_order = _by_file(self._library.closure(self._definitions, self._process))
        for other, (home, body) in zip(there, own_order, strict=False):
            own, theirs = list(_parts(body)), list(_parts(other))
            if [text for _, text in own] == [text for _, text in theirs]:
                for (line, text), (sent_line, _) in zip(own, theirs, strict=True):
                    places.update({sent_line + more: (home.file, line + more) for more in range(text.count("\n") + 1)})
        return places


def _by_file(closure: list[tuple[Definitions, Process]]) -> list[tuple[Definitions, Process]]:
    """The processes file by file, files in the order in which they are met: so are they put together."""
    files = list(dict.fromkeys(home.file for home, _ in closure))
    return sorted(closure, key=lambda found: files.index(found[0].file))


def _parts(process: Process) -> Iterator[tuple[int, str]]:
    """The line of a process, of its elements, and of their texts, each of these with the text.

    A text counts where an element begins on the same line.
    """
    yield process.line, ""
    for body in process.body.bodies():
        yield from ((element.line, "") for element in (*body.nodes, *body.flows, *body.data_objects))
        yield from ((text.expression.line, text.expression.text) for text in expressions_in(body))
