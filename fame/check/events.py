"""Checks of timer, error and cancel events: times that are not ISO 8601, what is caught where nothing throws it.

An error code may be misspelt, or its boundary event at another activity. Every activity may fail with code ``script``
or ``no_flow`` besides what its error events, scripts, services and actions throw. Where functions, JavaScript or
computed codes may throw any code, nothing is reported.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator

from fame.bpmn.model import (
    Body,
    CallActivity,
    CancelDefinition,
    ErrorDefinition,
    FlowNode,
    SubProcess,
    Task,
    TimerDefinition,
)
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix
from fame.iso8601 import TIMES
from fame.middleware.messages import is_action
from fame.robot.service_tasks import failure_codes, renamed_codes
from fame.robot.suspension import TAKEN_OVER
from fame.scripting import script_effects


def check_timers(scope: CheckScope) -> Iterator[Finding]:
    """Find invalid times, and cycles that fire only once."""
    for process in scope.processes:
        handled = {
            node.id
            for handler in process.nodes()
            if handler.triggered_by_event and handler.body is not None
            for node in handler.body.nodes
        }
        for node in process.nodes():
            for timer in node.defined(TimerDefinition):
                yield from _timer(process, node, timer, node.id in handled)


_MONTHS = re.compile(r"(?:^|/)P(\d+)M$")


def _timer(process: CheckedProcess, event: FlowNode, timer: TimerDefinition, handler: bool) -> Iterator[Finding]:
    expression = timer.expression
    if (
        expression is not None
        and expression.language == "template"
        and "${" not in expression.text
        and "#{" not in expression.text
    ):
        try:
            TIMES[timer.kind](expression.text)
        except ValueError as error:
            yield process.finding("error", f"timer {timer.kind}: {error}", event, expression.line)
        if months := _MONTHS.search(expression.text.strip()):
            text = f"P{months[1]}M is {months[1]} months: PT{months[1]}M is as many minutes"
            yield process.finding("warning", text, event, expression.line)
    once = event.place == "catch" or (event.interrupting and (event.place == "boundary" or handler))
    if timer.kind == "cycle" and once:
        text = "fires only once, so only the first time of its cycle counts: use a duration"
        yield process.finding("warning", text, event)


# ---- errors ----------------------------------------------------------------------------------------------------------


_ANY = ("script", "no_flow", TAKEN_OVER)


def check_error_handling(scope: CheckScope) -> Iterator[Finding]:
    """Check the error boundary events of every process."""
    for process in scope.processes:
        for body in process.bodies():
            nodes = {node.id: node for node in body.nodes}
            for event in body.nodes:
                if event.place == "boundary":
                    if not event.interrupting and event.defined(ErrorDefinition):
                        text = "is drawn as non-interrupting, but its activity has ended with the error"
                        yield process.finding("warning", text, event)
                    beside = {code for one in body.boundary(event.attached_to) for code in _of_element(one)}
                    yield from _caught(process, event, nodes[event.attached_to], beside)


def check_transactions(scope: CheckScope) -> Iterator[Finding]:
    """Find cancel end events and cancel boundary events that have no partner at their transaction."""
    for process in scope.processes:
        for body in process.bodies():
            for one in body.nodes:
                if isinstance(one, SubProcess) and one.kind == "transaction":
                    catching = [event for event in body.boundary(one.id) if event.defined(CancelDefinition)]
                    throwing = list(_cancels(one.body))
                    for end in throwing if not catching else ():
                        text = f"cancels {one.display_name}, which has no cancel boundary event: that is an error, "
                        yield process.finding("warning", f"{text}and undoes nothing", end)
                    for event in catching if not throwing else ():
                        text = f"catches the cancel of {one.display_name}, in which no end event cancels"
                        yield process.finding("warning", text, event)


def _cancels(body: Body) -> Iterator[FlowNode]:
    """The cancel end events of a transaction, without those of transactions inside."""
    for node in body.nodes:
        if node.place == "end" and node.defined(CancelDefinition):
            yield node
        elif isinstance(node, SubProcess) and node.kind != "transaction":
            yield from _cancels(node.body)


def _caught(process: CheckedProcess, event: FlowNode, activity: FlowNode, beside: set[str]) -> Iterator[Finding]:
    codes = [one.code for one in event.defined(ErrorDefinition) if one.code]
    thrown = _thrown(process, activity, set()) if codes else None
    if thrown is None:
        return
    thrown |= beside
    asking = [(home, one, renamed_codes(one)) for home, one in executed(process, activity, set())
              if isinstance(one, Task) and _asks(one)]  # fmt: skip
    repeated = [each for each in asking if each[1].properties.get("retry") not in ("never", "ask")]
    for code in codes:
        again = [(home, one, names.get("lost", "lost")) for home, one, names in repeated
                 if code in ("lost", names.get("lost"))]  # fmt: skip
        if code not in thrown and again:
            home, task, name = again[0]
            text = f"catches error {code!r}, but a request of unknown fate is made again: for the error, "
            text += "set retry = never" if name == code else f"set retry = never and catch {name!r}"
            fix = _never(task) if len(again) == 1 and name == code and home.file == process.file else None
            yield process.finding("warning", text, event, fix=fix)
        elif code not in thrown and code not in _ANY:
            renamed = [names[code] for _, _, names in asking if names.get(code) in thrown]
            similar = renamed or difflib.get_close_matches(code, sorted(thrown), 1)
            known = (
                f"did you mean {similar[0]!r}?" if similar else f"it throws {', '.join(sorted(thrown)) or 'no errors'}"
            )
            text = f"catches error {code!r}, which nothing in {activity.display_name} throws; {known}"
            only = similar and len(event.definitions) == 1
            fix = Fix(f"catch {similar[0]}", event.id, "error", similar[0]) if only else None
            yield process.finding("warning", text, event, fix=fix)


def _thrown(process: CheckedProcess, node: FlowNode, seen: set[CheckedProcess]) -> set[str] | None:
    """The codes that an element and everything in it may throw; None if they are unknown."""
    if node.body is not None:
        return _together(_thrown(process, one, seen) for one in node.body.nodes)
    if isinstance(node, CallActivity):
        callee = process.called_by(node)
        if callee is None or callee in seen:
            return set() if callee is not None else None
        seen.add(callee)
        return _together(_thrown(callee, one, seen) for one in callee.bpmn.body.nodes)
    if node.place == "end":
        ends = node.defined(ErrorDefinition)
        return None if any(one.computed for one in ends) else {one.code for one in ends if one.code} | _of_element(node)
    if isinstance(node, Task) and node.service is not None:
        return failure_codes(node)
    if isinstance(node, Task) and (node.operation or node.kind in ("service", "send")):
        return None
    codes = raised_codes(node)
    return codes if codes is None else codes | _of_element(node)


def _of_element(node: FlowNode) -> set[str]:
    """The codes with which an element fails of itself: a request of unknown fate that is not made again, a timer that
    came due while the engine was away, a message to a robot that is not there."""
    to = any(throws and topic.to is not None for topic, throws in node.topics())
    fails = {
        "lost": node.properties.get("retry") in ("never", "ask"),
        "missed": node.properties.get("missed") == "fail",
        "unreachable": to,
    }
    return {code for code, may in fails.items() if may}


def _asks(task: Task) -> bool:
    """Whether a task calls a service or action."""
    return task.service is not None or bool(script_effects(task).asked)


def _never(task: FlowNode) -> Fix:
    """The fix by which a request of unknown fate is not made again."""
    return Fix(f"add retry = never to {task.label}", task.id, "property", "never", "retry")


def check_repeated_calls(scope: CheckScope) -> Iterator[Finding]:
    """Find calls of services that the model itself suspends, and makes again although they may have been done."""
    for process in scope.processes:
        original = process.bpmn.semantics == "original"
        for body in process.bodies():
            handlers = [one for one in body.nodes if isinstance(one, SubProcess) and one.triggered_by_event]
            suspends = [one for one in handlers if one.resume or original]
            suspends = [one for one in suspends if any(each.interrupting for each in one.body.events("start"))]
            seen = set[CheckedProcess]()
            inside = (found for one in body.nodes if one not in handlers for found in executed(process, one, seen))
            for home, task in inside if suspends else ():
                called = task.service if isinstance(task, Task) and "retry" not in task.properties else None
                if called is not None and not is_action(called.type or ""):
                    text = f"after {suspends[0].display_name} it calls again, even if the first call has been done"
                    yield home.finding("warning", f"{text}: set retry = never, ask or safe", task, fix=_never(task))


def executed(
    process: CheckedProcess, node: FlowNode, seen: set[CheckedProcess]
) -> Iterator[tuple[CheckedProcess, FlowNode]]:
    """Yield an element and all that is executed in it, with their processes."""
    yield process, node
    callee = process.called_by(node)
    if callee is not None and callee not in seen:
        seen.add(callee)
        for one in callee.bpmn.body.nodes:
            yield from executed(callee, one, seen)
    for one in node.body.nodes if node.body is not None else ():
        yield from executed(process, one, seen)


def _together(parts: Iterator[set[str] | None]) -> set[str] | None:
    codes: set[str] = set()
    for part in parts:
        if part is None:
            return None
        codes |= part
    return codes


def raised_codes(node: FlowNode) -> set[str] | None:
    """Return the error codes in a script: ``raise BpmnError("lost")``; None if they are unknown."""
    codes = script_effects(node).codes
    return None if codes is None or (node.script is not None and "robot.act" in node.script.text) else {*codes}
