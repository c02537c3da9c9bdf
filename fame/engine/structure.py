"""How the elements of a model hang together: which begin by themselves, which are handlers."""

from __future__ import annotations

from fame.bpmn import model


def instantiates(node: model.FlowNode) -> bool:
    """Whether it is a gateway or receive task that starts a process."""
    return isinstance(node, model.Gateway | model.Task) and node.instantiate and not node.incoming


def begins(node: model.FlowNode) -> bool:
    """Whether an element starts by itself in a body without start event (standard 13.2)."""
    if node.incoming or (isinstance(node, model.Event) and node.place == "boundary"):
        return False
    if isinstance(node, model.Event) and node.definitions and isinstance(node.definitions[0], model.LinkDefinition):
        return node.place != "catch"
    return is_reached(node)


def is_reached(node: model.FlowNode) -> bool:
    """Whether tokens of the flow around it get to an element."""
    return not (isinstance(node, model.Activity) and (node.for_compensation or is_handler(node)))


def is_handler(node: model.FlowNode) -> bool:
    """Whether it is an event sub-process."""
    return isinstance(node, model.SubProcess) and node.triggered_by_event


def links_of(event: model.Event) -> set[str]:
    """The names of the links that an event throws or catches."""
    return {each.name for each in event.definitions if isinstance(each, model.LinkDefinition)}


def jumping_to(content: model.Body, event: model.Event) -> list[str]:
    """The ids of the events that jump to a catching one."""
    others = (other for other in content.nodes if isinstance(other, model.Event) and other.place == "throw")
    return [other.id for other in others if links_of(event) & links_of(other)]
