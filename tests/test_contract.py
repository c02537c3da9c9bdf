"""The contract of a mission: its topics, services and actions, and what a running graph lacks of them."""

import json
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process
from check_drawing import call, data, given, script

from fame.bpmn import read, read_text
from fame.bpmn.library import Library
from fame.check.contract import ContractEndpoint, compare, contract_of
from fame.cli import main
from fame.clock import Scheduler
from fame.middleware.actions import ActionServer
from fame.middleware.interface import SENSOR_DATA
from fame.middleware.local import LocalMiddleware

MODELS = Path(__file__).parent.parent / "models"
SCAN = """
<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="c"/>
<intermediateCatchEvent id="c"><extensionElements><camunda:properties>
<camunda:property name="type" value="sensor_msgs/msg/Range"/><camunda:property name="scope" value="robot"/>
</camunda:properties></extensionElements><signalEventDefinition signalRef="R"/></intermediateCatchEvent>
<sequenceFlow id="g" sourceRef="c" targetRef="t"/><serviceTask id="t"><extensionElements><camunda:properties>
<camunda:property name="action" value="spin"/><camunda:property name="type" value="nav2_msgs/action/Spin"/>
</camunda:properties></extensionElements></serviceTask><sequenceFlow id="h" sourceRef="t" targetRef="x"/>
<scriptTask id="x" scriptFormat="python"><script>robot.publish("led", "std_msgs/msg/ColorRGBA", r=1.0)
await robot.call("grip", "std_srvs/srv/SetBool", data=True)</script></scriptTask>
"""


def contract() -> list[ContractEndpoint]:
    text = process(SCAN, root='<signal id="R" name="range"/>').replace("<process ", '<process name="REX" ', 1)
    return contract_of(read_text(text, file="m.bpmn"), Library())


def test_it_has_every_topic_service_and_action_with_type_direction_qos_and_robot() -> None:
    assert [str(one) for one in contract()] == [
        "m.bpmn: contract: REX calls the action /REX/spin, nav2_msgs/action/Spin",
        "m.bpmn: contract: REX calls the service /REX/grip, std_srvs/srv/SetBool",
        "m.bpmn: contract: REX publishes /REX/led, std_msgs/msg/ColorRGBA, reliable, keep last 100",
        "m.bpmn: contract: REX subscribes to /REX/range, sensor_msgs/msg/Range, reliable, keep last 100",
    ]


def test_a_topic_that_an_event_catches_and_a_script_publishes_is_in_it_in_both_directions() -> None:
    content = SCAN.replace('robot.publish("led", "std_msgs/msg/ColorRGBA", r=1.0)', 'signal("~/range")')
    text = process(content, root='<signal id="R" name="range"/>').replace("<process ", '<process name="REX" ', 1)
    ends = contract_of(read_text(text, file="m.bpmn"), Library())
    assert [(one.direction, one.type) for one in ends if one.full_name == "/REX/range"] == [
        ("publishes", "sensor_msgs/msg/Range"),
        ("subscribes to", "sensor_msgs/msg/Range"),
    ]


def test_called_processes_and_pools_of_many_robots_are_in_it() -> None:
    lines = [str(one) for one in contract_of(read(MODELS / "warehouse.bpmn"), Library())]
    assert any("Carrier calls the action /Carrier_<n>/navigate_to_pose, nav2_msgs/action/Nav" in one for one in lines)
    assert any("Dispatcher publishes /parcel_offered, geometry_msgs/msg/PoseArray" in one for one in lines)


class Graph:
    """A graph with a robot whose nodes have everything of `contract`, unless `without` names it."""

    def __init__(
        self, *without: str, range_type: str = "sensor_msgs/msg/Range", name: str = "REX", **options: Any
    ) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        node = self.middleware.node("driver", name)
        if "range" not in without:
            node.publisher("range", range_type, **options)
        if "led" not in without:
            node.subscription("led", "std_msgs/msg/ColorRGBA", lambda message: None)
        if "grip" not in without:
            node.service("grip", "std_srvs/srv/SetBool", lambda request: None)
        if "spin" not in without:
            ActionServer(node, "spin", "nav2_msgs/action/Spin", lambda goal: None, lambda goal: None)

    def findings(self) -> list[str]:
        found = compare(contract(), self.middleware, self.scheduler, 1.0)
        return [f"{one.level}: {one.text}" for one in found]


def test_a_graph_that_has_everything_has_no_findings() -> None:
    assert Graph().findings() == []
    assert Graph(name="rex").findings() == []  # as robots are named


@pytest.mark.parametrize(
    ("missing", "text"),
    [
        ("range", "error: no node publishes /REX/range (sensor_msgs/msg/Range)"),
        ("led", "warning: no node subscribes to /REX/led (std_msgs/msg/ColorRGBA)"),
        ("grip", "error: no node offers the service /REX/grip (std_srvs/srv/SetBool)"),
        ("spin", "error: no node offers the action /REX/spin (nav2_msgs/action/Spin)"),
    ],
)
def test_what_is_missing_is_named(missing: str, text: str) -> None:
    assert Graph(missing).findings() == [text]


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        (script("robot.publish('ran' + 'ge', 'sensor_msgs/msg/Range')", "u"), False),
        (script("robot.publish('rn' + 'ge', 'sensor_msgs/msg/Range')", "u"), True),
        (call("u", "ProcessingUnit", given("u", "unit")), False),
    ],
)
def test_what_the_mission_itself_may_publish_is_not_missing(
    content: str, missing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    port = "{Topic: range, Field: [range], MessageType: sensor_msgs/msg/Range}"
    Path("unit.yaml").write_text(
        f"Outputs: {{value: {port}}}\nProcessor: {{Class: Machine, Parameters: {{source: 'tcp://h:1'}}}}\n"
    )
    text = process(SCAN + content + data("unit", configuration="unit.yaml"), root='<signal id="R" name="range"/>')
    ends = contract_of(read_text(text.replace("<process ", '<process name="REX" ', 1), file="m.bpmn"), Library())
    graph = Graph("range")
    found = [one.text for one in compare(ends, graph.middleware, graph.scheduler, 0.1)]
    assert found == (["no node publishes /REX/range (sensor_msgs/msg/Range)"] if missing else [])


def test_incompatible_qos_is_an_error() -> None:
    (text,) = Graph(qos=SENSOR_DATA).findings()
    assert text.startswith("error: /REX/range: /REX/fame_check receives nothing from /REX/driver")


def test_another_type_is_an_error() -> None:
    (text,) = Graph(range_type="std_msgs/msg/Float32").findings()
    assert "/REX/range" in text
    assert "std_msgs/msg/Float32" in text


def test_the_command_prints_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explain", "--json", str(MODELS / "warehouse.bpmn")]) == 0
    rows = json.loads(capsys.readouterr().out)["contract"]
    assert {"dock_robot", "load"} <= {row["name"].rpartition("/")[2] for row in rows}
    assert {row["qos"] for row in rows if row["direction"].startswith("calls")} == {None}
