"""Checks of timers: literal times have to be ISO 8601 and make sense where they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from fame.bpmn.model import Event, SubProcess, TimerDefinition
from fame.check.findings import Finding
from fame.check.scope import CheckedProcess, CheckScope
from fame.iso8601 import parse_cycle, parse_datetime, parse_duration

_PARSERS: Mapping[str, Callable[[str], object]] = {
    "duration": parse_duration,
    "date": parse_datetime,
    "cycle": parse_cycle,
}


def check_timers(scope: CheckScope) -> Iterator[Finding]:
    """Find invalid times, and cycles that fire only once."""
    for process in scope.processes:
        handled = {
            node.id
            for handler in process.bpmn.body.walk()
            if isinstance(handler, SubProcess) and handler.triggered_by_event
            for node in handler.body.nodes
        }
        for node in process.bpmn.body.walk():
            for timer in node.definitions if isinstance(node, Event) else ():
                if isinstance(node, Event) and isinstance(timer, TimerDefinition):
                    yield from _timer(process, node, timer, node.id in handled)


def _timer(process: CheckedProcess, event: Event, timer: TimerDefinition, handler: bool) -> Iterator[Finding]:
    expression = timer.expression
    if (
        expression is not None
        and expression.language == "template"
        and "${" not in expression.text
        and "#{" not in expression.text
    ):
        try:
            _PARSERS[timer.kind](expression.text)
        except ValueError as error:
            yield process.finding("error", f"timer {timer.kind}: {error}", event, expression.line)
    once = event.place == "catch" or (event.interrupting and (event.place == "boundary" or handler))
    if timer.kind == "cycle" and once:
        text = "fires only once, so only the first time of its cycle counts: use a duration"
        yield process.finding("warning", text, event)
