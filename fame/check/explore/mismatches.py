"""What texts may raise because a value is not of the kind that they expect.

Theory of operation. A variable surely is of a kind if all that may set it gives that kind: a number, a text, a message
of a type. The kinds of assigned expressions depend on those of variables, so they are computed together, until nothing
changes. All names of a team are taken as one scope. What a person, a service, a mapping or a script in JavaScript sets
may be of any kind. A text `mismatches` if it does something with a value that values of some kind refuse: it computes
with what may be no number, compares, takes a field of what may be no message. That a division, an index or a key may
fail on values of the right kind, is in `slicing`. That a name is never set is not looked at, only that a person may
leave a field of a form out (`optional`).
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from fame.bpmn import model
from fame.bpmn.topics import EMPTY_TYPE, TopicUse
from fame.check.explore.element_variables import written_objects
from fame.check.explore.slicing import (
    OF_INTERFACE,
    OF_ROBOT,
    SURE,
    SURE_CALLS,
    SURE_METHODS,
    is_exception,
    may_time_out,
    walk,
)
from fame.check.explore.values import is_unknown
from fame.check.expressions import constant
from fame.dataclasses import dataclass, replace
from fame.engine.data import variable_name
from fame.errors import FameError
from fame.middleware import messages, typesystem
from fame.middleware.definitions import Field
from fame.scripting.effects import effects_of, script_effects
from fame.scripting.python_effects import syntax_tree

NUMBER, TRUTH, TEXT, LIST, TUPLE, MAPPING, ARRAY, ANY = (
    "number",
    "truth",
    "text",
    "list",
    "tuple",
    "mapping",
    "array",
    "",
)
"""Kinds of values, besides the types of messages; an array is one of numpy."""
_OPEN = "?"
"""Of a variable of which the kind is not known yet."""
_KINDS: Mapping[type, str] = {
    bool: TRUTH,
    int: NUMBER,
    float: NUMBER,
    str: TEXT,
    list: LIST,
    tuple: TUPLE,
    dict: MAPPING,
}
_ITEMS = (LIST, TUPLE, TEXT, MAPPING, ARRAY)
_OF_FORM = {"number": NUMBER, "integer": NUMBER, "checkbox": TRUTH}
_GIVES = {"len": NUMBER, "int": NUMBER, "float": NUMBER, "bool": TRUTH, "isinstance": TRUTH, "str": TEXT, "repr": TEXT,
          "list": LIST, "sorted": LIST, "dict": MAPPING, "tuple": TUPLE, "range": TUPLE}  # fmt: skip
_OF_NUMBERS = ("abs", "round", "float", "int", "max", "min")
_OF_LIST = {"append": 1, "copy": 0, "clear": 0, "reverse": 0}
_OF_MAPPING = {"items": 0, "keys": 0, "values": 0, "copy": 0, "clear": 0}
_OF_TEXT = {"lower": 0, "upper": 0, "strip": 0, "title": 0, "capitalize": 0}
_METHODS = {LIST: _OF_LIST, MAPPING: _OF_MAPPING, TEXT: _OF_TEXT}
"""Kind -> its methods that raise nothing, with the number of their arguments."""

_Env = Mapping[str, str]
_Value = ast.expr | str
"""What is assigned: an expression, or a kind."""


def kind_of(value: object) -> str:
    """Return the kind of a value; `ANY` of one that is not known."""
    if is_unknown(value):
        return ANY
    named: str = getattr(value, "__msgtype__", ANY)
    return _KINDS.get(type(value), ARRAY if hasattr(value, "tolist") else named)


def given_values(of_robots: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return the values with which robots start, by variable."""
    given = defaultdict[str, list[Any]](list)
    for name, value in (item for values in of_robots for item in values.items()):
        given[name].append(value)
    return given


_HOLE = re.compile(r"[$#]\{([^{}]*)\}")


def inserted_whole(payload: str) -> frozenset[str]:
    """Return the variables that a payload only inserts, by ``${name}``: unknown values leave other fields known."""
    inside = [found[1].strip() for found in _HOLE.finditer(payload)]
    if payload.lstrip().startswith("=") or len(inside) < payload.count("${") + payload.count("#{"):
        return frozenset()
    computed = {name for text in inside if not text.isidentifier() for name in re.findall(r"\w+", text)}
    return frozenset(text for text in inside if text.isidentifier()) - computed


@dataclass(frozen=True, slots=True)
class Kinds:
    """What is known of the variables of a team.

    of        variable -> its kind, `ANY` if that is not known
    optional  those that nothing sets but a form that may leave them out
    types     topic -> the type of its messages
    """

    of: _Env
    optional: frozenset[str]
    types: Mapping[str, str]

    def beside(self, known: _Env) -> Kinds:
        """Return the kinds where the values of some variables are known."""
        return replace(self, of={**self.of, **known}, optional=self.optional - known.keys())

    def mismatch(self, text: model.Expression, *, script: bool = False, condition: bool = False) -> str:
        """Return what a text may raise something at, since a value is of another kind than expected; empty for nothing.

        `condition`: its value has to be true or false, where the language asks for that.
        """
        if text.language == "python":
            tree = syntax_tree(text, script=script)
            return _first(tree, self, text.text) if tree is not None else text.text
        if text.language == "javascript":
            return text.text if effects_of(text, script=script).may_mismatch else ""
        if text.language == "feel" and not condition:
            return ""  # what does not fit is null
        tree = effects_of(text).as_python
        if text.language == "feel":
            return "" if tree is None or isinstance(tree, ast.Compare | ast.BoolOp) else self._no_truth(tree, text)
        if tree is None or text.language in ("payload", "template"):
            fitting = inserted_whole(text.text) if text.language == "template" else frozenset()
            unknown = any(name in self.optional or not (self.of.get(name) or name in fitting)
                          for name in effects_of(text).reads)  # fmt: skip
            return text.text if unknown else ""
        operands = [one for node in ast.walk(tree) if isinstance(node, ast.BoolOp) for one in node.values]
        operands += [
            node.operand for node in ast.walk(tree) if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
        ]
        strict = next(
            filter(None, (self._no_truth(one, text) for one in (*operands, *([tree] if condition else [])))), ""
        )
        return strict or _first(tree, self, text.text)

    def _no_truth(self, tree: ast.expr, text: model.Expression) -> str:
        return "" if _kind(tree, self.of, self.types) in (TRUTH, NUMBER) else text.text

    def is_list(self, text: model.Expression) -> bool:
        """Return whether the value of an expression surely is a list."""
        tree = effects_of(text).as_python
        return (
            tree is not None and _kind(tree, self.of, self.types) == LIST and not effects_of(text).reads & self.optional
        )

    @staticmethod
    def is_count(text: model.Expression) -> bool:
        """Return whether the value of an expression surely is a number of items."""
        tree = effects_of(text).as_python
        return isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and tree.func.id in ("len", "count")


def kinds_in(
    processes: Collection[model.Process],
    types: Mapping[str, TopicUse],
    parameters: Mapping[str, Collection[Any]],
    forms: Iterable[tuple[str, str, bool]],
    *,
    nothing: bool,
) -> Kinds:
    """Return the kinds of the variables of some processes.

    parameters  variable -> its values at the start
    forms       (variable, kind of its field, whether it is required) of each field of a form
    nothing     nothing is known: somebody may set any variable to anything
    """
    named = {name: use.type for name, use in types.items()}
    effects = [script_effects(node) for process in processes for node in process.body.walk()]
    if nothing or any(one.open or one.unseen for one in effects):
        return Kinds({}, frozenset(name for name, _, required in forms if not required), named)
    assigned = defaultdict[str, list[_Value]](list)
    for name, values in parameters.items():
        assigned[name] += map(kind_of, values)
    for name, kind, required in forms:
        of_text = TEXT if kind in ("text", "textarea") else ANY
        assigned[name].append(_OF_FORM.get(kind, of_text) if required else ANY)
    for body in (body for process in processes for body in process.body.bodies()):
        for name, value in _assigned_in(body, named):
            assigned[name].append(value)
    kinds, before = dict.fromkeys(assigned, _OPEN), dict[str, str]()
    while kinds != before:
        before = {**kinds}
        for name, values in assigned.items():
            of_values = (one if isinstance(one, str) else _kind(one, kinds, named) for one in values)
            kinds[name] = _joined((kinds[name], *of_values))
    optional = {name for name, _, required in forms if not required} - parameters.keys()
    return Kinds({name: kind for name, kind in kinds.items() if kind != _OPEN}, frozenset(optional), named)


def _joined(kinds: Iterable[str]) -> str:
    """The kind that all of them are; `_OPEN` if none is known yet."""
    known = {*kinds} - {_OPEN}
    return _OPEN if not known else known.pop() if len(known) == 1 else ANY


# ---- what is assigned ------------------------------------------------------------------------------------------------


def _assigned_in(body: model.Body, types: Mapping[str, str]) -> Iterator[tuple[str, _Value]]:
    """(variable, what it is set to) in a body, without forms."""
    for item in body.data_objects:
        for name, value in item.values:
            if value.text not in ("", f"${{{name}}}"):
                known = constant(value)[0]
                yield name, ANY if known is None else kind_of(known)
    for node in body.nodes:
        if node.script is not None:
            yield from _by_script(node.script)
        yield from ((name, ANY) for name in node.sets())
        for topic, throws in node.topics():
            yield from ((name, ANY) for name, _ in node.keys_of(topic))
            if not throws:
                names = [item.target for item in topic.takes] or written_objects(node, body)
                yield from ((name, ANY) for name in names)
                yield variable_name(topic.name), ANY if topic.takes else _bare(types.get(topic.qualified, ""))
        yield from ((name, ANY) for name in written_objects(node, body))
        if isinstance(node, model.Task):
            yield from ((name, ANY) for name in filter(None, (node.result_variable,)))
            if node.service is not None:
                yield variable_name(node.service.name), ANY
                yield from ((name, ANY) for name in node.properties.get("feedback", "").replace(",", " ").split())


def _by_script(script: model.Expression) -> Iterator[tuple[str, _Value]]:
    """What a script sets; what is not understood is of any kind."""
    effects, tree, left = effects_of(script, script=True), syntax_tree(script), set[int]()
    shadowed = _bound(tree) if tree is not None else set()
    for node in ast.walk(tree) if tree is not None else ():
        for target, given in _assignments(node):
            left.add(id(target))
            names = {one.id for one in ast.walk(given) if isinstance(one, ast.Name)}
            yield target.id, ANY if names & shadowed else given
    others = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load)
              and id(node) not in left} if tree is not None else effects.writes  # fmt: skip
    plain = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} if tree is not None else set[str]()
    yield from ((name, ANY) for name in {*others, *effects.later, *(effects.sets - plain)})


def _assignments(node: ast.AST) -> Iterator[tuple[ast.Name, ast.expr]]:
    """The names that a statement or expression sets to the values of expressions."""
    match node:
        case ast.Assign(targets, value):
            yield from (pair for target in targets for pair in _taken_apart(target, value))
        case ast.AugAssign(ast.Name(name) as target, op, value):
            yield target, ast.BinOp(ast.Name(name, ast.Load()), op, value)
        case ast.NamedExpr(target, value):
            yield target, value
        case ast.For(ast.Name() as target, ast.Call(ast.Name("range"))):
            yield target, ast.Constant(0)


def _taken_apart(target: ast.expr, value: ast.expr) -> Iterator[tuple[ast.Name, ast.expr]]:
    """The names that an assignment sets, and what they get: of ``a, b = 1, 2``, too."""
    if isinstance(target, ast.Name):
        yield target, value
    elif _fits(target, value):
        for part, given in zip(target.elts, value.elts, strict=True):  # type: ignore[attr-defined]
            yield from _taken_apart(part, given)


def _fits(target: ast.AST, value: ast.AST) -> bool:
    """Whether a tuple of names surely gets as many values."""
    return (
        isinstance(target, ast.Tuple | ast.List) and isinstance(value, ast.Tuple | ast.List)
        and len(target.elts) == len(value.elts)
        and not any(isinstance(one, ast.Starred) for one in (*target.elts, *value.elts))
    )  # fmt: skip


def _bound(tree: ast.AST) -> set[str]:
    """The names of parameters and of variables of comprehensions: they are others than variables of the process."""
    bound = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    targets = (node.target for node in ast.walk(tree) if isinstance(node, ast.comprehension))
    return bound | {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}


# ---- the kind of an expression ---------------------------------------------------------------------------------------


def _kind(tree: ast.AST, kinds: _Env, types: Mapping[str, str]) -> str:
    """The kind of an expression; `_OPEN` if it depends on one that is not known yet."""

    def of(node: ast.AST) -> str:
        return _kind(node, kinds, types)

    match tree:
        case ast.Constant(value):
            return kind_of(value)
        case ast.Name(name):
            return kinds.get(name, ANY)
        case ast.JoinedStr():
            return TEXT
        case ast.List() | ast.ListComp():
            return LIST
        case ast.Tuple():
            return TUPLE
        case ast.Dict() | ast.DictComp():
            return MAPPING
        case ast.NamedExpr(_, value):
            return of(value)
        case ast.BoolOp(values=values):
            return _joined(map(of, values))
        case ast.IfExp(_, body, orelse):
            return _joined((of(body), of(orelse)))
        case ast.UnaryOp(op, operand):
            kind = of(operand)
            return TRUTH if isinstance(op, ast.Not) else kind if kind in (NUMBER, _OPEN) else ANY
        case ast.Compare(left, _, others):
            operands = {*map(of, (left, *others))}
            return _OPEN if _OPEN in operands else ANY if operands & {ANY, ARRAY} else TRUTH
        case ast.BinOp(left, op, right):
            both = of(left), of(right)
            return _OPEN if _OPEN in both else _computed(op, *both)
        case ast.Attribute(ast.Name("math"), name):
            return NUMBER if name in ("pi", "e", "tau", "inf", "nan") else ANY
        case ast.Attribute(ast.Name("robot"), name):
            return {"now": NUMBER, "name": TEXT, "namespace": TEXT}.get(name, ANY)
        case ast.Attribute(value, name):
            kind = of(value)
            return kind if kind == _OPEN else _of_field(_field(kind, name))
        case ast.Call(ast.Attribute(ast.Name("math"), name), arguments, []) if arguments and name in SURE_METHODS:
            return TRUTH if name.startswith("is") else NUMBER
        case ast.Call(ast.Attribute(ast.Name("math"), name)):
            return NUMBER if name in ("sqrt", "floor", "ceil", "exp", "log", "fmod", "sin", "cos", "tan") else ANY
        case ast.Call(ast.Name(name), arguments) if name not in kinds and name in _GIVES:
            return _GIVES[name]
        case ast.Call(ast.Name(name), arguments, []) if name not in kinds and name in _OF_NUMBERS:
            given = {*map(of, arguments)}
            return _OPEN if _OPEN in given else NUMBER if given == {NUMBER} and _are_numbers(name, arguments) else ANY
        case ast.Await(ast.Call(ast.Name("receive"), [ast.Constant(str(topic)), *_])):
            name = topic if topic.startswith(("/", "~/")) else f"~/{topic}"
            return _bare(types.get(name, ""), whole=True)
    return ANY


def _are_numbers(function: str, arguments: Collection[ast.expr]) -> bool:
    return len(arguments) > 1 if function in ("max", "min") else len(arguments) == 1 or function == "round"


def _computed(op: ast.operator, left: str, right: str) -> str:
    if left == right == NUMBER and isinstance(
        op, ast.Add | ast.Sub | ast.Mult | ast.Div | ast.FloorDiv | ast.Mod | ast.Pow
    ):
        return NUMBER
    if isinstance(op, ast.Add) and left == right and left in (TEXT, LIST, TUPLE):
        return left
    return ANY


def _bare(type: str, *, whole: bool = False) -> str:
    """The kind of the value of a message: of a wrapper, that of its field."""
    if not type or type == EMPTY_TYPE:
        return ANY
    try:
        return _of_field(_field(type, "data")) if messages.is_wrapper(type) and not whole else type
    except FameError:
        return ANY


def _of_field(field: Field | None) -> str:
    if field is None:
        return ANY
    if field.shape != "single":
        return ARRAY
    if field.is_message:
        return field.base
    return TEXT if "string" in field.base else TRUTH if field.base == "bool" else NUMBER


@lru_cache(maxsize=1024)
def _field(type: str, name: str) -> Field | None:
    """A field of a type of messages; None of any other kind."""
    if "/" not in type:
        return None
    try:
        fields = typesystem.definition(type).fields
    except FameError:
        return None
    return next((field for field in fields if field.attribute == name), None)


# ---- what may raise --------------------------------------------------------------------------------------------------


def _first(tree: ast.AST, kinds: Kinds, text: str) -> str:
    """The first statement of a text that may raise, on one line; empty for none."""
    bound = _bound(tree)
    known = {name: kind for name, kind in kinds.of.items() if name not in bound}
    parts: Iterable[ast.AST] = [tree]
    if isinstance(tree, ast.Module | ast.Expression):
        parts = tree.body if isinstance(tree, ast.Module) else [tree.body]
    for part in parts:
        fitting = {id(target) for node in ast.walk(part) if isinstance(node, ast.Assign)
                   for target in node.targets if _fits(target, node.value)}  # fmt: skip
        if any(id(node) not in fitting and _mismatches(node, known, kinds) for node in walk(part)):
            return ast.unparse(part).partition("\n")[0]
    return ""


def _mismatches(node: ast.AST, known: _Env, kinds: Kinds) -> bool:
    def of(tree: ast.AST) -> str:
        return _kind(tree, known, kinds.types)

    match node:
        case ast.Name(name, ast.Load()):
            return name in kinds.optional
        case ast.Attribute(ast.Name("robot"), name, ast.Load()):
            return name not in OF_ROBOT
        case ast.Attribute(ast.Name("math"), _, ast.Load()):
            return False
        case ast.Attribute():
            return of(node) == ANY or not isinstance(node.ctx, ast.Load)
        case ast.Call(function, arguments, named):
            return _call_mismatches(node, function, [*arguments, *(one.value for one in named)], of)
        case ast.UnaryOp(op, operand):
            return of(operand) == ARRAY if isinstance(op, ast.Not) else of(operand) != NUMBER
        case ast.BinOp(left, op, right):
            return _computed(op, of(left), of(right)) == ANY
        case ast.AugAssign(target, op, value):
            return not isinstance(target, ast.Name) or _computed(op, of(target), of(value)) == ANY
        case ast.Compare(left, operators, others):
            return not all(map(_compares, operators, map(of, (left, *others)), map(of, others)))
        case ast.BoolOp(values=values):
            return any(of(value) == ARRAY for value in values)
        case ast.If(test) | ast.While(test) | ast.IfExp(test) | ast.Assert(test):
            return of(test) == ARRAY
        case ast.Subscript(value, index):
            return not isinstance(index, ast.Slice) or of(value) not in (LIST, TUPLE, TEXT, ARRAY)
        case ast.Slice(lower, upper, step):
            return not all(one is None or isinstance(one, ast.Constant) for one in (lower, upper, step))
        case ast.For(target, iterated) | ast.comprehension(target, iterated):
            return of(iterated) not in _ITEMS or not isinstance(target, ast.Name)
        case ast.ListComp() | ast.DictComp() | ast.GeneratorExp() | ast.Lambda() | ast.arguments() | ast.arg():
            return False
        case ast.Tuple() | ast.List():
            return not isinstance(node.ctx, ast.Load)
        case ast.Dict(keys=keys):
            return not all(isinstance(one, ast.Constant) or (one and of(one) in (TEXT, NUMBER)) for one in keys)
        case ast.FormattedValue(value, _, spec):
            return spec is not None and of(value) not in (NUMBER, TEXT)
        case ast.ExceptHandler():
            return not all(is_exception(one) for one in ast.walk(node.type or ast.Load()))
        case ast.Await(value):
            return not isinstance(value, ast.Call)  # of what gives something else, the call is not sure
    return not isinstance(node, SURE)


def _compares(operator: ast.cmpop, left: str, right: str) -> bool:
    """Whether operands surely can be compared, and give true or false."""
    if ARRAY in (left, right):
        return isinstance(operator, ast.Is | ast.IsNot)
    if isinstance(operator, ast.In | ast.NotIn):
        return right in (LIST, TUPLE) or (left == right == TEXT) or (right == MAPPING and left in (TEXT, NUMBER))
    return isinstance(operator, ast.Eq | ast.NotEq | ast.Is | ast.IsNot) or (left == right and left in (NUMBER, TEXT))


def _call_mismatches(call: ast.Call, function: ast.expr, given: list[ast.expr], of: Any) -> bool:
    kinds = [*map(of, given)]
    match function:
        case ast.Name(name) if name in SURE_CALLS:
            return len(given) != 1 or bool(call.keywords)
        case ast.Name("log") | ast.Attribute(ast.Name("log")):
            return bool(call.keywords)
        case ast.Name("len" | "list" | "tuple" | "enumerate"):
            return len(given) != 1 or kinds[0] not in _ITEMS
        case ast.Name("range"):
            return not all(isinstance(one, ast.Constant) for one in given)
        case ast.Name(name) if name in _OF_NUMBERS:
            return {*kinds} != {NUMBER} or not _are_numbers(name, given)
        case ast.Attribute(ast.Name("math")):
            return not {*kinds} <= {NUMBER}
        case ast.Name(name) | ast.Attribute(ast.Name(name)) if name in OF_INTERFACE:
            return may_time_out(call) or not all(map(_is_plain, given, [of] * len(given)))
        case ast.Attribute(owner, name) if name in _METHODS.get(of(owner), {}):
            return len(given) != _METHODS[of(owner)][name]
    return True


def _is_plain(tree: ast.expr, of: Any) -> bool:
    """Whether a value is of a kind that is known, and so is each value in it."""
    if isinstance(tree, ast.Dict):
        return all(key is not None and _is_plain(one, of) for key, one in zip(tree.keys, tree.values, strict=True))
    return isinstance(tree, ast.Constant) or of(tree) in (NUMBER, TRUTH, TEXT) or "/" in of(tree)
