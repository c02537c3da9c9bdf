"""Texts that contain ``${...}``: templates, properties of data objects, payloads.

A payload is parsed once, when it is compiled: each ``${...}`` is a mark in the text, the text is parsed as flow-style
YAML or JSON, and what is found to be a mark becomes its expression. So values are inserted as values, whatever
letters they are made of. A name that is not set leaves its field out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache, partial
from typing import Any

from fame.config.scalars import core_loader, scalar
from fame.engine.data import UNDEFINED
from fame.rooms import LANGUAGES, load
from fame.scripting.data import Evaluate, ExpressionError, Parsed, Undefined, constant, to_text

# ---- texts with ${...} -----------------------------------------------------------------------------------------------


Missing = Callable[[Mapping[str, Any], str, Undefined], object]
"""Called for a name that is not set with (variables, path of the field, error); may raise."""

_HOLE = re.compile(r"[$#]\{")
_MARK = re.compile("\ue000([0-9]+)\ue001")
_COLLECTION = ("{", "[")
_TWICE = "a key is given twice"
_FLOW = (*_COLLECTION, '"', "'")


class Substituted:
    """A text taken apart: `marked` is the text with marks, `evaluates` are the expressions by mark."""

    __slots__ = ("constants", "evaluates", "marked", "names", "text")

    text: str
    evaluates: list[Evaluate]
    names: dict[str, None]
    constants: list[Evaluate]
    marked: str

    def __init__(self, text: str) -> None:
        self.text, self.evaluates, self.names, self.constants = (
            text,
            list[Evaluate](),
            dict[str, None](),
            list[Evaluate](),
        )
        if _MARK.search(text):
            raise ExpressionError("the private signs U+E000 and U+E001 cannot be used here")
        marked, last = [], 0
        for start, end in _holes(text):
            marked += [text[last:start], f"\ue000{len(self.evaluates)}\ue001"]
            self.evaluates.append(self._parsed(start, end))
            last = end
        self.marked = "".join([*marked, text[last:]])

    def _parsed(self, start: int, end: int) -> Evaluate:
        try:
            found: Parsed = load(LANGUAGES["juel"])(self.text[start + 2 : end - 1])
        except ExpressionError as error:
            raise ExpressionError(f"{self.text[start:end]}: {error}", error.place + start + 2) from None
        self.names |= found.names
        self.constants += found.constants
        return found.evaluate

    def parsed(self, evaluate: Evaluate) -> Parsed:
        """Return a function that fills the values in, with what it reads."""
        return Parsed(evaluate, self.names, self.constants)


def inside(text: str) -> str | None:
    """Return the inside of a text that is a single ``${...}`` or ``#{...}``, else None.

    >>> inside("${a + 1}"), inside("${a}-${b}")
    ('a + 1', None)
    """
    holes = list(_holes(text)) if text[:2] in ("${", "#{") else []
    return text[2:-1] if holes == [(0, len(text))] else None


def is_text(text: str) -> bool:
    """Return whether the value of a payload is always a text: ``at ${x}``, not ``${x}``, ``"${x}"`` or
    ``{x: ${x}}``."""
    text = text.strip()
    return not text.startswith(_COLLECTION) and inside(text.strip("\"'")) is None and bool(_HOLE.search(text))


def template(text: str) -> Parsed:
    """Return a function that fills in the text, and the names that it reads.

    Raises ExpressionError; the function raises Undefined.
    """
    substituted = Substituted(text)
    return substituted.parsed(_text(substituted.marked, substituted.evaluates))


def payload(text: str, missing: Missing) -> Parsed:
    """Return a function that gives the value, or UNDEFINED; and the names that it reads. Raises ExpressionError."""
    substituted = Substituted(text.strip())
    marked = substituted.marked
    try:
        tree = flow(marked) if marked.startswith(_FLOW) else scalar(marked)
    except ValueError as error:
        if marked.startswith(_COLLECTION):
            raise ExpressionError(f"not valid YAML or JSON: {error}: {_plainly(substituted.text)}") from None
        tree = marked
    return substituted.parsed(_build(tree, "", substituted.evaluates, missing))


def feel_payload(text: str, missing: Missing) -> Parsed:
    """As `payload`, of one FEEL expression (without its ``=``): what is null in it is as a name that is not set."""
    evaluate, names, constants = load(LANGUAGES["feel"])(text)
    return Parsed(
        lambda variables: _without_nulls(evaluate(variables), "", partial(missing, variables)), names, constants
    )


def _without_nulls(value: Any, path: str, missing: Callable[[str, Undefined], object]) -> Any:
    if value is None:
        missing(path, Undefined("is null"))
        return UNDEFINED
    if isinstance(value, dict):
        pairs = ((key, _without_nulls(item, f"{path}.{key}".lstrip("."), missing)) for key, item in value.items())
        return {key: item for key, item in pairs if item is not UNDEFINED}
    if isinstance(value, list):
        items = [_without_nulls(item, f"{path}[{index}]", missing) for index, item in enumerate(value)]
        return UNDEFINED if any(item is UNDEFINED for item in items) else items
    return value


def value(text: str, missing: Missing) -> Parsed:
    """As `payload`, of a data object's property: no text only declares the name, and a text may begin with any sign."""
    if not text.strip():
        return Parsed(constant(UNDEFINED), {})
    try:
        return payload(text, missing)
    except ExpressionError as error:
        if _TWICE in str(error):  # it is a collection
            raise
        substituted = Substituted(text.strip())
        return substituted.parsed(_build(substituted.marked, "", substituted.evaluates, missing))


def _holes(text: str) -> Iterator[tuple[int, int]]:
    """Find ``${...}`` and ``#{...}``: (start, end). Raises ExpressionError for a missing brace."""
    place = 0
    while True:
        found = _HOLE.search(text, place)
        if found is None:
            return
        place = _closing(text, found.start())
        yield found.start(), place


def _closing(text: str, start: int) -> int:
    """Behind the brace that closes the one after `start`; braces in quotes do not count."""
    depth, quote, place = 0, "", start + 1
    while place < len(text):
        letter = text[place]
        if quote:
            place += letter == "\\"
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        else:
            depth += (letter == "{") - (letter == "}")
            if not depth:
                return place + 1
        place += 1
    raise ExpressionError(f"`{text[start : start + 2]}` has no closing brace", start)


def _build(tree: Any, path: str, evaluates: list[Evaluate], missing: Missing) -> Evaluate:
    """A function that gives the value of a parsed tree. Collections are made anew each time."""
    if isinstance(tree, dict):
        entries = [
            (_key(key), _build(item, f"{path}.{key}".lstrip("."), evaluates, missing)) for key, item in tree.items()
        ]
        return lambda variables: {
            key: found for key, item in entries if (found := item(variables)) is not UNDEFINED
        }  # fmt: skip
    if isinstance(tree, list):
        items = [_build(item, f"{path}[{index}]", evaluates, missing) for index, item in enumerate(tree)]
        return _list(items)
    if not isinstance(tree, str) or not _MARK.search(tree):
        return constant(tree)
    whole = _MARK.fullmatch(tree)
    return _or_missing(evaluates[int(whole[1])] if whole else _text(tree, evaluates), path, missing)


def _list(items: list[Evaluate]) -> Evaluate:
    """Without one of its elements the others would stand in the wrong places: the list is left out."""

    def evaluate(variables: Mapping[str, Any]) -> Any:
        values = [item(variables) for item in items]
        return UNDEFINED if any(value is UNDEFINED for value in values) else values

    return evaluate


def _or_missing(found: Evaluate, path: str, missing: Missing) -> Evaluate:
    def evaluate(variables: Mapping[str, Any]) -> Any:
        try:
            return found(variables)
        except Undefined as error:
            missing(variables, path, error)
            return UNDEFINED

    return evaluate


def _text(marked: str, evaluates: list[Evaluate]) -> Evaluate:
    """A function that fills a text in."""
    pieces = _MARK.split(marked)
    if len(pieces) == 1:
        return constant(marked)
    literals, holes = pieces[::2], [evaluates[int(mark)] for mark in pieces[1::2]]

    def evaluate(variables: Mapping[str, Any]) -> str:
        filled = [to_text(hole(variables)) for hole in holes]
        return literals[0] + "".join(a + b for a, b in zip(filled, literals[1:], strict=True))

    return evaluate


def _key(key: Any) -> str:
    if isinstance(key, str) and _MARK.search(key):
        raise ExpressionError("a key cannot be computed; before a value there is a space: {x: ${x}}")
    return to_text(key)


def _plainly(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."


# ---- flow collections of YAML ----------------------------------------------------------------------------------------


_QUOTED_OR_TAB = re.compile(r"""((?<!\w)"(?:\\.|[^"\\])*"|(?<!\w)'[^']*')|\t""", re.DOTALL)
"""PyYAML takes no tab between values, where YAML has blanks; one in a text in quotes belongs to it."""


@lru_cache(maxsize=1024)
def flow(text: str) -> Any:
    """Return the value of a flow collection or quoted scalar: flow-style YAML, of which JSON is a
    part. Not to be changed.

    Raises ValueError that says where.
    """
    import yaml

    try:
        return yaml.load(_QUOTED_OR_TAB.sub(lambda found: found[1] or " ", text), _loader())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f" at letter {mark.index + 1}" if mark is not None else ""
        raise ValueError(f"{error.problem or error.context}{place}") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(str(error)) from None


@cache
def _loader() -> Any:
    import yaml

    class Flow(core_loader()):  # type: ignore[misc]
        """Without aliases, and without keys that are given twice."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            mapping = super().construct_mapping(node, deep)
            if len(mapping) < len(node.value):
                raise yaml.constructor.ConstructorError(None, None, _TWICE, node.start_mark)
            return mapping

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                event = self.peek_event()
                raise yaml.composer.ComposerError(None, None, f"an alias (*{event.anchor})", event.start_mark)
            return super().compose_node(parent, index)

    return Flow
