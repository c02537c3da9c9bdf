"""One JavaScript context: the scripts of one process instance, apart from those of all others.

Theory of operation. Python calls into the context; nothing in it can call Python. So each step can have a time limit,
and no script reaches more of the host than the orders that `orders` carries out. One call is one step:

====================================================  =====================================================
Python                                                JavaScript (`interface.js`)
====================================================  =====================================================
what has changed in the variables, and the time   ->  runs a script, or one callback of it
promises that are due, one by one                 ->  run their reactions
sets variables, carries out orders                <-  what it has changed, its orders, whether it is over
====================================================  =====================================================

Orders take effect when the step is over, also if it ended in an error; what is wrong with an order is an error of the
script that gave it. A script that returns without next() is suspended until one of its callbacks calls it.

Invariants. A callback has the same number on both sides and belongs to one run. A run is known here as long as the
engine waits for it or it has callbacks. The context is never called from within a call.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

from fame.engine.variables import BUILTINS
from fame.errors import UnavailableError
from fame.scripting.javascript import limits
from fame.scripting.javascript.commands import carry_out
from fame.scripting.javascript.environment import Environment
from fame.scripting.javascript.errors import JavaScriptError, located, thrown
from fame.scripting.javascript.host_api import REALM, Surroundings
from fame.scripting.javascript.run import Run, Suspended
from fame.scripting.javascript.source import Script
from fame.scripting.javascript.values import Digits, decode, encode

_PROMISING = frozenset(
    {"Function", "Promise", "async", "constructor", "eval", "fromAsync", "import", "queueMicrotask", "waitForService"}
)
"""Words without which no promise comes about."""

_FAR = 100_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a step came to. `run` is None if nothing of it can come any more."""

    over: bool = True
    error: BaseException | None = None
    value: Any = None
    run: Run | None = None


_OVER = Outcome()


class Realm:
    """The scripts that share an interface. `variables` are those of the process instance.

    names, computed  the words in its scripts; whether these may name variables by other means
    """

    def __init__(self, variables: dict[str, Any], surroundings: Surroundings | None) -> None:
        self.variables, self.surroundings = variables, surroundings
        self.names, self.computed = set[str](), False
        self._context = limits.new_context()
        host = self._context.eval(_interface())
        self._begin, self._resume, self._collect, self._cancel = map(host, ("begin", "resume", "collect", "cancel"))
        self._open, self._load, self._keep, self._kept = map(host, ("open", "load", "keep", "kept"))
        self._react = self._context.execute_pending_job
        self._loaded: dict[Script, Any] = {}
        self._environments: dict[int, Environment] = {}
        self._digits = Digits()
        self._runs: dict[int, Run] = {}
        self._expected: dict[int, tuple[Run, Callable[[], object]]] = {}
        self._reacts, self._instant, self._calls = False, -1, 0
        if surroundings is not None:
            surroundings.realms.append(self)
        host("configure")(encode(self._settings()))

    def _settings(self) -> dict[str, Any]:
        robot = self.surroundings
        name, namespace, number = (robot.name, robot.namespace, next(robot.numbers)) if robot else ("", "", 0)
        return {"name": name, "namespace": f"/{namespace}", "seed": zlib.crc32(f"{namespace} {number}".encode()) or 1}

    @property
    def robot(self) -> Surroundings:
        """Raises UnavailableError where scripts run without a robot."""
        if self.surroundings is None:
            raise UnavailableError("there is no robot here: scripts have their variables alone")
        return self.surroundings

    # ---- what the engine asks ----------------------------------------------------------------------------------------

    def run(self, script: Script, variables: dict[str, Any]) -> Suspended | None:
        """A script task: over at once, or suspended. Raises what it throws."""
        outcome = self._begin_script(script, variables)
        if outcome is _OVER or outcome.__class__ is bool:
            return None
        run, error = outcome.run, outcome.error
        if error is None and not outcome.over:
            error = _never(run)
        if error is not None:
            self._end(run)
            raise error
        if outcome.over:
            return None
        run.suspended = Suspended(self, run)
        return run.suspended  # type: ignore[no-any-return]

    def evaluate(self, script: Script, variables: dict[str, Any]) -> Any:
        """A condition or value. Raises what it throws."""
        outcome = self._begin_script(script, variables)
        if outcome.__class__ is bool:
            return outcome
        error = outcome.error
        if error is None and not outcome.over:
            error = located(JavaScriptError("gives no value: neither an expression nor next(null, value)"), script)
        if error is not None:
            self._end(outcome.run)
            raise error
        return outcome.value

    def cancel(self, run: Run) -> None:
        """A suspended script is not wanted any more."""
        self._end(run)

    def close(self) -> None:
        """All is over: nothing of it is left, neither in the variables nor in their interface."""
        for number in tuple(self._expected):
            self.drop(number)
        for environment in self._environments.values():
            environment.forget()
        self._runs.clear()
        self._environments.clear()
        self._loaded.clear()
        self.variables[BUILTINS].pop(REALM, None)
        if self.surroundings is not None and self in self.surroundings.realms:
            self.surroundings.realms.remove(self)

    # ---- what orders ask ---------------------------------------------------------------------------------------------

    def expect(self, number: int, run: Run, cancel: Callable[[], object]) -> None:
        """A callback may come; `cancel` takes away what would bring it."""
        run.callbacks[number] = None
        self._expected[number] = run, cancel

    def drop(self, number: int) -> None:
        """A callback is destroyed, or has come for the only time."""
        if number in self._expected:
            run, cancel = self._expected.pop(number)
            del run.callbacks[number]
            cancel()
            self._let_go(run)

    def call_back(self, number: int, payload: str, *, again: bool = False) -> None:
        """What a callback waits for is there; `again`: it may come again. Called by entries of the scheduler."""
        if number not in self._expected:
            return
        run, _ = self._expected[number]
        if not self.robot.alive(run.environment.variables):
            self._end(run)
            return
        if self._is_livelock():
            text = f"{limits.AT_ONE_INSTANT} callbacks without time going on"
            self._settle(run, Outcome(error=located(JavaScriptError(text), run.script)))
        else:
            outcome = self._step(run.script, run.environment, self._resume, number, payload)
            if not again:
                self.drop(number)
            self._settle(run, outcome)
        self.robot.stepped()

    def end_other(self, number: int, error: dict[str, str] | None) -> None:
        """A suspended script was ended by another one; `error` is described."""
        run = self._runs.get(number)
        if run is not None and run.suspended is not None:
            self._settle(run, Outcome(error=None if error is None else thrown(error, run.script)))

    # ---- steps -------------------------------------------------------------------------------------------------------

    def _begin_script(self, script: Script, variables: dict[str, Any]) -> Any:
        """The first step: an Outcome, or the truth value that a condition gave."""
        environment = self._environments.get(id(variables)) or self._environment(variables)
        loaded = self._loaded.get(script) or self._loading(script)
        outcome = self._step(script, environment, self._begin, loaded, environment.shown)
        if not (environment.lasting or environment.runs):
            del self._environments[id(variables)]
        return outcome

    def _step(self, script: Script, environment: Environment, call: Callable[..., Any], what: Any, given: Any) -> Any:
        changes, kept = environment.changes(self)
        for name in kept:
            with suppress(ValueError):  # it is of another realm
                self._keep(environment.shown, name, environment.variables[name])
        for text in (changes, given):
            if text.__class__ is str:
                self._digits.learn(text)
        robot = self.surroundings
        time = robot.epoch + robot.scheduler.now / 1e6 if robot is not None else 0.0
        try:
            said = call(what, given, time, changes)
            if self._reacts and self._react():
                return self._heed(script, environment, said, self._finish())
        except limits.failure() as error:
            return self._broken(script, environment, error)
        if said.__class__ is bool:
            return said
        return self._heed(script, environment, said) if said else _OVER

    def _finish(self) -> Any:
        """Let promises react until none is left."""
        for _ in range(limits.REACTIONS):
            if not self._react():
                return self._collect()
        raise limits.failure()(f"Error: {limits.REACTIONS} reactions of promises in one step")

    def _broken(self, script: Script, environment: Environment, error: Exception) -> Outcome:
        """A step was ended by force. What it said before counts; saying it may take a little more memory."""
        outcome = _OVER
        with suppress(limits.failure()), limits.spare_memory(self._context):
            outcome = self._heed(script, environment, self._collect())
        with suppress(limits.failure()):
            self._cancel()
        text, _, stack = str(error).partition("\n")
        return replace(outcome, error=thrown({"text": text, "stack": stack}, script))

    def _heed(self, script: Script, environment: Environment, *texts: Any) -> Outcome:
        """Do what a script says. A text that makes no sense is its own work: it broke built-in objects."""
        outcome = _OVER
        try:
            for text in texts:
                said = decode(text) if text.__class__ is str and text else {}
                said = self._digits.restored(said, {"set": environment.variables})
                environment.read_back(said, self._kept)
                if "number" in said:
                    outcome = self._learn(script, environment, said, outcome.error)
        except (ValueError, TypeError, LookupError, AttributeError) as error:
            text = f"broke the built-in objects that it needs: {type(error).__name__}: {error}"
            outcome = Outcome(error=located(JavaScriptError(text), script))
        return outcome

    def _learn(
        self, script: Script, environment: Environment, said: dict[str, Any], error: BaseException | None
    ) -> Outcome:
        """Carry out orders, and see how it is with the run. `error` is what went wrong before."""
        run = self._runs.get(said["number"]) or Run(said["number"], script, environment)
        run.entrusted |= bool(said.get("kept"))
        failures = [error, *(carry_out(self, run, order) for order in said.get("orders", ()))]
        for rejection in said.get("rejected", ()):
            run.rejection = str(rejection["text"])
            if self.surroundings is not None:
                self.surroundings.report(script.element, f"a promise was rejected: {run.rejection}")
        if "error" in said:
            failures.append(thrown(said["error"], script))
        error = next((failure for failure in failures if failure is not None), None)
        if said["over"] and not run.callbacks and error is None:
            return Outcome(value=said.get("value"))
        if run.number not in self._runs:
            self._runs[run.number] = run
            environment.runs += 1
        return Outcome(said["over"], error, said.get("value"), run)

    # ---- the life of runs --------------------------------------------------------------------------------------------

    def _settle(self, run: Run, outcome: Outcome) -> None:
        """A callback has ended: its script may be over now, or have failed."""
        suspended, error = run.suspended, outcome.error
        if error is None and suspended is not None and not outcome.over:
            error = _never(run)
        if error is not None:
            self._end(run)
        if suspended is not None and (outcome.over or error is not None):
            run.suspended = None
            suspended.end(error)
        elif error is not None:
            self.robot.failed(run.environment.variables, run.script.element, error)
        self._let_go(run)

    def _end(self, run: Run | None) -> None:
        """Forget a run and all its callbacks."""
        if run is None or self._runs.pop(run.number, None) is None:
            return
        run.environment.runs -= 1
        for number in tuple(run.callbacks):
            self.drop(number)
        with suppress(limits.failure()):
            self._cancel(run.number)

    def _let_go(self, run: Run) -> None:
        """Forget a run that is over and has no callbacks any more."""
        if run.suspended is None and not run.callbacks and self._runs.pop(run.number, None) is not None:
            run.environment.runs -= 1

    def _is_livelock(self) -> bool:
        now = self.robot.scheduler.now
        self._calls = self._calls + 1 if now == self._instant else 1
        self._instant = now
        return self._calls > limits.AT_ONE_INSTANT

    # ---- what is made once -------------------------------------------------------------------------------------------

    def _environment(self, variables: dict[str, Any]) -> Environment:
        environment = self._environments[id(variables)] = Environment(variables, self._open())
        return environment

    def _loading(self, script: Script) -> Any:
        """Compile a script in this context."""
        self.names |= script.names
        self.computed |= script.computed
        for environment in self._environments.values():
            environment.retell()
        self._reacts |= not _PROMISING.isdisjoint(script.names)
        kind = "bpmn:ScriptTask" if script.mode == "script" else "bpmn:SequenceFlow"
        loaded = self._load(self._context.eval(script.code), script.element, kind, script.mode)
        self._loaded[script] = loaded
        return loaded


def _never(run: Run) -> BaseException | None:
    """The error of a script that is not over and cannot end any more; None if it can."""
    if "next" not in run.script.names:
        text = "never calls next()"
    elif run.callbacks or run.entrusted:
        return None
    else:
        text = "returned without calling next(), and left nothing that could call it"
    rejection = f"; a promise was rejected: {run.rejection}" if run.rejection else ""
    if not rejection and "async" in run.script.names:
        rejection = "; an async function may have thrown: what it throws is heard where it is awaited or caught"
    return located(JavaScriptError(text + rejection), run.script)


@cache
def _interface() -> str:
    """The text, far behind the lines of any file, which tells its places in stacks from those of scripts."""
    return "\n" * _FAR + files(__package__).joinpath("interface.js").read_text(encoding="utf-8")
