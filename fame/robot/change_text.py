"""The JSON of what changes in one robot, as recordings and live views have it (docs/recordings.md).

A `ChangeText` gets what a `fame.robot.changes.ChangeTracker` gives away, instant by instant, makes the messages of the
channels of it, and keeps the state that these lead to (`key`). This module imports little, so that a process that
writes a recording starts quickly.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

Group = tuple[int, int, Sequence[tuple[str, str, Any]]]
"""Marks of a scope, with the keys of its instance and of the scope (see docs/recordings.md)."""
ScopeChange = tuple[int, str, "Sequence[str] | None", Sequence[int], Sequence[Any]]
"""A scope with variables of its own: its key, where it is (members of a JSON object; empty if that is known), the names
of all its variables (None: as before), the places in them of those that may have changed, and the values of these in
plain form (`fame.robot.plain_values.plain`)."""
Token = tuple[str, str, str, int, str, "tuple[int, str] | None"]
"""A waiting token: its key, where it is, its element, since when (ns), what it waits for, the last message missed."""
Changes = tuple[Sequence[Group], Sequence[ScopeChange], Sequence[int], Sequence[Token], Sequence[str]]
"""Changes of a robot: groups, scopes, keys of removed scopes, tokens, keys of removed tokens."""

Put = Callable[[str, int, str], object]
"""Takes a channel (``events``, ``variables``, ``waiting``), a time (ns) and JSON."""

TEXT = 1000
"""Most characters of a text."""
_LARGE = 1 << 63
COUNTED = frozenset(("enter", "leave", "take", "cancel", "fail"))
"""Marks that are counted by element."""
_ENDED = 20
"""Ended instances that a robot's state keeps."""
_KNOWN = 10_000
"""Marks whose JSON is kept."""

string: Callable[[str], str] = json.encoder.encode_basestring
"""The JSON of a text."""
encode: Callable[[Any], str] = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode
"""The JSON of plain data."""


@lru_cache(10_000)
def name_text(name: str) -> str:
    """A name as JSON."""
    return string(name)


def float_text(value: float) -> str:
    """A number as JSON; one that JSON does not have is a text."""
    if value - value == 0.0:
        return repr(value)
    return '"NaN"' if value != value else '"Infinity"' if value > 0 else '"-Infinity"'


def complex_text(value: complex) -> str:
    """A complex number as JSON: a text."""
    return f'"{value.real:.6g}{value.imag:+.6g}j"'


class ChangeText:
    """The JSON of the changes of `robot`, which runs a process (id)."""

    def __init__(self, robot: str, process: str) -> None:
        self._name, self._process = name_text(robot), process
        self._marks: dict[tuple[str, str, Any], str] = {}  # as JSON
        self._counted: list[tuple[str, str, Any]] = []  # not yet in `_counts`
        self._counts: dict[str, dict[str, int]] = {}
        self._instances: dict[int, tuple[str, str]] = {}  # key -> process, status
        self._scopes: dict[int, _ScopeText] = {}
        self._tokens: dict[str, str] = {}

    def write(self, time: int, changes: Changes, put: Put) -> None:
        """Give the messages of what has changed until `time` (ns) to `put`."""
        groups, scopes, ended, tokens, left = changes
        if groups:
            put("events", time, f'{{"robot":{self._name},"events":[{",".join(map(self._group, groups))}]}}')
        changed = [text for change in scopes if (text := self._scope(change))]
        changed += [f'{self._scopes.pop(key).where},"gone":true}}' for key in ended]
        if changed:
            put("variables", time, f'{{"robot":{self._name},"changes":[{",".join(changed)}]}}')
        if tokens or left:
            fresh = ",".join(map(self._token, tokens))
            gone = ",".join([f'"{key}"' for key in left if self._tokens.pop(key, None) is not None])
            put("waiting", time, f'{{"robot":{self._name},"tokens":[{fresh}],"gone":[{gone}]}}')

    def count(self, changes: Changes) -> None:
        """Count events without passing them on."""
        for instance, _, marks in changes[0]:
            self._counted += marks
            for mark in marks:
                if mark[1] in ("start", "end"):
                    self._mark(instance, mark)
        if len(self._counted) > _KNOWN:
            self._count()

    def _group(self, group: Group) -> str:
        instance, scope, marks = group
        known = self._marks
        try:
            text = ",".join([known[mark] for mark in marks])
        except (KeyError, TypeError):  # TypeError: a detail that is not hashable
            text = ",".join([self._mark(instance, mark) for mark in marks])
        self._counted += marks
        return f'{{"instance":{instance},"scope":{scope},"marks":[{text}]}}'

    def _mark(self, instance: int, mark: tuple[str, str, Any]) -> str:
        element, what, detail = mark
        text = f"[{name_text(element)},{name_text(what)}" + ("]" if detail is None else f",{value_text(detail)}]")
        if what in COUNTED and len(self._marks) < _KNOWN:
            self._marks[mark] = text
        elif what == "start":
            self._instances[instance] = element, "running"
        elif what == "end":
            self._instances[instance] = element, str(detail)
            forget_ended(self._instances)
        return text

    def _scope(self, change: ScopeChange) -> str:
        """The differences of a scope, as a JSON object; empty without a difference."""
        key, where, names, places, values = change
        if where:
            self._scopes[key] = _ScopeText(where)
        return self._scopes[key].differences(names, places, values)

    def _token(self, token: Token) -> str:
        key, place, element, since, text, miss = token
        missed = "" if miss is None else f',"missed":{{"time":{miss[0]},"why":{name_text(miss[1])}}}'
        whole = f'{{"key":"{key}",{place},"element":{name_text(element)},"since":{since},{text}{missed}}}'
        self._tokens[key] = whole
        return whole

    def _count(self) -> None:
        """Count what has happened since the last time."""
        for (element, what), number in Counter([mark[:2] for mark in self._counted]).items():
            if what in COUNTED:
                counts = self._counts.setdefault(element, {})
                counts[what] = counts.get(what, 0) + number
        self._counted.clear()

    def key(self) -> str:
        """The complete state as of the last `write`."""
        self._count()
        instances = [
            {"instance": key, "process": process, "status": status}
            for key, (process, status) in self._instances.items()
        ]
        variables = ",".join([scope.key() for scope in self._scopes.values()])
        return (
            f'{{"process":{name_text(self._process)},"instances":{encode(instances)},'
            f'"tokens":[{",".join(self._tokens.values())}],"variables":[{variables}],"counts":{encode(self._counts)}}}'
        )


class _ScopeText:
    """The variables of a scope as JSON."""

    def __init__(self, where: str) -> None:
        self.where = where
        self._names: Sequence[str] = ()
        self._texts: dict[str, str] = {}

    def differences(self, names: Sequence[str] | None, places: Sequence[int], values: Sequence[Any]) -> str:
        """What is different with these values, as a JSON object; empty if nothing is."""
        texts, gone, fresh = self._texts, list[str](), list[str]()
        if names is not None:
            self._names = names
            gone = [name for name in texts if name not in names]
        for place, value in zip(places, values, strict=True):
            name = self._names[place]
            if value is ...:
                gone += [name] * (name in texts)
                continue
            text = value_text(value)
            if texts.get(name) != text:
                texts[name] = text
                fresh.append(f"{name_text(name)}:{text}")
        for name in gone:
            del texts[name]
        parts = [f'"set":{{{",".join(fresh)}}}'] * bool(fresh) + [f'"unset":{encode(gone)}'] * bool(gone)
        return f"{self.where},{','.join(parts)}}}" if parts else ""

    def key(self) -> str:
        """All variables, as a JSON object."""
        members = ",".join([f"{name_text(name)}:{text}" for name, text in self._texts.items()])
        return f'{self.where},"set":{{{members}}}}}'


def value_text(value: Any) -> str:
    """The JSON of a value in plain form (`fame.robot.plain_values.plain`): bytes are JSON already."""
    kind = value.__class__
    if kind is bytes:
        text: str = value.decode("utf-8", "surrogatepass")
        return text
    if kind is str and len(value) <= TEXT:
        return string(value)
    if kind is float:
        return float_text(value)
    if kind is bool:
        return "true" if value else "false"
    if kind is int and -_LARGE < value < _LARGE:
        return repr(value)
    if value is None:
        return "null"
    if kind is complex:
        return complex_text(value)
    from fame.robot.plain_values import json_text  # imports much, and is rarely needed

    return json_text(value)


def forget_ended(instances: dict[int, tuple[str, str]]) -> None:
    """Forget the oldest of the instances that have ended, if there are many."""
    ended = [key for key, (_, status) in instances.items() if status != "running"]
    for key in ended[:-_ENDED]:
        del instances[key]
