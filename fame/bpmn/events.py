"""Events: what triggers them, what they throw, where they may stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from fame.bpmn.context import Context, boolean, find, is_type
from fame.bpmn.dialects import extensions_of, fame_g0
from fame.bpmn.dialects.extensions import Extensions, TopicProperties, topic_properties
from fame.bpmn.expressions import body, template
from fame.bpmn.model import (
    Assignment,
    CancelDefinition,
    CompensateDefinition,
    ConditionalDefinition,
    ErrorDefinition,
    EscalationDefinition,
    EventDefinition,
    Expression,
    LinkDefinition,
    MessageDefinition,
    Place,
    SignalDefinition,
    TerminateDefinition,
    TimerDefinition,
    Topic,
)
from fame.bpmn.xml import Node, Parts, attributes, child, children, line_of, local, text_of

PLACES: Mapping[str, Place] = {
    "startEvent": "start",
    "intermediateCatchEvent": "catch",
    "intermediateThrowEvent": "throw",
    "endEvent": "end",
    "boundaryEvent": "boundary",
}
THROWS = ("throw", "end")

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
"""Trigger -> places (standard, tables 10.84 to 10.93)."""
_SUFFIX = "EventDefinition"


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a flow node must know of its process. `data`: see `fame.bpmn.data.data_ids`; `labels`: they name topics."""

    data: Mapping[str, str]
    labels: bool = False


@dataclass(slots=True)
class Source:
    """An event as far as it is read."""

    around: Surroundings
    element: Node
    id: str
    place: Place
    extensions: Extensions
    takes: tuple[Assignment, ...] = ()
    common: TopicProperties | None = None

    @property
    def label(self) -> str:
        return " ".join(self.element.get("name", "").split())


def read_definitions(context: Context, source: Source, parts: Parts) -> tuple[EventDefinition, ...]:
    """Its event definitions, in document order.

    Raises ModelError for one that may not stand there or says too little.
    """
    found = []
    for tag, elements in parts.items():
        if tag.endswith(_SUFFIX):
            found += [(element, tag.removesuffix(_SUFFIX)) for element in elements]
        elif tag == "eventDefinitionRef":
            found += [_referred(context, element) for element in elements]
    for _, kind in found:
        if kind not in _ALLOWED:
            raise context.error(
                source.element, f"event definition {kind!r} is not of BPMN 2.0: {', '.join(_ALLOWED)} are"
            )
        if source.place not in _ALLOWED[kind].split():
            places = ", ".join(_ALLOWED[kind].split())
            text = f"a {kind} event cannot be a {source.place} event: it can be {places}"
            raise context.error(source.element, text)
    order = {element: place for place, element in enumerate(source.element)} if len(found) > 1 else {}
    found.sort(key=lambda pair: order.get(pair[0], 0))
    return tuple(_READERS[kind](context, source, element) for element, kind in found)


def _referred(context: Context, reference: Node) -> tuple[Node, str]:
    element = context.root(text_of(reference))
    if element is None:
        raise context.error(
            reference, f"eventDefinitionRef {text_of(reference)!r}: the file has no such event definition"
        )
    return element, local(element).removesuffix(_SUFFIX)


def read_topic(
    context: Context, source: Source, element: Node, kind: Literal["signal", "message"], say: TopicProperties
) -> Topic:
    """The topic of a signal or message: named by what is referred to, else by the label (FORMATS, rules of reading)."""
    reference = element.get(f"{kind}Ref")
    referred = context.root(reference)
    if referred is not None and local(referred) != kind:
        raise context.error(source.element, f"{kind}Ref {reference!r} is a {local(referred)}: expected a {kind}")
    name = referred.get("name", "").strip() if referred is not None else ""
    label = source.label
    if source.extensions.topic:
        name = source.extensions.topic
    elif source.around.labels and label:
        name = label
    elif name and label and name != label and (say.type or say.payload or source.extensions.original):
        level: Literal["warning", "note"] = "warning" if source.extensions.original else "note"
        context.note(source.element, f"the topic is {name!r}, the name of the signal, not the label {label!r}", level)
    name = name or label
    if not name and reference and referred is None:
        raise context.error(
            source.element, f"{kind}Ref {reference!r}: the file has no such {kind}, and the event has no label"
        )
    if not name and kind == "signal":
        raise context.error(source.element, "the signal has no name: give it one, or the event a label")
    return Topic(
        name=name or source.id,
        type=say.type or _item_type(context, referred),
        payload=say.payload if source.place in THROWS else None,
        queue=say.queue,
        private=say.private,
        qos=say.qos,
        takes=source.takes,
    )


def _item_type(context: Context, referred: Node | None) -> str | None:
    """The message type by way of an item definition, the standard's own place for it."""
    if referred is None:
        return None
    item = context.root(referred.get("structureRef") or referred.get("itemRef"))
    text = item.get("structureRef", "") if item is not None else ""
    return text.strip() if is_type(text) else None


def _topic(context: Context, source: Source, element: Node, kind: Literal["signal", "message"]) -> Topic:
    if source.common is None:
        fame_g0.apply(source.extensions)
        source.common = topic_properties(context, source.element, source.extensions)
        if source.place not in THROWS:
            source.takes += tuple(source.extensions.outputs)
    say = source.common
    if len(element) or any(key[0] == "{" for key in attributes(element)):
        say = _own(context, source, element)
    return read_topic(context, source, element, kind, say)


def _own(context: Context, source: Source, element: Node) -> TopicProperties:
    """What the definition itself says, before what the event says."""
    assert source.common is not None
    extensions = extensions_of(context, element)
    if extensions.refused:
        text = f"{extensions.refused.split(';')[0]}: that is passed over, the message is published"
        context.note(source.element, text, "warning")
    own, common = topic_properties(context, element, extensions), source.common
    return TopicProperties(
        type=own.type or common.type,
        payload=own.payload or common.payload or _copied(extensions),
        queue=own.queue or common.queue,
        private=own.private or common.private,
        qos=own.qos or common.qos,
    )


def _copied(extensions: Extensions) -> Expression | None:
    """``camunda:in`` of a signal that is thrown: the payload as a mapping."""
    if not extensions.inputs:
        return None
    pairs = ((one.target, one.source) for one in extensions.inputs)
    entries = (f"{name}: {text.text if text.language == 'juel' else f'${{{text.text}}}'}" for name, text in pairs)
    return Expression(f"{{{', '.join(entries)}}}", "payload", extensions.inputs[0].source.line)


def _signal(context: Context, source: Source, element: Node) -> SignalDefinition:
    return SignalDefinition(topic=_topic(context, source, element, "signal"), line=line_of(element))


def _message(context: Context, source: Source, element: Node) -> MessageDefinition:
    topic = _topic(context, source, element, "message")
    return MessageDefinition(topic=topic, keys=message_keys(context, element.get("messageRef")), line=line_of(element))


def message_keys(context: Context, reference: str | None) -> tuple[tuple[str, Expression], ...]:
    """What correlates a message: name of a variable of the process -> expression over ``msg``.

    The standard's correlation properties (chapter 8.3.2); a Camunda 8 key ``=order.id`` correlates with field ``id``.
    """
    message = context.root(reference)
    if message is None:
        return ()
    found: list[tuple[str, Expression]] = []
    key = extensions_of(context, message).key
    if key is not None:
        field = key.text.rpartition(".")[2].strip("${} ")
        found.append((key.text.strip("${} "), Expression(f"msg.{field}", "python", key.line)))
    for one in context.roots.values():
        if local(one) == "correlationProperty":
            for retrieval in children(one, "correlationPropertyRetrievalExpression"):
                path = child(retrieval, "messagePath")
                if find({message.get("id", ""): message}, retrieval.get("messageRef")) is not None and path is not None:
                    expression = body(context, path)
                    if expression is not None:
                        found.append((one.get("name", "") or one.get("id", ""), expression))
    return tuple(found)


def _timer(context: Context, source: Source, element: Node) -> TimerDefinition:
    kinds: Mapping[str, Literal["duration", "date", "cycle"]] = {
        "timeDuration": "duration",
        "timeDate": "date",
        "timeCycle": "cycle",
    }
    for tag, kind in kinds.items():
        holder = child(element, tag)
        expression = template(context, holder) if holder is not None else None
        if expression is not None:
            return TimerDefinition(kind=kind, expression=expression, line=line_of(element))
    raise context.error(source.element, "the timer has no time: expected a duration, date or cycle of ISO 8601")


def _conditional(context: Context, source: Source, element: Node) -> ConditionalDefinition:
    holder = child(element, "condition")
    condition = body(context, holder) if holder is not None else None
    if condition is None:
        raise context.error(source.element, "the conditional event has no condition")
    return ConditionalDefinition(condition=condition, line=line_of(element))


def _code(context: Context, source: Source, element: Node, kind: str) -> str | None:
    """The code of an error or escalation. A throw without one goes by its name."""
    reference = element.get(f"{kind}Ref")
    referred = context.root(reference)
    if reference and referred is None:
        raise context.error(source.element, f"{kind}Ref {reference!r}: the file has no such {kind}")
    code = referred.get(f"{kind}Code", "").strip() if referred is not None else ""
    if code or source.place not in THROWS:
        return code or None
    if referred is not None:
        return referred.get("name", "").strip() or referred.get("id")
    return source.label or None


def _error(context: Context, source: Source, element: Node) -> ErrorDefinition:
    extensions = extensions_of(context, element)
    return ErrorDefinition(
        code=_code(context, source, element, "error"),
        code_variable=extensions.code_variable,
        message_variable=extensions.message_variable,
        line=line_of(element),
    )


def _escalation(context: Context, source: Source, element: Node) -> EscalationDefinition:
    return EscalationDefinition(
        code=_code(context, source, element, "escalation"),
        code_variable=extensions_of(context, element).code_variable,
        line=line_of(element),
    )


def _link(context: Context, source: Source, element: Node) -> LinkDefinition:
    name = element.get("name", "").strip() or source.label
    if not name:
        raise context.error(source.element, "the link has no name: give both of its ends the same one")
    return LinkDefinition(name=name, line=line_of(element))


def _terminate(context: Context, source: Source, element: Node) -> TerminateDefinition:
    return TerminateDefinition(line=line_of(element))


def _compensate(context: Context, source: Source, element: Node) -> CompensateDefinition:
    wait = boolean(context, element, "waitForCompletion", True)
    return CompensateDefinition(activity=element.get("activityRef") or None, wait=wait, line=line_of(element))


def _cancel(context: Context, source: Source, element: Node) -> CancelDefinition:
    return CancelDefinition(line=line_of(element))


_READERS: Mapping[str, Callable[[Context, Source, Node], EventDefinition]] = {
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
