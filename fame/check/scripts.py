"""Checks of scripts: mistakes that otherwise appear only when the script runs."""

from __future__ import annotations

import ast
import difflib
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from fame.bpmn.model import Body, Element, Event, Expression
from fame.check.expressions import ExpressionUse, expressions_in
from fame.check.graph import graph_of
from fame.check.scope import CheckedProcess, CheckScope, Finding
from fame.errors import MODULE_NOT_FOUND
from fame.scripting.interface import Log, Robot
from fame.scripting.python import REQUESTS, bound_names, called_name
from fame.scripting.python_effects import syntax_tree

# ---- requests and the script interface -------------------------------------------------------------------------------


_HAVE: Mapping[str, tuple[str, ...]] = {
    name: tuple(one for one in dir(kind) if not one.startswith("_")) for name, kind in (("robot", Robot), ("log", Log))
}
"""The methods of the objects of the script interface."""

_IN_EXPRESSIONS = {"robot": ("name", "namespace")}
"""The attributes that expressions in other languages can use."""

_OF_ROBOT = {"": re.compile(r"[$#]\{[^{}]*\brobot\.(\w+)"), "feel": re.compile(r"\brobot\.(\w+)")}
"""Where ``robot.name`` occurs in another language than Python: inside ``${...}``, or anywhere in FEEL."""

_CLOCK = "is the clock of the computer, not the time of the mission: use robot."
_DIFFERS = "differs in each run, also with the same seed: use robot.random"
_UNSEEDED = "without a seed differs in each run: use robot.random, or give it a seed"
_CLOCKS = ("time", "monotonic", "perf_counter", "process_time", "thread_time")
_DOUBTFUL_CALLS: Mapping[str, str] = {
    "time.sleep": "blocks the whole robot: use await sleep(...)",
    **dict.fromkeys((f"time.{name}{unit}" for name in _CLOCKS for unit in ("", "_ns")), f"{_CLOCK}now"),
    **dict.fromkeys((f"datetime.datetime.{name}" for name in ("now", "utcnow", "today")), f"{_CLOCK}date"),
    "datetime.date.today": f"{_CLOCK}date",
    **dict.fromkeys(("uuid.uuid1", "uuid.uuid4", "os.urandom", "random.SystemRandom", "secrets"), _DIFFERS),
}
"""Functions that block, or whose values a run with the same seed does not repeat; and modules of such functions."""
_OF_NUMPY = ("default_rng", "RandomState", "seed", "SeedSequence", "MT19937", "PCG64", "PCG64DXSM", "Philox", "SFC64")
_SEEDED = ("random.Random", "random.seed", *(f"numpy.random.{name}" for name in _OF_NUMPY))
"""Functions that take a seed: without one, or with None, it is a new one in each run."""

_USES = (ast.Attribute, ast.Subscript, ast.Compare, ast.BinOp, ast.BoolOp, ast.UnaryOp, ast.FormattedValue)
_USES_TEST = (ast.If, ast.While, ast.IfExp)
"""Uses of a value that make no sense for a request."""


def check_scripts(scope: CheckScope) -> Iterator[Finding]:
    """Check the scripts and expressions of every process."""
    yield from _modules_not_found(scope)
    for process in scope.processes:
        texts = [text for body in process.bodies() for text in expressions_in(body)]
        scripts = [text for text in texts if text.use == "script"]
        for text in texts:
            yield from _misused_interface(process, text)
        yield from _doubtful_calls(process, texts)
        in_javascript = [text for text in scripts if text.expression.language == "javascript"]
        yield from _without_next(process, in_javascript)
        yield from _piling_up(process, in_javascript)


def _modules_not_found(scope: CheckScope) -> Iterator[Finding]:
    """Modules that scripts import and Python does not find here, each once; nothing is imported."""
    found: set[str] = set()
    for process in scope.processes:
        for text in (text for body in process.bodies() for text in expressions_in(body) if text.use == "script"):
            tree = syntax_tree(text.expression, script=True)
            for module, line in _imported(tree) if tree is not None else ():
                if module in found or module in sys.modules or find_spec(module) is not None:
                    continue
                found.add(module)
                beside = Path(process.file).parent
                there = any((beside / name).exists() for name in (module, f"{module}.py"))
                mend = f"set PYTHONPATH={beside}" if there else MODULE_NOT_FOUND
                problem = f"imports {module}, which Python does not find here: {mend}"
                yield process.finding("warning", problem, text.element, line)


def _imported(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """(package, line) of each import, but for those that a script tries."""
    if isinstance(tree, ast.Import):
        yield from ((alias.name.partition(".")[0], tree.lineno) for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom) and tree.module and not tree.level:
        yield tree.module.partition(".")[0], tree.lineno
    elif not (isinstance(tree, ast.Try) and tree.handlers):
        for child in ast.iter_child_nodes(tree):
            yield from _imported(child)


def _misused_interface(process: CheckedProcess, text: ExpressionUse) -> Iterator[Finding]:
    """Methods that the script interface does not have, and requests that are not awaited."""
    tree = syntax_tree(text.expression, script=text.use == "script")
    bound = bound_names(tree) if tree is not None else set()
    have = _HAVE if tree is not None else _IN_EXPRESSIONS
    for name, method, line in _attributes(text.expression, tree):
        if method not in have[name] and name not in bound:
            yield process.finding("warning", _unknown(name, method, have[name]), text.element, line)
    if tree is not None and text.use == "script":
        yield from _not_awaited(process, text.element, tree, bound)


def _attributes(expression: Expression, tree: ast.AST | None) -> Iterator[tuple[str, str, int]]:
    """(object, attribute, line) of each use of an object of the script interface."""
    if tree is None and expression.language != "javascript":
        of_robot = _OF_ROBOT["feel" if expression.language == "feel" else ""]
        yield from (("robot", name, expression.line) for name in of_robot.findall(expression.text))
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in _HAVE:
            yield node.value.id, node.attr, node.lineno


def _unknown(name: str, method: str, have: Sequence[str]) -> str:
    similar = difflib.get_close_matches(method, have, 1)
    known = f"did you mean {name}.{similar[0]}?" if similar else f"it has {', '.join(have)}"
    return f"{name} has no {method!r}; {known}"


def _not_awaited(process: CheckedProcess, element: Element, tree: ast.AST, bound: set[str]) -> Iterator[Finding]:
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        called = called_name(node) if isinstance(node, ast.Call) else ""
        if called not in REQUESTS or called.partition(".")[0] in bound:
            continue
        target = _target(parents[node])
        used = _is_used(parents, node) or (target and all(_is_used(parents, one) for one in _loads(tree, target)))
        if used:
            right = f"{target} = await {called}(...)" if target else f"(await {called}(...))"
            text = f"{called}(...) has no result unless it is awaited: {right}"
            yield process.finding("warning", text, element, getattr(node, "lineno", 0))


def _doubtful_calls(process: CheckedProcess, texts: Sequence[ExpressionUse]) -> Iterator[Finding]:
    """Calls that block, or that a run with the same seed does not repeat. What one script imports, all others see."""
    parsed = [(text, syntax_tree(text.expression, script=text.use == "script")) for text in texts]
    trees = [(text, tree) for text, tree in parsed if tree is not None]
    imported = {name: path for text, _ in trees for name, path in text.effects.imports.items()}
    star = imported.pop("*", "*").removesuffix("*")  # of `from time import *`; of `eval` there is no path

    def path_of(node: ast.AST) -> str:
        root, dot, rest = _dotted(node).partition(".")
        return imported.get(root, star and star + root) + dot + rest

    for assigned in [node for _, tree in trees for node in ast.walk(tree) if isinstance(node, ast.Assign)]:
        if (path := path_of(assigned.value)) in (*_DOUBTFUL_CALLS, *_SEEDED):  # now = time.time
            imported |= {target.id: path for target in assigned.targets if isinstance(target, ast.Name)}
    for text, tree in trees if imported or star else ():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            path = path_of(node.func)
            problem = _DOUBTFUL_CALLS.get(path) or _DOUBTFUL_CALLS.get(path.partition(".")[0])
            given = [*node.args, *(keyword.value for keyword in node.keywords)]
            if path in _SEEDED and all(isinstance(one, ast.Constant) and one.value is None for one in given):
                problem = _UNSEEDED
            if problem is not None:
                yield process.finding("warning", f"{path}() {problem}", text.element, node.lineno)


def _dotted(node: ast.AST) -> str:
    """``np.random.seed``; empty if it is no name with attributes."""
    if isinstance(node, ast.Attribute):
        inside = _dotted(node.value)
        return f"{inside}.{node.attr}" if inside else ""
    return node.id if isinstance(node, ast.Name) else ""


def _target(parent: ast.AST) -> str:
    """Return the variable to which the value is assigned, or an empty text."""
    targets = parent.targets if isinstance(parent, ast.Assign) else [getattr(parent, "target", None)]
    only = targets[0] if len(targets) == 1 and isinstance(parent, ast.Assign | ast.AnnAssign | ast.NamedExpr) else None
    return only.id if isinstance(only, ast.Name) else ""


def _loads(tree: ast.AST, name: str) -> list[ast.Name]:
    names = (node for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id == name)
    return [node for node in names if isinstance(node.ctx, ast.Load)]


def _is_used(parents: Mapping[ast.AST, ast.AST], node: ast.AST) -> bool:
    """Whether a value is used in a way that makes no sense for a request."""
    parent = parents[node]
    return isinstance(parent, _USES) or (isinstance(parent, _USES_TEST) and parent.test is node)


# ---- JavaScript -----------------------------------------------------------------------------------------------------


def _without_next(process: CheckedProcess, scripts: list[ExpressionUse]) -> Iterator[Finding]:
    """Scripts that never call next(): they fail when they run."""
    for text in scripts:
        if text.effects.calls is not None and not text.effects.calls.next:
            message = "never calls next(), so it fails after it has run: next() completes a script"
            yield process.finding("warning", message, text.element, text.expression.line)


def _piling_up(process: CheckedProcess, scripts: list[ExpressionUse]) -> Iterator[Finding]:
    """Subscriptions that are made in each iteration of a loop, while nothing destroys any."""
    calls = [(text, text.effects.calls) for text in scripts if text.effects.calls is not None]
    if any(one.destroys for _, one in calls):
        return
    repeated = set(_repeated(process.bpmn.body, around=False))
    for text, call in calls:
        if text.element.id in repeated and call.subscribes:
            message = (
                "creates a subscription in each iteration: end the previous one with node.destroySubscription(...)"
            )
            yield process.finding("note", message, text.element, text.expression.line)


def _repeated(body: Body, *, around: bool) -> Iterator[str]:
    """The ids of nodes that may run again in one instance; `around`: the whole body may."""
    graph = graph_of(body)
    events = [node for node in body.nodes if isinstance(node, Event) and not node.interrupting]
    around |= any(node.place == "start" for node in events)  # of an event sub-process
    often = graph.reach([node.id for node in events if node.place == "boundary"], set())
    for node in body.nodes:
        in_a_circle = node.id in graph.reach(graph.following[node.id], set())
        again = around or in_a_circle or node.loop is not None or node.id in often
        if again:
            yield node.id
        if node.body is not None:
            yield from _repeated(node.body, around=again)
