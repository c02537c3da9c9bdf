"""Writes the events of a run as XES (IEEE 1849), for process mining.

Each process instance, with the processes that it calls, is a trace. Each execution of an activity (task, sub-process,
call activity) has a ``start`` and a ``complete``, or an ``ate_abort`` if it was cancelled or failed, and its own
``concept:instance``. The resource is the robot. Times are dates in microseconds, counted from the epoch of the run or
from `EPOCH`.

A trace is written when its instance ends. The remaining ones are written at the end, and the verdicts about properties
as attributes of the log: ``property:NAME``, with sentence, slack and why in it; and ``ended``, with its date.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from typing import Any, BinaryIO
from xml.sax.saxutils import quoteattr

from fame.clock import EPOCH, date_at
from fame.dataclasses import dataclass, field
from fame.engine.program import Mark
from fame.engine.state import Trail
from fame.iso8601 import parse_datetime
from fame.log.elements import ElementInfo
from fame.log.reading import PART
from fame.robot.events import ENDED, Event, Observer
from fame.text import NOT_XML

_LIFECYCLE = {"enter": "start", "leave": "complete", "cancel": "ate_abort", "fail": "ate_abort"}
"""Mark of an activity -> transition of the standard life cycle (IEEE 1849, extension Lifecycle)."""

_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<log xes.version="1849-2016" xes.features="" xmlns="http://www.xes-standard.org/">
  <extension name="Concept" prefix="concept" uri="http://www.xes-standard.org/concept.xesext"/>
  <extension name="Lifecycle" prefix="lifecycle" uri="http://www.xes-standard.org/lifecycle.xesext"/>
  <extension name="Organizational" prefix="org" uri="http://www.xes-standard.org/org.xesext"/>
  <extension name="Time" prefix="time" uri="http://www.xes-standard.org/time.xesext"/>
  <global scope="trace">
    <string key="concept:name" value="unnamed"/>
  </global>
  <global scope="event">
    <string key="concept:name" value="unnamed"/>
    <string key="lifecycle:transition" value="complete"/>
    <string key="org:resource" value="nobody"/>
    <date key="time:timestamp" value="1970-01-01T00:00:00.000000+00:00"/>
  </global>
  <classifier name="Activity" keys="concept:name"/>
  <classifier name="Activity and transition" keys="concept:name lifecycle:transition"/>
  <string key="lifecycle:model" value="standard"/>
"""


@dataclass(slots=True)
class _Trace:
    """A process instance: its events as XML, and the running executions of each element.

    `process` is empty if the log does not have its beginning: the recorder joined later.
    """

    process: str
    events: list[str] = field(default_factory=list)
    under_way: dict[tuple[int, str], list[int]] = field(default_factory=dict)  # (scope, element) -> executions
    count: int = 0

    def execution(self, scope: int, element: str, what: str) -> int:
        """Return the number of the execution that a mark belongs to, or 0. The execution that
        started first ends first."""
        runs = self.under_way.setdefault((scope, element), [])
        if what == "enter":
            self.count += 1
            runs.append(self.count)
            return self.count
        return runs.pop(0) if runs else 0


@contextmanager
def xes(stream: BinaryIO, elements: Mapping[str, ElementInfo]) -> Iterator[Observer]:
    """An observer that writes events to `stream`, in traces."""
    traces = _Traces(stream, elements)
    stream.write(_HEAD.encode())
    try:
        yield traces
    finally:
        traces.close()
        stream.write(b"</log>\n")


class _Traces(Observer):
    """The traces of instances that have not ended."""

    def __init__(self, stream: BinaryIO, elements: Mapping[str, ElementInfo]) -> None:
        self._stream, self._elements, self._epoch = stream, elements, EPOCH
        self._open: dict[tuple[str, int], _Trace] = {}
        self._known: dict[tuple[str, Mark], tuple[str, str] | None] = {}
        self._verdicts: list[str] = []

    def __call__(self, event: Event) -> None:
        if event.what == "epoch":
            self._epoch = parse_datetime(event.detail)
        if event.what == PART:
            self._stream.write(_attribute(2, PART, str(event.detail)).encode())
        if event.what == "verdict":
            self._verdicts.append(_verdict(event.detail))
        if event.what == ENDED:
            date = _attribute(4, "time:timestamp", _moment(self._epoch, event.time), "date")
            self._verdicts.append(_with_inner(ENDED, event.detail, date))
        self._add(event.robot, event.instance, event.scope, event[4:], _date(self._epoch, event.time))

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Record everything that happened at one instant."""
        date = _date(self._epoch, time)
        for scope, marks in trail:
            for mark in marks:
                self._add(robot, scope.instance.key, scope.key, mark, date)

    def _add(self, robot: str, instance: int, scope: int, mark: Mark, date: str) -> None:
        element, what, detail = mark
        if what == "start":
            name = self._elements.get(element)
            self._open[robot, instance] = _Trace((name.name if name is not None else "") or element)
        elif what == "end":
            self._write((robot, instance), self._open.pop((robot, instance), _Trace("")), str(detail))
        elif what in _LIFECYCLE:
            words = self._words(robot, mark)
            if words is not None:
                trace = self._open.setdefault((robot, instance), _Trace(""))
                trace.events.append(f"{words[0]}{trace.execution(scope, element, what)}{words[1]}{date}")

    def _words(self, robot: str, mark: Mark) -> tuple[str, str] | None:
        """The XML of a mark before and after the number of its execution; None if it does not belong to an activity."""
        key = (robot, mark)
        if key not in self._known:
            name = self._elements.get(mark[0])
            self._known[key] = _event(robot, mark, name) if name is not None and name.activity else None
        return self._known[key]

    def _write(self, key: tuple[str, int], trace: _Trace, status: str) -> None:
        self._stream.write(_trace(*key, trace, status).encode("utf-8", "backslashreplace"))

    def close(self) -> None:
        """Write the traces of instances that have not ended."""
        for key, trace in self._open.items():
            self._write(key, trace, "running")
        self._stream.write("".join(self._verdicts).encode("utf-8", "backslashreplace"))


def _verdict(judgement: Mapping[str, Any]) -> str:
    """The XML of an attribute ``property:NAME`` of the log."""
    inner = "".join(_attribute(4, key, judgement[key]) for key in ("sentence", "text") if judgement[key])
    if judgement["slack"] is not None:
        inner += _attribute(4, "slack", str(judgement["slack"]), "float")
    return _with_inner(f"property:{judgement['property']}", judgement["verdict"], inner)


def _with_inner(key: str, value: str, inner: str) -> str:
    """An attribute of the log with others in it."""
    return f"{_attribute(2, key, value).replace('/>', '>')}{inner}  </string>\n"


def _trace(robot: str, instance: int, trace: _Trace, status: str) -> str:
    values = {"concept:name": f"{robot}/{instance}", "process": trace.process, "robot": robot, "status": status}
    if not trace.process:
        values |= {"process": "unknown", "incomplete": "the log does not have its beginning"}
    attributes = "".join(_attribute(4, key, value) for key, value in values.items())
    return f"  <trace>\n{attributes}{''.join(trace.events)}  </trace>\n"


def _event(robot: str, mark: Mark, name: ElementInfo) -> tuple[str, str]:
    """The XML of an event before and after the number of its execution."""
    element, what, detail = mark
    values = {
        "lifecycle:transition": _LIFECYCLE[what],
        "org:resource": robot,
        "element": element,
        "kind": name.tag,
    }
    if what == "fail":
        values["error"] = str(detail)
    named = _attribute(6, "concept:name", name.name or element)
    attributes = "".join(_attribute(6, key, value) for key, value in values.items())
    return f'    <event>\n{named}      <string key="concept:instance" value="', f'"/>\n{attributes}'


def _date(epoch: datetime, time: int) -> str:
    """The date of an event, and its end tag."""
    return f"{_attribute(6, 'time:timestamp', _moment(epoch, time), 'date')}    </event>\n"


def _moment(epoch: datetime, time: int) -> str:
    return date_at(epoch, time).isoformat(timespec="microseconds")


def _attribute(indent: int, key: str, value: str, tag: str = "string") -> str:
    legal = NOT_XML.sub("\ufffd", value)
    return f"{' ' * indent}<{tag} key={quoteattr(key)} value={quoteattr(legal)}/>\n"
