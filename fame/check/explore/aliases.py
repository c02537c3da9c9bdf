"""Variables that may hold the same list, set or mapping: what a script changes in one, it changes in the others.

After ``z = x`` a later ``z.append(3)`` changes `x` too, but an exploration keeps the value of each variable by itself.
There, a script that may change in place what another variable of its pool may hold too begins with a call of `shared`.
It makes the script undecidable where two of the values may be the same object, which only equal ones can be; and
whoever looks for what the script changes finds all of them in the call.

Values flow: after ``z = x[0]`` the object of `z` may be any in `x`; after ``z.append(x)`` or ``z = [x]`` only those
inside of it. Two variables may share an object if it may have flowed to both from the same variable.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from typing import Any, Literal

from fame.bpmn import model
from fame.check.explore.element_variables import used_besides_texts
from fame.check.explore.graph import reachable
from fame.check.explore.values import UndecidableError, is_unknown
from fame.check.expressions import expressions_in
from fame.engine.data import variable_name
from fame.scripting.effects import effects_of
from fame.scripting.interface import ALWAYS
from fame.scripting.python import accepted
from fame.scripting.python_effects import (
    CHANGING_METHODS,
    COMPUTING,
    NEW,
    READING_METHODS,
    changed_place,
    changes_itself,
    changes_something,
    handed_over,
    is_understood,
    root,
    syntax_tree,
)

SHARED = "_shared_"
"""The name under which scripts call `shared`."""
ChangedPlace = tuple[str, bool]
"""A variable that a script changes in place, and whether it is only the object of the variable itself."""
FlowKind = Literal["is", "holds", "into", "inside"]
Flow = tuple[Set[str], Set[str], FlowKind]
"""(from, to, how): how values flow. The object of the second may be one of the first, or is new and holds some; or they
were put into the object that it had, or into one inside of it."""


class Aliases:
    """The variables of a team that may hold parts of the same value, by its scripts, messages and mappings.

    What is stored in place (``t[0].append(c)``) is also in all other variables in which that change shows. `coarse`:
    what parameters and comprehensions bind counts as variables of these names, which is more than there is.
    """

    def __init__(self, bodies: Iterable[model.Body] = (), *, coarse: bool = False) -> None:
        self._before: dict[str, set[str]] = defaultdict(set)
        self._after: dict[str, set[str]] = defaultdict(set)
        self._owners: dict[str, set[str]] = defaultdict(set)
        bodies = [*bodies]
        mappings = _mappings(bodies)
        flows, holders = list[Flow](), set[str]()
        for body in bodies:
            flows += _flows_in(body, mappings, coarse=coarse)
            for effects in (use.effects for use in expressions_in(body) if use.effects.leaves):
                filled = (targets for sources, targets, how in _flows_of_text(effects.expression, mappings, script=True)
                          if sources and how in ("into", "inside"))  # fmt: skip
                holders |= (effects.sets | effects.code).union(*filled)
        if any(use.effects.open for body in bodies for use in expressions_in(body)):
            names = {name for sources, targets, _ in flows for name in (*sources, *targets)}
            flows.append((names, names, "is"))
        self._functions: Set[str] = _NO_VARIABLES - _set_in(bodies)
        for sources, targets, how in flows:
            self._add(sources, targets, itself=how == "is")
        put = [(sources, (target, how == "into")) for sources, targets, how in flows if how in ("into", "inside")
               for target in targets]  # fmt: skip
        while any(self._add(sources, self.of(change), itself=False) for sources, change in put):
            pass
        self.holders: frozenset[str] = frozenset(reachable(holders, lambda one: self._after.get(one, ())))
        """What may hold functions that change something: what reads one may call them."""

    def _add(self, sources: Set[str], targets: Set[str], *, itself: bool) -> bool:
        """Add a flow; return whether it is new."""
        new = False
        for source in sources - self._functions:
            for target in targets - self._functions - {source}:
                new |= target not in self._after[source]
                self._after[source].add(target)
                self._before[target].add(source)
                if itself:
                    self._owners[target].add(source)
        return new

    def of(self, change: ChangedPlace) -> set[str]:
        """Return the other variables in which a change of one shows."""
        name, itself = change
        owners = self._owners.get(name, set()) if itself else self._before.get(name, set())
        before = reachable(owners, lambda one: self._before.get(one, ()))
        return reachable({name} | before, lambda one: self._after.get(one, ())) - {name}

    def links(self, bodies: Iterable[model.Body]) -> Iterator[tuple[frozenset[str], frozenset[str]]]:
        """(reads, writes): what a script changes in one variable, it changes in those that may hold the same value."""
        uses = [use for body in bodies for use in expressions_in(body) if use.expression.language == "python"]
        for text in {use.expression for use in uses}:
            for change in changes_in_place(text):
                yield _sources(text, change), frozenset(self.of(change))

    def marked(self, script: model.Expression, needed: Set[str]) -> model.Expression:
        """Return a script with a call of `shared`, if it may change what others that are needed
        hold; each line stays."""
        names = defaultdict[str, set[str]](set)
        for change in sorted(changes_in_place(script)):
            for name in (
                sorted(filter(str.isidentifier, _sources(script, change)))
                if (others := {*filter(str.isidentifier, self.of(change) & needed)})
                else ()
            ):
                names[name] |= others - {name}
        parsed = accepted(script, "exec") if names else None
        if parsed is None:
            return script
        calls = (", ".join(f"lambda: {one}" for one in (name, *sorted(others))) for name, others in names.items())
        text = "; ".join(f"{SHARED}({call})" for call in calls)
        return replace(script, text=f"{text}\n{parsed[0]}", line=script.line - 1)


@lru_cache(maxsize=1024)
def _sources(text: model.Expression, change: ChangedPlace) -> frozenset[str]:
    """The variables that a text may change in place there: the one that it names, and those that this may be of."""
    name, itself = change
    before, owners = defaultdict[str, set[str]](set), set[str]()
    for sources, targets, how in _flows_of_text(text, frozenset(), script=True):
        owners |= sources if name in targets and (how == "is" or not itself) else set()
        for target in targets:
            before[target] |= sources
    return frozenset(reachable(owners, lambda one: before.get(one, ()))) - _NO_VARIABLES | {name}


# ---- how values flow -------------------------------------------------------------------------------------------------


def _mappings(bodies: Iterable[model.Body]) -> set[str]:
    """The variables that only hold mappings and sets: iterating over one gives keys, which nothing changes."""
    mappings, others = set[str](), set[str]()
    nodes = [node for body in bodies for node in body.nodes]
    if any(isinstance(node, model.Task) and node.kind in ("user", "manual") for node in nodes):
        return set()  # a person may give any value
    for body in bodies:
        outputs = {id for node in body.nodes for id in node.data_outputs}
        others |= {name for item in body.data_objects if item.id in outputs for name in item.names}
        others |= {name for item in body.data_objects for name, value in item.values
                   if value.text not in ("", f"${{{name}}}")}  # fmt: skip
        others |= {name for node in body.nodes for name in node.sets()}
        for topic, _ in (one for node in body.nodes for one in node.topics()):
            others |= {variable_name(topic.name), *(item.target for item in topic.takes)}
        for use in expressions_in(body):
            new = mappings_in(syntax_tree(use.expression) or ast.Pass()) if use.use == "script" else set()
            if use.effects.open:
                return set()
            mappings |= new
            others |= (use.effects.sets | use.effects.code) - new
    return mappings - others


def _set_in(bodies: Iterable[model.Body]) -> set[str]:
    """The variables that something in the bodies sets."""
    names = set[str]()
    for body in bodies:
        names.update(*(use.effects.sets | use.effects.code for use in expressions_in(body)))
        names.update(*(used_besides_texts(node, body) for node in body.nodes))
        names.update(*(item.names for item in body.data_objects))
    return names


def _flows_in(body: model.Body, mappings: Set[str], *, coarse: bool) -> Iterator[Flow]:
    for node in body.nodes:
        yield from _flows_of(node)
    for use in expressions_in(body):
        if use.expression.language == "python" and isinstance(use.element, model.FlowNode | model.SequenceFlow):
            yield from _flows_of_text(use.expression, mappings, script=use.use == "script", coarse=coarse)
        elif use.use == "script":  # in JavaScript
            names = use.reads | use.effects.sets
            yield names, names, "is"
        elif isinstance(use.element, model.DataObject):
            yield use.reads, {*use.element.names}, "is"


def _flows_of_text(text: model.Expression, mappings: Set[str], *, script: bool, coarse: bool = False) -> Iterator[Flow]:
    """How values flow in a text in Python; where it has a part that is not understood, from each name to each."""
    nodes = [*ast.walk(syntax_tree(text, script=script) or ast.Pass())]
    names = {name for node in nodes for name in _names_of(node)}
    if not all(map(is_understood, nodes)):
        yield names, names, "is"
    local = {} if coarse else _local_names(text)
    for node in nodes:
        for sources, targets, how in _flows_at(node, mappings, names):
            yield {local.get(one, one) for one in sources}, {local.get(one, one) for one in targets}, how


def _flows_of(node: model.FlowNode) -> Iterator[Flow]:
    for topic, throws in node.topics():
        if not throws:
            yield {f"?{topic.qualified}"}, {item.target for item in topic.takes}, "is"
    copies = [*node.copies_in, *node.copies_out, *((*node.io.inputs, *node.io.outputs) if node.io is not None else ())]
    for item in copies:
        yield effects_of(item.source).reads, {item.target}, "is"
    if isinstance(node.loop, model.MultiInstance):
        inside = {node.loop.element_variable, node.loop.output_collection} - {""}
        read = {name for text, _ in node.texts() for name in effects_of(text).reads}
        yield read | inside, inside, "is"


def _flows_at(node: ast.AST, mappings: Set[str], names: Set[str]) -> Iterator[Flow]:
    """How values flow at a part of a text with these names."""
    match node:
        case ast.Assign(targets=targets, value=value):
            yield from _assigned(targets, value, mappings)
        case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
            yield from _assigned([target], value, mappings)
        case ast.For(target=target, iter=value) | ast.AsyncFor(target=target, iter=value) \
                | ast.comprehension(target=target, iter=value):  # fmt: skip
            keys = isinstance(value, ast.Name) and value.id in mappings
            yield from _assigned([target], ast.Constant(0) if keys else ast.Starred(value), mappings)
        case ast.AugAssign(target=target, value=value):
            yield parts_in(value), parts_in(target), _put(target)
        case ast.Match(subject=value):
            captured = {name for one in ast.walk(node) if isinstance(one, ast.pattern) for name in _names_of(one)}
            yield parts_in(value) | captured, captured, "is"
        case ast.Call(func=ast.Attribute(value=value, attr=name), args=arguments, keywords=named) \
                if name in CHANGING_METHODS | READING_METHODS and not root(value) & COMPUTING:  # fmt: skip
            given = set[str]().union(*map(parts_in, arguments), *(parts_in(one.value) for one in named))
            yield given, parts_in(value) if name in CHANGING_METHODS else set(), _put(value)
        case ast.Call():
            if any(True for _ in handed_over(node)):
                yield parts_in(node), parts_in(node), "inside"
        case ast.ExceptHandler(name=str() as name):
            yield names, {name}, "is"
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda():
            inside = {name for one in ast.walk(node) for name in _names_of(one)}
            parameters = {one.arg for one in ast.walk(node) if isinstance(one, ast.arg)}
            if any(map(changes_something, ast.walk(node))):
                yield names, parameters, "is"
            if not isinstance(node, ast.Lambda):
                yield inside, {node.name}, "is"


def _assigned(targets: Sequence[ast.expr], value: ast.expr, mappings: Set[str]) -> Iterator[Flow]:
    """How a value flows to what it is assigned to; what is assigned at the same time may be one object."""
    together = {name for target in targets for name in _stored(target)}
    if len(targets) == 1 and isinstance(targets[0], ast.Tuple | ast.List) and isinstance(value, ast.Tuple | ast.List) \
            and len(value.elts) == len(targets[0].elts) \
            and not any(isinstance(one, ast.Starred | ast.NamedExpr) for one in ast.walk(value)):  # fmt: skip
        for target, item in zip(targets[0].elts, value.elts, strict=True):
            yield from _assigned([target], item, mappings)
        return
    parts = parts_in(value, mappings)
    if len(together) > 1 and not isinstance(value, ast.Constant):
        yield together, together, "is"
    for target in targets:
        for one in _places(target):
            if isinstance(one, ast.Name):
                whole = len(targets) == 1 and one is target and new_value(value)
                yield parts, {one.id}, "holds" if whole else "is"
            elif isinstance(one, ast.Subscript | ast.Attribute):
                yield parts, parts_in(one.value), _put(one.value)


def _put(place: ast.expr) -> FlowKind:
    """How something is put into the object that an expression gives."""
    return "into" if isinstance(place, ast.Name) else "inside"


def _places(target: ast.expr) -> Iterator[ast.expr]:
    """The single targets of an assignment."""
    if isinstance(target, ast.Tuple | ast.List):
        for one in target.elts:
            yield from _places(one)
    else:
        yield target.value if isinstance(target, ast.Starred) else target


def _stored(target: ast.expr) -> set[str]:
    return set[str]().union(*map(parts_in, _places(target)))


def _names_of(node: ast.AST) -> Iterator[str]:
    """The names that a part of a text has."""
    match node:
        case ast.Name(id=name) | ast.arg(arg=name):
            yield name
        case ast.MatchAs(name=str() as name) | ast.MatchStar(name=str() as name) | ast.MatchMapping(rest=str() as name):
            yield name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.ExceptHandler(name=str() as name):
            yield name
        case ast.alias(name=name, asname=other):
            yield other or name.partition(".")[0]


@lru_cache(maxsize=1024)
def _local_names(text: model.Expression) -> dict[str, str]:
    """Names of parameters and of what comprehensions bind, which are no variables -> their names in flows."""
    effects = effects_of(text, script=True)
    names = {name for node in ast.walk(syntax_tree(text) or ast.Pass()) for name in _names_of(node)} - _NO_VARIABLES
    return {name: f"{name} {text.text}" for name in names - effects.reads - effects.sets - effects.code}


@lru_cache(maxsize=1024)
def changes_in_place(script: model.Expression) -> frozenset[ChangedPlace]:
    """Return what a script in Python may change in lists, mappings or objects, which other variables may hold too."""
    changes = set[ChangedPlace]()
    nodes = [*ast.walk(syntax_tree(script) or ast.Pass())]
    for node in nodes:
        if isinstance(node, ast.AugAssign) and not _of_numbers(node):
            changes |= {(name, isinstance(node.target, ast.Name)) for name in parts_in(node.target)}
        if (place := changed_place(node)) is not None:
            changes |= {(name, isinstance(place, ast.Name)) for name in parts_in(place)}
        elif isinstance(node, ast.Call) and not changes_itself(node):
            changes |= {(name, False) for name in handed_over(node)}
    if not all(map(is_understood, nodes)):
        changes |= {(name, False) for node in nodes for name in _names_of(node)}
    local = _local_names(script)
    return frozenset((local.get(name, name), itself) for name, itself in changes)


def _of_numbers(node: ast.AugAssign) -> bool:
    """Whether it is an operation that no list, set or mapping has: ``n += 1``."""
    number = isinstance(node.value, ast.Constant) and isinstance(node.value.value, int | float)
    return number and not isinstance(node.op, ast.Mult)


def parts_in(node: ast.AST, mappings: Set[str] = frozenset()) -> set[str]:
    """Return the names in an expression of whose values it may hold a part; functions give keys of `mappings`."""
    inside: list[ast.AST] = [*ast.iter_child_nodes(node)]
    match node:
        case ast.Name():
            return {node.id}
        case ast.UnaryOp() | ast.Compare() | ast.JoinedStr() | ast.Constant():
            return set()
        case ast.BinOp(op=op) if not isinstance(op, ast.Add | ast.Mult | ast.BitOr | ast.MatMult):
            return set()
        case ast.Call(func=function):
            if _is_fresh(node):
                return set()
            iterates = isinstance(function, ast.Name) and function.id in _ITERATE
            inside = [function, *node.args]
            inside += [one.value for one in node.keywords if not (iterates and one.arg == "key")]
            if iterates:
                inside = [one for one in inside if not (isinstance(one, ast.Name) and one.id in mappings)]
        case ast.Subscript(value=value):
            inside = [value]
    return set[str]().union(*(parts_in(one, mappings) for one in inside))


def mappings_in(tree: ast.AST) -> set[str]:
    """Return the names to which a script assigns nothing but new mappings or sets."""
    mappings, places = set[str](), set[int]()
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Name(id=name) as target], value=value):
                match value:
                    case ast.Dict() | ast.DictComp() | ast.Set() | ast.SetComp() | ast.Call(ast.Name("dict" | "set")):
                        mappings.add(name)
                        places.add(id(target))
    return mappings - {name for node in ast.walk(tree) if id(node) not in places and _binds(node)
                       for name in _names_of(node)}  # fmt: skip


def _binds(node: ast.AST) -> bool:
    return not (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load))


def new_value(node: ast.AST) -> bool:
    """Return whether the value of an expression is an object of its own, though parts of it need not be."""
    return isinstance(node, NEW) or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
                                      and node.func.id in _FRESH | _COPIES)  # fmt: skip


def _is_fresh(call: ast.Call) -> bool:
    match call.func:
        case ast.Attribute(value=ast.Name("math")):
            return True
        case ast.Name("sum"):  # what it begins with may be what it gives
            return len(call.args) == 1 and not call.keywords
        case ast.Name(name):
            return name in _FRESH
    return False


_FRESH = frozenset(
    ("abs", "all", "any", "bool", "bytes", "divmod", "float", "format", "hash", "int", "isinstance", "len", "print",
     "range", "repr", "round", "str")
)  # fmt: skip
"""Functions whose results hold no part of their arguments."""
_COPIES = frozenset(("dict", "list", "set", "sorted", "tuple"))
"""Functions whose results are new, and hold parts of their arguments."""
_ITERATE = frozenset(("enumerate", "frozenset", "iter", "list", "max", "min", "reversed", "set", "sorted", "tuple"))
"""Functions whose results hold what iterating over their arguments gives, but not of a key."""
_NO_VARIABLES = frozenset(ALWAYS) | {"robot", "signal", "log"}
"""Names of the script interface: functions without a memory."""

# ---- values ----------------------------------------------------------------------------------------------------------


def shared(touched: Callable[[], Any], *others: Callable[[], Any]) -> None:
    """Raise UndecidableError if other variables may hold the same list, set or mapping as one that is changed."""
    mutable = [*_mutable(_value(touched))]
    if any(may_equal(one, value) for other in others for value in _mutable(_value(other)) for one in mutable):
        raise UndecidableError


def _value(getter: Callable[[], Any]) -> Any:
    try:
        return getter()
    except NameError:
        return None


def _mutable(value: Any) -> Iterator[Any]:
    """The lists, sets and mappings in a value, and what may be one."""
    if isinstance(value, list | set | dict) or is_unknown(value):
        yield value
    for item in _inside(value):
        yield from _mutable(item)


def _inside(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    if is_dataclass(value) and not isinstance(value, type):
        return [getattr(value, field.name) for field in fields(value)]
    return value if isinstance(value, list | tuple) else ()


def may_equal(first: Any, other: Any) -> bool:
    """Return whether two values are equal, or may be, as something in them is unknown."""
    if is_unknown(first) or is_unknown(other):
        return True
    if first.__class__ is not other.__class__:
        return False
    if isinstance(first, dict):
        return first.keys() == other.keys() and all(may_equal(first[key], other[key]) for key in first)
    inside, others = [*_inside(first)], [*_inside(other)]
    if inside or others:
        return len(inside) == len(others) and all(map(may_equal, inside, others))
    return bool(first == other)
