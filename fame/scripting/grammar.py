"""One parser for the two expression languages: precedence climbing over a table of operators, straight to closures.

A `Dialect` is two tables: what an operand can begin with, and what can follow an operand, with its binding power. The
result of parsing is a function of the variables. No Python text is made or evaluated anywhere.
"""

from __future__ import annotations

import builtins
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Literal

from fame.dataclasses import dataclass
from fame.scripting.budget import metered
from fame.scripting.data import NUMBERS, PLAIN, Evaluate, ExpressionError, Parsed, Undefined, checked, constant
from fame.scripting.signatures import Argument, Function, called, chosen

_TOKEN = re.compile(
    r"""(?P<space>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<number>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)
      | (?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')
      | (?P<name>[^\W\d]\w*|`[^`]+`)
      | (?P<operator>\*\*|\.\.|&&|\|\||==|!=|<=|>=|[-+*/%<>=!?:.,()\[\]{}]|@(?=\s*"))
    """,
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(
    r"\\(u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{6}|.)", re.DOTALL
)
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r", "\\": "\\", '"': '"', "'": "'"}


TokenKind = Literal["number", "text", "name", "operator", "end"]


@dataclass(frozen=True, slots=True)
class Token:
    """One token: `value` is its number or text, its name, or its sign. An `end` stands after the last."""

    kind: TokenKind
    value: str | int | float
    place: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else f"`{self.value}`"


def tokenize(text: str) -> list[Token]:
    """Return the tokens of a text and an end. Raises ExpressionError."""
    tokens: list[Token] = []
    place = 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            what = "a text without an end" if text[place] in "\"'" else f"`{text[place]}`"
            raise ExpressionError(f"{what} was not expected here", place)
        if match.lastgroup != "space":
            tokens.append(_token(match, place))
        place = match.end()
    tokens.append(Token("end", "", len(text)))
    return tokens


def _token(match: re.Match[str], place: int) -> Token:
    text = match.group()
    match match.lastgroup:
        case "number":
            return Token("number", int(text) if text.isdecimal() and len(text) < 4000 else float(text), place)
        case "text":
            return Token("text", _ESCAPE.sub(_unescape, text[1:-1]), place)
        case "name":
            return Token("name", text.strip("`"), place)
        case _:
            return Token("operator", text, place)


def _unescape(match: re.Match[str]) -> str:
    code = match.group(1)
    if len(code) == 1:  # what is no escape (DMN 1.5, rule 65) is one of a regular expression: \\d, \\.
        return _ESCAPED.get(code, match.group())
    if len(code) == 11:  # two halves of UTF-16 are one letter
        return bytes.fromhex(code[1:5] + code[7:]).decode("utf-16-be")
    point = int(code[1:], 16)
    return chr(point) if point <= sys.maxunicode else code


Operation = Callable[[Any, Any], Any]
Prefix = Callable[["ExpressionParser"], Evaluate]
Infix = Callable[["ExpressionParser", Evaluate], Evaluate]

_DEPTH = 100
"""Levels of nesting that are accepted."""
_CHAIN = 300
"""Operators that are accepted, each on the result of the one before: every one takes a frame when it is evaluated."""

_WORDS = 4
"""Words in the name of a function, at most."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """A language. `prefixes` are tried before names and literals; `functions` may have names with spaces."""

    name: str
    prefixes: Mapping[str, Prefix]
    infixes: Mapping[str, tuple[int, Infix]]
    functions: Mapping[str, Sequence[Function]]
    undefined_is_null: bool


class ExpressionParser:
    """A walk over the tokens of one expression.

    `names` collects the variables that it reads; `counts`: it has loops or calls, which count against the budget;
    `constants`: its largest parts with loops or calls that read no variables; `after` converts the final value, None if
    it needs no conversion.
    """

    def __init__(self, text: str, dialect: Dialect) -> None:
        self.dialect: Dialect = dialect
        self.names: dict[str, None] = {}
        self.counts: bool = False
        self._tokens, self._index, self._depth, self._height = tokenize(text), 0, 0, 0
        self._bound: list[str] = []
        self._fields = 0
        self._outermost: float = math.inf
        """Where the outermost name that is read is bound, in `_bound`; -1: it is a variable."""
        self.constants: list[Evaluate] = []
        self.after: Callable[[Any], Any] | None = None

    def whole(self) -> Evaluate:
        """Parse the whole text. Raises ExpressionError."""
        if self._at_end():
            raise ExpressionError("the expression is empty")
        evaluate = self.expression()
        if not self._at_end():
            raise self.unexpected("an operator or the end")
        evaluate = evaluate if self.after is None else _then(evaluate, self.after)
        return metered(evaluate) if self.counts else evaluate

    def parsed(self) -> Parsed:
        """Return the same, with the variables and constants."""
        return Parsed(self.whole(), self.names, self.constants)

    def expression(self, power: int = 0) -> Evaluate:
        """Parse an operand and all operators after it that bind tighter than `power`."""
        self._depth += 1
        if self._depth > _DEPTH:
            raise ExpressionError(f"nested more than {_DEPTH} levels deep", self.token.place)
        before, self._height = self._height, 0
        around, self._outermost, self.counts = (self._outermost, self.counts), math.inf, False
        within, constant = len(self.constants), None
        left = self._operand()
        while True:
            if self._outermost >= len(self._bound):
                constant, so_far = left, (self.counts, len(self.constants))
            elif constant is not None:
                self._keep(constant, within, *so_far)
                constant = None
            binding, build = self._following()
            if build is None or binding <= power:
                break
            sign = self.advance()
            left = build(self, left)
            self._height += 1
            if self._height > _CHAIN:
                raise ExpressionError(f"more than {_CHAIN} operators, each on the result of the one before", sign.place)
        if constant is not None:
            self._keep(constant, within, *so_far)
        self._depth -= 1
        self._height = max(before, self._height)
        self._outermost, self.counts = min(around[0], self._outermost), around[1] or self.counts
        return left

    def _keep(self, constant: Evaluate, start: int, counts: bool, end: int) -> None:
        """Keep a part that reads no variables instead of the parts of it, which are those from `start` to `end`."""
        if counts:
            self.constants[start:end] = [metered(constant)]

    def _following(self) -> tuple[int, Infix | None]:
        """What the next token makes of the operand before it, and how tight it binds."""
        token = self.token
        found = self.dialect.infixes.get(str(token.value)) if token.kind in ("operator", "name") else None
        return found or (0, None)

    # ---- tokens ------------------------------------------------------------------------------------------------------

    @property
    def token(self) -> Token:
        return self._tokens[self._index]

    def _at_end(self) -> bool:
        return self.token.kind == "end"

    def advance(self) -> Token:
        token = self._tokens[self._index]
        self._index += token.kind != "end"
        return token

    def at(self, sign: str, ahead: int = 0) -> bool:
        """Return whether the next token (or one further ahead) is this operator or word."""
        token = self._tokens[min(self._index + ahead, len(self._tokens) - 1)]
        return token.kind in ("operator", "name") and token.value == sign

    def take(self, sign: str) -> bool:
        """Take the next token if it is this operator or word."""
        found = self.at(sign)
        self._index += found
        return found

    def expect(self, sign: str) -> None:
        """Take this operator or word. Raises ExpressionError."""
        if not self.take(sign):
            raise self.unexpected(f"`{sign}`")

    def name(self) -> str:
        """Take a name. Raises ExpressionError; names with a leading underscore are refused."""
        token = self.token
        if token.kind != "name":
            raise self.unexpected("a name")
        if str(token.value).startswith("_"):
            raise ExpressionError(f"{token}: names with a leading underscore cannot be used here", token.place)
        return str(self.advance().value)

    def unexpected(self, expected: str) -> ExpressionError:
        """Return the error for the next token."""
        return ExpressionError(f"expected {expected}, got {self.token}", self.token.place)

    def separated(self, close: str) -> Iterator[None]:
        """Go through items with commas between them, up to and with the closing sign; each is parsed in the loop."""
        while not self.take(close):
            yield
            if not self.at(close):
                self.expect(",")

    def listed(self, close: str) -> list[Evaluate]:
        """Expressions with commas between them, up to and with the closing sign."""
        return [self.expression() for _ in self.separated(close)]

    def key(self) -> str:
        """Take the key of an entry, a name or text, and the colon after it."""
        key = str(self.advance().value) if self.token.kind == "text" else self.name()
        self.expect(":")
        return key

    def arguments(self) -> list[Argument]:
        """After ``(``: what a function is called with, up to and with the closing sign. Each may have its name."""
        self.counts = True
        return [(self._label(), self.expression()) for _ in self.separated(")")]

    def _label(self) -> str:
        """``start position:`` before an argument, if it is there."""
        index = self._index
        while self._tokens[index].kind == "name":
            index += 1
        words = self._tokens[self._index : index]
        if not words or not self.at(":", len(words)):
            return ""
        self._index = index + 1
        return " ".join(str(word.value) for word in words)

    def inside(self, names: list[str], power: int = 0, *, fields: bool = False) -> Evaluate:
        """Parse an expression in which these names are bound by the surrounding expression.

        `fields`: any other name may be bound, too: that of a field.
        """
        self._bound += names
        self._fields += fields
        evaluate = self.expression(power)
        self._fields -= fields
        del self._bound[len(self._bound) - len(names) :]
        return evaluate

    # ---- operands ----------------------------------------------------------------------------------------------------

    def _operand(self) -> Evaluate:
        token = self.token
        if token.kind in ("number", "text"):
            return constant(self.advance().value)
        prefix = self.dialect.prefixes.get(str(token.value)) if token.kind != "end" else None
        if prefix is not None:
            self.advance()
            return prefix(self)
        if token.kind != "name":
            raise self.unexpected("a value")
        return self._call() or self._variable()

    def _variable(self) -> Evaluate:
        place, name = self.token.place, self.name()
        if self.at("(") and name not in self._bound:
            python = " (plain Python has it)" if hasattr(builtins, name) else ""
            raise ExpressionError(f"there is no function `{name}` here{python}{self._likely(name)}", place)
        if name not in self._bound and not self._fields:
            self.names[name] = None
        innermost = max((place for place, bound in enumerate(self._bound) if bound == name), default=-1)
        self._outermost = min(self._outermost, innermost)
        return variable(name, self.dialect.undefined_is_null)

    def _likely(self, name: str) -> str:
        """A suggestion of similar functions."""
        close = get_close_matches(name, self.dialect.functions, 3)
        return f"; did you mean {' or '.join(close)}?" if close else ""

    def _call(self) -> Evaluate | None:
        """A call of a function of the dialect, if one begins here; its name may be several words."""
        for words in range(_WORDS, 0, -1):
            tokens = self._tokens[self._index : self._index + words]
            name = " ".join(str(token.value) for token in tokens)
            if name in self.dialect.functions and self.at("(", words):
                place = self.token.place
                self._index += words + 1
                return self._called(name, place)
        return None

    def _called(self, name: str, place: int) -> Evaluate:
        found = chosen(self.dialect.functions[name], self.arguments())
        if found is not None:
            return called(found[0], name, found[1], self.dialect.undefined_is_null)
        if self.dialect.undefined_is_null:
            return constant(None)
        takes = " or ".join(map(str, self.dialect.functions[name]))
        raise ExpressionError(f"`{name}` takes {takes}", place)


def _then(evaluate: Evaluate, after: Callable[[Any], Any]) -> Evaluate:
    return lambda variables: after(evaluate(variables))


def variable(name: str, undefined_is_null: bool) -> Evaluate:
    """Return a variable by name. Where it is not set: null, or raises Undefined."""

    def evaluate(variables: Mapping[str, Any]) -> Any:
        try:
            value = variables[name]
        except KeyError:
            return _of_robot(variables, name, undefined_is_null)
        return value if value.__class__ in PLAIN else checked(value, name)

    return evaluate


def _of_robot(variables: Mapping[str, Any], name: str, undefined_is_null: bool) -> Any:
    if name == "robot":
        builtins = variables.get("__builtins__")
        if isinstance(builtins, dict) and "robot" in builtins:
            return builtins["robot"]
    if undefined_is_null:
        return None
    raise Undefined(f"`{name}` is not set")


def numbers_first(compute: Operation, otherwise: Operation) -> Callable[[Evaluate, Evaluate], Evaluate]:
    """Return an operator that computes with plain numbers at once, and otherwise with anything else."""

    def combine(left: Evaluate, right: Evaluate) -> Evaluate:
        def evaluate(variables: Mapping[str, Any]) -> Any:
            a, b = left(variables), right(variables)
            if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
                return compute(a, b)
            return otherwise(a, b)

        return evaluate

    return combine


def infix(power: int, combine: Callable[[Evaluate, Evaluate], Evaluate]) -> tuple[int, Infix]:
    """Return the table entry of a left-associative operator."""
    return power, lambda parser, left: combine(left, parser.expression(power))


def parenthesized(parser: ExpressionParser) -> Evaluate:
    """After ``(``."""
    inner = parser.expression()
    parser.expect(")")
    return inner


def listing(parser: ExpressionParser) -> Evaluate:
    """After ``[``: a list."""
    items = parser.listed("]")
    return lambda variables: [item(variables) for item in items]


def mapping(parser: ExpressionParser) -> Evaluate:
    """After ``{``: a mapping; its keys are names or texts."""
    entries = [(parser.key(), parser.expression()) for _ in parser.separated("}")]
    return lambda variables: {key: value(variables) for key, value in entries}
