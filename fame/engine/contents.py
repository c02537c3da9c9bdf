"""The contents of the dicts of variables of engines, by number, and the way back.

A step changes few variables. A dict that was made from a content is compared with it object by object: what is the same
object has the same code, so that only variables that have changed are encoded.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from itertools import compress
from operator import is_, is_not
from typing import Any

from fame.engine.snapshot import is_data

Encode = Callable[[Any], Hashable]
Decode = Callable[[Any], Any]


class Layout:
    """The names of the variables of a dict, sorted.

    places   name -> its position
    numbers  codes in this order -> number of the content that has them
    """

    __slots__ = ("names", "numbers", "places")

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.places: dict[str, int] = {name: place for place, name in enumerate(names)}
        self.numbers: dict[tuple[Hashable, ...], int] = {}


class Content:
    """The content of a dict of variables: names, and a code for each.

    values   the immutable values
    lists    the items of lists of immutable values, which are copied for each engine
    mutable  codes of the other mutable values, decoded for each engine
    """

    __slots__ = ("codes", "layout", "lists", "mutable", "number", "values")

    def __init__(self, number: int, layout: Layout, codes: tuple[Hashable, ...]) -> None:
        self.number, self.layout, self.codes = number, layout, codes
        self.values: dict[str, Any] = {}
        self.lists: list[tuple[str, tuple[Any, ...]]] = []
        self.mutable: list[tuple[str, Hashable]] = []


Given = tuple[dict[str, Any], Content, list[str], list[Any]]
"""A dict that was made from a content, with its first names and values."""


def _changed(given: Given) -> list[str] | None:
    """The names of variables that may have another code than at first; None if some are gone."""
    variables, content, first, values = given
    names = list(variables)
    if names == first:
        found = [*compress(names, map(is_not, dict.values(variables), values))]
    else:
        count = len(first)
        if names[:count] != first:
            return None
        found = [*compress(first, map(is_not, dict.values(variables), values)), *names[count:]]
    for name, items in content.lists:
        value = variables[name]
        if name not in found and not (len(value) == len(items) and all(map(is_, value, items))):
            found.append(name)
    if content.mutable:
        found += [name for name, _ in content.mutable]
    return found


class Contents:
    """A number for each content.

    encode    value -> hashable
    decode    the inverse; gives a new object if the value is mutable
    variable  (name, value) of a variable -> hashable
    kept      whether a variable belongs to the content
    constant  whether `decode` always gives the same immutable value
    """

    encode: Encode
    decode: Decode
    variable: Callable[[str, Any], Hashable]
    kept: Callable[[str], bool]
    constant: Callable[[Hashable], bool]

    def __init__(
        self,
        encode: Encode,
        decode: Decode,
        variable: Callable[[str, Any], Hashable],
        kept: Callable[[str], bool],
        constant: Callable[[Hashable], bool],
    ) -> None:
        self.encode, self.decode, self.variable, self.kept, self.constant = encode, decode, variable, kept, constant
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._contents: list[Content] = []
        self._lists: dict[Hashable, tuple[Any, ...] | None] = {}  # code -> items, of lists of immutable values
        self._given: dict[int, Given] = {}

    def forget(self) -> None:
        """Forget the dicts that were made: those of an engine are compared once."""
        self._given = {}

    def values(self, number: int) -> dict[str, Any]:
        """The variables of a content, for a new dict."""
        content = self._contents[number]
        values = content.values.copy()
        for name, items in content.lists:
            values[name] = list(items)
        for name, code in content.mutable:
            values[name] = self.decode(code)
        return values

    def give(self, variables: dict[str, Any], number: int) -> None:
        """Remember that a dict was made from a content."""
        given = variables, self._contents[number], list(variables), list(dict.values(variables))
        self._given[id(variables)] = given

    def number(self, variables: dict[str, Any]) -> int:
        """The number of the content of a dict."""
        given = self._given.get(id(variables))
        changed = _changed(given) if given is not None else None
        if given is None or changed is None:
            return self._number(self._codes(variables, variables))
        content = given[1]
        if not changed:
            return content.number
        fresh, layout = self._codes(variables, changed), content.layout
        places, codes = layout.places, list(content.codes)
        for name in changed:
            place, code = places.get(name), fresh.get(name)
            if place is not None and code is not None:
                codes[place] = code
            elif place is not None or code is not None:  # it has come into the content, or is no data any more
                return self._number(self._merged(content, changed, fresh))
        return self._numbered(layout, tuple(codes))

    def _merged(self, content: Content, changed: list[str], fresh: dict[str, Hashable]) -> dict[str, Hashable]:
        """The codes of a content, with those of the changed variables."""
        codes = dict(zip(content.layout.names, content.codes, strict=True))
        for name in changed:
            if name in fresh:
                codes[name] = fresh[name]
            else:
                codes.pop(name, None)
        return codes

    def _codes(self, variables: dict[str, Any], names: Iterable[str]) -> dict[str, Hashable]:
        """The codes of those of these variables that belong to the content."""
        variable, kept = self.variable, self.kept
        found = dict[str, Hashable]()
        for name in names:
            if kept(name) and is_data(name, value := variables[name]):
                found[name] = variable(name, value)
        return found

    def _number(self, codes: dict[str, Hashable]) -> int:
        names = tuple(sorted(codes))
        layout = self._layouts.get(names)
        if layout is None:
            layout = self._layouts[names] = Layout(names)
        return self._numbered(layout, tuple([codes[name] for name in names]))

    def _numbered(self, layout: Layout, codes: tuple[Hashable, ...]) -> int:
        number = layout.numbers.get(codes)
        if number is None:
            number = layout.numbers[codes] = len(self._contents)
            self._contents.append(self._content(number, layout, codes))
        return number

    def _content(self, number: int, layout: Layout, codes: tuple[Hashable, ...]) -> Content:
        content = Content(number, layout, codes)
        for name, code in zip(layout.names, codes, strict=True):
            if self.constant(code):
                content.values[name] = self.decode(code)
            elif (items := self._items(code)) is not None:
                content.lists.append((name, items))
            else:
                content.mutable.append((name, code))
        return content

    def _items(self, code: Hashable) -> tuple[Any, ...] | None:
        """The items of a list of immutable values; None for another value."""
        if code not in self._lists:
            value = self.decode(code)
            fixed = value.__class__ is list and all(self.constant(self.encode(item)) for item in value)
            self._lists[code] = tuple(value) if fixed else None
        return self._lists[code]
