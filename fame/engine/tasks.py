"""Tasks: scripts, services, expressions, and tasks that wait for a person or a message."""

from __future__ import annotations

from typing import Any

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import events, faults, scopes, steps, triggers, waiting
from fame.engine.engine_state import EngineState
from fame.engine.program import USER, Compiled, Node, Start, StepFunction, Trigger, nothing
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Scope, Wait
from fame.errors import ModelError


@dataclass(slots=True)
class Script:
    """Spec of a task that runs a script, an expression or a service.

    run       the compiled text, or the service
    variable  the variable for the value of an expression or service
    """

    run: Compiled
    variable: str = ""


# ---- steps ---------------------------------------------------------------------------------------


def script(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Run the script of a task, which ends at once or is suspended."""
    run = node.spec.run
    try:
        suspended = run(scope.variables)
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    if suspended is None:
        return steps.settle(engine, scope, node) if engine.unsettled else node.next
    return _suspend(engine, scope, node, suspended)


def evaluate(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Evaluate an expression or call a service function, and store the result if wanted."""
    spec: Script = node.spec
    run = spec.run
    try:
        value = run(scope.variables)
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    if hasattr(value, "send") and hasattr(value, "throw"):
        return _suspend(engine, scope, node, value)
    if spec.variable:
        scope.variables[spec.variable] = value
    return steps.settle(engine, scope, node) if engine.unsettled else node.next


def wait_for_person(engine: EngineState, scope: Scope, node: Node) -> None:
    """Wait until a person completes a user or manual task."""
    waiting.wait_at(engine, node, scope)


def _suspend(engine: EngineState, scope: Scope, node: Node, suspended: Any) -> Node | None:
    """Let the token of a suspended script wait, and hand the script to the host."""
    scope.counts[node.index] -= 1
    engine.unsettled = bool(engine.conditions)
    _drive(engine, waiting.wait_at(engine, node, scope), suspended)
    if engine.conditions:
        waiting.check_conditions(engine)
    return None


def _drive(engine: EngineState, wait: Wait, suspended: Any) -> None:
    """Hand a suspended script to the host."""
    if not wait.alive:  # a conditional boundary event fired as it was armed
        suspended.close()
        return
    engine.waits[wait.key] = wait
    wait.started = True
    engine.host.run(wait.key, suspended)
    engine.unsettled = bool(engine.conditions)


def script_ended(engine: EngineState, wait: Wait, error: BaseException | None) -> None:
    """Continue the token of a script that has ended or failed."""
    waiting.withdraw(engine, wait)
    if error is None:
        scopes.complete(engine, wait.scope, wait.node)
    else:
        faults.fail(engine, wait.scope, wait.node, error)
    if engine.conditions:
        waiting.check_conditions(engine)


def restart(engine: EngineState, wait: Wait) -> None:
    """Start a script again after a suspension or from a snapshot, with a new key: the old script may still end."""
    if not wait.started:
        return
    node, scope = wait.node, wait.scope
    engine.waits.pop(wait.key, None)
    wait.key, wait.started = engine.new_key(), False
    try:
        suspended = node.spec.run(scope.variables)
    except BaseException as error:
        waiting.withdraw(engine, wait)
        faults.fail(engine, scope, node, error)
        return
    if suspended is None:
        waiting.withdraw(engine, wait)
        scopes.complete(engine, scope, node)
    else:
        _drive(engine, wait, suspended)
    if engine.conditions:
        waiting.check_conditions(engine)


def _forget_script(engine: EngineState, wait: Wait) -> None:
    """Ignore a later report of the host that the script has ended."""
    engine.waits.pop(wait.key, None)


SCRIPT = Trigger("script", arm=nothing, disarm=_forget_script, suspend=nothing, resume=restart)

# ---- compiling -----------------------------------------------------------------------------------


def make(context: ScopeCompiler, task: model.Task) -> Node:
    if task.script is not None:
        return _script(context, task, task.script)
    match task.kind:
        case "user" | "manual":
            node = context.node(task, wait_for_person)
            node.catch = triggers.catching(trigger=USER)
            return node
        case "receive":
            return _receive(context, task)
        case "send" if task.topic is not None or not task.operation:
            return _send(context, task)
        case "service" | "send":  # in Camunda a send task can call a service
            return _service(context, task)
        case "business_rule":
            context.refuse("business rule tasks are not executed: DMN is not supported", task)
    return context.node(task, steps.pass_on)


_SCRIPT_CATCH = triggers.catching(trigger=SCRIPT)
"""Shared by all scripts: it does not depend on the task."""


def _running(context: ScopeCompiler, task: model.Task, step: StepFunction, spec: Script) -> Node:
    """Make a node at which a token waits for its script or service, if that waits."""
    node = context.node(task, step, spec=spec)
    node.catch = _SCRIPT_CATCH
    return node


def _script(context: ScopeCompiler, task: model.Task, text: model.Expression) -> Node:
    if text.language not in ("python", "javascript"):
        return _running(context, task, evaluate, Script(context.expression(text, task), task.result_variable))
    run = context.compiler.host.compile(text, element=task.id, file=context.file, script=True)
    return _running(context, task, script, Script(run))


def _receive(context: ScopeCompiler, task: model.Task) -> Node:
    if task.topic is None:
        context.refuse("a receive task needs a message", task)
    node = context.node(task, triggers.wait)
    node.catch = triggers.catching(trigger=waiting.MESSAGE)
    node.catch.keys = context.assignments(task.keys, task)
    triggers.listen(context, task, node.catch, task.topic)
    triggers.keep_queue(context, node)
    return node


def _send(context: ScopeCompiler, task: model.Task) -> Node:
    if task.topic is None:
        context.refuse("a send task needs a message", task)
    payload = context.optional(task.topic.payload, task)
    to = context.optional(task.topic.to, task)
    return context.node(task, events.send, spec=events.Throw(task.topic.qualified, payload, to))


def _service(context: ScopeCompiler, task: model.Task) -> Node:
    if not task.operation:
        context.refuse("a service task needs the name of a service", task)
    try:
        run = context.compiler.host.service(task.operation, element=task.id, file=context.file)
    except ModelError as error:  # the host knows no lines
        context.refuse(error.text, task)
    return _running(context, task, evaluate, Script(run, task.result_variable))


COUNTED_STEPS = (steps.pass_on, script, evaluate, events.send)
"""Steps of tasks that complete as they are entered, unless they fail or wait."""


def instantiating(context: ScopeCompiler, task: model.Task) -> list[Node]:
    """Make a receive task that starts the process."""
    main = context.main[task.id]
    if main.catch is None or task.topic is None:
        context.refuse("a receive task that starts a process must not repeat or have variables of its own", task)
    begin = context.node(task, steps.pass_on, "/start", Start())
    begin.catch = main.catch
    begin.index = begin.slot = main.slot
    begin.next = main.next
    context.watch(begin)
    return [begin]
