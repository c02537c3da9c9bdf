"""Find what a text uses before it runs: the variables that it reads and writes, the topics that it names.

Python is parsed. JavaScript is not: comments and string literals are removed, and the rest is searched for the usual
ways to access variables. Any other access makes the names *open*: the script may use further variables.
"""

from __future__ import annotations

import ast
import re
import symtable
from collections.abc import Iterator
from functools import lru_cache
from typing import Literal, cast

from fame.bpmn.model import Expression
from fame.dataclasses import dataclass, field
from fame.scripting.interface import interface
from fame.scripting.languages import parse_expression
from fame.scripting.python import called_name, compile_python, parse_python
from fame.scripting.transforms import TF, TOPICS
from fame.text import label_of, topic_of

# ---- variables -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1024)
def script_names(expression: Expression, *, script: bool = False) -> tuple[frozenset[str], frozenset[str]]:
    """Return (reads, writes): the variables that a text reads, and those that it sets.

    `script`: it is statements, not an expression. Functions, classes and imports of a script are not variables, nor are
    names of the interface and builtins that it does not set (in ``${...}`` and FEEL: ``robot``). Raises ModelError if
    the text is wrong.
    """
    if expression.language == "javascript":
        words = identifiers_of(expression.text)
        return words.reads, words.writes
    if expression.language != "python":
        return frozenset(parse_expression(expression)[1]) - {"robot"}, frozenset()
    tree = parse_python(expression, "exec" if script else "eval")
    top = _symbols(expression, tree)
    inner = _comprehended(tree)  # CPython 3.12 counts them among the names around the comprehension
    inner.add("__conditional_annotations__")  # which `x: int = 1` reads from 3.14 on
    code = _code(top)
    reads, writes = set[str](), set[str]()
    for table in _tables(top):
        for symbol in table.get_symbols():
            if table is top or symbol.is_global():
                reads |= {symbol.get_name()} if symbol.is_referenced() else set()
                writes |= {symbol.get_name()} if symbol.is_assigned() else set()
    reads |= {name for name in writes if name in _augmented(tree)}
    reads, writes = reads - inner, writes - inner
    provided = interface(robot=None, signal=print, log=lambda level, text: None).keys() - writes
    return frozenset(reads - code - provided), frozenset(writes - code)


@lru_cache(maxsize=1024)
def code_names(script: Expression) -> frozenset[str]:
    """Return the functions, classes and modules that a script defines for later scripts; ``*`` for a star import.

    Raises ModelError if the text is wrong.
    """
    if script.language != "python":
        return frozenset()
    tree = parse_python(script)
    everything = any(isinstance(node, ast.ImportFrom) and node.names[0].name == "*" for node in ast.walk(tree))
    return _code(_symbols(script, tree)) | ({"*"} if everything else set())


def _symbols(expression: Expression, tree: ast.AST) -> symtable.SymbolTable:
    """The symbols of a parsed text. Raises ModelError for what parses and does not compile (``global x`` too late)."""
    try:
        return symtable.symtable(ast.unparse(_Synchronous().visit(tree)), "<script>", "exec")
    except SyntaxError:
        compile_python(expression, "exec" if isinstance(tree, ast.Module) else "eval")
        raise


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


_IMPORTERS = frozenset(("__import__", "eval", "exec"))


@lru_cache(maxsize=1024)
def imported_modules(expression: Expression) -> frozenset[str]:
    """Return the modules that a text in Python imports; ``*`` where it can import any. Raises ModelError."""
    words = (*_IMPORTERS, "import")
    if expression.language != "python" or not any(word in expression.text for word in words):
        return frozenset()
    found = set[str]()
    for node in ast.walk(parse_python(expression)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(str(node.module))
        elif isinstance(node, ast.Name) and node.id in _IMPORTERS:
            found.add("*")
    return frozenset(found)


def _code(table: symtable.SymbolTable) -> frozenset[str]:
    symbols = table.get_symbols()
    return frozenset(symbol.get_name() for symbol in symbols if symbol.is_imported() or symbol.is_namespace())


def _augmented(tree: ast.AST) -> set[str]:
    """The targets of ``x += 1``, which symbol tables do not count as read."""
    targets = (node.target for node in ast.walk(tree) if isinstance(node, ast.AugAssign))
    return {target.id for target in targets if isinstance(target, ast.Name)}


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


# ---- topics ----------------------------------------------------------------------------------------------------------


Direction = Literal["publish", "subscribe", "call", "act"]

_CALLS: dict[str, Direction] = {
    "receive": "subscribe",
    "robot.subscribe": "subscribe",
    "robot.latest": "subscribe",
    "robot.publish": "publish",
    "robot.call": "call",
    "robot.act": "act",
    "signal": "publish",
}
_MAKES: dict[str, Direction] = {"Publisher": "publish", "Subscription": "subscribe", "Client": "call"}
_MADE = re.compile(
    r"""\bcreate(?P<kind>Publisher|Subscription|Client)\s*\(
    \s*(?P<q>["'`])(?P<type>[\w/]+)(?P=q)\s*,\s*(?P<r>["'`])(?P<name>[\w/~]+)(?P=r)""",
    re.VERBOSE,
)


_TOPIC_WORDS = ("receive", "robot", "signal")
"""Every text that names a topic contains one of these."""


@dataclass(frozen=True, slots=True)
class ScriptTopic:
    """A topic as a script names it (relative to its robot), or a service or an action.

    `type` is None if the script does not give it; `label` is the name that is thrown, if the topic is made of it.
    """

    name: str
    direction: Direction
    type: str | None = None
    line: int = 0
    label: str = field(default="", compare=False, repr=False)

    @property
    def qualified(self) -> str:
        """The name with its scope: ``/weed_found``, or ``~/odom`` for one in the robot's namespace."""
        return self.name if self.name.startswith(("/", "~/")) else f"~/{self.name}"

    @property
    def full_type(self) -> str | None:
        """The type of a message in its long form: ``std_msgs/msg/Bool`` for ``std_msgs/Bool``."""
        return self.type.replace("/", "/msg/") if self.type and self.type.count("/") == 1 else self.type


@lru_cache(maxsize=1024)
def script_topics(expression: Expression) -> tuple[ScriptTopic, ...]:
    """Return the topics in the order of the text, each once. The topic of ``signal("done")`` is ``/done``.

    A text in Python that names none is not looked at further. Raises ModelError if one that does is wrong.
    """
    if expression.language == "javascript":
        return tuple(dict.fromkeys(_endpoints(expression)))
    if expression.language != "python" or not any(name in expression.text for name in _TOPIC_WORDS):
        return ()
    calls = [node for node in ast.walk(parse_python(expression)) if isinstance(node, ast.Call)]
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    found: dict[tuple[str, str, Direction, str | None], ScriptTopic] = {}
    for topic in (topic for call in calls for topic in _topics(call)):
        found.setdefault((topic.name, topic.label, topic.direction, topic.type), topic)
    return tuple(found.values())


def _endpoints(expression: Expression) -> Iterator[ScriptTopic]:
    """The endpoints that a script in JavaScript creates with literal type and topic."""
    for found in _MADE.finditer(expression.text):
        kind, type, name = found["kind"], found["type"], found["name"]
        yield ScriptTopic(name, _MAKES[kind], type, expression.line + expression.text.count("\n", 0, found.start()))


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


def _argument(call: ast.Call, place: int, name: str) -> str | None:
    """The value of a literal text argument, else None."""
    given = call.args[place] if place < len(call.args) else None
    for keyword in call.keywords:
        if keyword.arg == name:
            given = keyword.value
    return given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None


# ---- identifiers of JavaScript ---------------------------------------------------------------------------------------

_LITERAL = re.compile(
    r"""//[^\n]* | /\*.*?\*/ | '(?:\\.|[^'\\\n])*' | "(?:\\.|[^"\\\n])*" | `(?:\\.|[^`\\])*`""", re.VERBOSE | re.DOTALL
)
_INSIDE = re.compile(r"\$\{([^{}]*)\}")
_NAME = r"[^\W\d][\w$]*"
_BEHIND = r"(?<![\w$])(?:(?:this|\w+)\s*\.\s*)?environment\s*\??\.\s*variables\b"
_ALIAS = re.compile(rf"\b(?:const|let|var)\s+({_NAME})\s*=\s*{_BEHIND}\s*(?=[;,\n}}]|$)")
_TAKEN = re.compile(rf"\{{([^{{}}]*)\}}\s*=\s*(?:{_BEHIND}|({_NAME}))\s*(?=[;,\n}}]|$)")
_SET = re.compile(r"\s*(?:=(?![=>])|[-+*/%&|^]=|\*\*=|\|\|=|&&=|\?\?=|<<=|>>=|\+\+|--)")
_CHANGE = re.compile(r"\s*(?:[-+*/%&|^]=|\*\*=|<<=|>>=|\+\+|--)")
_NODES = ("ros_node", "node")
_FUNCTION = re.compile(
    r"\bfunction\b|=>|\bclass\b|\b(?!(?:if|for|while|switch|catch|with)\b)[\w$]+\s*\([^()]*\)\s*\{|\]\s*\("
)
_HARMLESS = re.compile(
    r"(?<![\w$.])(?:(?:Math|Number|console)\s*\.\s*\w+|Date\s*\.\s*now|next|Number|String|Boolean|parseInt|parseFloat|isNaN"
    r"|isFinite|if|for|while|switch|return|typeof|else|do|case|in|of)\s*(?=\()"
)
_IN_PLACE = re.compile(
    rf"""[\w$\])]\s*(?:\?\.\s*)?\( | (?:\.\s*{_NAME}|[\]}}])(?:{_SET.pattern}|\s+(?:of|in)\b) | \bdelete\b
    | (?:\+\+|--)\s*[\w$]+\s*[.\[]""",
    re.VERBOSE,
)
"""A call, or what sets, counts or deletes a member."""


@dataclass(frozen=True, slots=True)
class Identifiers:
    """The identifiers in one text.

    reads, writes  the variables that it names
    open           whether it may read and set other variables, too
    next           whether it names next
    node           whether it uses node for ros_node
    subscribes     whether it creates a subscription; `destroys`: whether it destroys one
    functions      whether it makes functions, which may run later
    changes        whether it may change lists or objects: by calls, or by setting members
    """

    reads: frozenset[str]
    writes: frozenset[str]
    open: bool
    next: bool
    node: bool
    subscribes: bool
    destroys: bool
    functions: bool
    changes: bool


def identifiers_of(text: str) -> Identifiers:
    """Find the identifiers of a script or condition.

    >>> found = identifiers_of("const env = this.environment.variables; env.x = env.y + 1; next(); // env.z")
    >>> sorted(found.reads), sorted(found.writes), found.open, found.next
    (['y'], ['x'], False, True)
    """
    code = _LITERAL.sub(_without, text)
    reads, writes = set[str](), set[str]()
    aliases = [found[1] for found in _ALIAS.finditer(code)]
    code = _ALIAS.sub("", code)
    objects = "|".join([_BEHIND, *(rf"(?<![\w$.]){alias}\b" for alias in aliases)])
    for found in _TAKEN.finditer(code):
        if found[2] is None or found[2] in aliases:
            reads |= {name.partition(":")[0].partition("=")[0].strip() for name in found[1].split(",")}
    code = _TAKEN.sub(lambda found: "" if found[2] is None or found[2] in aliases else found[0], code)
    is_open = False
    for found in re.finditer(rf"(?:{objects})(?:\s*\??\.\s*({_NAME}))?", code):
        name, after = found[1], code[found.end() :]
        if name is None:
            is_open = True
        elif _SET.match(after) or code[: found.start()].rstrip().endswith(("++", "--", "delete")):
            writes.add(name)
            reads |= {name} if _CHANGE.match(after) else set()
        else:
            reads.add(name)
    is_open |= "environment" in re.sub(_BEHIND, "", code)
    names_node = "node" in reads
    functions = _FUNCTION.search(code) is not None
    plain = _HARMLESS.sub("", re.sub(rf"(?:{objects})\s*\??\.\s*", "$", code))
    return Identifiers(
        frozenset(reads - {"", *_NODES}),
        frozenset(writes),
        is_open,
        re.search(r"\bnext\b", code) is not None,
        names_node,
        "createSubscription" in code,
        "destroySubscription" in code,
        functions,
        functions or _IN_PLACE.search(plain) is not None or re.search(r"[\w$\])]\s*`", text) is not None,
    )


def _without(found: re.Match[str]) -> str:
    """The replacement of a comment or string literal: a blank, or the expressions of a template."""
    if found[0][0] != "`":
        return '""' if found[0][0] in "'\"" else " "
    return " ".join(("", *_INSIDE.findall(found[0]), ""))
