"""The state of a robot's engine as tables of plain data, and what has changed in them since the last time.

A *change* is ``{"set": {table: {key: value}}, "gone": {table: [keys]}}``. The whole state is the change from nothing,
so that a journal of changes is read by one function, `fold`. Tables:

=========  =====================================================================================================
engine     what `fame.engine.snapshot` has once: counter, conditions, continuations ...
instances, scopes, waits, boxes, listeners, waiting_starts, gathered, starts   its lists and mappings, by key
counts     completed elements, by instance and slot
dicts      the dicts of variables by number: the number of the dict outside
values     variables, by number of the dict and name
timers     by key: kind, text, the date they count from (ns since 1970), how often they have fired
totals     instances started, completed and failed, and elements completed in those that are over
ended      the last instances that are over
cancelled  goals that were cancelled and have not ended (`fame.scripting.cancelled_goals`), by hex id
goals      the last goal of each waiting task, by key: hex id, action, type
unanswered  calls and goals that had not ended before their tasks were suspended, by key: text, hex id
begins     how a process that has not started yet is to: as a ``process``, or with a state that it has ``taken over``
suspension  the person who suspended the mission, and when (ns since 1970)
people     since when tasks wait for a person, by key of the wait (ns since 1970)
answers    what the last requests of people were answered, by id: answer, reason, cause
thrown, receivers, accepted   acknowledged signals (`fame.robot.acknowledged`)
=========  =====================================================================================================

Values are compared by type and value (numbers and texts) or by their encoded content (all else): a script that changes
a list in place is noticed, and so is True in place of 1.
"""

from __future__ import annotations

import json
import marshal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import compress
from operator import itemgetter, ne
from typing import Any

import orjson

from fame.engine import Engine, Instance, Variables, restore, snapshot
from fame.engine.data import is_data
from fame.engine.encoding import Convert, decode, encode
from fame.engine.host import Host
from fame.engine.program import Program
from fame.engine.snapshot import without_instances
from fame.errors import MissionError
from fame.robot.stored_values import message_json

TableRows = dict[str, Any]
Tables = dict[str, TableRows]
_Change = dict[str, Any]

_LARGE = 1_000_000
"""Size from which on there must be room for the JSON of a value (bytes), which may take eight times as much memory."""
_KEYED = ("instances", "scopes", "waits", "boxes")
_MAPPED = ("listeners", "waiting_starts", "gathered", "starts")
_VALUES: dict[str, Callable[[Any], Any]] = {
    "scopes": itemgetter("items"), "boxes": itemgetter("messages"), "waiting_starts": list, "gathered": list,
}  # fmt: skip
"""Where rows of a table have values of variables or messages."""
_ATOMS = frozenset({type(None), bool, int, str})
_ABSENT = object()
_EMPTY: TableRows = {}


def fold(tables: Tables, change: _Change) -> Tables:
    """Apply a change. Returns the same tables."""
    for name, entries in change.get("set", {}).items():
        tables.setdefault(name, {}).update(entries)
    for name, keys in change.get("gone", {}).items():
        table = tables.setdefault(name, {})
        for key in keys:
            table.pop(key, None)
    return tables


class StateTables:
    """The tables of one engine, and how they were the last time.

    unstorable  called with the name of a variable whose value cannot be stored, and the reason
    dump        makes plain data of values that JSON lacks, or raises MissionError
    """

    def __init__(self, engine: Engine, unstorable: Callable[[str, str], object], dump: Convert) -> None:
        self._engine, self._unstorable, self._plain = engine, unstorable, dump
        self._variables = _VariableTable(unstorable, dump)
        self._last: Tables = {}
        self._contents: dict[str, dict[str, bytes | str]] = {}
        self._counts: dict[int, list[int]] = {}

    def changes(self, more: Mapping[str, TableRows], *, whole: bool = False) -> _Change:
        """Return the changes since the last call, or the whole state.

        `more` are tables of the caller: those that are missing have not changed.
        """
        if whole:
            self._last, self._contents, self._counts = {}, {}, {}
            self._variables.forget()
        change: _Change = {}
        if self._engine.instances or self._counts or whole:
            data = self._running(change)
        else:  # as for most of the time: nothing runs, and nothing did
            data = without_instances(self._engine, self._dump, self._lost)
            self._note_tables(change, {name: data.pop(name) for name in _MAPPED})
        self._note_tables(change, {"engine": data, **more})
        return change

    def _running(self, change: _Change) -> TableRows:
        """Note what has changed in instances. Returns what the engine has once."""
        self._variables.begin()
        data = snapshot(self._engine, dump=self._dump, dicts=self._variables, lost=self._lost)
        del data["variables"]
        for name in _KEYED:
            data[name] = {str(item["key"]): item for item in data[name]}
        for item in data["instances"].values():
            del item["counts"]
        self._note_tables(change, {name: data.pop(name) for name in (*_KEYED, *_MAPPED)})
        _note(change, "counts", *self._changed_counts())
        self._variables.note(change)
        return data

    def _note_tables(self, change: _Change, tables: Mapping[str, TableRows]) -> None:
        """Note how tables differ from the last ones."""
        last = self._last
        for name, table in tables.items():
            old = last.get(name, _EMPTY)
            retyped = self._new_contents(name, table) if table and name in _VALUES else ()
            if retyped or old != table:
                changed = {
                    key: value
                    for key, value in table.items()
                    if key in retyped or ((before := old.get(key, _ABSENT)) is not value and before != value)
                }
                _note(change, name, changed, [key for key in old if key not in table])
                last[name] = dict(table)

    def _new_contents(self, name: str, table: TableRows) -> set[str]:
        """Return the rows whose values have changed, also to equal ones of another type, and note the values."""
        values, last = _VALUES[name], self._contents.get(name, {})
        found = ((key, values(row)) for key, row in table.items())
        new = {key: _content(value) for key, value in found if value and value.__class__ is not int}
        self._contents[name] = new
        return {key for key, content in new.items() if last.get(key) != content}

    def drop(self, table: str, key: str) -> _Change:
        """Return the change that removes an entry."""
        self._last[table].pop(key, None)
        return {"gone": {table: [key]}}

    def _dump(self, value: Any) -> Any:
        """Data of a value outside the variables; nothing for one that cannot be stored."""
        try:
            return self._plain(value)
        except MissionError as error:
            self._unstorable("", str(error))
            return {"lost": type(value).__name__}

    def _lost(self, error: MissionError) -> Any:
        self._unstorable("", str(error))
        return encode(None)

    def _changed_counts(self) -> tuple[TableRows, list[str]]:
        changed: TableRows = {}
        known, self._counts = self._counts, {}
        for key, instance in self._engine.instances.items():
            old, new = known.pop(key, None), instance.counts
            if old is None:
                changed.update((f"{key} {slot}", count) for slot, count in enumerate(new) if count)
            elif old != new:
                changed.update((f"{key} {slot}", new[slot]) for slot in compress(range(len(new)), map(ne, old, new)))
            self._counts[key] = new.copy()
        return changed, [f"{key} {slot}" for key, old in known.items() for slot, count in enumerate(old) if count]


def _note(change: _Change, name: str, changed: TableRows, gone: list[str]) -> None:
    if changed:
        change.setdefault("set", {})[name] = changed
    if gone:
        change.setdefault("gone", {})[name] = gone


def _content(value: Any) -> bytes | str:
    """Return what is the same for values of the same types alone."""
    try:
        return marshal.dumps(value, 2)
    except ValueError:  # a subclass of int or str
        return repr(value)


class _VariableTable:
    """The dicts of variables under numbers that stay, and what has changed in them."""

    def __init__(self, unstorable: Callable[[str, str], object], dump: Convert) -> None:
        self._unstorable, self._dump = unstorable, dump
        self._numbers: dict[int, int] = {}
        self._dicts: dict[int, dict[str, Any]] = {}
        self._known: dict[int, dict[str, tuple[Any, Any]]] = {}  # name -> value, and its content if it may change
        self._seen: dict[int, None] = {}
        self._next = 0

    def forget(self) -> None:
        """Treat everything as changed."""
        self._known = {}

    def begin(self) -> None:
        self._seen = {}

    def number(self, variables: dict[str, Any]) -> int:
        """Return the number of a dict, greater than those of the dicts outside it."""
        if isinstance(variables, Variables):
            self.number(variables.outer)
        number = self._numbers.get(id(variables))
        if number is None:
            number = self._numbers[id(variables)] = self._next
            self._dicts[number] = variables  # keeps its id from being used again
            self._next += 1
        self._seen[number] = None
        return number

    def written(self, dump: Any) -> list[Any]:
        """Do nothing: see `note`."""
        return []

    def note(self, change: _Change) -> None:
        """Add what has changed since the last snapshot."""
        values: TableRows = {}
        gone: list[str] = []
        lost = [number for number in self._dicts if number not in self._seen]
        for number in lost:
            del self._numbers[id(self._dicts.pop(number))]
            gone += [f"{number} {name}" for name in self._known.pop(number, ())]
        dicts = {str(number): self._outer(number) for number in self._seen if number not in self._known}
        for number in self._seen:
            self._note_dict(number, values, gone)
        _note(change, "dicts", dicts, [str(number) for number in lost])
        _note(change, "values", values, gone)

    def _outer(self, number: int) -> int | None:
        variables = self._dicts[number]
        return self._numbers[id(variables.outer)] if isinstance(variables, Variables) else None

    def _note_dict(self, number: int, values: TableRows, gone: list[str]) -> None:
        variables, known = self._dicts[number], self._known.setdefault(number, {})
        left_out = 0
        for name, value in variables.items():
            old = known.get(name)
            if old is None and name.startswith("__"):
                left_out += 1
            elif value.__class__ in _ATOMS:
                if old is None or old[0].__class__ is not value.__class__ or old[0] != value:
                    known[name], values[f"{number} {name}"] = (value, None), encode(value)
            else:
                self._note_value(f"{number} {name}", name, value, known, values)
        if len(known) + left_out != len(variables):
            own = variables.keys()  # `in variables` would find outer ones of the same name
            for name in [name for name in known if name not in own]:
                del known[name]
                gone.append(f"{number} {name}")

    def _note_value(
        self, key: str, name: str, value: Any, known: dict[str, tuple[Any, Any]], values: TableRows
    ) -> None:
        """Note a value whose content may change in place, if it has changed."""
        old = known.get(name)
        type: Any = getattr(value.__class__, "__msgtype__", None)
        text = message_json(type, value) if type is not None else None
        if text is not None:
            if old is None or old[1] != text:
                known[name] = value, text
                values[key] = orjson.Fragment(b'{"$object":{"message":"%s","value":%s}}' % (type.encode(), text))
            return
        try:
            content: Any = marshal.dumps(value, 2)
            if old is not None and old[1] == content:
                return
            if len(content) > _LARGE:
                bytearray(8 * len(content))  # raises MemoryError, where orjson would crash
            values[key] = encode(value, self._dump)
        except (ValueError, MissionError):
            try:
                encoded = encode(value, self._dump)
                content = json.dumps(encoded)
            except (MissionError, TypeError, ValueError, RecursionError) as error:
                if old is None or old[0] is not value:
                    self._unstorable(name, str(error))
                encoded, content = None, ""
            if old is not None and old[1] == content:
                return
            values[key] = encoded
        known[name] = value, content


# ---- the engine again ------------------------------------------------------------------------------------------------


def restore_engine(
    tables: Tables,
    program: Program,
    host: Host,
    new_variables: Callable[[], dict[str, Any]],
    load: Callable[[Any], Any],
    *,
    elements: Sequence[str] | None = None,
    moved: dict[str, str] | None = None,
) -> Engine:
    """Return the engine of these tables. `elements` (by default those of the program) and `moved` are as of `slots_of`
    and `restore`.

    Raises MissionError for the state of another model, and for what has no place in this program.
    """
    data: dict[str, Any] = dict(tables["engine"])
    for name in _KEYED:
        table = tables.get(name, {})
        data[name] = [dict(table[key]) for key in sorted(table, key=int)]
    data |= {name: tables.get(name, {}) for name in _MAPPED}
    numbers = {int(number): place for place, number in enumerate(sorted(tables.get("dicts", {}), key=int))}
    data["variables"] = [
        {"outer": None if outer is None else numbers[outer], "own": {}}
        for _, outer in sorted(tables.get("dicts", {}).items(), key=lambda item: int(item[0]))
    ]
    for key, value in tables.get("values", {}).items():
        number, _, name = key.partition(" ")
        data["variables"][numbers[int(number)]]["own"][name] = value
    counts = {item["key"]: [0] * len(program.elements) for item in data["instances"]}
    slots = slots_of(program.elements if elements is None else elements, program)
    for key, count in tables.get("counts", {}).items():
        instance, slot = map(int, key.split())
        if slot in slots:
            counts[instance][slots[slot]] += count
    for item in (*data["instances"], *data["scopes"]):
        item["variables"] = numbers[item["variables"]]
    for item in data["instances"]:
        item["counts"] = counts[item["key"]]
    for item in data["scopes"]:
        if item["done"] is not None:
            item["done"] = [_renumbered(record, numbers) for record in item["done"]]
    return restore(program, data, host, new_variables, load=load, moved=moved)


def slots_of(elements: Sequence[str], program: Program) -> Mapping[int, int]:
    """Return the slots of elements, as their ids stood in `Program.elements` when the state was written, by old slot.

    Elements that are not counted any more have none.
    """
    slots: dict[str, list[int]] = {}
    for slot, element in enumerate(program.elements):
        slots.setdefault(element, []).append(slot)
    return {old: left.pop(0) for old, element in enumerate(elements) if (left := slots.get(element))}


def _renumbered(record: list[Any], numbers: Mapping[int, int]) -> list[Any]:
    """A record of something that can be compensated, with the places of its dicts."""
    node, variables, inner = record
    return [node, numbers[variables], [_renumbered(item, numbers) for item in inner]]


def instance_data(instance: Instance, program: Program, dump: Convert) -> dict[str, Any]:
    """Return an instance that is over, as plain data. Values that cannot be stored are left out.

    If it was one of another program, its completed elements are counted at those of the same ids.
    """
    values = {}
    for name, value in instance.root_variables.items():
        if value.__class__ in _ATOMS and name[:2] != "__":
            values[name] = encode(value)
        elif is_data(name, value):
            with suppress(MissionError):
                values[name] = encode(value, dump)
    error = instance.error
    return {
        "key": instance.key,
        "status": instance.status,
        "counts": _packed(instance.counts if instance.program is program else _counts_of(instance, program)),
        "values": values,
        "error": None if error is None else {**error.to_json(), "robot": error.robot},
    }


def _counts_of(instance: Instance, program: Program) -> list[int]:
    visits = dict(instance.visits)
    return [visits.pop(element, 0) for element in program.elements]


def _packed(counts: list[int]) -> str | list[int]:
    """Small numbers as hexadecimal text: fast to write, since most instances have many elements."""
    try:
        return bytes(counts).hex()
    except ValueError:
        return list(counts)


def instance_of(
    data: Mapping[str, Any], program: Program, load: Callable[[Any], Any], slots: Mapping[int, int]
) -> Instance:
    """Return the instance that `instance_data` made such data of; `slots` as of `slots_of`."""
    variables = {name: decode(value, load) for name, value in data["values"].items()}
    instance = Instance(data["key"], program, variables)
    instance.status = data["status"]
    counts = data["counts"]
    for slot, count in enumerate(bytes.fromhex(counts) if isinstance(counts, str) else counts):
        if slot in slots:
            instance.counts[slots[slot]] += count
    if data["error"] is not None:
        fields = dict(data["error"])
        instance.error = MissionError(fields.pop("text"), **fields)
    return instance
