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
from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

from fame.bpmn import model
from fame.check.explore.graph import reachable
from fame.check.explore.values import UndecidableError, is_unknown
from fame.check.expressions import expressions_in
from fame.engine.data import variable_name
from fame.scripting.effects import effects_of
from fame.scripting.python import accepted
from fame.scripting.python_effects import NEW, changed_place, changes_itself, handed_over, root, syntax_tree

SHARED = "_shared_"
"""The name under which scripts call `shared`."""
ChangedPlace = tuple[str, bool]
"""A variable that a script changes in place, and whether it is only the object of the variable itself."""
Flow = tuple[Set[str], Set[str], bool]
"""(from, to, whether the object of the second itself may be one of the first): how values flow between variables."""


class Aliases:
    """The variables of a team that may hold parts of the same value, by its scripts, messages and mappings."""

    def __init__(self, bodies: Iterable[model.Body] = ()) -> None:
        self._before: dict[str, set[str]] = defaultdict(set)
        self._after: dict[str, set[str]] = defaultdict(set)
        self._owners: dict[str, set[str]] = defaultdict(set)
        bodies = [*bodies]
        mappings = _mappings(bodies)
        for sources, targets, itself in (flow for body in bodies for flow in _flows_in(body, mappings)):
            for source in sources:
                self._after[source] |= targets
                for target in targets:
                    self._before[target].add(source)
                    if itself:
                        self._owners[target].add(source)

    def of(self, change: ChangedPlace) -> set[str]:
        """Return the other variables in which a change of one shows."""
        name, itself = change
        owners = self._owners.get(name, set()) if itself else self._before.get(name, set())
        before = reachable(owners, lambda one: self._before.get(one, ()))
        return reachable({name} | before, lambda one: self._after.get(one, ())) - {name}

    def links(self, bodies: Iterable[model.Body]) -> Iterator[tuple[frozenset[str], frozenset[str]]]:
        """(reads, writes): what a script changes in one variable, it changes in those that may hold the same value."""
        uses = (use for body in bodies for use in expressions_in(body) if use.use == "script")
        for change in {change for use in uses for change in changes_in_place(use.expression)}:
            yield frozenset((change[0],)), frozenset(self.of(change))

    def marked(self, script: model.Expression, needed: Set[str]) -> model.Expression:
        """Return a script with a call of `shared`, if it may change what others that are needed
        hold; each line stays."""
        changes = sorted(changes_in_place(script))
        names = {change[0]: others for change in changes if (others := self.of(change) & needed)}
        parsed = accepted(script, "exec") if names else None
        if parsed is None:
            return script
        calls = (", ".join(f"lambda: {one}" for one in (name, *sorted(others))) for name, others in names.items())
        text = "; ".join(f"{SHARED}({call})" for call in calls)
        return replace(script, text=f"{text}\n{parsed[0]}", line=script.line - 1)


# ---- how values flow -------------------------------------------------------------------------------------------------


def _mappings(bodies: Iterable[model.Body]) -> set[str]:
    """The variables that only hold mappings and sets: iterating over one gives keys, which nothing changes."""
    mappings, others = set[str](), set[str]()
    for body in bodies:
        outputs = {id for node in body.nodes for id in node.data_outputs}
        others |= {name for item in body.data_objects if item.id in outputs for name in item.names}
        others |= {name for item in body.data_objects for name, value in item.values
                   if value.text not in ("", f"${{{name}}}")}  # fmt: skip
        others |= {name for node in body.nodes for name in node.sets()}
        for topic, _ in (one for node in body.nodes for one in node.topics()):
            others |= {variable_name(topic.name), *(item.target for item in topic.takes)}
        for use in expressions_in(body):
            if use.use == "script" and (script := accepted(use.expression, "exec")):
                new, other = mappings_in(script[1])
                mappings, others = mappings | new, others | other
    return mappings - others


def _flows_in(body: model.Body, mappings: Set[str]) -> Iterator[Flow]:
    for node in body.nodes:
        yield from _flows_of(node)
    for use in expressions_in(body):
        if use.use == "script" and (parsed := accepted(use.expression, "exec")):
            for part in ast.walk(parsed[1]):
                yield from _flows_at(part, mappings)
        elif use.use == "script":  # in JavaScript
            yield use.reads, use.effects.sets, True
        elif isinstance(use.element, model.DataObject):
            yield use.reads, {*use.element.names}, True


def _flows_of(node: model.FlowNode) -> Iterator[Flow]:
    for topic, throws in node.topics():
        if not throws:
            yield {f"?{topic.qualified}"}, {item.target for item in topic.takes}, True
    for item in (*node.io.inputs, *node.io.outputs) if node.io is not None else ():
        yield effects_of(item.source).reads, {item.target}, True
    if isinstance(node.loop, model.MultiInstance):
        inside = {node.loop.element_variable, node.loop.output_collection} - {""}
        read = {name for text, _ in node.texts() for name in effects_of(text).reads}
        yield read | inside, inside, True


def _flows_at(node: ast.AST, mappings: Set[str]) -> Iterator[Flow]:
    """How values flow at a part of a script."""
    match node:
        case ast.Assign(targets=targets, value=value):
            for target in targets:
                itself = not isinstance(target, ast.Subscript | ast.Attribute)
                itself &= not (isinstance(target, ast.Name) and new_value(value))
                yield parts_in(value, mappings), _roots(target), itself
        case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
            yield parts_in(value, mappings), _roots(target), not new_value(value)
        case ast.For(target=target, iter=value) | ast.AsyncFor(target=target, iter=value):
            if not (isinstance(value, ast.Name) and value.id in mappings):
                yield parts_in(value, mappings), _roots(target), True
        case ast.AugAssign(target=target, value=value):
            yield parts_in(value), _roots(target), False
        case ast.Call(func=ast.Attribute(value=value), args=arguments):
            yield set().union(*map(parts_in, arguments)), _roots(value), False
        case ast.Call(args=arguments):
            given = set[str]().union(*map(parts_in, arguments))
            if not new_value(node) and len(given) > 1:
                yield given, given, False


def _roots(target: ast.AST) -> set[str]:
    """The variables that an assignment sets or changes in place."""
    if isinstance(target, ast.Tuple | ast.List):
        return set().union(*map(_roots, target.elts))
    while isinstance(target, ast.Subscript | ast.Attribute | ast.Starred | ast.Call):
        target = target.func if isinstance(target, ast.Call) else target.value
    return {target.id} if isinstance(target, ast.Name) else set()


@lru_cache(maxsize=1024)
def changes_in_place(script: model.Expression) -> frozenset[ChangedPlace]:
    """Return what a script in Python may change in lists, mappings or objects, which other variables may hold too."""
    changes = set[ChangedPlace]()
    for node in ast.walk(syntax_tree(script) or ast.Pass()):
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            changes.add((node.target.id, True))
        elif (place := changed_place(node)) is not None:
            changes |= {(name, isinstance(place, ast.Name)) for name in root(place)}
        elif isinstance(node, ast.Call) and not changes_itself(node):
            changes |= {
                (name, False) for name in handed_over(node) if name in effects_of(script, script=True).may_change
            }
    return frozenset(changes)


def parts_in(node: ast.AST, mappings: Set[str] = frozenset()) -> set[str]:
    """Return the names in an expression of whose values it may hold a part; functions give keys of `mappings`."""
    inside: list[ast.AST] = [*ast.iter_child_nodes(node)]
    match node:
        case ast.Name():
            return {node.id}
        case ast.UnaryOp() | ast.Compare() | ast.JoinedStr() | ast.Constant():
            return set()
        case ast.BinOp(op=op) if not isinstance(op, ast.Add | ast.Mult | ast.BitOr):
            return set()
        case ast.Call(func=function):
            if _is_fresh(function):
                return set()
            given = [*node.args, *(one.value for one in node.keywords if one.arg != "key")]
            inside = [one for one in given if not (isinstance(one, ast.Name) and one.id in mappings)]
            inside += [function.value] if isinstance(function, ast.Attribute) else []
        case ast.Subscript(value=value):
            inside = [value]
    return set[str]().union(*(parts_in(one, mappings) for one in inside))


def mappings_in(tree: ast.AST) -> tuple[set[str], set[str]]:
    """Return the names to which a script assigns new mappings or sets, and those to which it assigns other values."""
    mappings = dict[int, str]()
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Name(id=name) as target], value=value):
                match value:
                    case ast.Dict() | ast.DictComp() | ast.Set() | ast.SetComp() | ast.Call(ast.Name("dict" | "set")):
                        mappings[id(target)] = name
    stores = (node for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {*mappings.values()}, {node.id for node in stores if id(node) not in mappings}


def new_value(node: ast.AST) -> bool:
    """Return whether the value of an expression is an object of its own, though parts of it need not be."""
    return isinstance(node, NEW) or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
                                      and node.func.id in _FRESH | _COPIES)  # fmt: skip


def _is_fresh(function: ast.AST) -> bool:
    if isinstance(function, ast.Attribute):
        return isinstance(function.value, ast.Name) and function.value.id == "math"
    return isinstance(function, ast.Name) and function.id in _FRESH


_FRESH = frozenset(
    ("abs", "all", "any", "bool", "bytes", "divmod", "float", "format", "hash", "int", "isinstance", "len", "print",
     "range", "repr", "round", "str", "sum")
)  # fmt: skip
"""Functions whose results hold no part of their arguments."""
_COPIES = frozenset(("dict", "list", "set", "sorted", "tuple"))
"""Functions whose results are new, and hold parts of their arguments."""


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
