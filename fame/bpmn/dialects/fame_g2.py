"""The original FaMe's web modeler: ``http://ros``, ``http://data``, ``http://qos``, ``http://callActivity``."""

from __future__ import annotations

from copy import deepcopy

from lxml import etree

from fame.bpmn.context import Context
from fame.bpmn.dialects.extensions import Extensions, Property
from fame.bpmn.dialects.flow_style import mapped_entries
from fame.bpmn.dialects.qos import CHOICES, DURATIONS, policy
from fame.bpmn.ids import unique_ids
from fame.bpmn.xml import BPMN, BPMNDI, CAMUNDA, DC, DI, ZEEBE, Node, line_of, local, parse_any

ROS, DATA, QOS, CALL = "http://ros", "http://data", "http://qos", "http://callActivity"

_POLICIES = {name.replace("_", "") for name in (*CHOICES, "depth", *DURATIONS)}
_PREFIXES = {
    "bpmn": BPMN, "bpmn2": BPMN, "bpmndi": BPMNDI, "dc": DC, "di": DI, "camunda": CAMUNDA, "zeebe": ZEEBE,
    "ros": ROS, "data": DATA, "qos": QOS, "callActivity": CALL, "xsi": "http://www.w3.org/2001/XMLSchema-instance",
}  # fmt: skip


def element(context: Context, node: Node, found: Extensions) -> None:
    """One extension element. Attributes that mean nothing (``selection``, ``is_output``) are passed over."""
    name = local(node)
    if name == "message":
        found.type = node.get("type", "")
    elif name == "payload":
        found.payload = _payload(context, node)
    elif name == "service":
        found.operation, found.type, found.service = node.get("name", "").strip(), node.get("type", ""), True
    elif name == "policy":
        for key, value in node.attrib.items():
            if str(key).replace("_", "").lower() not in _POLICIES or not str(value).strip():
                continue
            meant = policy(context, node, str(key), str(value))
            found.qos.update([meant] if meant is not None else ())
            if meant is not None and meant[1] != str(value):
                context.quirk(node, f"quality of service {key!s}={value!s} is {' '.join(meant)}")
    elif name == "parameters":
        named = [(_name(context, one), one) for one in node]
        found.values += [(name, Property(one.get("value", ""), line_of(one))) for name, one in named if name]
    elif name == "process":
        found.called = node.get("process", "").strip()


def _name(context: Context, node: Node) -> str:
    given = node.get("name", "").strip()
    name = given.removesuffix(":").strip()
    if name != given:
        context.quirk(node, f"the parameter {given!r} is {name!r}")
    return name


def _payload(context: Context, node: Node) -> Property | None:
    if node.get("data") is not None:
        return Property(node.get("data", ""), line_of(node))
    given = [(_name(context, one), one.get("value", "")) for one in node if one.get("value", "").strip()]
    return Property(mapped_entries(given), line_of(node)) if given else None


def unfold(context: Context, root: Node) -> None:
    """Makes processes that stand as escaped text in a call activity processes of the file, called by their id.

    The extension element then holds the id. Ids in it that are taken get a number: it was drawn in a file of its own,
    and may have call activities with processes inside in turn.
    """
    holders = _folded(root)
    known = {etree.tostring(one): one for one in root.iterchildren(f"{{{BPMN}}}process")} if holders else {}
    taken = {id for one in root.iter("*") if (id := one.get("id"))} if holders else set()
    for holder in holders:
        process, diagrams = _embedded(context, holder, holder.get("process", "").strip())
        plain = etree.tostring(process)
        if plain not in known:
            known[plain] = process
            process.set("id", process.get("id") or f"process_{line_of(holder)}")
            everything = [one for part in (process, *diagrams) for one in part.iter("*")]
            unique_ids(everything, taken)
            for one in everything:
                one.sourceline = line_of(holder)  # type: ignore[assignment]
            root.extend([process, *diagrams])
            holders += _folded(process)
        holder.set("process", known[plain].get("id", ""))
        text = f"the process embedded in it is read as process {known[plain].get('id')} of the file"
        context.quirk(holder, text)


def _folded(element: Node) -> list[Node]:
    return [one for one in element.iter(f"{{{CALL}}}process") if one.get("process", "").strip().startswith("<")]


def _embedded(context: Context, holder: Node, text: str) -> tuple[Node, list[Node]]:
    """The process, and the diagrams that show it."""
    around = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in _PREFIXES.items())
    text = text[text.index("?>") + 2 :] if text.startswith("<?") and "?>" in text else text
    source = f'<definitions xmlns="{BPMN}" {around}>{text}</definitions>'.encode()
    try:
        inner = parse_any(source, context.file)
    except Exception as error:
        raise context.error(holder, f"the process embedded in it: {error}") from None
    process = next(inner.iter(f"{{{BPMN}}}process"), None)
    if process is None:
        raise context.error(holder, "the text embedded in it holds no BPMN process")
    return deepcopy(process), [deepcopy(one) for one in inner.iter(f"{{{BPMNDI}}}BPMNDiagram") if len(one)]
