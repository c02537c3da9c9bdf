"""The effects of scripts and expressions in Python, by their syntax trees and symbol tables."""

from __future__ import annotations

import ast
import re
import symtable
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import cached_property, lru_cache
from typing import Any, Literal, cast

from fame.bpmn.model import Expression
from fame.errors import ModelError
from fame.scripting.effects import NONE, Direction, Effects, ScriptTopic
from fame.scripting.interface import NAMES, interface
from fame.scripting.python import called_name, name_of, parse_python
from fame.scripting.requests import STILL_RUNNING
from fame.scripting.transforms import TF, TOPICS
from fame.text import label_of, topic_of


def own_syntax_tree(expression: Expression, *, script: bool = True) -> ast.AST | None:
    """Return the tree of a text in Python, with the lines of the file, for the caller to change; None of a wrong one,
    which the compiler reports, and of one in another language."""
    mode: Literal["exec", "eval"] = "exec" if script else "eval"
    try:
        return parse_python(expression, mode) if expression.language == "python" else None
    except (ModelError, RecursionError):
        return None


syntax_tree: Callable[..., ast.AST | None] = lru_cache(maxsize=1024)(own_syntax_tree)
"""The same, shared: do not change it."""

_TOPIC_WORDS = ("receive", "robot", "signal")
"""Every text that names a topic contains one of these."""
_IMPORTERS = ("__import__", "eval", "exec")
_ANY_NAME = ("eval", "exec", "__builtins__")
"""What may get at every name of the script interface."""


class PythonEffects(Effects):
    """The effects of a text in Python."""

    @property
    def tree(self) -> ast.AST | None:
        """The tree of the text: do not change it."""
        return syntax_tree(self.expression, script=self.script)

    def nodes(self) -> Iterator[ast.AST]:
        """Yield all nodes of the tree."""
        return ast.walk(self.tree) if self.tree is not None else iter(())

    # ---- variables -------------------------------------------------------------------------------------

    @property
    def reads(self) -> frozenset[str]:
        return self._names[0]

    @property
    def sets(self) -> frozenset[str]:
        return self._names[1]

    @property
    def code(self) -> frozenset[str]:
        return self._names[2]

    @cached_property
    def _names(self) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
        try:
            tree = own_syntax_tree(self.expression, script=self.script)
            return names_in(tree) if tree is not None else (NONE, NONE, NONE)
        except (SyntaxError, RecursionError):  # it parses and does not compile (`global x` too late), or is too deep
            return NONE, NONE, NONE

    @cached_property
    def always(self) -> frozenset[str]:
        return frozenset(name for statement in self._statements for name in _set_by(statement))

    @cached_property
    def read_first(self) -> frozenset[str]:
        found, done = set[str](), set[str]()
        for statement in self._statements:
            nodes = list(ast.walk(statement))
            changed = [node.target for node in nodes if isinstance(node, ast.AugAssign)]
            names = (node for node in nodes if isinstance(node, ast.Name))
            found |= {one.id for one in names if not isinstance(one.ctx, ast.Store) or one in changed} - done
            done |= {*_set_by(statement)}
        return frozenset(found)

    @property
    def _statements(self) -> list[ast.stmt]:
        return list(getattr(self.tree, "body", ())) if self.script else []

    @cached_property
    def changes(self) -> frozenset[str]:
        """What it reads, if it changes what may be a part of anything."""
        if self.tree is None or not (changed := changed_names(self.tree)):
            return NONE
        foreign = changed - self.reads - self.sets - bound_in(self.tree)  # `append` of the class `list`
        return self.reads if foreign or changes_parts(self.tree) else self.reads & changed

    @cached_property
    def may_change(self) -> frozenset[str]:
        return self._reached_by(lambda call: True) if all(map(is_understood, self.nodes())) else self.reads

    @cached_property
    def reaches(self) -> frozenset[str]:
        return self._reached_by(lambda call: not changes_itself(call))

    def _reached_by(self, chosen: Callable[[ast.Call], bool]) -> frozenset[str]:
        calls = [node for node in self.nodes() if isinstance(node, ast.Call) and chosen(node)]
        names = {name for call in calls for name in handed_over(call)}
        return self.reads if self.tree is not None and names & bound_in(self.tree) else self.reads & names

    @cached_property
    def leaves(self) -> frozenset[str]:
        nodes = list(self.nodes())
        called = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
        methods = [node for node in nodes if isinstance(node, ast.Attribute) and id(node) not in called]
        names = {name for node in methods if node.attr in CHANGING_METHODS for name in root(node.value)}
        later = [[*ast.walk(node)] for node in nodes if isinstance(node, _LATER)]
        parameters = {part.arg for parts in later for part in parts if isinstance(part, ast.arg)}
        changing = [parts for parts in later if any(map(changes_something, parts))]
        names |= {part.id for parts in changing for part in parts if isinstance(part, ast.Name)}
        lazy = [node for node in nodes if isinstance(node, ast.Call) and called_name(node) in _LAZY]
        names |= {name for call in lazy for name in handed_over(call)}
        names -= parameters
        return self.reads if self.tree is not None and names & bound_in(self.tree) else self.reads & names

    @cached_property
    def open(self) -> bool:
        return any(map(_reaches_all, self.nodes()))

    @cached_property
    def steady(self) -> bool:
        return self.tree is not None and all(map(_is_steady, self.nodes()))

    # ---- topics and modules ----------------------------------------------------------------------------

    @cached_property
    def imports(self) -> Mapping[str, str]:
        words = (*_IMPORTERS, "import")
        if not any(word in self.expression.text for word in words):
            return {}
        return dict(_imports(own_syntax_tree(self.expression, script=self.script)))

    @cached_property
    def topics(self) -> tuple[ScriptTopic, ...]:
        if not any(word in self.expression.text for word in _TOPIC_WORDS):
            return ()
        return tuple(_topics_in(own_syntax_tree(self.expression, script=self.script)))

    @cached_property
    def computed(self) -> frozenset[tuple[Direction, str]]:
        if not any(word in self.expression.text for word in (*_TOPIC_WORDS, *_ANY_NAME)):
            return NONE
        return frozenset(_computed_in(list(self.nodes())))

    @cached_property
    def awaits(self) -> frozenset[str]:
        calls = (node for node in self.nodes() if isinstance(node, ast.Call) and called_name(node) in _TAKING)
        return frozenset(topic.qualified for call in calls for topic in _topics(call))

    @cached_property
    def publications(self) -> tuple[tuple[str, bool], ...]:
        """A call is certain in a statement outside of blocks, which nothing but an error can leave out."""
        if not self.publishes:
            return ()
        statements = getattr(own_syntax_tree(self.expression), "body", ())
        always = (_AlwaysEvaluated().visit(one) for one in statements if isinstance(one, ast.Expr))
        certain = {_place(call) for one in always for call, _ in _published(ast.walk(one))}
        repeated = self._repeated()
        return tuple((topic, _place(call) in certain) for call, topic in _published(self.nodes())
                     for _ in range(2 if id(call) in repeated else 1))  # fmt: skip

    def _repeated(self) -> set[int]:
        """The ids of the nodes that are executed any number of times."""
        return {id(inner) for one in self.nodes() if isinstance(one, _REPEATING) for inner in ast.walk(one)}

    @cached_property
    def midway(self) -> frozenset[str]:
        if not self.publishes:
            return NONE
        nodes, repeated = [*self.nodes()], self._repeated()
        waits = [_place(one) for one in nodes if isinstance(one, ast.Await | ast.AsyncFor | ast.AsyncWith)]
        return frozenset(topic for call, topic in _published(nodes)
                         if id(call) in repeated or any(_place(call) < place for place in waits))  # fmt: skip

    # ---- errors and requests ---------------------------------------------------------------------------

    @cached_property
    def codes(self) -> frozenset[str] | None:
        if "BpmnError" not in self.expression.text:
            return NONE
        handlers = [node.type for node in self.nodes() if isinstance(node, ast.ExceptHandler) and node.type]
        caught = {id(inner) for one in handlers for inner in ast.walk(one)}
        nodes = [node for node in self.nodes() if id(node) not in caught]
        named = [node for node in nodes if isinstance(node, ast.Name) and node.id == "BpmnError"]
        raised = [node.args[0] for node in nodes if isinstance(node, ast.Call) and node.func in named and node.args]
        constants = [one.value for one in raised if isinstance(one, ast.Constant)]
        return frozenset(map(str, constants)) if len(constants) == len(named) else None

    @property
    def computes_code(self) -> bool:
        return self.codes is None

    @cached_property
    def asked(self) -> frozenset[str]:
        return NONE.union(*(_REQUESTS[name][0] for name in self._asked())) if self.waits else NONE

    def _asked(self) -> Iterator[str]:
        """The requests whose failure leaves the script: those in no ``try`` that catches what they raise."""
        tries = [node for node in self.nodes() if isinstance(node, ast.Try)]
        for name, (_, broad) in _REQUESTS.items():
            inside = {id(inner) for one in tries if any(_catches(handler, broad) for handler in one.handlers)
                      for line in one.body for inner in ast.walk(line)}  # fmt: skip
            yield from (name for node in self.nodes() if id(node) not in inside and _request(node) == name)

    @cached_property
    def waits(self) -> bool:
        return any(isinstance(node, ast.Await | ast.AsyncFor | ast.AsyncWith) for node in self.nodes())

    @cached_property
    def catches(self) -> bool:
        return any(isinstance(node, ast.Try | ast.TryStar) for node in self.nodes())


# ---- variables -------------------------------------------------------------------------------------------------------


def names_in(tree: ast.AST) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """Return the variables that a tree reads, those that it sets, and the functions, classes and modules that it
    defines. It is changed. Raises SyntaxError."""
    top = symtable.symtable(ast.unparse(_Synchronous().visit(tree)), "<script>", "exec")
    inner = _comprehended(tree)  # CPython 3.12 counts them among the names around the comprehension
    inner.add("__conditional_annotations__")  # which `x: int = 1` reads from 3.14 on
    symbols = top.get_symbols()
    code = {symbol.get_name() for symbol in symbols if symbol.is_imported() or symbol.is_namespace()}
    reads, sets = set[str](), set[str]()
    for table in _tables(top):
        for symbol in table.get_symbols():
            if table is top or symbol.is_global():
                reads |= {symbol.get_name()} if symbol.is_referenced() else set()
                sets |= {symbol.get_name()} if symbol.is_assigned() else set()
    reads |= {name for name in sets if name in _augmented(tree)}
    reads, sets = reads - inner, sets - inner
    provided = interface(robot=None, signal=print, log=lambda level, text: None).keys() - sets
    star = any(isinstance(node, ast.ImportFrom) and node.names[0].name == "*" for node in ast.walk(tree))
    return frozenset(reads - code - provided), frozenset(sets - code), frozenset(code | ({"*"} if star else set()))


class _Synchronous(ast.NodeTransformer):
    """The same names without ``async`` and ``await``, which `symtable` refuses at the top level from Python 3.14 on."""

    def visit_Await(self, node: ast.Await) -> ast.AST:
        return cast("ast.AST", self.visit(node.value))

    def visit_AsyncFor(self, node: ast.AsyncFor) -> ast.AST:
        return self.generic_visit(ast.For(**dict(ast.iter_fields(node)), lineno=node.lineno))

    def visit_AsyncWith(self, node: ast.AsyncWith) -> ast.AST:
        return self.generic_visit(ast.With(**dict(ast.iter_fields(node)), lineno=node.lineno))

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        node.is_async = 0
        return self.generic_visit(node)


def _augmented(tree: ast.AST) -> set[str]:
    """The targets of ``x += 1`` and ``del x``, which symbol tables do not count as read."""
    nodes = [*ast.walk(tree)]
    targets = {id(node.target) for node in nodes if isinstance(node, ast.AugAssign)}
    return {node.id for node in nodes if isinstance(node, ast.Name)
            and (isinstance(node.ctx, ast.Del) or id(node) in targets)}  # fmt: skip


def _comprehended(tree: ast.AST) -> set[str]:
    """The names that only comprehensions bind."""
    nodes = list(ast.walk(tree))
    inner = {id(name) for node in nodes if isinstance(node, ast.comprehension) for name in ast.walk(node.target)}
    stored = [node for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return {node.id for node in stored if id(node) in inner} - {node.id for node in stored if id(node) not in inner}


def _tables(table: symtable.SymbolTable) -> Iterator[symtable.SymbolTable]:
    yield table
    for child in table.get_children():
        yield from _tables(child)


def _set_by(statement: ast.stmt) -> Iterator[str]:
    """The variables that a statement sets, if it is an assignment."""
    for target in statement.targets if isinstance(statement, ast.Assign) else ():
        for part in target.elts if isinstance(target, ast.Tuple | ast.List) else (target,):
            if isinstance(part, ast.Name):
                yield part.id


_STEADY = frozenset(
    ("abs", "all", "any", "bool", "float", "int", "isinstance", "len", "max", "min", "round", "sorted", "str", "sum")
)
"""Functions whose results depend on their arguments alone."""


def _is_steady(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id in _STEADY
    if isinstance(node, ast.Name):
        return node.id not in NAMES  # what is there changes by itself
    return not isinstance(node, ast.NamedExpr | ast.Lambda | ast.Await)


_LATER = (ast.Lambda, ast.FunctionDef, ast.AsyncFunctionDef, ast.GeneratorExp)
"""What may be executed when the script is over."""
_LAZY = ("map", "filter")
_ALL = frozenset(("__builtins__", "__import__", "eval", "exec", "globals", "locals", "vars"))
_OF_FRAMES = re.compile(r"__|_getframe$|(f|tb|gi|cr|ag)_(frame|globals|locals|back|builtins)$")
_OF_INTERPRETER = frozenset(("builtins", "ctypes", "gc", "inspect"))


def _reaches_all(node: ast.AST) -> bool:
    """Whether a part of a script may get at variables by other ways than their names."""
    match node:
        case ast.Name(name):
            return name in _ALL
        case ast.Attribute(attr=name):
            return _OF_FRAMES.match(name) is not None
        case ast.Import(names) | ast.ImportFrom(names=names):
            modules = {getattr(node, "module", None) or "", *(alias.name for alias in names)}
            return any(one.partition(".")[0] in _OF_INTERPRETER or _OF_FRAMES.match(one) for one in modules)
    return False


# ---- what is changed in place ----------------------------------------------------------------------------------------

COMPUTING = frozenset(
    ("abs", "all", "any", "bool", "dict", "divmod", "enumerate", "float", "frozenset", "int", "len", "list", "max",
     "min", "print", "range", "repr", "reversed", "round", "set", "sorted", "str", "sum", "tuple", "zip")
)  # fmt: skip
"""Builtins that only compute a value, and call no function that they are given (but for a key)."""
_HARMLESS = COMPUTING | frozenset(
    ("BpmnError", "bytes", "format", "hasattr", "hash", "isinstance", "iter", "log", "receive", "signal", "sleep",
     "type", "until")
)  # fmt: skip
"""Functions that leave their arguments as they are."""
_HARMLESS_MODULES = frozenset(("json", "log", "math", "re", "robot", "statistics"))
"""Modules and objects whose functions all do so."""
CHANGING_METHODS = frozenset(
    ("add", "append", "appendleft", "clear", "difference_update", "discard", "extend", "extendleft", "insert",
     "intersection_update", "pop", "popitem", "popleft", "remove", "reverse", "rotate", "setdefault", "sort",
     "symmetric_difference_update", "update")
)  # fmt: skip
"""Methods that change a list, mapping, set or deque."""
READING_METHODS = frozenset(
    ("capitalize", "copy", "count", "difference", "endswith", "find", "get", "index", "intersection", "isalpha",
     "isdigit", "isnumeric", "issubset", "issuperset", "items", "join", "keys", "lower", "lstrip", "partition",
     "removeprefix", "removesuffix", "replace", "rfind", "rpartition", "rsplit", "rstrip", "split", "splitlines",
     "startswith", "strip", "title", "union", "upper", "values")
)  # fmt: skip
"""Methods of plain data that leave it and their arguments as they are."""
NEW = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp, ast.Constant, ast.BinOp, ast.JoinedStr)
"""Expressions whose value does not share parts with another one."""


def changed_names(tree: ast.AST) -> set[str]:
    """Return the names whose values a script changes by items, attributes or methods."""
    places = filter(None, map(changed_place, ast.walk(tree)))
    return {name for place in places for name in root(place)}


def changed_place(node: ast.AST) -> ast.AST | None:
    """Return the expression whose object a part of a script changes, if it changes one."""
    match node:
        case ast.Attribute(value=value, attr=name) if name in CHANGING_METHODS:
            return value  # whether it is called, or given away to be called
        case ast.Subscript(value=value, ctx=ctx) | ast.Attribute(value=value, ctx=ctx):
            return None if isinstance(ctx, ast.Load) else value
    return None


def is_understood(node: ast.AST) -> bool:
    """Return whether it is known what a part of a script changes in place, and how values flow there; else it may
    change all that the script reads, and give each name a part of what any other one has."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return not node.decorator_list
    return isinstance(node, _UNDERSTOOD)


_UNDERSTOOD = (
    ast.mod, ast.expr_context, ast.boolop, ast.operator, ast.unaryop, ast.cmpop, ast.keyword, ast.arguments, ast.arg,
    ast.alias, ast.comprehension, ast.match_case, ast.ExceptHandler, ast.Assign, ast.AnnAssign, ast.AugAssign, ast.For,
    ast.AsyncFor, ast.While, ast.If, ast.Match, ast.Try, ast.Raise, ast.Assert, ast.Delete, ast.Expr, ast.Pass,
    ast.Break, ast.Continue, ast.Import, ast.ImportFrom, ast.Global, ast.Nonlocal, ast.Return, ast.BoolOp,
    ast.NamedExpr, ast.BinOp, ast.UnaryOp, ast.Lambda, ast.IfExp, ast.Dict, ast.Set, ast.List, ast.Tuple, ast.ListComp,
    ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Await, ast.Compare, ast.Call, ast.FormattedValue, ast.JoinedStr,
    ast.Constant, ast.Attribute, ast.Subscript, ast.Starred, ast.Name, ast.Slice, ast.MatchValue, ast.MatchSingleton,
    ast.MatchSequence, ast.MatchMapping, ast.MatchStar, ast.MatchAs, ast.MatchOr,
)  # fmt: skip


def changes_something(node: ast.AST) -> bool:
    """Return whether a part of a script may change something in place."""
    if isinstance(node, ast.Call):
        named = isinstance(node.func, ast.Name | ast.Attribute)
        return not named or any(True for _ in handed_over(node)) or changes_itself(node)
    return changed_place(node) is not None or isinstance(node, ast.AugAssign) or not is_understood(node)


def changes_itself(call: ast.Call) -> bool:
    """Return whether a call is one of a changing method of a variable."""
    match call:
        case ast.Call(func=ast.Attribute(value=value, attr=name), keywords=[]):
            return name in CHANGING_METHODS and not root(value) & COMPUTING
    return False


def changes_parts(tree: ast.AST) -> bool:
    """Return whether a script may change, in place, what is a part of another value."""
    places = list(filter(None, map(changed_place, ast.walk(tree))))
    inside = {name for place in places if not isinstance(place, ast.Name) for name in root(place)}
    return bool(changed_names(tree) & parts_of(tree) or inside & bound_in(tree))


def bound_in(tree: ast.AST) -> set[str]:
    """Return the names that a script sets itself, and those of parameters and patterns."""
    nodes = list(ast.walk(tree))
    names = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    names |= {node.arg for node in nodes if isinstance(node, ast.arg)}
    return names | {str(node.name) for node in nodes if isinstance(node, ast.MatchAs | ast.MatchStar)}


def parts_of(tree: ast.AST) -> set[str]:
    """Return the names that a script sets to something that may be a part of another value."""
    targets: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.For | ast.AsyncFor | ast.comprehension):
            targets.append(node.target)
        elif isinstance(node, ast.Assign) and not isinstance(node.value, NEW):
            targets += node.targets
        elif isinstance(node, ast.NamedExpr) and not isinstance(node.value, NEW):
            targets.append(node.target)
    stored = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    inside = {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return inside | (bound_in(tree) - stored)


def root(node: ast.AST) -> set[str]:
    """Return the variable that an attribute or item belongs to; of an item of a computed value those that it is of."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return {*_whole(node)}


def handed_over(call: ast.Call) -> Iterator[str]:
    """Yield the variables that a call may change: what it is given, and the object of the method."""
    function = call.func
    if isinstance(function, ast.Name) and (function.id in _HARMLESS or _calls_harmless(call)):
        return
    if isinstance(function, ast.Attribute):
        if isinstance(function.value, ast.Name) and function.value.id in _HARMLESS_MODULES:
            return
        if function.attr in READING_METHODS:
            return
    yield from _whole(function.value if isinstance(function, ast.Attribute) else function)
    for argument in (*call.args, *(keyword.value for keyword in call.keywords)):
        yield from _whole(argument)


def _calls_harmless(call: ast.Call) -> bool:
    """Whether it is `map` or `filter` with a function that leaves its argument as it is, or one that is looked at."""
    match call:
        case ast.Call(ast.Name("map" | "filter"), [ast.Name(name), *_]):
            return name in COMPUTING
        case ast.Call(ast.Name("map" | "filter"), [ast.Lambda() | ast.Constant(), *_]):
            return True
    return False


def _whole(node: ast.AST) -> Iterator[str]:
    """The names in an expression whose values may be its value, or a part of it."""
    computed = isinstance(node, ast.BinOp) and not isinstance(node.op, ast.Add | ast.Mult | ast.BitOr | ast.MatMult)
    if isinstance(node, ast.Name):
        yield node.id
    elif not computed and not isinstance(node, ast.UnaryOp | ast.Compare | ast.JoinedStr | ast.Constant):
        for inner in ast.iter_child_nodes(node):
            yield from _whole(inner)


# ---- modules and topics ----------------------------------------------------------------------------------------------


def _imports(tree: ast.AST | None) -> Iterator[tuple[str, str]]:
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.Import):
            for alias in node.names:
                whole = alias.name if alias.asname else alias.name.partition(".")[0]
                yield alias.asname or whole, whole
        elif isinstance(node, ast.ImportFrom):
            yield from ((alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Name) and node.id in _IMPORTERS:
            yield "*", "*"


_CALLS: Mapping[str, Direction] = {
    "receive": "subscribe", "robot.subscribe": "subscribe", "robot.latest": "subscribe", "robot.publish": "publish",
    "robot.call": "call", "robot.act": "act", "signal": "publish",
}  # fmt: skip

_TAKING = ("receive", "robot.subscribe")


def _topics_in(tree: ast.AST | None) -> Iterator[ScriptTopic]:
    """The topics that a tree names, in the order of the text, each once."""
    calls = (
        sorted((node for node in ast.walk(tree) if isinstance(node, ast.Call)), key=_place) if tree is not None else []
    )
    found: dict[tuple[str, str, Direction, str | None], ScriptTopic] = {}
    for topic in (topic for call in calls for topic in _topics(call)):
        found.setdefault((topic.name, topic.label, topic.direction, topic.type), topic)
    yield from found.values()


def _published(nodes: Iterable[ast.AST]) -> list[tuple[ast.Call, str]]:
    """Each call that publishes, and the topic, in the order of the text."""
    calls = sorted((node for node in nodes if isinstance(node, ast.Call)), key=_place)
    return [(call, topic.qualified) for call in calls for topic in _topics(call) if topic.direction == "publish"]


def _place(node: ast.AST) -> tuple[int, int]:
    """Where an expression or statement begins."""
    assert isinstance(node, ast.expr | ast.stmt)
    return node.lineno, node.col_offset


_REPEATING = (ast.For, ast.AsyncFor, ast.While, ast.comprehension, ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda,
              ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)  # fmt: skip
"""What may execute what is inside any number of times."""


def _topics(call: ast.Call) -> Iterator[ScriptTopic]:
    called = called_name(call)
    if called == "robot.transform":
        yield from (ScriptTopic(name, "subscribe", TF, call.lineno) for name in TOPICS)
    direction = _CALLS.get(called)
    name = _argument(call, 0, "name" if called == "signal" else "topic")
    if direction is None or name is None:
        return
    if called == "signal":
        yield ScriptTopic(topic_of(name), direction, None, call.lineno, label_of(name))
    else:
        yield ScriptTopic(name, direction, _argument(call, 1, "type"), call.lineno)


def _computed_in(nodes: Sequence[ast.AST]) -> Iterator[tuple[Direction, str]]:
    """The topics of which the name is computed, and those of functions that are given away: these may be any."""
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    known = {id(call.func) for call in calls if called_name(call) in _CALLS}
    known |= {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    for call in calls:
        called = called_name(call)
        if called in _CALLS and _argument(call, 0, argument := "name" if called == "signal" else "topic") is None:
            begins = _beginning(_given(call, 0, argument))
            topic = ScriptTopic(topic_of(begins) if called == "signal" else begins, _CALLS[called])
            yield topic.direction, topic.qualified if re.fullmatch(r"(~?/)?[A-Za-z][\w/]*", begins) else ""
    for node in nodes:
        name = name_of(node) if id(node) not in known else ""
        if name == "robot" or name in _ANY_NAME:
            yield from (("publish", ""), ("subscribe", ""))
        elif name in _CALLS:
            yield _CALLS[name], ""


def _beginning(name: ast.expr | None) -> str:
    """The text that the value of an expression begins with, as far as that is known."""
    while isinstance(name, ast.JoinedStr) or (isinstance(name, ast.BinOp) and isinstance(name.op, ast.Add)):
        name = name.left if isinstance(name, ast.BinOp) else next(iter(name.values), None)
    return name.value if isinstance(name, ast.Constant) and isinstance(name.value, str) else ""


def _argument(call: ast.Call, place: int, name: str) -> str | None:
    """The value of a literal text argument, else None."""
    given = _given(call, place, name)
    return given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None


def _given(call: ast.Call, place: int, name: str) -> ast.expr | None:
    given = call.args[place] if place < len(call.args) else None
    return next((keyword.value for keyword in call.keywords if keyword.arg == name), given)


class _AlwaysEvaluated(ast.NodeTransformer):
    """Reduces a statement to parts that are evaluated each time that it is executed."""

    def visit(self, node: ast.AST) -> Any:
        match node:
            case ast.BoolOp(values=[first, *_]) | ast.IfExp(test=first) | ast.Compare(left=first):
                return self.visit(first)
            case ast.Lambda() | ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                return ast.Constant(None)
        return self.generic_visit(node)


# ---- requests --------------------------------------------------------------------------------------------------------

_BROAD = frozenset(("Exception", "BaseException"))
_REQUESTS = {
    "robot.act": (frozenset(("aborted", "canceled", "rejected")), _BROAD | {"BpmnError"}),
    "robot.call": (frozenset(("script",)), _BROAD),
    "wait_cancelled": (frozenset((STILL_RUNNING,)), _BROAD | {"BpmnError"}),
}
"""Request, or argument of one -> the codes with which it fails, and the exceptions that catch these."""


def _request(node: ast.AST) -> str | None:
    return node.arg if isinstance(node, ast.keyword) else ast.unparse(node) if isinstance(node, ast.Attribute) else ""


def catches_all(handler: ast.ExceptHandler) -> bool:
    """Return whether an ``except`` catches whatever a script raises."""
    return _catches(handler, _BROAD)


def _catches(handler: ast.ExceptHandler, broad: Set[str]) -> bool:
    named = {node.id for node in ast.walk(handler.type) if isinstance(node, ast.Name)} if handler.type else broad
    return bool(named & broad)
