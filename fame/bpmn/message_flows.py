"""Message flows between pools: what a sender sends goes to the topic of its receiver.

A message flow from one element to another says what they need not say themselves. It is written into the tree before
anything is read: sender and receiver then refer to one message. The message of the receiver counts, else that of the
flow, else that of the sender; where nobody names one, it is called as the receiver is. What is put together from a file
has no message flows any more, but the references.
"""

from __future__ import annotations

from lxml import etree

from fame.bpmn.context import Context, find
from fame.bpmn.xml import BPMN, Node, child, children, local

_SENDS = ("intermediateThrowEvent", "endEvent", "sendTask")
_RECEIVES = ("startEvent", "intermediateCatchEvent", "boundaryEvent", "receiveTask")


def connect(context: Context, root: Node) -> None:
    """Let the ends of each message flow refer to the same message."""
    flows = [
        flow for collaboration in children(root, "collaboration") for flow in children(collaboration, "messageFlow")
    ]
    if not flows:
        return
    tags = (f"{{{BPMN}}}{tag}" for tag in (*_SENDS, *_RECEIVES))
    elements = {
        id: one for process in children(root, "process") for one in process.iter(*tags) if (id := one.get("id"))
    }
    for flow in flows:
        sender = _holder(find(elements, flow.get("sourceRef")), _SENDS)
        receiver = _holder(find(elements, flow.get("targetRef")), _RECEIVES)
        if sender is not None and receiver is not None:
            _agree(context, root, flow, sender, receiver)


def _holder(element: Node | None, tags: tuple[str, ...]) -> Node | None:
    """What says which message an element sends or receives; None if it has to do with none."""
    if element is None or local(element) not in tags:
        return None
    return element if local(element).endswith("Task") else child(element, "messageEventDefinition")


def _agree(context: Context, root: Node, flow: Node, sender: Node, receiver: Node) -> None:
    wanted = receiver.get("messageRef") or flow.get("messageRef") or sender.get("messageRef")
    if not wanted:
        wanted = f"{_element(receiver).get('id')}_message"
        label = " ".join(_element(receiver).get("name", "").split()) or _element(receiver).get("id", "")
        root.insert(0, etree.Element(f"{{{BPMN}}}message", {"id": wanted, "name": label}))
    said = sender.get("messageRef")
    if said and said != wanted:
        text = f"sends {said} to {_element(receiver).get('id')}, which waits for {wanted}: that is the topic it goes to"
        context.note(_element(sender), text, "warning")
    sender.set("messageRef", wanted)
    receiver.set("messageRef", wanted)


def _element(holder: Node) -> Node:
    """The event or task that a holder is of."""
    around = holder.getparent()
    return holder if local(holder).endswith("Task") or around is None else around
