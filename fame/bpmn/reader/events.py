"""Reads events: their definitions, topics, codes and mappings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from fame.bpmn.model import (
    Assignment,
    CancelDefinition,
    CompensateDefinition,
    ConditionalDefinition,
    ErrorDefinition,
    EscalationDefinition,
    EventDefinition,
    EventPosition,
    Expression,
    IoMapping,
    LinkDefinition,
    MessageDefinition,
    SignalDefinition,
    TerminateDefinition,
    TimerDefinition,
    Topic,
)
from fame.bpmn.reader.context import Context, boolean_attribute, is_message_type
from fame.bpmn.reader.dialects import original_fame, read_extensions
from fame.bpmn.reader.dialects.extensions import Extensions, TopicProperties, take_topic_properties
from fame.bpmn.reader.expressions import by_form, code_of, condition_of, has_placeholders, mapping_source, timer_text
from fame.bpmn.reader.flow_nodes import NodeReader
from fame.bpmn.reader.xml import (
    CAMUNDA,
    Node,
    attributes,
    child,
    children,
    line_of,
    local_id,
    local_name,
    resolve,
    text_of,
)
from fame.dataclasses import dataclass, fields, replace
from fame.text import label_of, ros_name

THROWS: tuple[str, ...] = ("throw", "end")

_ALLOWED: Mapping[str, str] = {
    "signal": "start catch throw end boundary",
    "message": "start catch throw end boundary",
    "timer": "start catch boundary",
    "conditional": "start catch boundary",
    "error": "start end boundary",
    "escalation": "start throw end boundary",
    "compensate": "start throw end boundary",
    "link": "catch throw",
    "cancel": "end boundary",
    "terminate": "end",
}
"""Event definition -> places where BPMN 2.0 allows it (tables 10.84 to 10.93)."""
_SUFFIX = "EventDefinition"


@dataclass(slots=True)
class TopicSource:
    """The event, or send or receive task, whose topics are read. `properties` apply to all of its topics."""

    node: NodeReader
    place: EventPosition
    takes: tuple[Assignment, ...] = ()
    properties: TopicProperties | None = None


def read_definitions(node: NodeReader, place: EventPosition) -> tuple[EventDefinition, ...]:
    """Return the event definitions of an event, in document order. Faults are definitions that are
    not allowed or invalid."""
    definitions: list[tuple[Node, str]] = []
    for tag, elements in node.parts.items():
        if tag.endswith(_SUFFIX):
            definitions += [(element, tag.removesuffix(_SUFFIX)) for element in elements]
        elif tag == "eventDefinitionRef":
            definitions += [pair for element in elements if (pair := _referred(node.context, element)) is not None]
    definitions = [pair for pair in definitions if _is_known(node, pair[1], place)]
    order = {element: number for number, element in enumerate(node.element)} if len(definitions) > 1 else {}
    definitions.sort(key=lambda pair: order.get(pair[0], 0))
    source = TopicSource(node, place, node.associations.assigned_out)
    return tuple(_READERS[kind](source, element) for element, kind in definitions)


def _is_known(node: NodeReader, kind: str, place: EventPosition) -> bool:
    """Whether BPMN 2.0 has definitions of this kind. One that is not allowed at this place is a fault."""
    if kind not in _ALLOWED:
        node.fault(f"unknown event definition {kind!r}: expected one of {', '.join(_ALLOWED)}")
    elif place not in _ALLOWED[kind].split():
        places = ", ".join(_ALLOWED[kind].split())
        node.fault(f"{kind} events cannot be {place} events: they can be {places}")
    return kind in _ALLOWED


def read_mapping(node: NodeReader, place: EventPosition, definitions: tuple[EventDefinition, ...]) -> IoMapping | None:
    """Return the mapping of an event, without that of a caught message."""
    extensions, moves = node.extensions, node.associations
    catches = place not in THROWS and any(isinstance(one, SignalDefinition | MessageDefinition) for one in definitions)
    inputs = (*extensions.inputs, *moves.assigned_in) if place in THROWS else ()
    outputs = () if catches else (*extensions.outputs, *moves.assigned_out)
    return IoMapping(inputs, outputs) if inputs or outputs else None


def _referred(context: Context, reference: Node) -> tuple[Node, str] | None:
    element = context.root(text_of(reference))
    if element is None:
        context.fault(reference, f"eventDefinitionRef {text_of(reference)!r}: the file has no such event definition")
        return None
    return element, local_name(element).removesuffix(_SUFFIX)


def read_topic(
    source: TopicSource, element: Node, kind: Literal["signal", "message"], properties: TopicProperties
) -> Topic:
    """Return the topic of a signal or message, named after the referenced element, else after the label."""
    node, reference = source.node, element.get(f"{kind}Ref")
    referred = node.context.root(reference)
    if referred is not None and local_name(referred) != kind:
        node.fault(f"{kind}Ref {reference!r} is a {local_name(referred)}: expected a {kind}")
    name = _topic_name(node, kind, referred, properties)
    computed = has_placeholders(name) or name.startswith("=")
    if computed:
        text = f"the name {name!r} is computed: give a fixed name, since topics are created before the process runs"
        node.fault(text)
    if not name or (reference and name == node.label and not (referred is not None and _name(referred))):
        name = _default_topic_name(node, kind, reference, referred)
    topic = Topic(
        name=name if computed else ros_name(name),
        type=properties.type or _item_type(node.context, referred),
        payload=properties.payload if source.place in THROWS else None,
        to=_addressee(source, element, kind, properties),
        queue=properties.queue,
        ttl=properties.ttl,
        private=properties.private,
        qos=properties.qos,
        takes=source.takes,
        label="" if computed else label_of(name),
    )
    if topic.ttl and not topic.qualified.startswith("/"):
        node.fault(f"delivery='acknowledged': no other robot catches {topic.qualified}, a topic of one robot")
    return topic


def _addressee(source: TopicSource, element: Node, kind: str, properties: TopicProperties) -> Expression | None:
    """The expression for the robot that a message is sent to."""
    if properties.to is not None and (kind == "signal" or source.place not in THROWS):
        text = "its property 'to' has no effect: only thrown messages can be sent to one robot"
        source.node.context.note(element, text, "warning")
        return None
    return properties.to


def _default_topic_name(node: NodeReader, kind: str, reference: str | None, referred: Node | None) -> str:
    """The topic of an event whose signal or message has no name: its label, else the id."""
    name = node.label or (referred.get("id", "") if referred is not None else node.id)
    source_of_name = f"the label {name!r}" if node.label else f"its id {name!r}"
    if reference and referred is None and not node.label:
        node.fault(f"{kind}Ref {reference!r}: the file has no such {kind}, and the event has no label")
    elif reference and referred is None:
        text = f"the file has no {kind} {reference!r}: the topic is {source_of_name}"
        node.context.note(node.element, text, "warning", quirk=True)
    elif reference or kind == "signal":
        text = f"the {kind} has no name: the topic is {source_of_name}"
        node.context.note(node.element, text, "reading" if node.label else "note", quirk=True)
    return name


def _name(element: Node) -> str:
    return " ".join(element.get("name", "").split())


def _topic_name(node: NodeReader, kind: str, referred: Node | None, properties: TopicProperties) -> str:
    name, label = _name(referred) if referred is not None else "", node.label
    if node.extensions.topic:
        return node.extensions.topic
    if node.process.labels and label:
        if name and name != label:
            text = f"the topic is the label {label!r}, not the name of the {kind} {name!r} (topics=labels)"
            node.context.quirk(node.element, text)
        return label
    if name and label and name != label and (properties.type or properties.payload or node.context.original):
        level: Literal["warning", "note"] = "warning" if node.context.original else "note"
        text = f"the topic is {name!r}, the name of the {kind}, not the label {label!r}"
        node.context.note(node.element, text, level, quirk=True)
    return name or label


def _item_type(context: Context, referred: Node | None) -> str | None:
    """The message type given by an item definition, as in the standard."""
    if referred is None:
        return None
    item = context.root(referred.get("structureRef") or referred.get("itemRef"))
    text = item.get("structureRef", "") if item is not None else ""
    return text.strip() if is_message_type(text) else None


def note_keys(context: Context, element: Node, keys: tuple[tuple[str, Expression], ...]) -> None:
    """A correlation key where nothing correlates."""
    if keys:
        text = "its property 'correlate' has no effect: only an element that receives a message correlates it"
        context.note(element, text, "warning")


def _note_misplaced(source: TopicSource, properties: TopicProperties, kind: str) -> None:
    """Keys where nothing correlates, a queue of an element that throws, and a payload of one that catches."""
    throws = source.place in THROWS
    if throws or kind == "signal":
        note_keys(source.node.context, source.node.element, properties.keys)
    name = "queue" if throws and properties.queue else "payload" if properties.payload and not throws else ""
    if name:
        right = "catches" if throws else "throws"
        text = f"its property {name!r} has no effect here: only an element that {right} has one"
        source.node.context.note(source.node.element, text, "warning")


def _topic(
    source: TopicSource, element: Node, kind: Literal["signal", "message"]
) -> tuple[Topic, tuple[tuple[str, Expression], ...]]:
    """Return the topic of a definition, and the correlation keys that properties give."""
    node = source.node
    if source.properties is None:
        original_fame.apply_message_list(node.context, node.element, node.extensions)
        source.properties = take_topic_properties(node.context, node.element, node.extensions)
        _note_misplaced(source, source.properties, kind)
        if source.place not in THROWS:
            source.takes += tuple(node.extensions.outputs)
    has_own = len(element) or any(key[0] == "{" for key in attributes(element))
    properties = _definition_properties(source, element, source.properties, kind) if has_own else source.properties
    topic = read_topic(source, element, kind, properties)
    return topic, properties.keys if kind == "message" and source.place not in THROWS else ()


def _definition_properties(
    source: TopicSource, element: Node, common: TopicProperties, kind: Literal["signal", "message"]
) -> TopicProperties:
    """The topic properties of a definition, completed by those of its event."""
    node = source.node
    extensions = read_extensions(node.context, element)
    if extensions.refused:
        text = f"{extensions.refused.split(';')[0]}: ignored, the message is published"
        node.context.note(element, text, "warning")
    own = take_topic_properties(node.context, element, extensions)
    _note_misplaced(source, own, kind)
    given = {one.name: value for one in fields(own) if (value := getattr(own, one.name))}
    properties = replace(common, **given)
    properties.payload = properties.payload or _copied_payload(extensions)
    return properties


def _copied_payload(extensions: Extensions) -> Expression | None:
    """The payload given by ``camunda:in`` of a thrown signal."""
    if not extensions.inputs:
        return None
    pairs = ((one.target, one.source) for one in extensions.inputs)
    entries = (f"{name}: {text.text if text.language == 'juel' else f'${{{text.text}}}'}" for name, text in pairs)
    return Expression(f"{{{', '.join(entries)}}}", "payload", extensions.inputs[0].source.line)


def _signal(source: TopicSource, element: Node) -> SignalDefinition:
    return SignalDefinition(topic=_topic(source, element, "signal")[0], line=line_of(element))


def _message(source: TopicSource, element: Node) -> MessageDefinition:
    topic, keys = _topic(source, element, "message")
    if source.place not in THROWS:
        keys = (*message_keys(source.node, element.get("messageRef")), *keys)
    return MessageDefinition(topic=topic, keys=keys, line=line_of(element))


def message_keys(node: NodeReader, reference: str | None) -> tuple[tuple[str, Expression], ...]:
    """Return the correlation keys of a message: variable of the process -> expression over ``msg``.

    From correlation properties (BPMN 2.0, chapter 8.3.2); a Camunda 8 key ``=order.id`` correlates with field ``id``.
    """
    context = node.context
    message = context.root(reference)
    if message is None:
        return ()
    keys: list[tuple[str, Expression]] = []
    extensions = read_extensions(context, message)
    if extensions.refused:
        context.fault(node.element, extensions.refused)
    if (key := extensions.key) is not None:
        keys.append((key.text, Expression(f"${{msg.{key.text.rpartition('.')[2]}}}", "juel", key.line)))
    for root in context.roots.values():
        if local_name(root) == "correlationProperty":
            for retrieval in children(root, "correlationPropertyRetrievalExpression"):
                path = child(retrieval, "messagePath")
                if (
                    resolve({message.get("id", ""): message}, retrieval.get("messageRef")) is not None
                    and path is not None
                ):
                    expression = code_of(context, path)
                    if expression is not None:
                        keys.append((root.get("name", "") or root.get("id", ""), expression))
    return tuple(keys)


def _timer(source: TopicSource, element: Node) -> TimerDefinition:
    kinds: Mapping[str, Literal["duration", "date", "cycle"]] = {
        "timeDuration": "duration",
        "timeDate": "date",
        "timeCycle": "cycle",
    }
    holders = [holder for tag in kinds if (holder := child(element, tag)) is not None]
    holder = next((one for one in holders if text_of(one).strip()), next(iter(holders), None))
    return TimerDefinition(
        kind=kinds[local_name(holder)] if holder is not None else "duration",
        expression=timer_text(source.node.context, holder) if holder is not None else None,
        line=line_of(element),
    )


def _conditional(source: TopicSource, element: Node) -> ConditionalDefinition:
    holder = child(element, "condition")
    condition = condition_of(source.node.context, holder) if holder is not None else None
    return ConditionalDefinition(condition=condition, line=line_of(element))


def _code(source: TopicSource, element: Node, kind: str, received: bool) -> str | None:
    """The code of an error or escalation, by default the name of a thrown one; `received`: a variable has it."""
    reference = element.get(f"{kind}Ref")
    referred = source.node.context.root(reference)
    if reference and referred is None:
        source.node.fault(f"{kind}Ref {reference!r}: the file has no such {kind}")
    if referred is not None and local_name(referred) != kind:
        source.node.fault(f"{kind}Ref {reference!r} is a {local_name(referred)}: expected an {kind}")
    code = referred.get(f"{kind}Code", "").strip() if referred is not None else ""
    if source.place not in THROWS:
        name = referred.get("name", "").strip() if referred is not None else ""
        if name and not code and not received:
            text = f"catches every {kind}: {name!r} is only the name of its {kind}, which has no code"
            source.node.context.note(element, text, "warning")
        return code or None
    if code:
        return code
    if referred is not None:
        return referred.get("name", "").strip() or referred.get("id")
    return source.node.label or None


def _computed_code(source: TopicSource, element: Node, kind: str) -> Expression | None:
    """The expression for the code of a throw event. At a catch event it is a fault."""
    referred = source.node.context.root(element.get(f"{kind}Ref"))
    text = referred.get(f"{kind}Code", "").strip() if referred is not None else ""
    if by_form(text, 0) is None:
        return None
    if source.place not in THROWS:
        source.node.fault(
            f"the {kind} code {text!r} is computed: a catch event needs a fixed code, or none to catch all"
        )
        return None
    return by_form(text, line_of(element))


def _error_text(source: TopicSource, element: Node) -> Expression | None:
    """The text of a thrown error: that of Camunda 7's field *Message*."""
    referred = source.node.context.root(element.get("errorRef"))
    text = referred.get(f"{{{CAMUNDA}}}errorMessage", "").strip() if referred is not None else ""
    return mapping_source(text, line_of(element)) if text and source.place in THROWS else None


def _error(source: TopicSource, element: Node) -> ErrorDefinition:
    extensions = read_extensions(source.node.context, element)
    return ErrorDefinition(
        code=_code(source, element, "error", extensions.code_variable is not None),
        computed=_computed_code(source, element, "error"),
        message=_error_text(source, element),
        code_variable=extensions.code_variable,
        message_variable=extensions.message_variable,
        line=line_of(element),
    )


def _escalation(source: TopicSource, element: Node) -> EscalationDefinition:
    code_variable = read_extensions(source.node.context, element).code_variable
    return EscalationDefinition(
        code=_code(source, element, "escalation", code_variable is not None),
        computed=_computed_code(source, element, "escalation"),
        code_variable=code_variable,
        line=line_of(element),
    )


def _link(source: TopicSource, element: Node) -> LinkDefinition:
    name = element.get("name", "").strip() or source.node.label
    if not name:
        source.node.fault("the link has no name: give both of its events the same name")
    return LinkDefinition(name=name or source.node.id, line=line_of(element))


def _terminate(source: TopicSource, element: Node) -> TerminateDefinition:
    return TerminateDefinition(line=line_of(element))


def _compensate(source: TopicSource, element: Node) -> CompensateDefinition:
    wait = boolean_attribute(source.node.context, element, "waitForCompletion", True)
    activity = source.node.context.find_in_file(element, element.get("activityRef"))
    id = activity.get("id", "") if activity is not None else local_id(element, "activityRef")
    return CompensateDefinition(activity=id or None, wait=wait, line=line_of(element))


def _cancel(source: TopicSource, element: Node) -> CancelDefinition:
    return CancelDefinition(line=line_of(element))


_READERS: Mapping[str, Callable[[TopicSource, Node], EventDefinition]] = {
    "signal": _signal,
    "message": _message,
    "timer": _timer,
    "conditional": _conditional,
    "error": _error,
    "escalation": _escalation,
    "link": _link,
    "terminate": _terminate,
    "compensate": _compensate,
    "cancel": _cancel,
}
