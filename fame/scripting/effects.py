"""What a text does to what is around it, found without running it: one interface for all languages.

`effects_of` gives the `Effects` of a script or expression. Each language has a module of its own: `python_effects`,
`javascript.effects`; those that only compute a value are here. Checks, exploration, endpoints made at load and the
state of random numbers all ask the same object, so that a language is understood everywhere alike, or nowhere.

Each effect is found when it is first asked for: an engine that starts needs the topics alone, of the few texts that
name one. A text that is wrong has no effects. It never runs, and the compiler says why.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from fame.bpmn.model import Expression, FlowNode
from fame.dataclasses import dataclass, field
from fame.errors import ModelError
from fame.rooms import EFFECTS, load
from fame.scripting.languages import parse_expression

NONE: frozenset[Any] = frozenset()
Direction = Literal["publish", "subscribe", "call", "act"]


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


class JavaScriptCalls(NamedTuple):
    """What only a text in JavaScript has to call: whether it names `next`, uses `node` for `ros_node`, creates a
    subscription, and destroys one."""

    next: bool
    node: bool
    subscribes: bool
    destroys: bool


class Effects:
    """The effects of a text. Names are those of variables, where nothing else is said.

    Builtins and names of the script interface that it does not set itself are no variables.
    """

    def __init__(self, expression: Expression, script: bool) -> None:
        self.expression: Expression = expression
        self.script: bool = script

    @property
    def reads(self) -> frozenset[str]:
        """What it reads."""
        return NONE

    @property
    def sets(self) -> frozenset[str]:
        """What it sets, on some way through it; see `always`."""
        return NONE

    @property
    def code(self) -> frozenset[str]:
        """The functions, classes and modules that it leaves for later scripts; ``*`` for a star import."""
        return NONE

    @property
    def changes(self) -> frozenset[str]:
        """Whose lists, mappings or objects it changes in place if it gets there."""
        return NONE

    @property
    def may_change(self) -> frozenset[str]:
        """Whose lists, mappings or objects it may change besides, since it is not known what it calls."""
        return NONE

    @property
    def reaches(self) -> frozenset[str]:
        """Those of them that it hands to functions."""
        return NONE

    @property
    def leaves(self) -> frozenset[str]:
        """Whose lists, mappings or objects functions and methods may change that it leaves for later scripts."""
        return NONE

    @property
    def writes(self) -> frozenset[str]:
        """What is another value afterwards: set, defined, or changed in place."""
        return self.sets | self.code | self.changes

    @property
    def calls(self) -> JavaScriptCalls | None:
        """Of a text in JavaScript."""
        return None

    @property
    def always(self) -> frozenset[str]:
        """What it sets whatever happens, unless it fails."""
        return NONE

    @property
    def read_first(self) -> frozenset[str]:
        """What it may read before it has certainly set it."""
        return self.reads

    @property
    def later(self) -> frozenset[str]:
        """What it may set when it is over, by functions that it leaves; "" for all variables."""
        return self.code

    @property
    def open(self) -> bool:
        """Whether it may read and set further variables, of which it computes the names."""
        return False

    @cached_property
    def unseen(self) -> bool:
        """Whether it may set variables in a way that no analysis sees, or change what a comparison means."""
        return _UNSEEN.search(self.expression.text) is not None

    @property
    def imports(self) -> Mapping[str, str]:
        """Name -> what it is imported as: ``np`` -> ``numpy``, ``now`` -> ``time.now``; ``*`` where that may be any."""
        return MappingProxyType({})

    @property
    def topics(self) -> tuple[ScriptTopic, ...]:
        """The topics, services and actions that it names, in the order of the text, each once."""
        return ()

    @property
    def computed(self) -> frozenset[tuple[Direction, str]]:
        """The topics (and services, actions) of which it computes the name: how each qualified name begins, as far as
        that is known."""
        return NONE

    @property
    def publishes(self) -> tuple[str, ...]:
        """The topics that it publishes on (qualified names)."""
        return tuple(one.qualified for one in self.topics if one.direction == "publish")

    @property
    def awaits(self) -> frozenset[str]:
        """The topics of which it takes messages one by one (qualified names)."""
        return NONE

    @property
    def publications(self) -> tuple[tuple[str, bool], ...]:
        """(topic, whether it does so each time that it ends without an error) of what it publishes, in the order of the
        text, each call once, one in a loop twice."""
        return tuple((topic, False) for topic in self.publishes)

    @property
    def midway(self) -> frozenset[str]:
        """The topics on which it publishes before it waits, or any number of times (qualified names)."""
        return NONE

    @property
    def codes(self) -> frozenset[str] | None:
        """The error codes that it raises by itself; None if these may be any."""
        return NONE

    @property
    def computes_code(self) -> bool:
        """Whether it raises an error with a code that it computes."""
        return False

    @property
    def asked(self) -> frozenset[str]:
        """The codes with which the actions and services fail that it waits for, and that it does not catch."""
        return NONE

    @property
    def fails(self) -> bool:
        """Whether it says that it fails otherwise than with an error code."""
        return _FAILS.search(self.expression.text) is not None

    @property
    def may_mismatch(self) -> bool:
        """Whether it may fail because a value is not of the kind that it expects."""
        return True

    @property
    def waits(self) -> bool:
        """Whether it may wait: the engine goes on meanwhile."""
        return False

    @property
    def catches(self) -> bool:
        """Whether it catches exceptions."""
        return False

    @property
    def steady(self) -> bool:
        """Whether an expression always gives the same for the same variables, and does nothing else."""
        varies = _VARIES.get(self.expression.language)
        return varies is not None and not varies.search(self.expression.text)

    @cached_property
    def as_python(self) -> ast.expr | None:
        """An expression of any language as a tree of Python; None if Python has no such form."""
        text = self.expression.text.strip()
        if self.expression.language != "python":
            text = text[2:-1] if text[:2] in ("${", "#{") and text[-1:] == "}" else text
            text = text.rstrip(";") if self.expression.language == "javascript" else text
            for pattern, spelling in _SPELLINGS:
                text = re.sub(pattern, spelling, text)
        try:
            return ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            return None

    @property
    def condition(self) -> ast.expr | None:
        """The tree of a condition that always gives the same result for the same variables, else None."""
        tree = self.as_python
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and tree.func.id == "next" \
                and len(tree.args) == 2:  # fmt: skip
            tree = tree.args[1]  # next(null, x > 3), the condition of the original FaMe
        return None if "random" in self.expression.text else tree


_FAILS = re.compile(r"\b(raise|assert|throw)\b(?!\s+(new\s+)?BpmnError\b)")
_UNSEEN = re.compile(r"\b(global|nonlocal|exec|eval|globals|locals|vars|setattr|class|del)\b|__|:=|\bimport\s*\*")
_VARIES = {
    "feel": re.compile(r"\b(random number|uuid|now|today)\s*\("),
    "juel": re.compile(r"(?<!\bnot)(?<!\bempty)(?<!\band)(?<!\bor)\b\s*\("),
}
"""Functions of a language that may give something else each time; in JUEL, all."""
_SPELLINGS = (
    (r"!==", "!="), (r"===", "=="), (r"&&", " and "), (r"\|\|", " or "), (r"!(?!=)", " not "),
    (r"(?<![<>=!])=(?!=)", "=="), (r"\bempty\s+", "~"), (r"\bgt\b", ">"), (r"\bge\b", ">="), (r"\blt\b", "<"),
    (r"\ble\b", "<="), (r"\beq\b", "=="), (r"\bne\b", "!="), (r"\btrue\b", "True"), (r"\bfalse\b", "False"),
    (r"\bnull\b", "None"),
)  # fmt: skip
"""Spelling in other languages -> in Python; ``empty x`` becomes an operator of the same precedence."""


class ValueEffects(Effects):
    """Of FEEL, JUEL, payloads, templates and values: they read variables, and do nothing."""

    @cached_property
    def reads(self) -> frozenset[str]:
        try:
            return frozenset(parse_expression(self.expression)[1]) - {"robot"}
        except (ModelError, RecursionError):
            return NONE


@lru_cache(maxsize=2048)
def effects_of(expression: Expression, *, script: bool = False) -> Effects:
    """Return the effects of a text. `script`: it is statements, not an expression.

    Raises UnavailableError for a language whose room was taken away.
    """
    if expression.language == "python":
        from fame.scripting.python_effects import PythonEffects

        return PythonEffects(expression, script)
    if expression.language in EFFECTS:
        made: Effects = load(EFFECTS[expression.language])(expression, script)
        return made
    return ValueEffects(expression, script)


def script_effects(node: FlowNode) -> Effects:
    """Return the effects of the script of an element; none of an element without one."""
    return effects_of(node.script, script=True) if node.script is not None else _NO_EFFECTS


def computed_topics(nodes: Iterable[FlowNode], direction: Direction) -> tuple[str, ...]:
    """Return how the topics of a direction begin of which scripts compute the names; empty: it may be any."""
    return tuple({begins for node in nodes for way, begins in script_effects(node).computed if way == direction})


_NO_EFFECTS = Effects(Expression(""), script=True)
