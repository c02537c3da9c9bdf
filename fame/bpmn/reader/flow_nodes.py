"""A flow node half read: what its element says whatever kind it is, for the readers of the kinds to go on from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fame.bpmn.reader.context import Context, boolean
from fame.bpmn.reader.data import Moves, read_moves, required_outputs
from fame.bpmn.reader.dialects import extensions_of
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import Node, Parts, children, line_of, parts_of, text_of

Wiring = Mapping[str, tuple[list[str], list[str]]]
"""Flow node -> ids of its incoming and outgoing sequence flows, in document order."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What flow nodes share.

    `data`, `variables`: see `data_ids` and `data_variables`; `labels`: they name the topics of this process.
    """

    context: Context
    data: Mapping[str, str]
    variables: Mapping[str, str]
    labels: bool = False


@dataclass(slots=True)
class HalfRead:
    """A flow node as far as it has been read."""

    context: Context
    around: Surroundings
    element: Node
    parts: Parts
    extensions: Extensions
    moves: Moves
    common: dict[str, Any]
    """Arguments that the dataclasses of all flow nodes take, but for the properties."""

    @property
    def id(self) -> str:
        id: str = self.common["id"]
        return id

    @property
    def label(self) -> str:
        """Its name on one line, empty if it has none."""
        return " ".join(self.element.get("name", "").split())

    def get(self, name: str) -> str:
        """An attribute, empty if it is not there."""
        return self.element.get(name, "")

    def flag(self, name: str, default: bool = False) -> bool:
        """An attribute that is true or false."""
        return boolean(self.context, self.element, name, default)

    def fault(self, text: str) -> None:
        """What is wrong with it."""
        self.context.fault(self.element, text)


def half_read(around: Surroundings, element: Node, wiring: Wiring) -> HalfRead:
    """Reads what all flow nodes have. Raises ModelError for an id that is taken."""
    context, parts = around.context, parts_of(element)
    moves = read_moves(context, around.data, around.variables, parts)
    id = context.claim(element)
    incoming, outgoing = wiring.get(id, ((), ()))
    common = {
        "id": id,
        "name": element.get("name", ""),
        "line": line_of(element),
        "documentation": documentation(element) if "documentation" in parts else "",
        "incoming": tuple(incoming),
        "outgoing": tuple(outgoing),
        "data_inputs": moves.inputs,
        "data_outputs": moves.outputs,
        "copies_in": moves.copied_in,
        "copies_out": moves.copied_out,
        "required": required_outputs(parts),
    }
    return HalfRead(context, around, element, parts, extensions_of(context, element), moves, common)


def documentation(element: Node) -> str:
    """The text of its documentation."""
    return "\n".join(text_of(one).strip() for one in children(element, "documentation"))
