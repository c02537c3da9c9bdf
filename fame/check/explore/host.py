"""The host of an explored engine: everything that may happen in the world is decided by the exploration.

Nothing is sent and nothing waits. What the engine publishes is noted, timers are kept by key, and scripts that may not
be computed leave unknown variables. Methods without a docstring are those of `fame.engine.host.Host`.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Set
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

from fame.bpmn.model import Expression
from fame.bpmn.topics import EMPTY_TYPE, TopicUse
from fame.check.explore.abstraction import Abstraction, AbstractStep, step_name
from fame.check.explore.aliases import SHARED, Aliases, changes_in_place, shared
from fame.check.explore.asking import asking, functions
from fame.check.explore.graph import reachable
from fame.check.explore.mismatches import ANY, Kinds, inserted_whole, kind_of
from fame.check.explore.purity import STEPS, is_computable
from fame.check.explore.remembering import Memory, Outcomes, key_of, memory_of, owner_of
from fame.check.explore.slicing import fails_alone, may_fail, may_mismatch
from fame.check.explore.timers import Timer
from fame.check.explore.values import (
    LENGTHS,
    MARK,
    UndecidableError,
    Values,
    holds_unknown,
    is_fixed,
    is_unknown,
    numbers_of,
)
from fame.dataclasses import dataclass, field, replace
from fame.engine import UNDEFINED, Engine, Instance
from fame.engine.host import BpmnError
from fame.engine.state import Trail, Wait
from fame.engine.tasks import SCRIPT
from fame.errors import FameError, ModelError
from fame.iso8601 import TIMES, parse_duration
from fame.middleware import typesystem
from fame.middleware.definitions import Field
from fame.scripting import compile_expression, compile_script, effects_of
from fame.scripting.interface import interface
from fame.text import topic_of

Flag = tuple[str, str]
"""Something to report of a step: (kind, detail)."""
Send = tuple[str, int, str]
"""A message: topic, number of its value, name of the only receiver or ""."""

Event = tuple[str, str, Any]
"""Something that a property names: (element, what, detail), with the words of `fame.engine`."""

MOST_DECISIONS = 8
"""Decisions within one step that go all ways; later ones alternate, so that a loop over an unknown condition ends."""


class _Doubts(int):
    """A number of ways that `choose` tells from others: they do not count as decisions."""


DOUBT = _Doubts(2)
MOST_DOUBTS = 24
"""Doubts within one step that are tried."""

SUPPOSED = "supposed"
"""The flag of an uncaught error of which it is only not known that it cannot happen."""

Stop = Callable[[], bool]
"""Returns whether the time is over."""


class OutOfTimeError(Exception):
    """The time of a search is over in the middle of a step."""


class Running:
    """A script, service or behaviour that takes time."""

    def __init__(self, step: AbstractStep) -> None:
        self.step = step

    def close(self) -> None: ...

    def send(self, value: Any) -> None: ...

    throw = send


@dataclass(slots=True)
class Outcome:
    """What a stimulus has led to, besides the state of the engine."""

    sent: list[Send] = field(default_factory=list)
    flags: list[Flag] = field(default_factory=list)
    over: list[Instance] = field(default_factory=list)
    begun: list[Instance] = field(default_factory=list)
    quiet: bool = True
    events: list[Event] = field(default_factory=list)
    choices: list[tuple[str, int, int]] = field(default_factory=list)  # element, chosen, ways
    doubts: int = 0
    """How many of the choices were `DOUBT`."""
    settled: set[int] = field(default_factory=set)
    """Places of choices that were made before, and remembered."""
    unsure: set[str] = field(default_factory=set)
    """Elements that failed while they used something unknown."""
    supposed: set[str] = field(default_factory=set)
    """Elements that failed because that is not known not to happen: it counts only where an error event catches it."""

    @property
    def most(self) -> int:
        """The number of choices that go all ways."""
        return MOST_DECISIONS + min(self.doubts, MOST_DOUBTS)


class ExplorationHost:
    """The host of all engines of one robot's program.

    robots    the names of the team
    ordered   timers fire in the order of their durations, where that is known
    observed  (element, what) of the events that properties name
    judged    properties are judged: scripts may fail also where nothing catches that
    """

    robot: str
    types: Mapping[str, TopicUse]
    values: Values
    robots: tuple[str, ...]
    ordered: bool
    observed: Set[tuple[str, str]]
    fields: frozenset[str]
    place: str
    engine: Engine

    def __init__(
        self,
        robot: str,
        model: Abstraction,
        values: Values,
        robots: tuple[str, ...],
        ordered: bool,
        observed: Set[tuple[str, str]] = frozenset(),
        *,
        judged: bool = False,
    ) -> None:
        self.robot, self.values, self.robots, self.ordered, self.observed = robot, values, robots, ordered, observed
        self.types, self.fields = model.facts.types, field_names(model.facts.types)
        self.steps: Mapping[str, AbstractStep] = model.steps
        self.matters: Set[str] = model.matters
        self.own_topics: frozenset[str] = frozenset()
        self.decisions: tuple[int, ...] = ()
        self.place = ""
        self.stop: Callable[[], bool] = never
        """Whether the time of the search is over."""
        self.entered: set[str] = set()
        self.caught: Set[str] = model.caught
        """Scripts whose failures may decide something: an error event catches them, or they are raised on purpose."""
        self.guarded: Set[str] = model.guarded
        """Scripts whose exceptions an error event catches."""
        self.risky: Set[str] = model.risky if judged else model.risky & model.guarded
        """Scripts that may fail if something is not known or not executed."""
        self.asks: Mapping[str, Set[str]] = model.asks
        """The codes with which scripts that wait fail, see `Abstraction`."""
        self.codes: Collection[str] = model.facts.codes
        """Error codes that somebody names."""
        self.computed: Mapping[tuple[str, str], Collection[str]] = model.computed
        """The computed codes of throwing events, see `Abstraction`."""
        self.supposed: set[str] = {*model.failures.supposed}
        """What fails with `script` only because it is not known that it does not, see `Outcome.supposed`."""
        self.doubted: dict[str, str] = {}
        """Elements that may have failed in a step since something is not known, and at which text."""
        self.kinds: Kinds = model.kinds
        self.originals: Mapping[str, Collection[Expression]] = model.originals
        """Scripts as they are in the model."""
        self.uses: Mapping[tuple[str, str], str] = model.uses
        """(element, text) of expressions that may fail -> their use."""
        self.judged: bool = judged
        self.opaque: set[str] = set()
        """Scripts that may raise, and are not executed."""
        self.skipped: dict[str, str] = {}
        """Scripts of which something is not executed that may raise, and what of it."""
        self.payloads: Mapping[tuple[str, str], str] = model.payloads
        """Payloads that do not fit without anybody noticing, see `Abstraction`."""
        self.shared_topics: Set[str] = model.facts.shared
        self.midway: dict[str, str] = {}
        """Scripts that publish before they wait or any number of times, and a topic: explored is that at their end."""
        self.left_out: Mapping[str, str] = model.skipped
        """Statements that the abstraction has left out, see `Abstraction.skipped`."""
        self.traceable: bool = True
        """Whether `Watched` variables note all that texts read and write."""
        self.given: Mapping[str, Set[str]] = model.given
        """What a person sets who completes a task, see `Abstraction`."""
        self.formless: Set[str] = model.formless
        self.names: Set[str] = frozenset()
        """All variables that decide something."""
        self.counts: Mapping[tuple[str, str], bool] = model.counts
        """Collections and cardinalities, see `Abstraction`."""
        self.shortened: set[str] = set()
        """Elements with lists or numbers of which only a few are tried."""
        self.kept: Callable[[str], bool] = lambda name: True
        self.remembered: Mapping[str, Set[str]] = {}
        """Conditions whose outcome is remembered, see `remembering`."""
        self.memory: Memory = Memory({})
        self.aliases: Aliases = model.facts.aliases
        self.leaked: Set[str] = model.facts.leaked
        """Variables that what reads one of `Aliases.holders` may change, see `TeamFacts`."""
        self.late: Set[str] = model.facts.late
        """Variables that functions of JavaScript may set at any time; "" stands for all."""
        self._again: deque[int] = deque()
        """What was chosen before in the condition that is asked again."""
        self._blank: dict[str, int] = {}
        for use in self.types.values():  # classes of messages are made once, which takes as long as many steps
            self._blank_of(use.type)
        self._interface = interface(robot=self._stub(), signal=self._signal, log=lambda level, text: None, budget=STEPS)
        self._interface |= numbers_of(values) | functions(values) | {SHARED: shared}
        self.reset()

    def reset(self) -> None:
        """Reset the record of the last step."""
        self.outcome: Outcome = Outcome()
        self.timers: dict[int, Timer] = {}
        self.fired: Timer | None = None
        self.values.choose = self.choose
        self.memory.scopes.clear()

    def new_variables(self) -> dict[str, Any]:
        """Return what an instance starts with."""
        new = {"__builtins__": self._interface}
        return Outcomes(new, self.memory) if self.remembered else new

    def compute(self, element: str) -> None:
        """Begin to compute a text of an element. Raises OutOfTimeError when the time is over."""
        if self.stop():
            raise OutOfTimeError
        self.place = element

    # ---- decisions -----------------------------------------------------------------------------------

    def choose(self, ways: int) -> int:
        """Return one of several ways: as decided, else the first; from `MOST_DECISIONS` on they alternate."""
        choices = self.outcome.choices
        self.shortened.update((self.place,) if ways is LENGTHS else ())
        place = len(choices)
        self.outcome.doubts += ways is DOUBT
        if self._again:
            self.outcome.settled.add(place)
            choices.append((self.place, self._again.popleft(), ways))
            return choices[place][1]
        undecided = 0 if place < self.outcome.most or ways is DOUBT else place % ways
        chosen = self.decisions[place] if place < len(self.decisions) else undecided
        choices.append((self.place, chosen, ways))
        return chosen

    # ---- texts ---------------------------------------------------------------------------------------

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Callable[..., Any]:
        made = self._compile(expression, element=element, file=file, script=script)
        reads = effects_of(expression, script=script).reads
        late = (self.names if "" in self.late else self.late) & reads
        holders = self.aliases.holders & reads

        def evaluate(variables: dict[str, Any]) -> Any:
            self._set_unknown([name for name in late if name in variables], variables)
            called = not all(name in variables and is_fixed(variables[name]) for name in holders)
            result = made(variables)
            if called:
                self._change(self.leaked, variables)
                self.memory.change(self.leaked)
            return result

        return evaluate if late or holders else made

    def _compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Callable[..., Any]:
        if ":=" in expression.text:  # within a comprehension it sets a variable past all methods of the dict
            self.traceable = False
        if script:
            run = self._script(expression, element, file)
            waits = effects_of(expression, script=True).waits
            return self._noted(run if waits else self._forgetting(run, expression), element)
        if self.payloads.get((element, expression.text), "") not in self.matters | {""}:
            self.skipped[element] = expression.text
        key = key_of(expression)
        made = self._doubting(self._expression(expression, element, file), expression, element)
        codes = self.computed.get((element, expression.text))
        if codes is not None:
            return lambda variables: self._code(made(variables), codes, element)
        if (element, expression.text) in self.counts:
            number = self.counts[element, expression.text]
            fits = self.kinds.is_count(expression) if number else self.kinds.is_list(expression)
            return partial(self._items, made, element, number=number, doubt="" if fits else expression.text)
        return self._remembering(made, key) if key in self.remembered else made

    def _expression(self, expression: Expression, element: str, file: str) -> Callable[..., Any]:
        effects = effects_of(expression)
        changed = {name for change in changes_in_place(expression) for name in (change[0], *self.aliases.of(change))}
        changes = tuple(sorted(effects.changes | effects.may_change | changed))
        step = AbstractStep(tuple(sorted(effects.sets)), changes, open=effects.open)
        if expression.language == "javascript":
            return self._uncomputed(element, step)
        if expression.language == "python":
            run = compile_expression(asking(expression, "eval"), file=file, element=element)
            if changed or not is_computable(expression, self.fields, "eval"):
                return self._uncomputed(element, step)
            return self._python(self._reading(run, effects.reads), effects.reads, element)
        if _is_feel(expression) and not effects_of(replace(expression, language="feel")).steady:  # now() and such
            return self._uncomputed(element, step)
        run = compile_expression(expression, file=file, element=element)
        if expression.language == "payload":
            return self._checked(run, expression, element, open_to=inserted_whole(expression.text))
        return self._checked(run, expression, element)

    def _doubting(self, run: Callable[..., Any], expression: Expression, element: str) -> Callable[..., Any]:
        """An expression that may also fail since a value is not of the kind that it expects, where that is noticed."""
        use = self.uses.get((element, expression.text))
        if use is None or not (self.judged or element in self.guarded):
            return run
        computed = expression.language != "javascript" and (
            expression.language != "python" or is_computable(expression, self.fields, "eval")
        )
        doubt = self._doubts(expression, computed, condition=use == "condition")

        def evaluate(variables: dict[str, Any]) -> Any:
            if text := doubt(variables):
                self.compute(element)
                self._may_fail(element, text)
            return run(variables)

        return evaluate

    def _doubts(
        self, text: Expression, computed: bool, *, script: bool = False, condition: bool = False
    ) -> Callable[[dict[str, Any]], str]:  # fmt: skip
        """A function that gives the part of a text that may fail since a value is not of the kind that it expects.

        computed  it is executed: on values that are known it fails in an exploration as it does in a run
        """
        if not self.kinds.mismatch(text, script=script, condition=condition):
            return lambda variables: ""
        effects, found = effects_of(text, script=script), dict[tuple[str, ...], str]()
        reads = tuple(sorted(effects.reads))
        kept = [name for name in reads if name not in effects.writes]  # others may be of another kind in the middle

        def doubt(variables: dict[str, Any]) -> str:
            if computed and not any(holds_unknown(variables.get(name)) for name in reads):
                return ""
            kinds = tuple([kind_of(variables[name]) if name in variables else ANY for name in kept])
            if kinds not in found:
                known = {name: kind for name, kind in zip(kept, kinds, strict=True) if kind}
                found[kinds] = self.kinds.beside(known).mismatch(text, script=script, condition=condition)
            return found[kinds]

        return doubt

    def _script_doubts(self, scripts: Iterable[Expression], computed: bool) -> Callable[[dict[str, Any]], str]:
        """The same of the script of a task, or of several tasks that have one id."""
        each = [self._doubts(one, computed, script=True) for one in scripts]
        return lambda variables: next(filter(None, (doubt(variables) for doubt in each)), "")

    def _may_fail(self, element: str, text: str) -> None:
        """Go on, or raise something, which only counts where that is noticed. Raises BpmnError."""
        self.doubted[element] = text
        if self.choose(2 if element in self.guarded else DOUBT):
            self.outcome.supposed.add(element)
            raise BpmnError("script", MARK)

    def _remembering(self, run: Callable[..., Any], key: str) -> Callable[..., Any]:
        """A condition with the same outcome until a variable that it reads is set."""
        reads = self.remembered[key]

        def evaluate(variables: dict[str, Any]) -> Any:
            memory = memory_of(variables, reads)
            if memory is None or self._may_change_meanwhile(variables, reads):
                return run(variables)
            begun = len(self.outcome.choices)
            known = memory.recall(key)
            self._again = deque(known)
            try:
                result = run(variables)
                outcome = self.choose(2) == 0 if is_unknown(result) else result
            finally:
                self._again.clear()
            made = tuple(chosen for _, chosen, _ in self.outcome.choices[begun:])
            if made and not known:
                memory.remember(key, made)
            return outcome

        return evaluate

    def _forgetting(self, run: Callable[..., Any], script: Expression) -> Callable[..., Any]:
        """The script, which first forgets the outcomes of conditions that read what it may change in place."""
        effects = effects_of(script, script=True)
        names = (effects.changes | effects.may_change) & self.memory.readers.keys()

        def change_and_run(variables: dict[str, Any]) -> Any:
            self.memory.change(names)
            return run(variables)

        return change_and_run if names else run

    def _may_change_meanwhile(self, variables: dict[str, Any], reads: Set[str]) -> bool:
        """Whether a script or behaviour under way may set one of these variables at any time."""
        for wait in self.engine.waits.values():
            there = wait.scope.variables
            if wait.catch.trigger is SCRIPT and isinstance(made := wait.node.spec.run(there), Running):
                sets = reads & {*made.step.writes}
                if reads & {*made.step.changes} or any(
                    owner_of(there, name) is owner_of(variables, name) for name in sets
                ):
                    return True
        return False

    def _code(self, code: Any, codes: Iterable[str], element: str) -> Any:
        """An error code; an unknown one is one of those that somebody names, or another."""
        if not is_unknown(code) and MARK not in str(code):
            return code
        self.place, named = element, sorted(codes)
        chosen = self.choose(1 + len(named)) if named else 0
        return named[chosen - 1] if chosen else MARK

    def _items(
        self, made: Callable[..., Any], element: str, variables: dict[str, Any], *, number: bool, doubt: str
    ) -> Any:  # fmt: skip
        """A collection, or a number of items. If it is unknown, a few are tried, and that it is neither and fails."""
        value, self.place = made(variables), element
        if not is_unknown(value) and not (isinstance(value, str) and MARK in value):
            return value
        if doubt and (self.judged or element in self.guarded):
            self._may_fail(element, doubt)
        return self.choose(LENGTHS) if number else [*iter(self.values.unknown)]

    def _reading(
        self, run: Callable[..., Any], names: Iterable[str], sets: Iterable[str] = ()
    ) -> Callable[..., Any]:  # fmt: skip
        """A text that first takes as unknown the code or text of a caught error of which nothing is known, and then
        the functions and methods that it has set."""

        def run_unmarked(variables: dict[str, Any]) -> Any:
            for name in names:
                if isinstance(value := variables.get(name), str) and MARK in value:
                    variables[name] = self.values.unknown
            result = run(variables)
            for name in sets:
                if name in variables and callable(variables[name]):
                    variables[name] = self.values.unknown
            return result

        return run_unmarked

    def _uncomputed(self, element: str, step: AbstractStep) -> Callable[..., Any]:
        """An expression that is not executed: its value is unknown. It may also fail where an error event notices."""
        noticed = element in self.guarded and element in self.risky

        def evaluate(variables: dict[str, Any]) -> Any:
            self.compute(element)
            if noticed and self.choose(2):
                self.outcome.supposed.add(element)
                raise BpmnError("script", MARK)
            self._begin_step(step, variables)
            return self.values.unknown

        return evaluate

    def _python(self, run: Callable[..., Any], reads: Set[str], element: str) -> Callable[..., Any]:

        def evaluate(variables: dict[str, Any]) -> Any:
            self.compute(element)
            try:
                return run(variables)
            except UndecidableError:
                return self.values.unknown
            except Exception as error:
                if any(not self.values.number(variables.get(name)) for name in reads):
                    if isinstance(error, TypeError | AttributeError):
                        return self.values.unknown
                    self.outcome.unsure.add(element)
                raise

        return evaluate

    def _checked(
        self, run: Callable[..., Any], expression: Expression, element: str, *, open_to: Set[str] = frozenset()
    ) -> Callable[..., Any]:  # fmt: skip
        """An expression that is unknown if it uses an unknown value, except of variables that it only inserts."""
        number, closed = self.values.number, effects_of(expression).reads - open_to
        text = expression.language == "template"
        if _is_feel(expression):  # in a filter, a name is that of a field or of a variable
            closed |= {*re.findall(r"[^\W\d]\w*", expression.text)}
        segment = r"\.[^\W\d]\w*+(?!\s*\()"  # no method: it may use all that is there
        paths = {name: re.findall(rf"\b{re.escape(name)}((?:{segment})*)", expression.text) for name in closed}

        def uses_unknown(name: str, value: Any) -> bool:
            lists = expression.language not in ("juel", "template")  # FEEL takes the field of each item
            return not paths[name] or any(holds_unknown(_at(value, path, lists)) for path in paths[name])

        def evaluate(variables: dict[str, Any]) -> Any:
            self.compute(element)
            for name in closed:
                value = variables.get(name)
                if value is not None and (not number(value) or (holds_unknown(value) and uses_unknown(name, value))):
                    return str(self.values.unknown) if text else self.values.unknown
            return run(variables)

        return evaluate

    def _script(self, script: Expression, element: str, file: str) -> Callable[..., Any]:
        step, effects = step_of(script), effects_of(script, script=True)
        step = replace(step, codes=tuple(sorted({*step.codes, *self.asks.get(element, ())})))
        reaches = effects.reaches | (frozenset() if self.aliases.holders.isdisjoint(effects.reads) else self.leaked)
        step = replace(step, changes=tuple(sorted(reaches.union(step.changes))))
        if script.language == "javascript":
            shown = {other for name in step.changes for other in self.aliases.of((name, False))}
            step = replace(step, changes=tuple(sorted(shown.union(step.changes))))
        run: Callable[..., Any] = _nothing
        if script.language == "python":
            run = self._reading(compile_script(asking(script), file=file, element=element), effects.reads, effects.sets)
        computable = is_computable(script, self.fields)
        executed = computable and not (effects.waits or effects.catches)
        if (effects.fails or effects.computes_code) and not executed:
            self.opaque.add(element)
        risky = element in self.risky and not effects.fails
        quiet = not step.emits and not step.codes and not any(one in script.text for one in ("signal", "BpmnError"))
        guarded = element in self.guarded
        odd = guarded and (may_mismatch(script) or (effects.waits and bool(effects.reads)))
        if (risky or guarded) and not effects.fails and "script" not in step.codes:
            self.supposed.add(element)
        failing = replace(step, codes=tuple(sorted({*step.codes, "script"})))
        step = failing if effects.fails or (not executed and (risky or odd)) else step
        told = "script" in step.codes and (element in self.guarded or not risky)
        originals = tuple(self.originals.get(element, (script,)))
        doubts = self._script_doubts(originals, computable and not effects.waits)
        mismatch = next(filter(None, (self.kinds.mismatch(one, script=True) for one in originals)), "")
        raises = bool(mismatch) or any(map(may_fail, originals))
        beginning = mismatch or originals[0].text.strip().partition("\n")[0]
        if element in self.left_out or (not computable and not effects.waits and not told and raises):
            self.skipped[element] = self.left_out.get(element) or beginning
        if effects.waits:
            if mismatch and not guarded and self.judged and not effects.fails:
                self.supposed.add(element)
                self.doubted[element], step = mismatch, failing
            self.midway.update((element, topic) for topic in sorted(effects.midway & self.shared_topics))
            running = Running(step)
            return lambda variables: running
        dropped = (
            quiet
            and element not in self.caught
            and not (step.open or fails_alone(script))
            and not any(map(self.kept, (*step.writes, *(reaches if computable else step.changes))))
        )
        if dropped:
            if raises:
                self.skipped.setdefault(element, beginning)
            run = _nothing
        unseen = effects.catches or not (computable or dropped)
        perhaps = partial(self._perhaps_failing, run)
        uncertain = self._abstract if unseen else perhaps if risky else partial(self._computed, run)
        otherwise = perhaps if risky and (dropped or element in self.left_out) else partial(self._computed, run)
        reads = effects.reads
        notices = not effects.fails and not risky and (self.judged or guarded)
        if dropped or element in self.left_out:
            doubts = self._script_doubts(originals, computed=False)

        def execute(variables: dict[str, Any]) -> None:
            if notices and (text := doubts(variables)) and not (guarded and (unseen or not computable)):
                self.compute(element)
                try:
                    self._may_fail(element, text)
                except BpmnError:
                    self.end_step(step, variables, failed=True)
                    raise
            given = [variables.get(name) for name in reads]
            of_any_kind = odd and any(map(is_unknown, given))
            unset = guarded and not all(name in variables for name in reads)
            way = uncertain if any(map(holds_unknown, given)) or not (computable or dropped) else otherwise
            way = perhaps if of_any_kind and not unseen else way
            way(failing if of_any_kind or unset else step, element, variables)

        return execute

    def _computed(self, run: Callable[..., Any], step: AbstractStep, element: str, variables: dict[str, Any]) -> None:
        """Run a script; one that asks too much of an unknown value counts as not computable."""
        self.compute(element)
        sent, posted = len(self.outcome.sent), len(self.engine.ready)
        choices = len(self.outcome.choices)
        try:
            run(variables)
        except UndecidableError:
            pass
        except BpmnError as error:
            code, text = self._code(error.code, self.codes, element), error.message
            if code is error.code and not is_unknown(text):
                raise
            raise BpmnError(code, MARK if is_unknown(text) or text is error.code else text) from None
        except Exception as error:
            reads = [variables.get(name) for name in tuple(variables) if not name.startswith("__")]
            if all(map(self.values.number, reads)):
                raise
            if not _is_about_unknown(error):
                self.outcome.unsure.add(element)
                raise
            if element in self.guarded:
                step = replace(step, codes=tuple(sorted({*step.codes, "script"})))
        else:
            return
        del self.outcome.sent[sent:], self.outcome.choices[choices:]
        while len(self.engine.ready) > posted:
            self.engine.ready.pop()
        self._abstract(step, element, variables)

    def _perhaps_failing(
        self, run: Callable[..., Any], step: AbstractStep, element: str, variables: dict[str, Any]
    ) -> None:
        """Run a script that may raise because of a value that is not known, or let it fail."""
        self.compute(element)
        if self.choose(2):
            self.end_step(step, variables, failed=True)
            self.outcome.supposed.add(element)
            raise BpmnError("script", MARK)
        self._computed(run, step, element, variables)

    def _abstract(self, step: AbstractStep, element: str, variables: dict[str, Any]) -> None:
        """The known effects of a script that is not run."""
        self.compute(element)
        chosen = self.choose(1 + len(step.codes)) if step.codes else 0
        self.end_step(step, variables, failed=chosen > 0)
        if chosen:
            self._raised(element, step.codes[chosen - 1])
            raise BpmnError(step.codes[chosen - 1], MARK)

    def _raised(self, element: str, code: str | None) -> None:
        """Note that a step fails in a way that is only supposed."""
        if code == "script" and element in self.supposed:
            self.outcome.supposed.add(element)

    def finish(self, wait: Wait, code: str | None) -> None:
        """Let a script, service or behaviour end, or raise an error code."""
        variables = wait.scope.variables
        self.place = wait.node.id
        self.end_step(step_under_way(wait), variables, failed=code is not None)
        self._raised(wait.node.id, code)
        variable = wait.node.spec.variable
        if code is None and variable and self.kept(variable):
            variables[variable] = self.values.unknown
        self.engine.script_ended(wait.key, None if code is None else BpmnError(code, MARK))

    def end_step(self, step: AbstractStep, variables: dict[str, Any], *, failed: bool) -> None:
        """End a step: its results are unknown, and what it does not certainly publish is published or not."""
        self._begin_step(step, variables)
        if not failed:
            self._set_unknown(step.results, variables)
            self._change(step.used, variables)
        for topic, certain in step.emits:
            if topic in self.types and ((certain and not failed) or self.choose(2) == 0):
                self._emit(topic, self.values.unknown)

    def _begin_step(self, step: AbstractStep, variables: dict[str, Any]) -> None:
        """Make unknown what a script or behaviour may set or change at any time."""
        self.memory.change(step.changes)
        self._set_unknown(step.writes, variables)
        self._change(step.changes, variables)
        if step.open:
            self._set_unknown(sorted(self._any(variables)), variables)

    def _set_unknown(self, names: Iterable[str], variables: dict[str, Any]) -> None:
        for name in names:
            if self.kept(name):
                variables[name] = self.values.unknown

    def _change(self, names: Iterable[str], variables: dict[str, Any]) -> None:
        """Make variables unknown, unless their values are known to be of a kind that cannot be changed in place."""
        for name in filter(self.kept, names):
            value = variables.get(name)
            if not is_unknown(value) and not is_fixed(value):
                variables[name] = self.values.unknown

    def answers(self, task: str, variables: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a person sets who completes a task; of one without a form, what nothing has set perhaps not."""
        self.place, names = task, self.given.get(task, set())
        names = names | self._any(variables, names) if task in self.formless else names
        return dict.fromkeys(sorted(names), self.values.unknown)

    def _any(self, variables: Mapping[str, Any], besides: Set[str] = frozenset()) -> set[str]:
        """All variables; those that nothing has set perhaps not."""
        unset = {name for name in self.names if name not in variables and name not in besides}
        return {*self.names} - (unset if unset and self.choose(2) else set())

    def service(self, operation: str, *, element: str, file: str) -> Callable[..., Any]:
        running = Running(self.steps.get(operation) or self.steps.get(step_name(file, element)) or AbstractStep())
        return self._noted(lambda variables: running, element)

    def _noted(self, run: Callable[..., Any], element: str) -> Callable[..., Any]:
        """The function, which first notes that a token has entered the element."""

        def noted(variables: dict[str, Any]) -> Any:
            self.entered.add(element)
            return run(variables)

        return noted

    # ---- messages ------------------------------------------------------------------------------------

    def publish(self, topic: str, value: Any) -> Any:
        self.outcome.quiet = False
        number, message = self._message(topic, value)
        if topic[0] == "/":
            self.outcome.sent.append((topic, number, ""))
        return message

    def send(self, topic: str, value: Any, robot: Any) -> None:
        self.outcome.quiet = False
        number, _ = self._message(topic, value)
        if isinstance(robot, str):
            receiver = next((name for name in self.robots if name.casefold() == robot.casefold()), None)
            if receiver is None:
                raise BpmnError("unreachable", f"there is no robot {robot!r}")
        else:
            receiver = self.robots[self.choose(len(self.robots))]
        self.outcome.sent.append((topic, number, receiver))

    def _message(self, topic: str, value: Any) -> tuple[int, Any]:
        """A message by number, and as catchers get it."""
        use = self.types.get(topic)
        kind = use.type if use is not None else EMPTY_TYPE
        if kind != EMPTY_TYPE and topic not in self.matters:
            value = self.values.unknown
        if is_unknown(value):
            number = self._blank_of(kind)
            return number, self.values.value(number)
        message = self.values.message(kind, None if value is UNDEFINED else value)
        return self.values.number(message), message

    def blank(self, topic: str) -> int:
        """Return the number of a message on a topic of which nothing is known."""
        use = self.types.get(topic)
        return self._blank_of(use.type if use is not None else EMPTY_TYPE)

    def _blank_of(self, kind: str) -> int:
        number = self._blank.get(kind)
        if number is None:
            number = self._blank[kind] = self.values.number(self.values.unknown_message(kind))
        return number

    def _signal(self, name: str, payload: Any = None) -> None:
        self._emit(topic_of(str(name)), payload)

    def _emit(self, topic: str, value: Any) -> None:
        message = self.publish(topic, value)
        if topic in self.own_topics:
            self.engine.post(topic, message)

    def _stub(self) -> Any:
        def publish(topic: str, type: str, message: Any = None, /, **fields: Any) -> None:
            name = str(topic)
            name = name if name.startswith(("/", "~/")) else f"~/{name}"
            if name in self.types:
                self._emit(name, fields if message is None else message)

        return SimpleNamespace(name=self.robot, namespace=self.robot, publish=publish)

    # ---- timers --------------------------------------------------------------------------------------

    def set_timer(self, key: int, kind: str, text: str) -> None:
        if MARK not in text:
            TIMES[kind](text)
        elif self.place in self.risky:
            self._may_fail(self.place, text)
        seconds = seconds_of(text)
        period = (seconds or 1.0) if kind == "cycle" else None
        if seconds is None or not self.ordered or kind == "date":
            self.timers[key] = Timer(("alone", key), 0.0, period)
        else:
            begun = self.fired.offset if self.fired is not None else 0.0
            group = self.fired.group if self.fired is not None else "now"
            self.timers[key] = Timer(group, begun + seconds, period)

    def cancel_timer(self, key: int) -> None:
        self.timers.pop(key, None)

    # ---- the rest ------------------------------------------------------------------------------------

    def run(self, key: int, script: Any) -> None:
        self.place = self.engine.waits[key].node.id
        self._begin_step(script.step, self.engine.waits[key].scope.variables)

    def cancel(self, key: int) -> bool:
        return True

    def make_safe(self, reason: str) -> None: ...

    def observe(self, trail: Trail) -> None:
        for _, marks in trail:
            for element, what, detail in marks:
                if (element, what) in self.observed:
                    self.outcome.events.append((element, what, None if detail is None else str(detail)))

    def output_missing(self, element: str, output: str) -> None: ...

    def begun(self, instance: Instance) -> None:
        self.outcome.begun.append(instance)

    def report(self, element: str, text: str) -> None:
        if text.startswith("trigger dropped"):
            self.outcome.flags.append(("dropped", element))
        elif text.startswith("escalation"):
            self.outcome.flags.append(("escalation", element))
        elif text.startswith("condition failed"):
            self.outcome.flags.append(("condition", f"{element}\n{text}"))

    def ended(self, instance: Instance) -> None:
        self.outcome.over.append(instance)
        if instance.error is not None:
            text = instance.error.text.replace(f": {MARK}", "")
            self.outcome.flags.append(("error", f"{instance.error.element}\n{text}"))
            if instance.error.element in self.outcome.unsure:
                self.outcome.flags.append(("unsure", instance.error.element))
            if instance.error.element in self.outcome.supposed:
                self.outcome.flags.append((SUPPOSED, instance.error.element))


def _nothing(variables: dict[str, Any]) -> None:
    """What a script does of which nothing is kept."""


def never() -> bool:
    """False: nothing ends the search before its time."""
    return False


def _is_about_unknown(error: Exception) -> bool:
    """Whether an error may be due to an unknown value, which is not of the expected kind, and not to the script."""
    unpacked = isinstance(error, ValueError) and "values to unpack" in str(error)
    return unpacked or isinstance(error, TypeError | AttributeError)


def step_under_way(wait: Wait) -> AbstractStep:
    """Return what takes time where a token waits."""
    made = wait.node.spec.run(wait.scope.variables)
    assert isinstance(made, Running)
    return made.step


def step_of(script: Expression) -> AbstractStep:
    """Return the known effects of a script that is not run."""
    effects = effects_of(script, script=True)
    changes = tuple(sorted(effects.changes | effects.may_change))
    codes = tuple(sorted(effects.codes or ()))
    return AbstractStep(
        tuple(sorted(effects.writes)), changes, codes=codes, emits=effects.publications, open=effects.open
    )


def _is_feel(expression: Expression) -> bool:
    return expression.language == "feel" or (
        expression.language in ("value", "payload") and expression.text.lstrip().startswith("=")
    )


def _at(value: Any, path: str, lists: bool) -> Any:
    """What an expression finds in a message or mapping by a path such as ``.pose.x``; with `lists`, a whole list."""
    for name in path.split(".")[1:]:
        if lists and isinstance(value, list | tuple):
            return value
        value = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
    return value


@lru_cache(maxsize=1024)
def seconds_of(text: str) -> float | None:
    try:
        return parse_duration(text.rsplit("/", 1)[-1]).nanoseconds / 1e9
    except (ValueError, ModelError, FameError, AttributeError):
        return None


def field_names(types: Mapping[str, TopicUse]) -> frozenset[str]:
    """Return the names of all fields of the messages of a team."""
    every = reachable(
        (use.type for use in types.values()), lambda name: [one.base for one in _fields(name) if one.is_message]
    )
    return frozenset(word for name in every for one in _fields(name) for word in (one.name, one.attribute))


def _fields(name: str) -> tuple[Field, ...]:
    try:
        return typesystem.definition(name).fields
    except FameError:
        return ()
