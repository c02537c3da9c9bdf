"""Plans of migrations: YAML that says what becomes of elements and variables, where it is not clear by itself.

::

    elements:
      Task_Cut: {to: Task_Mow}      # another id; of another kind: it begins there
      Task_Scan: restart            # begins again
      Task_Wait: abandon            # its token ends
    variables:
      speed: {rename: velocity}
      height: {default: 0.5}        # if it is not set
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fame.config.values import ConfigValue
    from fame.engine.migration import Plan

_WORDS = ("keep", "restart", "abandon")


def read_plan(path: Path) -> dict[str, Any]:
    """A plan as plain data. Raises ConfigError with file, line and key."""
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
    found = value.mapping(["rename", "default"])
    return {
        **({"rename": found["rename"].text()} if "rename" in found else {}),
        **({"default": found["default"].data} if "default" in found else {}),
    }


def plan_of(data: Mapping[str, Any]) -> Plan:
    """Return the plan that `read_plan` gave, perhaps from an envelope. Parts that are not valid are ignored."""
    from fame.engine.migration import Plan

    elements, variables = data.get("elements") or {}, data.get("variables") or {}
    said = {id: what for id, what in elements.items() if isinstance(what, str)}
    return Plan(
        to={id: str(what["to"]) for id, what in elements.items() if isinstance(what, Mapping) and "to" in what},
        restart=frozenset(id for id, what in said.items() if what == "restart"),
        abandon=frozenset(id for id, what in said.items() if what == "abandon"),
        rename={name: str(what["rename"]) for name, what in variables.items() if "rename" in what},
        default={name: what["default"] for name, what in variables.items() if "default" in what},
    )
