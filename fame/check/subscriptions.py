"""Subscriptions of JavaScript that pile up: made anew each time round a loop, and destroyed by nothing."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.model import Activity, Body, Element, SubProcess
from fame.check.findings import Finding
from fame.check.graph import graph
from fame.check.scope import Subject, Unit
from fame.check.texts import Text, texts_of
from fame.scripting.javascript.identifiers import words_of


def subscription_findings(subject: Subject) -> Iterator[Finding]:
    """Of the scripts of every process."""
    for unit in subject.units:
        scripts = [text for body in unit.bodies() for text in texts_of(body) if _in_javascript(text)]
        if not any(words_of(text.expression.text).destroys for text in scripts):
            yield from _piling_up(unit, scripts)


def _in_javascript(text: Text) -> bool:
    return text.use == "script" and text.expression.language == "javascript"


def _piling_up(unit: Unit, scripts: list[Text]) -> Iterator[Finding]:
    repeated = set(_repeated(unit.process.body, around=False))
    for text in scripts:
        if text.element.id in repeated and words_of(text.expression.text).subscribes:
            found = "subscribes anew each time round: end the subscription before with node.destroySubscription(...)"
            yield unit.finding("note", found, text.element, text.expression.line)


def _repeated(body: Body, *, around: bool) -> Iterator[str]:
    """The nodes (ids) that may run again in one instance; `around`: the whole body may."""
    scope = graph(body)
    for node in body.nodes:
        again = around or _loops(node) or node.id in scope.reach(scope.following[node.id], set())
        if again:
            yield node.id
        if isinstance(node, SubProcess):
            yield from _repeated(node.body, around=again)


def _loops(node: Element) -> bool:
    return isinstance(node, Activity) and node.loop is not None
