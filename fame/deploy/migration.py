"""Migration of what a robot runs: the plan for it, and what is foreseen.

A plan is YAML that says what becomes of elements and variables, where it is not clear by itself::

    elements:
      Task_Cut: {to: Task_Mow}      # another id; of another kind: it begins there
      Task_Scan: restart            # begins again
      Task_Wait: abandon            # its token ends
    variables:
      speed: {rename: velocity}
      height: {default: 0.5}        # if it is not set
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.dataclasses import asdict, dataclass, field, fields
from fame.text import DEPTH, is_deep, suggestion

if TYPE_CHECKING:
    from fame.config.values import ConfigValue
    from fame.engine.migration import MigratedToken, MigrationPlan
    from fame.robot import RobotNode

_LARGEST = 500_000
"""The longest state that is part of a report (characters of JSON)."""
_ABOVE = 2
"""Levels of a report above the state in it."""
_MISSING = ("unknown", "without_target", "unset")
"""What a plan names and is not there: fields of `Foreseen`."""
_WORDS = ("keep", "restart", "abandon")


def read_plan(path: Path) -> dict[str, Any]:
    """Return a plan as plain data. Raises ConfigError with file, line and key."""
    from fame.config.loader import read_document

    document = read_document(path).mapping(["elements", "variables"])
    elements, variables = document.get("elements"), document.get("variables")
    return {
        "elements": {id: _element(value) for id, value in (elements.mapping() if elements is not None else {}).items()},
        "variables": {
            name: _variable(value) for name, value in (variables.mapping() if variables is not None else {}).items()
        },
    }


def _element(value: ConfigValue) -> Any:
    if isinstance(value.data, str):
        return value.choice(_WORDS, "a fate or {to: ID}")
    value.mapping(["to"])
    return {"to": value.required("to", "the id of an element").text()}


def _variable(value: ConfigValue) -> Any:
    keys = value.mapping(["rename", "default"])
    return {
        **({"rename": keys["rename"].text()} if "rename" in keys else {}),
        **({"default": keys["default"].data} if "default" in keys else {}),
    }


def plan_of(data: Mapping[str, Any]) -> MigrationPlan:
    """Return the plan that `read_plan` gave, perhaps from an envelope. Parts that are not valid are ignored."""
    from fame.engine.migration import MigrationPlan

    elements, variables = (
        part if isinstance(part := data.get(name), Mapping) else {} for name in ("elements", "variables")
    )
    variables = {name: what for name, what in variables.items() if isinstance(what, Mapping)}
    named = {id: what for id, what in elements.items() if isinstance(what, str)}
    return MigrationPlan(
        to={id: str(what["to"]) for id, what in elements.items() if isinstance(what, Mapping) and "to" in what},
        restart=frozenset(id for id, what in named.items() if what == "restart"),
        abandon=frozenset(id for id, what in named.items() if what == "abandon"),
        rename={name: str(what["rename"]) for name, what in variables.items() if "rename" in what},
        default={name: what["default"] for name, what in variables.items() if "default" in what},
    )


# ---- what is foreseen ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What would become of what a robot runs.

    hash    of the model that it runs
    tokens  each token, and what becomes of it
    gone    elements without a token now that have no counterpart: a token that comes there would be blocked
    state   the state in the new program, as `fame.robot.state_transfer.what_becomes` gives it; empty if one is blocked
            or if it is too large to be sent
    unknown what the plan names and the old model does not have; `without_target`: elements whose new id the new model
            does not have; `unset`: variables that the plan renames and the robot does not have. With a hint each.
    """

    hash: str = ""
    tokens: Sequence[MigratedToken] = ()
    gone: Sequence[MigratedToken] = ()
    state: Mapping[str, Any] = field(default_factory=dict)
    unknown: Mapping[str, str] = field(default_factory=dict)
    without_target: Mapping[str, str] = field(default_factory=dict)
    unset: Mapping[str, str] = field(default_factory=dict)

    @property
    def blocked(self) -> str:
        """All reasons why it is not possible; empty if it is."""
        reasons = "; ".join(str(token) for token in self.tokens if token.fate == "blocked")
        return f"the state does not fit the new model: {reasons}" if reasons else ""

    def to_json(self) -> dict[str, Any]:
        tokens, gone = (
            [{**asdict(token), "others": list(token.others)} for token in found] for found in (self.tokens, self.gone)
        )
        missing = {name: dict(getattr(self, name)) for name in _MISSING}
        more = {name: texts for name, texts in missing.items() if texts}  # FAME 0.2 does not take them
        return {"hash": self.hash, "tokens": tokens, "gone": gone, "state": self.state, **more}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Foreseen:
        """Return what a report has; what it does not have is empty."""
        from fame.engine.migration import MigratedToken

        names = [each.name for each in fields(MigratedToken)]

        def token(data: Mapping[str, Any]) -> MigratedToken:
            known = {name: data[name] for name in names if name in data}
            return MigratedToken(**{**known, "others": tuple(known.get("others", ()))})

        tokens, gone = ([token(each) for each in data.get(name, ())] for name in ("tokens", "gone"))
        missing = (x if isinstance(x := data.get(name), Mapping) else {} for name in _MISSING)
        return cls(str(data.get("hash", "")), tokens, gone, data.get("state", {}), *missing)


def foresee(new: RobotNode, old: RobotNode, plan: Mapping[str, Any], hash: str) -> Foreseen:
    """Return what would become of what runs (`old`, of the model with this hash) in a loaded process."""
    from fame.engine.migration import kinds
    from fame.robot.state_transfer import gone_elements, variables_of, what_becomes

    parsed = plan_of(plan)
    tokens, state = what_becomes(new, old, parsed)
    there = {token.element for token in tokens}
    gone = [token for token in gone_elements(new, old, parsed) if token.element not in there]
    text = json.dumps(state or {})
    sent = len(text) <= _LARGEST and not is_deep(text, DEPTH - _ABOVE)
    before, now = kinds(old.engine.program), kinds(new.engine.program)
    unknown = {id: suggestion(id, before) for id in (*parsed.to, *parsed.restart, *parsed.abandon) if id not in before}
    missing = {id: suggestion(to, now) for id, to in parsed.to.items() if id in before and to not in now}
    names = variables_of(old) if parsed.rename and tokens else {*parsed.rename}
    unset = {name: suggestion(name, sorted(names)) for name in parsed.rename if name not in names}
    return Foreseen(hash, tokens, gone, (state or {}) if sent else {}, unknown, missing, unset)


def expect_met(path: Path, foreseen: Mapping[str, Foreseen]) -> None:
    """Raise ConfigError, with file and line, for an element that no robot runs, or a new id that is in no new model."""
    from fame.config.loader import read_document

    running = [one for one in foreseen.values() if one.hash]
    elements = read_document(path).mapping().get("elements")
    for id, value in (elements.mapping() if elements is not None and running else {}).items():
        if all(id in one.unknown for one in running):
            hint = min((one.unknown[id] for one in running), key=lambda hint: not hint.startswith("did you"))
            raise value.error(f"no robot runs a model with this element; {hint}")
        for hint in (one.without_target[id] for one in running if id in one.without_target):
            raise value.required("to", "ID").error(f"the new model has no element {value.data['to']}; {hint}")


def unset_variables(path: Path, foreseen: Mapping[str, Foreseen]) -> list[str]:
    """Return a warning, with file and line, for each variable that a plan renames and no robot has."""
    from fame.config.loader import read_document

    running = [one for one in foreseen.values() if one.tokens]
    variables = read_document(path).mapping().get("variables")
    return [
        str(value.error(f"no robot has this variable; {min(one.unset[name] for one in running)}"))
        for name, value in (variables.mapping() if variables is not None and running else {}).items()
        if all(name in one.unset for one in running)
    ]


def migrate_robot(
    new: RobotNode, old: RobotNode, plan: Mapping[str, Any], text: str
) -> tuple[Callable[[], object], dict[str, Any]]:
    """Transfer the state of what runs (`old`), which is held, to a loaded process (`new`).

    Returns a function that reports `text` and lets the new one go on, and the timers that this sets, as `timers_of`
    gives them.
    Raises MissionError if the state does not fit.
    """
    from fame.robot.state_transfer import go_on_after, timers_of, transfer_state

    timers = timers_of(old)
    tokens = transfer_state(new, old, plan_of(plan))
    changed = ", ".join(map(str, tokens)) or "no token"

    def go_on() -> None:
        new.note("", f"{text}: {changed}")
        go_on_after(new, timers)

    return go_on, timers


def write_plan(path: Path, foreseen: Mapping[str, Foreseen]) -> None:
    """Write a plan to edit: a line for each element that has a token, or that is gone and may have one later.

    Raises ConfigError, also if the file exists.
    """
    from fame.errors import ConfigError

    lines, taken = dict[str, str](), set[str]()
    tokens = [(robot, token, "blocked") for robot, one in foreseen.items() for token in one.tokens]
    tokens += [(robot, token, "no token is there now") for robot, one in foreseen.items() for token in one.gone]
    for robot, token, state in tokens:
        if token.element not in lines:
            lines[token.element] = _plan_line(robot, token, taken, state)
    text = "\n".join(
        ["# What becomes of each token: keep, restart (begins again), abandon (its token ends), or {to: ID}",
         "elements:" if lines else "elements: {}", *lines.values(),
         "# variables:", "#   old_name: {rename: new_name}", "#   name: {default: 0}", ""]
    )  # fmt: skip
    try:
        with path.open("x") as file:
            file.write(text)
    except FileExistsError:
        raise ConfigError("exists already; give it with --plan, or remove it", file=str(path)) from None
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None


def _plan_line(robot: str, token: MigratedToken, taken: set[str], state: str) -> str:
    """The line of an element: what is decided, or a comment with what is possible.

    An element that is gone goes to the only new one of its kind, unless another element has `taken` it.
    """
    label = f'"{token.name}" of {robot}' if token.name else robot
    if token.fate != "blocked":
        return f"  {json.dumps(token.element)}: {_decided(token)}  # {label}"
    targets = ", ".join(token.others) or "ID"
    comment = f"{label}: {state}: {token.reason}"
    if len(token.others) == 1 and token.others[0] not in taken:
        taken.update(token.others)
        return f"  {json.dumps(token.element)}: {{to: {json.dumps(token.others[0])}}}  # {comment}"
    return f"  # {json.dumps(token.element)}: {{to: {targets}}}  # or restart, abandon; {comment}"


def _decided(token: MigratedToken) -> str:
    if token.target not in ("", token.element):
        return f"{{to: {json.dumps(token.target)}}}"
    return token.fate
