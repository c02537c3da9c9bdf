"""Semantics of verifiers of BPMN collaborations (fbpmn and others), where they are not those of FAME: as options.

Tasks take time, also those that FAME completes at once; at an end event only one token may arrive; a run may go round
for ever though it could leave. A model is changed before it is explored, so that the engine stays what it is.
"""

from __future__ import annotations

from dataclasses import fields, replace

from fame.bpmn import model
from fame.check.explore.graph import Explored

SECOND_TOKEN = "second token"
"""The error code of a token that comes to an end event to which one has come."""
_COUNTED = " counted"
_COUNT = """\
try:
    {name} = {name} + 1
except Exception:
    {name} = 1
if {name} > 1:
    raise BpmnError({code!r})"""


def with_time(body: model.Body, operation: str) -> model.Body:
    """A body in which plain tasks, and what send tasks do first, are steps of an operation that takes time."""
    made = replace(body, nodes=tuple(_as_step(node, operation) for node in body.nodes))
    for node in body.nodes:
        if isinstance(node, model.Task) and node.kind == "send" and node.incoming:
            made = _before(made, node.id, model.Task(id=f"{node.id} begins", kind="service", operation=operation))
    return made


def _as_step(node: model.FlowNode, operation: str) -> model.FlowNode:
    if isinstance(node, model.Task) and node.kind == "plain":
        kept = {item.name: getattr(node, item.name) for item in fields(model.Activity)}
        return model.Task(kind="service", operation=operation, **kept)
    return node


def with_counts(body: model.Body) -> model.Body:
    """A body in which a second token that comes to an end event fails, with code `SECOND_TOKEN`."""
    made = body
    ends = [node for node in body.nodes if isinstance(node, model.Event) and node.place == "end" and node.incoming]
    for number, end in enumerate(ends, 1):
        text = _COUNT.format(name=f"tokens_at_end_{number}", code=SECOND_TOKEN)
        made = _before(made, end.id, model.Task(id=f"{end.id}{_COUNTED}", name=end.name, line=end.line, kind="script",
                                                script=model.Expression(text)))  # fmt: skip
    return made


def counted(element: str) -> str:
    """The end event of what counts the tokens that come to it; any other element itself."""
    return element.removesuffix(_COUNTED)


def _before(body: model.Body, id: str, task: model.Task) -> model.Body:
    """A body with a task before an element."""
    following = next(node for node in body.nodes if node.id == id)
    flow = model.SequenceFlow(id=f"{task.id} flow", source=task.id, target=id)
    task = replace(task, incoming=following.incoming, outgoing=(flow.id,))
    nodes = tuple(replace(node, incoming=(flow.id,)) if node.id == id else node for node in body.nodes)
    flows = tuple(replace(one, target=task.id) if one.target == id else one for one in body.flows)
    return replace(body, nodes=(*nodes, task), flows=(*flows, flow))


def cycle(explored: Explored) -> list[int]:
    """Return the states of a shortest cycle, in order; empty if no state can be reached again.

    A message from outside that changes nothing does not count as a cycle.
    """
    count, loops = len(explored.offsets) - 1, set(explored.loops)

    def following(at: int) -> set[int]:
        found = set(explored.targets[explored.offsets[at] : explored.offsets[at + 1]])
        return found if at in loops else found - {at}

    left = [0] * len(explored.states)
    before: list[list[int]] = [[] for _ in explored.states]
    for at in range(count):
        ways = following(at)
        left[at] = len(ways)
        for target in ways:
            before[target].append(at)
    pending = [at for at, number in enumerate(left) if not number]
    while pending:  # what leads only to states that end
        for at in before[pending.pop()]:
            left[at] -= 1
            if not left[at]:
                pending.append(at)
    at = next((at for at, number in enumerate(left) if number), -1)
    way: dict[int, None] = {}
    while at >= 0 and at not in way:
        way[at] = None
        at = min(target for target in following(at) if left[target])
    return list(way)[list(way).index(at) :] if way else []
