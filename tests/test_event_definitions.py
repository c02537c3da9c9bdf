"""Events: what triggers them, what they throw, and where they may stand."""

import pytest
from bpmn_text import node_of, process, properties, refused

from fame.bpmn.model import (
    CancelDefinition,
    CompensateDefinition,
    ConditionalDefinition,
    ErrorDefinition,
    EscalationDefinition,
    Event,
    Expression,
    LinkDefinition,
    MessageDefinition,
    SignalDefinition,
    TerminateDefinition,
    TimerDefinition,
)

SIGNAL = '<signal id="S" name="weed_found"/>'


PLACES = {
    "start": "startEvent",
    "catch": "intermediateCatchEvent",
    "throw": "intermediateThrowEvent",
    "end": "endEvent",
    "boundary": "boundaryEvent",
}
TRIGGERS = {
    "signal": ('<signalEventDefinition signalRef="S"/>', SignalDefinition, "start catch throw end boundary"),
    "message": ('<messageEventDefinition messageRef="M"/>', MessageDefinition, "start catch throw end boundary"),
    "timer": (
        "<timerEventDefinition><timeDuration>PT1S</timeDuration></timerEventDefinition>",
        TimerDefinition,
        "start catch boundary",
    ),
    "conditional": (
        "<conditionalEventDefinition><condition>x</condition></conditionalEventDefinition>",
        ConditionalDefinition,
        "start catch boundary",
    ),
    "error": ('<errorEventDefinition errorRef="E"/>', ErrorDefinition, "start end boundary"),
    "escalation": (
        '<escalationEventDefinition escalationRef="X"/>',
        EscalationDefinition,
        "start throw end boundary",
    ),
    "compensate": ('<compensateEventDefinition activityRef="t"/>', CompensateDefinition, "start throw end boundary"),
    "link": ('<linkEventDefinition name="jump"/>', LinkDefinition, "catch throw"),
    "cancel": ("<cancelEventDefinition/>", CancelDefinition, "end boundary"),
    "terminate": ("<terminateEventDefinition/>", TerminateDefinition, "end"),
}
ROOTS = (
    f'{SIGNAL}<message id="M" name="order"/><error id="E" name="Lost" errorCode="lost"/>'
    '<escalation id="X" name="Late" escalationCode="late"/>'
)


def written(place: str, definition: str, attributes: str = "", content: str = "") -> str:
    """An event at some place, and the task that it may be attached to."""
    tag = PLACES[place]
    host = 'attachedToRef="t"' if place == "boundary" else ""
    return f'<{tag} id="e" {host} {attributes}>{content}{definition}</{tag}><task id="t"/>'


def event_of(place: str, definition: str, attributes: str = "", roots: str = ROOTS, content: str = "") -> Event:
    """An event at some place, as it is read."""
    node = node_of(written(place, definition, attributes, content), roots)
    assert isinstance(node, Event)
    return node


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("trigger", TRIGGERS)
def test_every_trigger_is_read_where_the_standard_allows_it_and_refused_elsewhere(place: str, trigger: str) -> None:
    definition, kind, allowed = TRIGGERS[trigger]
    if place in allowed.split():
        event = event_of(place, definition)
        assert event.place == place
        assert [type(one) for one in event.definitions] == [kind]
    else:
        error = refused(process(written(place, definition), ROOTS))
        assert error.text.startswith(f"{trigger} events cannot be {place} events")


@pytest.mark.parametrize("place", ["start", "throw", "end"])
def test_an_event_without_a_trigger_is_a_none_event(place: str) -> None:
    assert event_of(place, "").definitions == ()


def test_what_the_definitions_say() -> None:
    message = event_of("catch", TRIGGERS["message"][0]).definitions[0]
    assert isinstance(message, MessageDefinition)
    assert message.topic.name == "order"
    assert event_of("end", TRIGGERS["error"][0]).definitions[0] == ErrorDefinition(code="lost", line=3)
    assert event_of("end", TRIGGERS["escalation"][0]).definitions[0] == EscalationDefinition(code="late", line=3)
    assert event_of("throw", TRIGGERS["link"][0]).definitions[0] == LinkDefinition(name="jump", line=3)
    assert event_of("throw", TRIGGERS["compensate"][0]).definitions[0] == CompensateDefinition(activity="t", line=3)
    nobody_waits = '<compensateEventDefinition waitForCompletion="false"/>'
    assert event_of("throw", nobody_waits).definitions[0] == CompensateDefinition(wait=False, line=3)


@pytest.mark.parametrize(
    ("xml", "kind", "expression"),
    [
        ("<timeDuration>PT1.5S</timeDuration>", "duration", Expression("PT1.5S", "template", 3)),
        ("<timeDate>2026-01-01T00:00:00Z</timeDate>", "date", Expression("2026-01-01T00:00:00Z", "template", 3)),
        ("<timeCycle>R3/PT1S</timeCycle>", "cycle", Expression("R3/PT1S", "template", 3)),
        ("<timeDuration>PT${x}S</timeDuration>", "duration", Expression("PT${x}S", "template", 3)),
        ("<timeDuration>${pause}</timeDuration>", "duration", Expression("${pause}", "juel", 3)),
        ("<timeDuration>=pause</timeDuration>", "duration", Expression("pause", "feel", 3)),
        ('<timeDuration language="python">pause</timeDuration>', "duration", Expression("pause", "python", 3)),
    ],
)
def test_timers_are_durations_dates_and_cycles_literal_or_computed(xml: str, kind: str, expression: Expression) -> None:
    timer = event_of("catch", f"<timerEventDefinition>{xml}</timerEventDefinition>").definitions[0]
    assert isinstance(timer, TimerDefinition)
    assert (timer.kind, timer.expression) == (kind, expression)


def test_interrupting_is_read_at_starts_and_boundaries() -> None:
    assert event_of("start", TRIGGERS["signal"][0]).interrupting
    assert not event_of("start", TRIGGERS["signal"][0], 'isInterrupting="false"').interrupting
    boundary = event_of("boundary", TRIGGERS["signal"][0], 'cancelActivity="false"')
    assert (boundary.interrupting, boundary.attached_to) == (False, "t")


def test_an_event_may_have_several_triggers_in_their_order() -> None:
    event = event_of(
        "catch", TRIGGERS["timer"][0] + TRIGGERS["signal"][0] + TRIGGERS["timer"][0], 'parallelMultiple="true"'
    )
    assert [type(one) for one in event.definitions] == [TimerDefinition, SignalDefinition, TimerDefinition]
    assert event.parallel


def test_an_event_may_refer_to_a_definition_at_the_root() -> None:
    root = '<timerEventDefinition id="T"><timeDuration>PT1S</timeDuration></timerEventDefinition>'
    event = event_of("catch", "<eventDefinitionRef>T</eventDefinitionRef>", roots=root)
    assert isinstance(event.definitions[0], TimerDefinition)


def test_a_catch_without_code_catches_all_and_a_throw_without_code_goes_by_its_name() -> None:
    nameless = '<error id="E" name="lost"/>'
    for place, code in (("boundary", None), ("end", "lost")):
        definition = event_of(place, TRIGGERS["error"][0], roots=nameless).definitions[0]
        assert isinstance(definition, ErrorDefinition)
        assert definition.code == code


def test_a_topic_is_named_by_the_signal_else_by_the_label() -> None:
    def topic(attributes: str, definition: str, roots: str = ROOTS) -> str:
        one = event_of("throw", definition, attributes, roots).definitions[0]
        assert isinstance(one, SignalDefinition)
        return one.topic.name

    assert topic('name="other"', '<signalEventDefinition signalRef="S"/>') == "weed_found"
    assert topic('name="other"', "<signalEventDefinition/>") == "other"
    assert topic('name="a&#10;label"', '<signalEventDefinition signalRef="S"/>', '<signal id="S"/>') == "a_label"
    assert topic('name="other"', '<signalEventDefinition signalRef="gone"/>') == "other"
    assert topic("", '<signalEventDefinition signalRef="tns:S"/>') == "weed_found"


def test_property_topics_labels_takes_the_label() -> None:
    content = '<endEvent id="e" name="label"><signalEventDefinition signalRef="S"/></endEvent>'
    node = node_of(properties(topics="labels") + content, SIGNAL)
    assert isinstance(node, Event)
    assert isinstance(node.definitions[0], SignalDefinition)
    assert node.definitions[0].topic.name == "label"


def test_the_type_of_a_topic_may_be_its_item_definition() -> None:
    roots = '<signal id="S" name="s" structureRef="I"/><itemDefinition id="I" structureRef="std_msgs/msg/Bool"/>'
    definition = event_of("catch", '<signalEventDefinition signalRef="S"/>', roots=roots).definitions[0]
    assert isinstance(definition, SignalDefinition)
    assert definition.topic.type == "std_msgs/msg/Bool"


def test_messages_are_correlated_by_the_keys_of_the_standard() -> None:
    roots = (
        '<message id="M" name="order"/><correlationProperty id="K" name="order_id">'
        "<correlationPropertyRetrievalExpression "
        'messageRef="M"><messagePath>msg.id</messagePath></correlationPropertyRetrievalExpression>'
        "</correlationProperty>"
    )
    definition = event_of("catch", TRIGGERS["message"][0], roots=roots).definitions[0]
    assert isinstance(definition, MessageDefinition)
    assert definition.keys == (("order_id", Expression("msg.id", "python", 3)),)
