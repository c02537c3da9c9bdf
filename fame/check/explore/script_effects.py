"""What scripts change: the variables that they set, and the lists, mappings and objects that they change in place.

`script_writes` names what a script certainly changes if it gets there, `may_change` what it only may change: values
that it hands to functions which are not known to leave them as they are, and all that a script in JavaScript reads that
calls something or sets a member. A number or a text cannot be changed in this way, so the exploration looks at the
values before it forgets them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Set
from functools import lru_cache

from fame.bpmn.model import Expression
from fame.check.explore.purity import CHANGING_METHODS, READING_METHODS
from fame.check.expressions import names_of, own_syntax_tree, syntax_tree
from fame.errors import FameError
from fame.scripting import code_names
from fame.scripting.analysis import identifiers_of
from fame.scripting.python import parse_python


@lru_cache(maxsize=1024)
def script_writes(script: Expression) -> frozenset[str]:
    """Return the variables that a script sets or changes in place, functions and modules included."""
    try:
        return names_of(script, True)[1] | code_names(script) | changed_in_place(script)
    except FameError:
        return frozenset()


@lru_cache(maxsize=1024)
def may_change(script: Expression) -> frozenset[str]:
    """Return the variables whose lists, mappings or objects a script may change by functions, or in JavaScript."""
    try:
        reads = names_of(script, True)[0]
        if script.language != "python":
            return reads if identifiers_of(script.text).changes else frozenset()
        tree = parse_python(script)
    except FameError:
        return frozenset()
    changed = {name for call in ast.walk(tree) if isinstance(call, ast.Call) for name in _handed_over(call)}
    return reads if changed & parts_of(tree) else reads & changed


@lru_cache(maxsize=1024)
def changed_in_place(script: Expression) -> frozenset[str]:
    """Return the variables whose lists, mappings or objects a script in Python changes by items, attributes or methods.

    A name that the script sets to a part of something else may stand for a part of anything that it reads.
    """
    tree = syntax_tree(script)
    if tree is None:
        return frozenset()
    changed, reads = _changed(tree), names_of(script, True)[0]
    return reads if changed & parts_of(tree) else reads & changed


ChangedPlace = tuple[str, bool]
"""A variable that a script changes in place, and whether it is only the object of the variable itself."""


@lru_cache(maxsize=1024)
def changes_in_place(script: Expression) -> frozenset[ChangedPlace]:
    """Return what a script in Python may change in lists, mappings or objects, which other variables may hold too."""
    tree = syntax_tree(script)
    if tree is None:
        return frozenset()
    found = set[ChangedPlace]()
    for node in ast.walk(tree):
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            found.add((node.target.id, True))
        elif (place := _changed_place(node)) is not None:
            found |= {(name, isinstance(place, ast.Name)) for name in _root(place)}
        elif isinstance(node, ast.Call):
            found |= {(name, False) for name in _handed_over(node) if name in may_change(script)}
    return frozenset(found)


def _changed_place(node: ast.AST) -> ast.AST | None:
    """The expression whose object a part of a script changes."""
    match node:
        case ast.Subscript(value=value, ctx=ctx) | ast.Attribute(value=value, ctx=ctx):
            return None if isinstance(ctx, ast.Load) else value
        case ast.Call(func=ast.Attribute(value=value, attr=name)):
            return value if name in CHANGING_METHODS else None
    return None


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
    found = dict[int, str]()
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Name(id=name) as target], value=value):
                match value:
                    case ast.Dict() | ast.DictComp() | ast.Set() | ast.SetComp() | ast.Call(ast.Name("dict" | "set")):
                        found[id(target)] = name
    stores = (node for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {*found.values()}, {node.id for node in stores if id(node) not in found}


def new_value(node: ast.AST) -> bool:
    """Return whether the value of an expression is an object of its own, though parts of it need not be."""
    return isinstance(node, _NEW) or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
                                      and node.func.id in _FRESH | _COPIES)  # fmt: skip


def _is_fresh(function: ast.AST) -> bool:
    if isinstance(function, ast.Attribute):
        return isinstance(function.value, ast.Name) and function.value.id == "math"
    return isinstance(function, ast.Name) and function.id in _FRESH


def changes_parts(tree: ast.AST) -> bool:
    """Return whether a script may change, in place, what is a part of another value."""
    return bool(_changed(tree) & parts_of(tree))


def _changed(tree: ast.AST) -> set[str]:
    """The names whose values a script changes by items, attributes or methods."""
    places = filter(None, map(_changed_place, ast.walk(tree)))
    return {name for place in places for name in _root(place)}


def parts_of(tree: ast.AST) -> set[str]:
    """Return the names that a script sets to something that may be a part of another value."""
    targets: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.For | ast.AsyncFor | ast.comprehension):
            targets.append(node.target)
        elif isinstance(node, ast.Assign) and not isinstance(node.value, _NEW):
            targets += node.targets
        elif isinstance(node, ast.NamedExpr) and not isinstance(node.value, _NEW):
            targets.append(node.target)
    return {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}


def _root(node: ast.AST) -> set[str]:
    """The variable that an attribute or item belongs to."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return {node.id} if isinstance(node, ast.Name) else set()


def _handed_over(call: ast.Call) -> Iterator[str]:
    """The variables that a call may change: what it is given, and the object of the method."""
    function = call.func
    if isinstance(function, ast.Name) and function.id in _HARMLESS:
        return
    if isinstance(function, ast.Attribute):
        if isinstance(function.value, ast.Name) and function.value.id in _HARMLESS_MODULES:
            return
        if function.attr in READING_METHODS:
            return
    yield from _whole(function.value if isinstance(function, ast.Attribute) else function)
    for argument in (*call.args, *(keyword.value for keyword in call.keywords)):
        yield from _whole(argument)


def _whole(node: ast.AST) -> Iterator[str]:
    """The names in an expression whose values may be its value, or a part of it."""
    if isinstance(node, ast.Name):
        yield node.id
    elif not isinstance(node, ast.BinOp | ast.UnaryOp | ast.Compare | ast.JoinedStr | ast.Constant):
        for inner in ast.iter_child_nodes(node):
            yield from _whole(inner)


_NEW = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp, ast.Constant, ast.BinOp, ast.JoinedStr)
"""Expressions whose value is no part of another one."""
_HARMLESS = frozenset(
    ("abs", "all", "any", "bool", "BpmnError", "bytes", "dict", "divmod", "enumerate", "float", "format", "frozenset",
     "hasattr", "hash", "int", "isinstance", "iter", "len", "list", "log", "max", "min", "print", "range", "receive",
     "repr", "reversed", "round", "set", "signal", "sleep", "sorted", "str", "sum", "tuple", "type", "until", "zip")
)  # fmt: skip
"""Functions that leave their arguments as they are."""
_FRESH = frozenset(
    ("abs", "all", "any", "bool", "bytes", "divmod", "float", "format", "hash", "int", "isinstance", "len", "print",
     "range", "repr", "round", "str", "sum")
)  # fmt: skip
"""Functions whose results hold no part of their arguments."""
_COPIES = frozenset(("dict", "list", "set", "sorted", "tuple"))
"""Functions whose results are new, and hold parts of their arguments."""
_HARMLESS_MODULES = frozenset(("json", "log", "math", "re", "robot", "statistics"))
"""Modules and objects whose functions all leave their arguments as they are."""


@lru_cache(maxsize=1024)
def only_changed(script: Expression) -> frozenset[str]:
    """Return the variables that a script in Python only changes: ``x[k] = ...``, ``x.append(...)``, ``x += ...``."""
    tree = syntax_tree(script)
    if tree is None:
        return frozenset()
    changing, counted_up = set[int](), set[int]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            changing |= {id(target.value) for target in node.targets if isinstance(target, ast.Subscript)}
        elif isinstance(node, ast.AugAssign):
            counted_up.add(id(node.target))
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            function = node.value.func
            if isinstance(function, ast.Attribute) and function.attr in CHANGING_METHODS:
                changing.add(id(function.value))
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    read = {node.id for node in names if isinstance(node.ctx, ast.Load) and id(node) not in changing}
    return frozenset({node.id for node in names if id(node) in changing | counted_up} - read)


# ---- lists of which only the length is read --------------------------------------------------------------------------


@lru_cache(maxsize=1024)
def list_uses(text: Expression, *, script: bool) -> tuple[frozenset[str], frozenset[str]]:
    """(counted, others): the variables of which a text uses only the length as a list, and the others that it uses.

    Using only the length is ``len(x)``, ``x.append(...)`` as a statement, and ``x = [...]``.
    """
    reads, writes = names_of(text, script)
    tree = syntax_tree(text, script=script)
    if tree is None:
        return frozenset(), reads | writes
    fine = {id(name) for node in ast.walk(tree) for name in _only_counted(node)}
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    others = {node.id for node in names if id(node) not in fine} | {
        name for node in ast.walk(tree) if isinstance(node, ast.Global | ast.Nonlocal) for name in node.names
    }
    return frozenset({node.id for node in names} - others), frozenset(others)


def _only_counted(node: ast.AST) -> Iterator[ast.Name]:
    """The names in a node that stand for a list of which only the length matters there."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "len":
        yield node.func
        yield from (argument for argument in node.args if isinstance(argument, ast.Name))
    elif isinstance(node, ast.Assign) and isinstance(node.value, ast.List) and len(node.targets) == 1:
        yield from (target for target in node.targets if isinstance(target, ast.Name))
    elif (name := _appended_to(node)) is not None:
        yield name


def _appended_to(node: ast.AST) -> ast.Name | None:
    """The list of a statement ``x.append(...)``."""
    if (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Attribute)
            and node.value.func.attr == "append" and len(node.value.args) == 1 and not node.value.keywords
            and isinstance(node.value.func.value, ast.Name)):  # fmt: skip
        return node.value.func.value
    return None


def without_items(script: Expression, counted: frozenset[str]) -> Expression:
    """Return the script with ``x.append(None)`` for lists of which only the length is read."""
    tree = own_syntax_tree(script) if "append" in script.text else None
    if tree is None:
        return script
    changed = False
    for node in ast.walk(tree):
        name = _appended_to(node)
        if name is not None and name.id in counted:
            assert isinstance(node, ast.Expr)
            assert isinstance(node.value, ast.Call)
            if not any(isinstance(one, _EFFECTS) for one in ast.walk(node.value.args[0])):
                node.value.args[0] = ast.copy_location(ast.Constant(None), node.value.args[0])
                changed = True
    return Expression(ast.unparse(tree), "python", script.line) if changed else script


_EFFECTS = (ast.Call, ast.Await, ast.NamedExpr, ast.Yield, ast.YieldFrom)
