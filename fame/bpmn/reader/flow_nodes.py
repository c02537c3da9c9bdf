"""Reads the common parts of flow nodes, for the readers of events, gateways and activities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.bpmn.reader.context import Context, boolean_attribute
from fame.bpmn.reader.data import DataAssociations, read_data_associations, required_outputs
from fame.bpmn.reader.dialects import read_extensions
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import Node, Parts, children, line_of, parts_of, text_of
from fame.dataclasses import dataclass

Connections = Mapping[str, tuple[list[str], list[str]]]
"""Flow node id -> ids of its incoming and outgoing sequence flows, in document order."""


@dataclass(frozen=True, slots=True)
class ProcessContext:
    """Shared context of the flow nodes of one process.

    `data`, `variables`: see `data_ids` and `data_variables`. `labels`: labels of events name their topics.
    """

    context: Context
    data: Mapping[str, str]
    variables: Mapping[str, str]
    labels: bool = False


@dataclass(slots=True)
class NodeReader:
    """A flow node whose common parts have been read. Readers take what they use from `extensions`."""

    context: Context
    process: ProcessContext
    element: Node
    parts: Parts
    extensions: Extensions
    associations: DataAssociations
    common: dict[str, Any]
    """Arguments for the dataclasses of all flow nodes, except the properties."""

    @property
    def id(self) -> str:
        id: str = self.common["id"]
        return id

    @property
    def label(self) -> str:
        """The name on one line, or empty."""
        return " ".join(self.element.get("name", "").split())

    def get(self, name: str) -> str:
        """Return the value of an attribute, or empty."""
        return self.element.get(name, "")

    def flag(self, name: str, default: bool = False) -> bool:
        """Return an attribute of type xsd:boolean."""
        return boolean_attribute(self.context, self.element, name, default)

    def fault(self, text: str) -> None:
        """Record a fault of the flow node."""
        self.context.fault(self.element, text)


def read_node(process: ProcessContext, element: Node, wiring: Connections) -> NodeReader:
    """Read the common parts of a flow node. Raises ModelError for an id that another element has."""
    context, parts = process.context, parts_of(element)
    moves = read_data_associations(context, process.data, process.variables, parts)
    id = context.register(element)
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
    return NodeReader(context, process, element, parts, read_extensions(context, element), moves, common)


def documentation(element: Node) -> str:
    return "\n".join(text_of(one).strip() for one in children(element, "documentation"))
