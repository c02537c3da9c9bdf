"""Rewrites the XML tree of a file before it is read: embedded processes first, then message flows.

The original FaMe's web modeler embeds called processes as escaped text: they become processes of the file.

The ends of a message flow come to refer to one message, so that sender and receiver use one topic. The message of the
receiver counts, else that of the flow, else that of the sender. If none of them names a message, it gets the name of
the receiver. Files that are put together from others therefore need no message flows.
"""

from __future__ import annotations

from collections import Counter
from copy import deepcopy

from lxml import etree

from fame.bpmn.namespaces import expand_types
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.dialects.original_fame import CALL, DATA, QOS, ROS
from fame.bpmn.reader.xml import (
    BPMN,
    BPMNDI,
    CAMUNDA,
    DC,
    DI,
    ZEEBE,
    Node,
    child,
    children,
    ids_in,
    invented_id,
    line_of,
    local_name,
    parse_any,
    resolve,
    unique_ids,
)

_SENDS = ("intermediateThrowEvent", "endEvent", "sendTask")
_RECEIVES = ("startEvent", "intermediateCatchEvent", "boundaryEvent", "receiveTask")


_PREFIXES = {
    "bpmn": BPMN, "bpmn2": BPMN, "bpmndi": BPMNDI, "dc": DC, "di": DI, "camunda": CAMUNDA, "zeebe": ZEEBE,
    "ros": ROS, "data": DATA, "qos": QOS, "callActivity": CALL, "xsi": "http://www.w3.org/2001/XMLSchema-instance",
}  # fmt: skip


def prepare(context: Context, root: Node) -> None:
    """Rewrite the tree in place. Raises ModelError for an embedded process that cannot be read."""
    _extract_embedded_processes(context, root)
    _connect_message_flows(context, root)


# ---- embedded processes ----------------------------------------------------------------------------------------------


def _extract_embedded_processes(context: Context, root: Node) -> None:
    """Move processes embedded as escaped text in call activities into the file, and call them by their id.

    Ids that are taken get a number, since an embedded process comes from another file. It may contain embedded
    processes in turn.
    """
    holders = _embedding_elements(root)
    processes_by_content = (
        {etree.tostring(one): one for one in root.iterchildren(f"{{{BPMN}}}process")} if holders else {}
    )
    taken = ids_in(root) if holders else Counter[str]()
    for holder in holders:
        process, diagrams = _parse_embedded(context, holder, holder.get("process", "").strip())
        content = etree.tostring(process)
        if content not in processes_by_content:
            processes_by_content[content] = process
            elements = [one for part in (process, *diagrams) for one in part.iter("*")]
            process.set("id", process.get("id") or invented_id(f"process_{line_of(holder)}", taken | ids_in(process)))
            unique_ids(elements, taken)
            for one in elements:
                one.sourceline = line_of(holder)  # type: ignore[assignment]
            root.extend([process, *diagrams])
            holders += _embedding_elements(process)
        holder.set("process", processes_by_content[content].get("id", ""))
        text = f"its embedded process is read as process {processes_by_content[content].get('id')} of the file"
        context.quirk(holder, text)


def _embedding_elements(element: Node) -> list[Node]:
    return [one for one in element.iter(f"{{{CALL}}}process") if one.get("process", "").strip().startswith("<")]


def _parse_embedded(context: Context, holder: Node, text: str) -> tuple[Node, list[Node]]:
    namespaces = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in _PREFIXES.items())
    text = text[text.index("?>") + 2 :] if text.startswith("<?") and "?>" in text else text
    source = f'<definitions xmlns="{BPMN}" {namespaces}>{text}</definitions>'.encode()
    try:
        inner = parse_any(source, context.file)
        expand_types(inner)
    except Exception as error:
        raise context.error(holder, f"its embedded process cannot be read: {error}") from None
    process = next(inner.iter(f"{{{BPMN}}}process"), None)
    if process is None:
        raise context.error(holder, "its embedded text has no BPMN process")
    return deepcopy(process), [deepcopy(one) for one in inner.iter(f"{{{BPMNDI}}}BPMNDiagram") if len(one)]


# ---- message flows ---------------------------------------------------------------------------------------------------


def _connect_message_flows(context: Context, root: Node) -> None:
    """Make both ends of each message flow refer to the same message."""
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
        sender = _holder(resolve(elements, flow.get("sourceRef")), _SENDS)
        receiver = _holder(resolve(elements, flow.get("targetRef")), _RECEIVES)
        if sender is not None and receiver is not None:
            _use_one_message(context, root, flow, sender, receiver)


def _holder(element: Node | None, tags: tuple[str, ...]) -> Node | None:
    """The element that refers to the sent or received message: the task itself or the event definition, or None."""
    if element is None or local_name(element) not in tags:
        return None
    return element if local_name(element).endswith("Task") else child(element, "messageEventDefinition")


def _use_one_message(context: Context, root: Node, flow: Node, sender: Node, receiver: Node) -> None:
    message = receiver.get("messageRef") or flow.get("messageRef") or sender.get("messageRef")
    if not message:
        message = invented_id(f"{_element(receiver).get('id')}_message", ids_in(root))
        name = " ".join(_element(receiver).get("name", "").split()) or _element(receiver).get("id", "")
        root.insert(0, etree.Element(f"{{{BPMN}}}message", {"id": message, "name": name}))
    sent = sender.get("messageRef")
    if sent and sent != message:
        text = f"sends {sent} to {_element(receiver).get('id')}, which waits for {message}: it is sent as {message}"
        context.note(_element(sender), text, "warning")
    sender.set("messageRef", message)
    receiver.set("messageRef", message)


def _element(holder: Node) -> Node:
    """The event or task of a holder."""
    around = holder.getparent()
    return holder if local_name(holder).endswith("Task") or around is None else around
