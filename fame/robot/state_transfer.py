"""Transfer the state of a robot's old process to its new one: tokens, variables, timers, queued messages.

Both run in one process, so values of variables go over as they are: also functions and classes that scripts defined.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from fame.engine import Engine, restore, snapshot
from fame.engine.data import Variables
from fame.engine.encoding import Convert, Data, encode
from fame.engine.migration import MigratedToken, MigrationPlan, arm_new, gone, migrate, preview
from fame.engine.snapshot import all_scopes
from fame.errors import MissionError
from fame.robot.changes import entered
from fame.robot.node import RobotNode
from fame.robot.restoring import epoch_of, go_on, set_timers, tables_of, take_unanswered
from fame.robot.stored_values import dump
from fame.text import DEPTH, is_deep

_LONG = 2000
"""Most characters of a value, as JSON, in a state that is foreseen."""
_DEEP = DEPTH // 2
"""Most levels of it."""


class _Live:
    """Values that stay as they are, by number."""

    def __init__(self) -> None:
        self._values: list[Any] = []

    def dump(self, value: Any) -> Any:
        self._values.append(value)
        return {"live": len(self._values) - 1}

    def load(self, data: Any) -> Any:
        return self._values[data["live"]]


class _AllVariables:
    """The dicts of variables with everything that scripts have put there (see `fame.engine.snapshot`)."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}
        self._found: list[dict[str, Any]] = []

    def number(self, variables: dict[str, Any]) -> int:
        if isinstance(variables, Variables):
            self.number(variables.outer)
        if id(variables) not in self._numbers:
            self._numbers[id(variables)] = len(self._found)
            self._found.append(variables)
        return self._numbers[id(variables)]

    def written(self, dump: Convert) -> list[Data]:
        return [
            {
                "outer": self.number(item.outer) if isinstance(item, Variables) else None,
                "own": {name: encode(value, dump) for name, value in item.items() if not name.startswith("__")},
            }
            for item in self._found
        ]


def gone_elements(new: RobotNode, old: RobotNode, plan: MigrationPlan) -> list[MigratedToken]:
    """Elements of the old process at which a token could wait, and that have no counterpart in the new one."""
    return gone(old.engine.program, new.engine.program, plan)


def variables_of(old: RobotNode) -> set[str]:
    """Return the names of all variables of a process that a migration transfers."""
    data = snapshot(old.engine, dump=lambda value: None, dicts=_AllVariables())
    return {name for item in data["variables"] for name in item["own"]}


def what_becomes(new: RobotNode, old: RobotNode, plan: MigrationPlan) -> tuple[list[MigratedToken], Data | None]:
    """Return the fate of each token of the old process, and the resulting state in the new one.

    The state is a snapshot as JSON (`fame.engine.snapshot`) in which long values and those of other kinds are
    ``{"$object": null}``: unknown. None if a token is blocked.
    """
    programs = old.engine.program, new.engine.program
    data = snapshot(old.engine, dump=_known)
    tokens = preview(data, *programs, plan)
    if any(token.fate == "blocked" for token in tokens):
        return tokens, None
    state, _ = migrate(data, *programs, plan)
    for item in state["variables"]:
        item["own"] = {name: _short(value) for name, value in item["own"].items()}
    for box in state["boxes"]:
        box["messages"] = [[number, _short(message)] for number, message in box["messages"]]
    return tokens, state


def _known(value: Any) -> Any:
    """A message as data; None for a value of another kind."""
    try:
        return dump(value)
    except MissionError:
        return None


def _short(value: Any) -> Any:
    """A short value as it is, a long or deep one as an unknown value."""
    text = json.dumps(value)
    return value if len(text) <= _LONG and not is_deep(text, _DEEP) else {"$object": None}


def transfer_state(new: RobotNode, old: RobotNode, plan: MigrationPlan) -> list[MigratedToken]:
    """Transfer the state of the old process, which is held, to a loaded one. Nothing moves until `go_on_after`.

    Raises MissionError if a token cannot go over; then nothing has changed.
    """
    live = _Live()
    data = snapshot(old.engine, dump=live.dump, dicts=_AllVariables())
    data, tokens = migrate(data, old.engine.program, new.engine.program, plan)
    engine = restore(new.engine.program, data, new.host, new.engine.new_variables, load=live.load)
    engine.at_once = new.engine.at_once
    host, before = new.host, old.host
    # The robot's counts and ended instances are those of its mission, whatever the version of the model.
    host.started, host.completed, host.failed = before.started, before.completed, before.failed
    host.elements_done = before.elements_done
    over = [instance for instance in old.instances if instance.status != "running"]
    host.instances[:] = sorted([*over, *engine.instances.values()], key=lambda instance: instance.key)
    new.attach(engine)
    take_unanswered(new, tables_of(old, epoch_of(old)))
    new.suspension.restore(old.suspension.table(0), 0)
    new.waiting.restore(old.waiting.table(old.engine, 0), 0)
    if new.acknowledged is not None and old.acknowledged is not None:
        new.acknowledged.restore(old.acknowledged.tables(epoch_of(old)), epoch_of(new))
    new.forget_early()
    _notify_changes(old.engine, engine)
    return tokens


def _notify_changes(old: Engine, new: Engine) -> None:
    """Notify the observers of the old process of what has ended or begun, or is in another scope, or has another id.

    Those of the new one begin with what is there (`RobotNode.attach`).
    """
    before, now = ({scope.key: scope for scope in all_scopes(engine)} for engine in (old, new))
    was, has = (Counter(one for each in scopes.values() for one in [*entered(each)][::-1]) for scopes in (before, now))
    for where, element in reversed([*(was - has).elements()]):  # inner ones first
        old.notify(before[where], (element, "cancel", None))
    for where, element in (has - was).elements():
        old.notify(now[where], (element, "enter", None))
    old.observe()


def go_on_after(new: RobotNode, timers: dict[str, Any]) -> None:
    """Continue a process that has taken over; `timers` are those of the old one, from `timers_of`."""
    set_timers(new, {"timers": timers})
    arm_taken_over(new)
    go_on(new)


def arm_taken_over(new: RobotNode) -> None:
    """Release a process that has taken over, unless something else holds it, and arm what only its model has."""
    if not (new.engine.incidents or new.suspension.by):
        new.engine.release()
    arm_new(new.engine)


def timers_of(old: RobotNode) -> dict[str, Any]:
    """Return the timers of a process, as tables of its state have them."""
    return tables_of(old, epoch_of(old))["timers"]
