"""The kinds of values of variables, as far as the model determines them: by scripts, data objects and messages.

A kind is shown by a sample: a value that a variable may have. Whatever is computed in a way that is not understood has
no sample, and then nothing is reported about its variable.
"""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fame.bpmn.model import Element, Expression, FlowNode
from fame.bpmn.topics import EMPTY_TYPE
from fame.check.endpoints import TopicEndpoint, by_topic, message_fields, types_of
from fame.check.expressions import ExpressionUse, constant, expressions_in
from fame.check.scope import CheckedProcess, CheckScope, Finding
from fame.check.topics import misfit
from fame.check.variables import assigned_objects, named_by, sharing, uses_of
from fame.dataclasses import dataclass
from fame.engine import UNDEFINED
from fame.engine.data import variable_name
from fame.errors import MessageError
from fame.middleware import messages
from fame.scripting.budget import BudgetExceeded
from fame.scripting.data import ExpressionError
from fame.scripting.effects import effects_of
from fame.scripting.python import called_name
from fame.scripting.python_effects import syntax_tree

_MOST = 16
"""The largest number of sample combinations tried for a payload."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A value that an element assigns to a variable. `exact`: the value itself, or one that fits wherever it fits.

    `whole`: a caught message that fills the variable named like its topic by default.
    """

    process: CheckedProcess
    element: Element
    value: Any
    exact: bool = True
    whole: bool = False

    @property
    def kind(self) -> str:
        """The kind as text."""
        if isinstance(self.value, bool):
            return "true or false"
        names = {int: "a number", float: "a number", str: "a text", list: "a list", tuple: "a list", dict: "a mapping"}
        value = self.value
        return f"a {messages.type_name(value)}" if is_message(value) else names.get(type(value), "")


def is_message(value: Any) -> bool:
    """Return whether it is a message or a nested message."""
    return hasattr(value, "__msgtype__")


_Samples = Mapping[str, Sequence[Sample]]
"""The samples of each variable; one without a kind stands for an unknown value."""


def check_value_kinds(scope: CheckScope) -> Iterator[Finding]:
    """Find variables that are set to different kinds of values, and payloads whose values do not fit."""
    types = types_of(scope)
    own = {process: list(_samples(process, types)) for process in scope.processes}
    for root in scope.roots:
        shared = list(sharing(root))
        samples = _by_name(own, shared)
        for name, of_name in samples.items():
            for sample in of_name:
                if sample.whole:
                    yield from _overwritten(sample, name, of_name, shared)
        closure = root.closure()
        uses = [uses_of(process, types) for process in closure]
        if not any(one.opaque for one in uses):
            given = set().union(*(one.declared for one in uses)) if not scope.has_pool(root) else set()
            known = {name: found for name, found in _by_name(own, closure).items() if name not in given}
            for ends in by_topic(closure).values():
                yield from (one for end in ends for one in _misfits(end, known, types))


def _by_name(
    own: Mapping[CheckedProcess, list[tuple[str, Sample]]], processes: Sequence[CheckedProcess]
) -> dict[str, list[Sample]]:
    by_name: dict[str, list[Sample]] = {}
    for process in processes:
        for name, sample in own[process]:
            by_name.setdefault(name, []).append(sample)
    return by_name


def kind_of(scope: CheckScope, root: CheckedProcess, name: str) -> str:
    """Return the kind of value that a variable gets wherever its robot sets it; empty if there are several, or none."""
    kinds = kinds_of(scope, root, name)
    return kinds.pop() if len(kinds) == 1 else ""


def kinds_of(scope: CheckScope, root: CheckedProcess, name: str) -> set[str]:
    """Return the kinds of values that a robot sets a variable to, empty for an unknown one; none if nothing sets it."""
    types = types_of(scope)
    return {one.kind for process in root.closure() for known, one in _samples(process, types) if known == name}


# ---- samples ---------------------------------------------------------------------------------------------------------


def _samples(process: CheckedProcess, types: Mapping[str, str]) -> Iterator[tuple[str, Sample]]:
    assigned = assigned_objects(process)
    for body in process.bodies():
        for text in expressions_in(body):
            if text.use == "script":
                yield from ((name, Sample(process, text.element, *value)) for name, value in _of_script(text))
        for node in body.nodes:
            inputs = node.io.inputs if node.io is not None else ()
            for name in (*named_by(node), *(item.target for item in inputs)):
                yield name, Sample(process, node, None)
            objects = [item for item in body.data_objects if item.id in node.data_outputs]
            names = [name for item in objects for name in item.names]
            yield from _of_messages(process, node, names, types)
        for item in body.data_objects:
            for name, expression in item.values if item.id in assigned else ():
                if expression.text.strip():
                    yield name, Sample(process, item, constant(expression)[0])


def _of_messages(
    process: CheckedProcess, node: FlowNode, names: Sequence[str], types: Mapping[str, str]
) -> Iterator[tuple[str, Sample]]:
    """The variables that caught messages set: those of data objects, else the one named like the topic."""
    for topic, throws in node.topics():
        type = types.get(topic.qualified, EMPTY_TYPE if topic.qualified.startswith("/") else "")
        if throws or not type:
            continue
        if topic.takes:
            yield from ((item.target, Sample(process, node, None)) for item in topic.takes)
        elif names:
            fields = message_fields(names, topic, type)
            yield from ((name, Sample(process, node, *_field(type, fields.get(name, "")))) for name in names)
        else:
            try:
                message = messages.create(type)
            except MessageError:  # reported as an error
                continue
            value = messages.bare(message)
            exact = not isinstance(value, str | list | tuple)
            yield variable_name(topic.name), Sample(process, node, _plain(value), exact, whole=True)


def _plain(value: Any) -> Any:
    return list(value) if hasattr(value, "tolist") or isinstance(value, tuple) else value


def _field(type: str, path: str) -> tuple[Any, bool]:
    """A sample of a field of a message, ``pose.position.x``, and whether it is exact."""
    if not path:
        return None, True
    value: Any = messages.create(type)
    for name in path.split("."):
        value = getattr(value, name, None)
    return _plain(value), isinstance(value, bool | int | float)


def _of_script(text: ExpressionUse) -> Iterator[tuple[str, tuple[Any, bool]]]:
    """(variable, (value, whether it is exact)) of each assignment in a script; the value is None if unknown."""
    left = set(text.effects.sets)
    tree = syntax_tree(text.expression)
    for target, value in _assignments(tree) if tree is not None else ():
        if target in text.effects.sets:
            left.discard(target)
            yield target, _value(value)
    yield from ((name, (None, True)) for name in sorted(left))


def _assignments(tree: ast.AST) -> Iterator[tuple[str, ast.expr | None]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                yield from _named(target, node.value)
        elif isinstance(node, ast.AugAssign | ast.AnnAssign | ast.NamedExpr):
            yield from _named(node.target, node.value)
        elif isinstance(node, ast.For | ast.AsyncFor):
            yield from _named(node.target, None)


def _named(target: ast.expr, value: ast.expr | None) -> Iterator[tuple[str, ast.expr | None]]:
    """(variable, value) of one assignment target; the value is None if unknown."""
    if isinstance(target, ast.Name):
        yield target.id, value
    elif isinstance(target, ast.Tuple | ast.List):
        values = value.elts if isinstance(value, ast.Tuple | ast.List) and len(value.elts) == len(target.elts) else ()
        for part, given in itertools.zip_longest(target.elts, values):
            yield from _named(part, given)


def _value(tree: ast.expr | None) -> tuple[Any, bool]:
    """A sample of the value of a Python expression, and whether it is exact; None if unknown."""
    if isinstance(tree, ast.Compare) or (isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not)):
        return True, True
    called = called_name(tree) if isinstance(tree, ast.Call) else ""
    if called in _GIVES:
        return _GIVES[called], _GIVES[called] != []
    if isinstance(tree, ast.ListComp | ast.List | ast.Dict | ast.DictComp):
        with_items: Any = {} if isinstance(tree, ast.Dict | ast.DictComp) else []
        try:
            return ast.literal_eval(tree), True
        except (ValueError, RecursionError):
            return with_items, False
    try:
        return (ast.literal_eval(tree), True) if tree is not None else (None, True)
    except (ValueError, SyntaxError, RecursionError):
        return None, True


_GIVES: Mapping[str, Any] = {"float": 1.0, "int": 1, "len": 1, "round": 1, "bool": True, "list": [], "sorted": []}
"""Functions of Python -> a sample of their result."""


# ---- a message that overwrites something else ------------------------------------------------------------------------


def _overwritten(
    sample: Sample, name: str, others: Sequence[Sample], processes: Sequence[CheckedProcess]
) -> Iterator[Finding]:
    does = f"fills `{name}` with {sample.kind}, but "
    right = "give the event a mapping or the signal another name"
    for other in others:
        if not other.whole and other.kind and sample.kind and other.kind != sample.kind:
            yield sample.process.finding(
                "warning", f"{does}{other.element.display_name} sets it to {other.kind}: {right}", sample.element
            )
            return
    for process in processes if is_message(sample.value) else ():
        for text in (text for body in process.bodies() for text in expressions_in(body) if name in text.reads):
            if _computes(text, name):
                message = f"{does}{text.element.display_name} computes with it as a number: {right}"
                yield sample.process.finding("warning", message, sample.element)
                return


def _computes(text: ExpressionUse, name: str) -> bool:
    """Whether a text computes with or orders the variable itself."""
    script = text.use == "script" and text.expression.language == "python"
    tree = syntax_tree(text.expression) if script else text.effects.as_python
    for node in ast.walk(tree) if tree is not None else ():
        operands: list[ast.expr] = []
        if isinstance(node, ast.BinOp):
            operands = [node.left, node.right]
        elif isinstance(node, ast.AugAssign):
            operands = [node.target]
        elif isinstance(node, ast.Compare) and all(
            isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE) for op in node.ops
        ):
            operands = [node.left, *node.comparators]
        if any(isinstance(one, ast.Name) and one.id == name for one in operands):
            return True
    return False


# ---- payloads --------------------------------------------------------------------------------------------------------


def _misfits(end: TopicEndpoint, known: _Samples, types: Mapping[str, str]) -> Iterator[Finding]:
    """A payload that does not fit its type with any possible values of its variables."""
    type, expression = types.get(end.name), end.payload
    if type is None or expression is None or expression.language != "payload" or expression.text.lstrip()[:1] == "=":
        return
    names = sorted(name for name in effects_of(expression).reads if _all_known(known.get(name, ()), name, expression))
    values = [[sample.value for sample in known[name]] for name in names]
    if not names or math.prod(map(len, values)) > _MOST:
        return
    from fame.scripting.substitution import payload

    try:
        evaluate = payload(expression.text, lambda variables, path, error: None)[0]
        if _error(evaluate({}), type) is not None:  # reported as an error
            return
        errors = [_error(evaluate(dict(zip(names, case, strict=True))), type) for case in itertools.product(*values)]
    except ExpressionError:  # the compiler reports it
        return
    except (Exception, BudgetExceeded):  # it fails with a sample: no telling
        return
    if all(error is not None for error in errors):
        yield end.process.finding("warning", f"the payload does not fit: {errors[0]}", end.node, expression.line)


def _error(value: Any, type: str) -> MessageError | None:
    return None if value is UNDEFINED else misfit(type, value)


def _all_known(samples: Sequence[Sample], name: str, expression: Expression) -> bool:
    """Whether all samples are exact; messages count as long as no field of them is read."""
    taken = re.search(rf"\b{re.escape(name)}\s*[.\[]", expression.text) is not None
    return bool(samples) and all(one.kind and one.exact and not (taken and is_message(one.value)) for one in samples)
