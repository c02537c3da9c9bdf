"""Writes a run for process mining: XES, the standard IEEE 1849.

One trace per process instance, with what the called processes did in it. Of every activity (task, sub-process, call
activity) each execution has a ``start`` and a ``complete``, or an ``ate_abort`` if it was cancelled or failed;
``concept:instance`` tells executions apart. The resource is the robot. Times are dates from `EPOCH` on, in
microseconds, which is as fine as readers take them.

A trace is written when its instance has ended; those still open are written at the end.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import TYPE_CHECKING, TextIO
from xml.sax.saxutils import quoteattr

from fame.node import EPOCH

if TYPE_CHECKING:
    from fame.log import Named
    from fame.node import Event

_LIFECYCLE = {"enter": "start", "leave": "complete", "cancel": "ate_abort", "fail": "ate_abort"}
"""Which transition of the standard life cycle an observation of an activity is (IEEE 1849, extension Lifecycle)."""

_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot hold."""

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
    """A process instance so far: its events as XML, and which executions of each element are under way."""

    process: str
    events: list[str] = field(default_factory=list)
    under_way: dict[tuple[int, str], list[int]] = field(default_factory=dict)  # (scope, element) -> executions
    count: int = 0

    def execution(self, event: Event) -> int:
        """The number of the execution that an event belongs to, or 0; of several the first to start ends first."""
        runs = self.under_way.setdefault((event.scope, event.element), [])
        if event.what == "enter":
            self.count += 1
            runs.append(self.count)
            return self.count
        return runs.pop(0) if runs else 0


@contextmanager
def xes(stream: TextIO, named: Mapping[str, Named]) -> Iterator[Callable[[Event], object]]:
    """A function that takes events and writes them to `stream` in their traces."""
    traces: dict[tuple[str, int], _Trace] = {}

    def write(event: Event) -> None:
        key, name = (event.robot, event.instance), named.get(event.element)
        if event.what == "start":
            traces[key] = _Trace((name.name if name is not None else "") or event.element)
        elif event.what == "end":
            stream.write(_trace(*key, traces.pop(key), str(event.detail)))
        elif name is not None and name.activity and event.what in _LIFECYCLE:
            trace = traces[key]
            trace.events.append(_event(event, name, trace.execution(event)))

    stream.write(_HEAD)
    try:
        yield write
    finally:
        stream.writelines(_trace(*key, trace, "running") for key, trace in traces.items())
        stream.write("</log>\n")


def _trace(robot: str, instance: int, trace: _Trace, status: str) -> str:
    said = {"concept:name": f"{robot}/{instance}", "process": trace.process, "robot": robot, "status": status}
    attributes = "".join(_attribute(4, key, value) for key, value in said.items())
    return f"  <trace>\n{attributes}{''.join(trace.events)}  </trace>\n"


def _event(event: Event, name: Named, execution: int) -> str:
    said = {
        "concept:name": name.name or event.element,
        "concept:instance": str(execution),
        "lifecycle:transition": _LIFECYCLE[event.what],
        "org:resource": event.robot,
        "element": event.element,
        "kind": name.kind,
    }
    if event.what == "fail":
        said["error"] = str(event.detail)
    moment = EPOCH + timedelta(microseconds=event.time // 1000)
    attributes = "".join(_attribute(6, key, value) for key, value in said.items())
    date = _attribute(6, "time:timestamp", moment.isoformat(timespec="microseconds"), "date")
    return f"    <event>\n{attributes}{date}    </event>\n"


def _attribute(indent: int, key: str, value: str, tag: str = "string") -> str:
    legal = _FORBIDDEN.sub("\ufffd", value)
    return f"{' ' * indent}<{tag} key={quoteattr(key)} value={quoteattr(legal)}/>\n"
