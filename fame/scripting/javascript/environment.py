"""A dict of variables, and what JavaScript knows of it: before a step it is told what has changed, and nothing else.

Numbers, texts and messages are told when another object stands in the dict, lists and dicts when their text is another;
and of all that is more than a number or text only what some script of the realm names. JavaScript parses the text of a
collection when a script looks at it. What JavaScript has written it tells after the step. Functions and handles of
JavaScript (a subscription that one script makes and another destroys) stand in the dict as they are, for its scripts
only.

Invariant: between steps, with a dict that nobody has touched since, `_known` equals it, in the same order.
"""

from __future__ import annotations

import marshal
from collections.abc import Callable, Sequence
from operator import is_
from types import ModuleType
from typing import Any, Protocol

from fame.engine.variables import Variables
from fame.scripting.javascript.values import ATOMS, encode

_NEW = object()
_CHANGING = frozenset({list, dict})
_NOTHING: dict[str, Any] = {}


class Words(Protocol):
    """What the scripts of a realm may name."""

    names: set[str]
    computed: bool


class Environment:
    """One dict. `runs` counts the scripts that may still write to it; `lasting`: it is that of a process instance.

    `shown` is what JavaScript has of it.
    """

    __slots__ = ("_known", "_texts", "_watched", "lasting", "runs", "shown", "variables")

    def __init__(self, variables: dict[str, Any], shown: Any) -> None:
        self.variables, self.shown, self.runs = variables, shown, 0
        self.lasting = type(variables) is dict
        self._known: dict[str, Any] = {}
        self._texts: dict[str, str] = {}  # of all collections that were told
        self._watched: dict[str, bytes | None] = {}  # those of them that may change inside, as `_mark` saw them

    def changes(self, words: Words) -> tuple[str | None, Sequence[str]]:
        """What JavaScript has to be told, as text; and the names of objects of JavaScript, which are told by hand."""
        view = self.variables if self.lasting else _chained(self.variables)
        known = self._known
        if len(known) == len(view) and all(map(is_, known.values(), view.values())) and [*known] == [*view]:
            collections = self._collections(view) if self._watched else _NOTHING
            return (encode([{}, collections, []]) if collections else None), ()
        values, kept = self._compare(view, words)
        gone = [name for name in known if name not in view]
        self._known = dict(view)
        for name in (*gone, *values):
            self._texts.pop(name, None)
            self._watched.pop(name, None)
        return encode([values, self._collections(view), gone]), kept

    def _compare(self, view: dict[str, Any], words: Words) -> tuple[dict[str, Any], list[str]]:
        """The numbers and texts that are new, and the names of new objects of JavaScript."""
        values: dict[str, Any] = {}
        kept: list[str] = []
        known = self._known
        for name, value in view.items():
            if known.get(name, _NEW) is value or name[:2] == "__":
                continue
            if value.__class__ in ATOMS:
                values[name] = value
            elif is_native(value):
                kept.append(name)
            elif words.computed or name in words.names:
                self._texts.pop(name, None)
                self._watched[name] = None
        return values, kept

    def _collections(self, view: dict[str, Any]) -> dict[str, str]:
        """The texts of collections that have changed."""
        texts = self._texts
        found: dict[str, str] = {}
        for name, mark in [*self._watched.items()]:
            value = view[name]
            try:
                now = marshal.dumps(value, 2)
                if now == mark:
                    continue
            except ValueError:
                now = None
            self._watched[name], text = now, _text(value)
            if value.__class__ not in _CHANGING:
                del self._watched[name]
            if text is not None and texts.get(name) != text:
                texts[name] = found[name] = text
        return found

    def retell(self) -> None:
        """A script was added, which may name what none has named before."""
        self._known = {
            name: value for name, value in self._known.items() if value.__class__ in ATOMS or name in self._texts
        }

    def read_back(self, said: dict[str, Any], kept: Callable[[Any, str], Any]) -> None:
        """What JavaScript has written and deleted. `kept` gives its objects. Raises TypeError for a wrong name."""
        for name, value in said.get("set", _NOTHING).items():
            self._write(name, value)
        if "kept" in said:
            for name in said["kept"]:
                self._write(name, kept(self.shown, name))
        if "gone" in said:
            for name in said["gone"]:
                self._delete(name)

    def _write(self, name: str, value: Any) -> None:
        if name[:2] == "__":
            raise TypeError(f"{name} cannot be the name of a variable")
        self.variables[name] = self._known[name] = value
        if value.__class__ in _CHANGING:
            self._texts[name] = encode(value)
            self._watched[name] = _mark(value)
        elif name in self._watched or name in self._texts:
            self._texts.pop(name, None)
            self._watched.pop(name, None)

    def _delete(self, name: str) -> None:
        if name[:2] != "__" and name in self.variables:
            del self.variables[name]
        for known in (self._known, self._texts, self._watched):
            known.pop(name, None)

    def forget(self) -> None:
        """Nothing of JavaScript stays behind."""
        for name, value in list(self.variables.items()):
            if is_native(value):
                del self.variables[name]


def is_native(value: Any) -> bool:
    """Whether it is an object of JavaScript."""
    return type(value).__module__ == "_quickjs"


def _mark(value: Any) -> bytes | None:
    """Tells whether a collection has changed, in a fraction of the time that its text takes; None if it cannot."""
    try:
        return marshal.dumps(value, 2)
    except ValueError:
        return None


def _text(value: Any) -> str | None:
    """The text of a collection; None for what is no data."""
    if callable(value) or isinstance(value, ModuleType):
        return None
    try:
        return encode(value)
    except (TypeError, ValueError, RecursionError):
        return None


def _chained(variables: dict[str, Any]) -> dict[str, Any]:
    """All that is seen from an inner scope."""
    if isinstance(variables, Variables):
        return {**_chained(variables.outer), **variables}
    return variables
