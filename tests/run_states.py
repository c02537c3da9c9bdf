"""States of a run from the key of a block, and as the rows of a key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.bpmn.model import Definitions
from fame.robot.robot_state import EVENTS, RobotState, ScopeState
from fame.view.blocks import COLUMNS, Block, Packer
from fame.view.catalogue import Catalogue
from fame.view.state import WHATS


def packer_at(key: Mapping[str, Any]) -> Packer:
    """A packer that has the state that a key tells, with the numbers of elements as their ids."""
    packer = Packer(_Numbers([]), map(str, range(9)))
    robot = packer.state.robot
    for number, scope, instance, parent, openers, _ in key.get("scopes", ()):
        robot(number).scopes[scope] = ScopeState(instance, max(parent, 0), tuple(map(str, openers)))
    for number, instance, scope, element, held, since in key.get("tokens", ()):
        robot(number).scopes.setdefault(scope, ScopeState(instance))
        robot(number).active[scope, str(element)] = [held, since]
        marks(robot(number), element)["enter"] += held
    for number, element, completed, failed, cancelled in key.get("counts", ()):
        counts = marks(robot(number), element)
        counts["enter"] += completed + failed + cancelled
        counts.update(leave=completed, fail=failed, cancel=cancelled)
    for number, scope, values in key.get("variables", ()):
        known = robot(number).scopes[scope]
        known.values = {name: value for name, (value, _) in values.items()}
        known.since = {name: since for name, (_, since) in values.items()}
    for number, tokens in key.get("waits", ()):
        robot(number).tokens = {token["key"]: {**token, "element": str(token["e"])} for token in tokens}
    for number, ended, failed, how, when in key.get("ends", ()):
        state = robot(number)
        state.ended, state.ended_at = {"failed": failed, "completed": ended - failed}, when
        state.instances[0] = "", how
    return packer


def marks(state: RobotState, element: int) -> dict[str, int]:
    return state.counts.setdefault(0, {}).setdefault(str(element), dict.fromkeys(("enter", "leave", "fail"), 0))


def replayed(block: Block) -> Mapping[str, Any]:
    """The rows of the state at the end of a block, from the block alone."""
    packer = packer_at(block.key)
    for robot, scope, instance, parent, openers, _ in block.lists["scopes"]:
        packer.state.robot(robot).scopes[scope] = ScopeState(instance, max(parent, 0), tuple(map(str, openers)))
    rows = zip(*(block.columns[name] for name in COLUMNS), strict=True)
    for at, (time, robot, instance, scope, element, what) in enumerate(rows):
        mark = [str(element), WHATS[what], *([block.details[at]] if at in block.details else [])]
        data = {"events": [{"instance": instance, "scope": scope, "marks": [mark]}]}
        packer.state.robot(robot).apply(EVENTS, data, time)
    return packer.key_json()


class _Numbers(Catalogue):
    """A catalogue whose elements have their numbers as ids."""

    def __init__(self, files: list[Definitions]) -> None:
        super().__init__(files)

    def number(self, file: int, id: str) -> int:
        return int(id)
