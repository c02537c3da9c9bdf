"""The contents of the dicts of variables of engines, by number, and the way back.

A step changes few variables. A dict that was made from a content is compared with it object by object: what is the same
object has the same code, so that only variables that have changed are encoded. Dicts are read by the methods of `dict`
itself: of chained variables only a scope's own count, and dicts that record what is read do not record this.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Sequence
from itertools import compress
from operator import is_, is_not
from typing import Any

from fame.engine.data import is_data

_Encode = Callable[[Any], Hashable]
Decode = Callable[[Any], Any]
Changes = tuple[tuple[str, Hashable | None], ...]
"""Names of variables with their new codes; None for those that the content no longer has."""


class Layout:
    """The names of the variables of a dict, sorted.

    places   name -> its position
    numbers  codes in this order -> number of the content that has them
    """

    __slots__ = ("names", "numbers", "places")

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names: tuple[str, ...] = names
        self.places: dict[str, int] = {name: place for place, name in enumerate(names)}
        self.numbers: dict[tuple[Hashable, ...], int] = {}


class DictContent:
    """The content of a dict of variables: names, and a code for each.

    values   the immutable values
    lists    the items of lists of immutable values, which are copied for each engine
    others   codes of the other values, decoded for each engine
    mutable  names of those of them that can change
    """

    number: int
    layout: Layout
    codes: tuple[Hashable, ...]

    __slots__ = ("codes", "layout", "lists", "mutable", "number", "others", "values")

    def __init__(self, number: int, layout: Layout, codes: tuple[Hashable, ...]) -> None:
        self.number, self.layout, self.codes = number, layout, codes
        self.values: dict[str, Any] = {}
        self.lists: list[tuple[str, tuple[Any, ...]]] = []
        self.others: list[tuple[str, Hashable]] = []
        self.mutable: list[str] = []


Given = tuple[dict[str, Any], DictContent, list[str], list[Any]]
"""A dict that was made from a content, with its first names and values."""


def _changed(given: Given) -> list[str] | None:
    """Return the names of variables that may have another code than at first; None if some are gone."""
    variables, content, first, values = given
    names = list(dict.keys(variables))
    if names == first:
        changed = [*compress(names, map(is_not, dict.values(variables), values))]
    else:
        count = len(first)
        if names[:count] != first:
            return None
        changed = [*compress(first, map(is_not, dict.values(variables), values)), *names[count:]]
    for name, items in content.lists:
        value = dict.__getitem__(variables, name)
        if name not in changed and not (len(value) == len(items) and all(map(is_, value, items))):
            changed.append(name)
    return changed + content.mutable if content.mutable else changed


class Contents:
    """A number for each content.

    encode    value -> hashable
    decode    the inverse; gives a new object if the value is mutable
    variable  (name, value) of a variable -> hashable
    kept      whether a variable belongs to the content
    constant  whether `decode` always gives the same immutable value
    fixed     whether nothing can change what `decode` gives
    """

    encode: _Encode
    decode: Decode
    variable: Callable[[str, Any], Hashable]
    kept: Callable[[str], bool]
    constant: Callable[[Hashable], bool]
    fixed: Callable[[Hashable], bool]

    def __init__(
        self,
        encode: _Encode,
        decode: Decode,
        variable: Callable[[str, Any], Hashable],
        kept: Callable[[str], bool],
        constant: Callable[[Hashable], bool],
        fixed: Callable[[Hashable], bool],
    ) -> None:
        self.encode, self.decode, self.variable = encode, decode, variable
        self.kept, self.constant, self.fixed = kept, constant, fixed
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._contents: list[DictContent] = []
        self._lists: dict[Hashable, tuple[Any, ...] | None] = {}  # code -> items, of lists of immutable values
        self._given: dict[int, Given] = {}

    def forget(self) -> None:
        """Forget the dicts that were made: those of an engine are compared once."""
        self._given = {}

    def values(self, number: int) -> dict[str, Any]:
        """Return the variables of a content, for a new dict."""
        content = self._contents[number]
        values = content.values.copy()
        for name, items in content.lists:
            values[name] = list(items)
        for name, code in content.others:
            values[name] = self.decode(code)
        return values

    def give(self, variables: dict[str, Any], number: int) -> None:
        """Remember that a dict was made from a content."""
        given = variables, self._contents[number], list(dict.keys(variables)), list(dict.values(variables))
        self._given[id(variables)] = given

    def number(self, variables: dict[str, Any]) -> int:
        """Return the number of the content of a dict."""
        given = self._given.get(id(variables))
        changed = _changed(given) if given is not None else None
        if given is None or changed is None:
            return self._number(self._codes(variables, dict.keys(variables)))
        content = given[1]
        if not changed:
            return content.number
        fresh = self._codes(variables, changed)
        return self.changed(content.number, tuple([(name, fresh.get(name)) for name in changed]))

    def is_empty(self, number: int) -> bool:
        return not self._contents[number].codes

    def codes(self, number: int, names: Sequence[str]) -> tuple[Hashable | None, ...]:
        """Return the codes of variables of a content; None for those that it does not have."""
        content = self._contents[number]
        places, codes = content.layout.places, content.codes
        return tuple([codes[places[name]] if name in places else None for name in names])

    def difference(self, before: int, after: int, written: Collection[str] = ()) -> Changes:
        """Return the changes from one content to another, including each variable in `written`, changed or not."""
        first, other = self._contents[before], self._contents[after]
        if first is other and not written:
            return ()
        if first.layout is other.layout:
            pairs = zip(first.layout.names, first.codes, other.codes, strict=True)
            names = {name for name, old, new in pairs if old != new}
        else:
            names = {name for name, _ in {*self._as_dict(before).items()} ^ {*self._as_dict(after).items()}}
        changed = sorted(names.union(written))
        return tuple(zip(changed, self.codes(after, changed), strict=True))

    def changed(self, number: int, changes: Changes) -> int:
        """Return the number of a content after some changes."""
        content = self._contents[number]
        places, codes = content.layout.places, list(content.codes)
        for name, code in changes:
            place = places.get(name)
            if place is not None and code is not None:
                codes[place] = code
            elif place is not None or code is not None:  # it has come into the content, or is no data any more
                merged = self._as_dict(number)
                for changed_name, new in changes:
                    if new is not None:
                        merged[changed_name] = new
                    else:
                        merged.pop(changed_name, None)
                return self._number(merged)
        return self._numbered(content.layout, tuple(codes)) if changes else number

    def forgotten(self, number: int, names: Collection[str], code: Hashable, removed: Collection[str] = ()) -> int:
        """Return the number of a content after those `names` that are set get `code`, and `removed` are removed."""
        changes = [(name, code) for name in names if name in self._contents[number].layout.places]
        return self.changed(number, (*changes, *((name, None) for name in removed)))

    def _as_dict(self, number: int) -> dict[str, Hashable]:
        content = self._contents[number]
        return dict(zip(content.layout.names, content.codes, strict=True))

    def _codes(self, variables: dict[str, Any], names: Iterable[str]) -> dict[str, Hashable]:
        """Return the codes of those of these variables that belong to the content."""
        variable, kept = self.variable, self.kept
        codes = dict[str, Hashable]()
        for name in names:
            if kept(name) and is_data(name, value := dict.__getitem__(variables, name)):
                codes[name] = variable(name, value)
        return codes

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

    def _content(self, number: int, layout: Layout, codes: tuple[Hashable, ...]) -> DictContent:
        content = DictContent(number, layout, codes)
        for name, code in zip(layout.names, codes, strict=True):
            if self.constant(code):
                content.values[name] = self.decode(code)
            elif (items := self._items(code)) is not None:
                content.lists.append((name, items))
            else:
                content.others.append((name, code))
                if not self.fixed(code):
                    content.mutable.append(name)
        return content

    def _items(self, code: Hashable) -> tuple[Any, ...] | None:
        """Return the items of a list of immutable values; None for another value."""
        if code not in self._lists:
            value = self.decode(code)
            fixed = value.__class__ is list and all(self.constant(self.encode(item)) for item in value)
            self._lists[code] = tuple(value) if fixed else None
        return self._lists[code]
