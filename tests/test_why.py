"""Why a token waits: the condition and its values; the topic, who publishes, why its last message did not count."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from bpmn_text import process

from fame.errors import DeploymentError
from fame.log.live_team import LiveTeam
from fame.log.wait_reasons import explain
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA
from tests.test_live_team import Field

SIGNALS = '<signal id="S" name="order"/><message id="M" name="part"/>'
START = '<startEvent id="Start"/><sequenceFlow id="f0" sourceRef="Start" targetRef="{0}"/>'
STRING = "std_msgs/msg/String"


@pytest.fixture
def field() -> Iterator[Field]:
    field = Field()
    yield field
    for engine in field.engines:
        engine.close()
    field.middleware.close()


def why(field: Field, text: str, element: str = "", before: str = "") -> list[str]:
    """What is said of a robot that runs this."""
    field.engine("REX")
    with LiveTeam(field.middleware.node("watcher"), field.middleware, field.scheduler, lambda *told: None) as team:
        field.run(1)
        field.deploy("REX", process(text, SIGNALS))
        field.run(1)
        if before:
            field.middleware.node("shop").publisher("/order", STRING).publish(messages.create(STRING, before))
        field.run(6)
        state = team.state.robots["REX"]
        lines = [
            line
            for reason in explain(state, team.models["REX"], element, team.last_time("REX"))
            for line in reason.lines("REX")
        ]
    return lines


def test_a_condition_is_told_with_the_values_that_it_reads(field: Field) -> None:
    lines = why(
        field,
        START.format("Set")
        + """<scriptTask id="Set"><script>battery = 55.5</script></scriptTask>
        <sequenceFlow id="f1" sourceRef="Set" targetRef="Low"/>
        <intermediateCatchEvent id="Low" name="battery low"><conditionalEventDefinition>
        <condition>battery &lt; limit</condition></conditionalEventDefinition></intermediateCatchEvent>""",
    )
    assert lines[0].startswith('REX waits at "battery low" (Low), for ')
    assert lines[1:] == ["  condition battery < limit is not true:", "    battery = 55.5", "    limit is not set"]


CATCH = (
    START.format("Sleep")
    + """
  <intermediateCatchEvent id="Sleep"><timerEventDefinition><timeDuration>PT3S</timeDuration></timerEventDefinition>
  </intermediateCatchEvent><sequenceFlow id="f1" sourceRef="Sleep" targetRef="Order"/>
  <intermediateCatchEvent id="Order" name="order comes"><extensionElements><camunda:properties>
  <camunda:property name="type" value="std_msgs/msg/String"/></camunda:properties></extensionElements>
  <signalEventDefinition signalRef="S"/></intermediateCatchEvent>"""
)


def test_a_topic_that_nobody_publishes_is_told(field: Field) -> None:
    lines = why(field, CATCH, "order comes")
    assert lines[1:] == ["  /order has no publisher", "  no message has come since the token waits"]


def test_a_message_that_came_too_early_is_told_with_its_publisher(field: Field) -> None:
    lines = why(field, CATCH, "Order", before="seven bolts")
    assert lines[1] == "  /order is published by /shop"
    assert "did not count: nothing waited for it then" in lines[2]


def test_a_publisher_that_is_not_connected_is_told_with_the_reason(field: Field) -> None:
    field.middleware.node("shop").publisher("/order", STRING, SENSOR_DATA)
    why_not = "/REX/fame_engine receives nothing from /shop: reliability: offered best_effort, requested reliable"
    lines = why(field, CATCH, "Order")
    assert lines[1:3] == ["  /order is published by /shop", f"  /order: {why_not}"]


def test_an_element_where_no_token_waits_is_refused(field: Field) -> None:
    with pytest.raises(DeploymentError, match="no token waits at 'Ordr'; did you mean 'Order'"):
        why(field, CATCH, "Ordr")
