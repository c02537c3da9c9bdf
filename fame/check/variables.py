"""Variables: those that are read and never set, and those that hide a name of the script interface.

Called processes share the variables of their caller, unless a mapping gives them variables of their own. Therefore the
check looks at variable spaces: a process and all that it calls without a mapping. In a space, a name counts as set if
anything sets it, in whatever order. Spaces in which people, services (other than FAME's own) or JavaScript with
computed names may set variables are not checked.
"""

from __future__ import annotations

import builtins
import difflib
from collections.abc import Iterator, Mapping

from fame.bpmn.library import Library, calls_of
from fame.bpmn.linked_forms import form_of
from fame.bpmn.model import CallActivity, DataObject, Definitions, Element, Expression, FlowNode, Process, Task, Topic
from fame.bpmn.model.forms import is_whole
from fame.bpmn.reader.expressions import has_placeholders
from fame.check.endpoints import fields_taken, taken_by_prefix, types_of
from fame.check.expressions import ExpressionUse, expressions_in
from fame.check.scope import CheckedProcess, CheckScope, Finding, Level, find_scope
from fame.dataclasses import dataclass, field
from fame.engine import gateways, loops
from fame.engine.data import variable_name
from fame.rooms import SERVICES
from fame.scripting.effects import effects_of
from fame.scripting.interface import NAMES, Robot

_SMALL = {"true": "True", "false": "False", "null": "None"}
"""Constants in most languages and in Python."""

_OF_JAVASCRIPT = ("console", "setTimeout", "this", "undefined", "JSON", "Math")
"""Names that scripts in JavaScript use and that variables are unlikely to have."""


@dataclass(slots=True)
class Uses:
    """The use of variables in one process. `declared` by data objects; `sets`: name -> first element that sets it.

    `code`: functions, classes and modules that scripts leave for later ones;
    `needs`: the variables that FAME's own services need; `opaque`: something in it may set whatever it likes.
    """

    texts: list[ExpressionUse] = field(default_factory=list)
    declared: set[str] = field(default_factory=set)
    sets: dict[str, Element] = field(default_factory=dict)
    code: set[str] = field(default_factory=set)
    needs: list[tuple[FlowNode, str]] = field(default_factory=list)
    opaque: bool = False


def check_variables(scope: CheckScope) -> Iterator[Finding]:
    """Find variables that are read and never set, and variables that hide names of the script interface."""
    types = types_of(scope)
    uses = {process: uses_of(process, types) for process in scope.processes}
    for process in scope.processes:
        yield from _hidden(process, uses[process])
    for root in scope.roots:
        given = set[str]()
        if not scope.has_pool(root) and uses[root].declared:  # the caller sets the variables of its data objects
            given = {name for process in sharing(root) for name in uses[process].declared}
        given |= scope.given.get(root.bpmn.id, frozenset())
        for space in _spaces(root, given, uses):
            yield from _unset(space, uses, scope.strict)


# ---- one process -----------------------------------------------------------------------------------------------------


def uses_of(process: CheckedProcess, types: Mapping[str, str]) -> Uses:
    """Collect the use of variables in a process."""
    uses, assigned = Uses(), assigned_objects(process)
    for body in process.bodies():
        uses.declared |= {name for item in body.data_objects for name in item.names}
        objects = {item.id: item for item in body.data_objects}
        for text in expressions_in(body):
            uses.texts.append(text)
            for name in text.effects.sets:
                uses.sets.setdefault(name, text.element)
            uses.code |= text.effects.code
            uses.opaque |= text.effects.open
        for node in body.nodes:
            for name in (*named_by(node), *_caught(process, node, objects, types)):
                uses.sets.setdefault(name, node)
            if isinstance(node, Task) and node.kind == "service" and node.operation in SERVICES:
                uses.needs += [(node, name) for name in SERVICES[node.operation].required]
            elif isinstance(node, Task):
                form = form_of(process.definitions, node.human)
                for field in form:
                    uses.sets.setdefault(field.key.partition(".")[0], node)
                uses.opaque |= node.kind in ("user", "manual", "service", "business_rule") and not is_whole(form)
            keys = [key for topic, _ in node.topics() for key, _ in node.keys_of(topic)]
            uses.needs += [(node, key.partition(".")[0]) for key in keys if "." in key]  # others its first message sets
        for item in body.data_objects:
            for name, expression in item.values:
                if item.id in assigned and sets_something(name, expression):
                    uses.sets.setdefault(name, item)
    return uses


def named_by(node: FlowNode) -> Iterator[str]:
    """Yield the variables that an element sets by name, those of FAME included."""
    yield from node.sets()
    if node.tag == "complexGateway":
        yield from gateways.NAMES
    if node.loop is not None:
        yield from loops.NAMES
    if isinstance(node, Task) and node.kind == "service":
        yield from SERVICES[node.operation].results if node.operation in SERVICES else ()


def _caught(
    process: CheckedProcess, node: FlowNode, objects: Mapping[str, DataObject], types: Mapping[str, str]
) -> Iterator[str]:
    """The variables that a caught message sets."""
    for topic, throws in node.topics():
        if not throws:
            yield from _taken(node, topic, objects, types)
            yield from taken_by_prefix(process, node, topic, types.get(topic.qualified, ""))


def _taken(node: FlowNode, topic: Topic, objects: Mapping[str, DataObject], types: Mapping[str, str]) -> Iterator[str]:
    names = tuple(name for id in node.data_outputs if id in objects for name in objects[id].names)
    if topic.takes:
        yield from (item.target for item in topic.takes)
    elif names:
        yield from fields_taken(names, topic, types.get(topic.qualified, ""))
    else:
        yield variable_name(topic.name)


def assigned_objects(process: CheckedProcess) -> set[str]:
    """Return the ids of data objects whose values are assigned when an element starts or ends."""
    objects: set[str] = set()
    for node in process.bpmn.body.walk():
        catches = node.place in ("start", "catch", "boundary")
        objects.update(node.data_inputs, () if catches else node.data_outputs)
    return objects


def sets_something(name: str, expression: Expression) -> bool:
    """Return whether a value is more than a declaration such as ``x`` or ``x: ${x}``."""
    return bool(expression.text.strip()) and effects_of(expression).reads != {name}


def _hidden(process: CheckedProcess, uses: Uses) -> Iterator[Finding]:
    for name in NAMES:
        if name in uses.sets:
            text = f"sets a variable `{name}`, which hides {name} of the script interface: rename the variable"
            yield process.finding("warning", text, uses.sets[name])


# ---- spaces ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Space:
    """A process and all that shares its variables.

    members  each with the call of the first one by which it is entered (None: the first itself)
    known    the names that anything sets, or that a script defines for later ones
    opaque   something in it may set whatever it likes
    call     the call with a mapping that made it, and whose it is
    """

    members: Mapping[CheckedProcess, CallActivity | None]
    known: frozenset[str]
    opaque: bool
    call: tuple[CheckedProcess, CallActivity] | None = None


def sharing(root: CheckedProcess) -> dict[CheckedProcess, CallActivity | None]:
    """Return the processes that share the variables of `root`, each with the call by which it is entered."""
    callers: dict[CheckedProcess, CallActivity | None] = {root: None}
    pending = [root]
    for process in pending:
        for call, callee in process.calls:
            if callee is not None and call.io is None and callee not in callers:
                callers[callee] = callers[process] or call
                pending.append(callee)
    return callers


def _spaces(root: CheckedProcess, given: set[str], uses: Mapping[CheckedProcess, Uses]) -> Iterator[_Space]:
    """The variable space of a process and those of the calls with a mapping in it."""
    pending = [_space(root, given, False, None, uses)]
    seen: set[tuple[CheckedProcess, str, frozenset[str], bool]] = set()
    for space in pending:
        yield space
        for process in space.members:
            for call, callee in process.calls:
                if call.io is None or callee is None:
                    continue
                inside = {item.target for item in call.io.inputs} | (space.known if call.io.all_in else set())
                opaque = call.io.all_in and space.opaque
                if (key := (process, call.id, frozenset(inside), opaque)) not in seen:
                    seen.add(key)
                    pending.append(_space(callee, inside, opaque, (process, call), uses))


def _space(
    root: CheckedProcess,
    given: set[str],
    opaque: bool,
    call: tuple[CheckedProcess, CallActivity] | None,
    uses: Mapping[CheckedProcess, Uses],
) -> _Space:
    members = sharing(root)
    setting = list(members)
    for process in members:
        for inner, callee in process.calls:
            if callee is None:
                opaque |= inner.io is None or inner.io.all_out
            elif inner.io is not None and inner.io.all_out:
                setting += callee.closure()
    known = frozenset(
        given.union(*(uses[process].sets for process in setting), *(uses[process].code for process in members))
    )
    opaque |= any(uses[process].opaque for process in setting) or "*" in known
    return _Space(members, known, opaque, call)


def _unset(space: _Space, uses: Mapping[CheckedProcess, Uses], strict: bool) -> Iterator[Finding]:
    """Names that are read and never set; those of a called process are reported at the call."""
    for process, entered in space.members.items() if not space.opaque else ():
        for text in uses[process].texts:
            for name in sorted(text.reads - space.known):
                level: Level = "error" if strict and text.use == "payload" else "warning"
                similar = _other_language(name, text.expression) or _similar(name, space.known)
                message = f"reads `{name}`, which nothing sets"
                here = process.finding(level, message + similar, text.element, text.expression.line)
                yield _where_called(space, process, entered, here, message, similar)
        for node, name in uses[process].needs:
            if name not in space.known:
                message, similar = f"needs `{name}`, which nothing sets", _similar(name, space.known)
                here = process.finding("warning", message + similar, node)
                yield _where_called(space, process, entered, here, message, similar)


def _where_called(
    space: _Space, process: CheckedProcess, entered: CallActivity | None, here: Finding, message: str, similar: str
) -> Finding:
    """The finding at the call that could have set the variable, else `here`."""
    text = f"{process.bpmn.display_name} {message}{similar}"
    if space.call is not None:
        caller, call = space.call
        return caller.finding(here.level, text if similar else f"{text}: add it to the mapping", call)
    if entered is not None:
        return next(iter(space.members)).finding(here.level, text, entered)
    return here


def _similar(name: str, known: frozenset[str]) -> str:
    close = difflib.get_close_matches(name, sorted(known), 1)
    return f"; did you mean `{close[0]}`?" if close else ""


def _other_language(name: str, expression: Expression) -> str:
    """A hint about a name of another language."""
    if expression.language == "python":
        if name in _SMALL:
            return f"; in Python it is {_SMALL[name]}"
        if name[0] != "_" and hasattr(Robot, name):
            return f"; did you mean robot.{name}?"
        return "; for JavaScript, set the script format javascript" if name in _OF_JAVASCRIPT else ""
    if expression.language == "javascript":
        return ""
    here = {large: small for small, large in _SMALL.items()}
    if name in here:
        return f"; in this language it is {here[name]}"
    known = name in NAMES or hasattr(builtins, name)
    return f"; {name} is a name of Python: write Python, without ${{ }}" if known else ""


def variable_names(definitions: Definitions, process: str, library: Library) -> frozenset[str] | None:
    """Return the variables of a process (id) and of what it calls without a mapping; None if
    something may set any name.

    Raises ModelError for a called process that is not found.
    """
    scope = find_scope(definitions, library)
    types = types_of(scope)
    uses = {one: uses_of(one, types) for one in scope.processes}
    root = next(one for one in scope.processes if one.bpmn.id == process and one.definitions is definitions)
    space = _space(root, uses[root].declared, False, None, uses)
    return None if space.opaque else space.known


# ---- parameters ------------------------------------------------------------------------------------------------------


def parameters(definitions: Definitions, process: Process, library: Library) -> dict[str, str]:
    """Return the variables that a process can be given, with their defaults (text; empty: none).

    They are those that its data objects hold, and those that it, or what it calls without a mapping, reads and neither
    a script nor a repetition of it sets. A default is the value that a data object gives, if that is not computed.
    Raises ModelError for a called process that is not found.
    """
    values: dict[str, str] = {}
    reads: set[str] = set()
    fixed: set[str] = set()
    pending, seen = [(definitions, process)], {(definitions.file, process.id)}
    for home, inner in pending:
        for body in inner.body.bodies():
            for name, value in ((name, value) for item in body.data_objects for name, value in item.values):
                default = "" if has_placeholders(value.text) else value.text
                if inner is process:
                    values[name] = values.get(name) or default
                elif default:
                    fixed.add(name)  # the called process sets it whatever its caller says
            for text in expressions_in(body):
                reads |= text.reads
                fixed |= text.effects.sets | text.effects.code
            for loop in (node.loop for node in body.nodes if node.loop is not None):
                fixed |= {*loops.NAMES, getattr(loop, "element_variable", "")}
        for call in calls_of(inner):
            if call.io is None:
                called = library.find(home, call)
                if (called[0].file, called[1].id) not in seen:
                    seen.add((called[0].file, called[1].id))
                    pending.append(called)
    values.update((name, "") for name in sorted(reads - fixed - set(NAMES) - values.keys()))
    return values
