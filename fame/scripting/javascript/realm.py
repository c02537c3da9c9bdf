"""One JavaScript context: the scripts of one process instance, isolated from all others.

Theory of operation. Python calls into the context; nothing in it can call Python. Therefore each step can have a time
limit, and a script reaches no more of the host than what `commands` executes. One call is one step:

====================================================  =====================================================
Python                                                JavaScript (`interface.js`)
====================================================  =====================================================
changed variables and the time                    ->  runs a script or one of its callbacks
each promise that is due                          ->  runs its reactions
sets variables, executes commands                 <-  changed variables, commands, whether the script is over
====================================================  =====================================================

Commands take effect when the step is over, even if it ended with an error; a failed command is an error of the script
that gave it. A script that returns without next() is suspended until one of its callbacks calls it.

Invariants. A callback has the same number on both sides and belongs to one run. A run is kept here as long as the
engine waits for it or it has callbacks. The context is never called from within a call.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from importlib.resources import files
from typing import Any

from fame.dataclasses import dataclass, replace
from fame.engine.data import BUILTINS
from fame.errors import UnavailableError
from fame.scripting.javascript import source
from fame.scripting.javascript.commands import REALM, HostApi, execute
from fame.scripting.javascript.environment import Environment, ScriptRun, Suspended
from fame.scripting.javascript.source import JavaScriptError, SourceText, located, thrown
from fame.scripting.javascript.values import Digits, decode, encode

_PROMISING = frozenset(
    {"Function", "Promise", "async", "constructor", "eval", "fromAsync", "import", "queueMicrotask", "waitForService"}
)
"""Identifiers without which a script creates no promise."""

_FAR = 100_000


@dataclass(frozen=True, slots=True)
class StepResult:
    """The result of a step. `run` is None if the script is over and has no callbacks."""

    over: bool = True
    error: BaseException | None = None
    value: Any = None
    run: ScriptRun | None = None


_OVER = StepResult()


class Realm:
    """The scripts that share a script interface. `variables` are those of the process instance.

    names     the identifiers in its scripts
    computed  whether its scripts may name variables by other means
    """

    def __init__(self, variables: dict[str, Any], host: HostApi | None) -> None:
        self.variables: dict[str, Any] = variables
        self.host: HostApi | None = host
        self.names: set[str] = set()
        self.computed: bool = False
        self._context = source.new_context()
        entry = self._context.eval(_interface())
        self._begin, self._resume, self._collect, self._cancel = map(entry, ("begin", "resume", "collect", "cancel"))
        self._open, self._load, self._keep, self._kept = map(entry, ("open", "load", "keep", "kept"))
        self._run_reaction = self._context.execute_pending_job
        self._loaded: dict[SourceText, Any] = {}
        self._environments: dict[int, Environment] = {}
        self._digits = Digits()
        self._runs: dict[int, ScriptRun] = {}
        self._expected: dict[int, tuple[ScriptRun, Callable[[], object]]] = {}
        self._reacts, self._instant, self._calls = False, -1, 0
        if host is not None:
            host.realms.append(self)
        entry("configure")(encode(self._settings()))

    def _settings(self) -> dict[str, Any]:
        robot = self.host
        name, namespace, seed = (robot.name, robot.namespace, robot.random.getrandbits(31)) if robot else ("", "", 0)
        stored = robot is not None and robot.altered() is not None
        return {"name": name, "namespace": f"/{namespace}", "seed": seed or 1, "stored": stored}

    @property
    def robot(self) -> HostApi:
        """The host API. Raises UnavailableError where scripts run without a robot."""
        if self.host is None:
            raise UnavailableError("there is no robot here: scripts have their variables alone")
        return self.host

    # ---- called by the engine ----------------------------------------------------------------------------------------

    def run(self, script: SourceText, variables: dict[str, Any]) -> Suspended | None:
        """Run a script task: it is over at once (None) or suspended. Raises what it throws."""
        outcome = self._begin_script(script, variables)
        if outcome is _OVER or outcome.__class__ is bool:
            return None
        run, error = outcome.run, outcome.error
        if error is None and not outcome.over:
            error = _unfinished(run)
        if error is not None:
            self._end(run)
            raise error
        if outcome.over:
            return None
        run.suspended = Suspended(partial(self._end, run))
        return run.suspended  # type: ignore[no-any-return]

    def evaluate(self, script: SourceText, variables: dict[str, Any]) -> Any:
        """Evaluate a condition or value. Raises what it throws."""
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

    def close(self) -> None:
        """End all runs, and remove everything of JavaScript from the variables and their interface."""
        for number in tuple(self._expected):
            self.drop(number)
        for environment in self._environments.values():
            environment.forget()
        self._runs.clear()
        self._environments.clear()
        self._loaded.clear()
        self.variables[BUILTINS].pop(REALM, None)
        if self.host is not None and self in self.host.realms:
            self.host.realms.remove(self)

    # ---- called by commands ------------------------------------------------------------------------------------------

    def expect(self, number: int, run: ScriptRun, cancel: Callable[[], object]) -> None:
        """Register a callback that may come; `cancel` prevents it."""
        run.callbacks[number] = None
        self._expected[number] = run, cancel

    def drop(self, number: int) -> None:
        """Forget a callback that is destroyed, or that has come for the only time."""
        if number in self._expected:
            run, cancel = self._expected.pop(number)
            del run.callbacks[number]
            cancel()
            self._forget_if_done(run)

    def expects(self, number: int) -> bool:
        """Return whether a callback may still come."""
        return number in self._expected

    def fail(self, number: int, error: BaseException) -> None:
        """Fail the run of a callback that does not come, with a located error. Called by entries of the scheduler."""
        if number in self._expected:
            run, _ = self._expected[number]
            self._settle(run, StepResult(error=error))
            self.robot.stepped()

    def call_back(self, number: int, payload: str, *, again: bool = False) -> None:
        """Run a callback with a JSON text; `again`: it may come again. Called by entries of the scheduler."""
        if number not in self._expected:
            return
        run, _ = self._expected[number]
        if not self.robot.alive(run.environment.variables):
            self._end(run)
            return
        if self._is_livelock():
            text = f"{source.AT_ONE_INSTANT} callbacks at one moment"
            self._settle(run, StepResult(error=located(JavaScriptError(text), run.script)))
        else:
            outcome = self._step(run.script, run.environment, self._resume, number, payload)
            if not again:
                self.drop(number)
            self._settle(run, outcome)
        self.robot.stepped()

    def end_other(self, number: int, error: dict[str, str] | None) -> None:
        """End a suspended script, as another one demands; `error` is a description, None if it succeeded."""
        run = self._runs.get(number)
        if run is not None and run.suspended is not None:
            self._settle(run, StepResult(error=None if error is None else thrown(error, run.script)))

    # ---- steps -------------------------------------------------------------------------------------------------------

    def _begin_script(self, script: SourceText, variables: dict[str, Any]) -> Any:
        """Run the first step. Returns a `StepResult`, or the truth value of a condition."""
        environment = self._environments.get(id(variables)) or self._environment(variables)
        loaded = self._loaded.get(script) or self._load_script(script)
        outcome = self._step(script, environment, self._begin, loaded, environment.shown)
        if not (environment.lasting or environment.runs):
            del self._environments[id(variables)]
        return outcome

    def _step(
        self, script: SourceText, environment: Environment, call: Callable[..., Any], what: Any, given: Any
    ) -> Any:
        changes, kept = environment.changes(self)
        for name in kept:
            try:
                self._keep(environment.shown, name, environment.variables[name])
            except ValueError:  # it is of another realm
                self._keep(environment.shown, name)
        for text in (changes, given):
            if text.__class__ is str:
                self._digits.remember(text)
        robot = self.host
        time = robot.epoch + robot.scheduler.now / 1e6 if robot is not None else 0.0
        try:
            reply = call(what, given, time, changes)
            if self._reacts and self._run_reaction():
                return self._process(script, environment, reply, self._settle_promises())
        except source.failure() as error:
            return self._aborted(script, environment, error)
        if reply.__class__ is bool:
            return reply
        return self._process(script, environment, reply) if reply else _OVER

    def _settle_promises(self) -> Any:
        """Run the reactions of promises until none is left."""
        for _ in range(source.REACTIONS):
            if not self._run_reaction():
                return self._collect()
        raise source.failure()(f"Error: {source.REACTIONS} reactions of promises in one step")

    def _aborted(self, script: SourceText, environment: Environment, error: Exception) -> StepResult:
        """The outcome of a step that exceeded a limit. What it did before still counts."""
        outcome = _OVER
        with suppress(source.failure()), source.reporting(self._context):
            outcome = self._process(script, environment, self._collect())
        with suppress(source.failure()):
            self._cancel()
        text, _, stack = str(error).partition("\n")
        return replace(outcome, error=thrown({"text": text, "stack": stack}, script))

    def _process(self, script: SourceText, environment: Environment, *texts: Any) -> StepResult:
        """Apply what a step returned. An invalid text means that the script has broken built-in objects."""
        outcome = _OVER
        try:
            for text in texts:
                reply = decode(text) if text.__class__ is str and text else {}
                reply = self._digits.restored(reply, {"set": environment.variables})
                environment.apply(reply, self._kept)
                for name, kind in reply.get("altered", {}).items():
                    self._report_altered(name, kind)
                if "number" in reply:
                    outcome = self._update_run(script, environment, reply, outcome.error)
        except (ValueError, TypeError, LookupError, AttributeError) as error:
            text = f"broke the built-in objects that it needs: {type(error).__name__}: {error}"
            outcome = StepResult(error=located(JavaScriptError(text), script))
        return outcome

    def _report_altered(self, name: str, kind: str) -> None:
        report = self.robot.altered()
        if report is not None:
            report(name, f"{kind} of JavaScript is stored as plain data")

    def _update_run(
        self, script: SourceText, environment: Environment, reply: dict[str, Any], error: BaseException | None
    ) -> StepResult:
        """Execute commands and find out whether the run is over. `error` is an earlier error of the step."""
        run = self._runs.get(reply["number"]) or ScriptRun(reply["number"], script, environment)
        run.entrusted |= bool(reply.get("kept"))
        failures = [error, *(execute(self, run, command) for command in reply.get("commands", ()))]
        for rejection in reply.get("rejected", ()):
            run.rejection = str(rejection["text"])
            if self.host is not None:
                self.host.report(script.element, f"a promise was rejected: {run.rejection}")
        if "error" in reply:
            failures.append(thrown(reply["error"], script))
        error = next((failure for failure in failures if failure is not None), None)
        if reply["over"] and not run.callbacks and error is None:
            return StepResult(value=reply.get("value"))
        if run.number not in self._runs:
            self._runs[run.number] = run
            environment.runs += 1
        return StepResult(reply["over"], error, reply.get("value"), run)

    # ---- end of runs -------------------------------------------------------------------------------------------------

    def _settle(self, run: ScriptRun, outcome: StepResult) -> None:
        """Handle the end of a callback: its script may be over or have failed."""
        suspended, error = run.suspended, outcome.error
        if error is None and suspended is not None and not outcome.over:
            error = _unfinished(run)
        if error is not None:
            self._end(run)
        if suspended is not None and (outcome.over or error is not None):
            run.suspended = None
            suspended.end(error)
        elif error is not None:
            self.robot.failed(run.environment.variables, run.script.element, error)
        self._forget_if_done(run)

    def _end(self, run: ScriptRun | None) -> None:
        """End a run: forget it and all its callbacks."""
        if run is None or self._runs.pop(run.number, None) is None:
            return
        run.environment.runs -= 1
        for number in tuple(run.callbacks):
            self.drop(number)
        with suppress(source.failure()):
            self._cancel(run.number)

    def _forget_if_done(self, run: ScriptRun) -> None:
        """Forget a run that is over and has no callbacks."""
        if run.suspended is None and not run.callbacks and self._runs.pop(run.number, None) is not None:
            run.environment.runs -= 1

    def _is_livelock(self) -> bool:
        now = self.robot.scheduler.now
        self._calls = self._calls + 1 if now == self._instant else 1
        self._instant = now
        return self._calls > source.AT_ONE_INSTANT

    # ---- caches ------------------------------------------------------------------------------------------------------

    def _environment(self, variables: dict[str, Any]) -> Environment:
        environment = self._environments[id(variables)] = Environment(variables, self._open())
        return environment

    def _load_script(self, script: SourceText) -> Any:
        """Compile a script in this context."""
        self.names |= script.names
        self.computed |= script.computed
        for environment in self._environments.values():
            environment.resend()
        self._reacts |= not _PROMISING.isdisjoint(script.names)
        kind = "bpmn:ScriptTask" if script.mode == "script" else "bpmn:SequenceFlow"
        loaded = self._load(self._context.eval(script.code), script.element, kind, script.mode)
        self._loaded[script] = loaded
        return loaded


def _unfinished(run: ScriptRun) -> BaseException | None:
    """The error of a script that is not over and can no longer end; None if it can."""
    if "next" not in run.script.names:
        text = "never calls next()"
    elif run.callbacks or run.entrusted:
        return None
    else:
        text = "returned without calling next(), and left nothing that could call it"
    rejection = f"; a promise was rejected: {run.rejection}" if run.rejection else ""
    if not rejection and "async" in run.script.names:
        rejection = "; an async function may have thrown: its errors appear only where it is awaited or caught"
    return located(JavaScriptError(text + rejection), run.script)


@cache
def _interface() -> str:
    """The text of interface.js, at lines beyond those of any file, so that stacks tell it from scripts."""
    return "\n" * _FAR + files(__package__).joinpath("interface.js").read_text(encoding="utf-8")
