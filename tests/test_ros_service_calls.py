"""ROS services called by service tasks, and by scripts in Python and JavaScript: of the drone, and of a node."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import extensions, process, properties
from grounds import Ground

import fame
from fame.bpmn import read_text
from fame.clock import SECOND
from fame.errors import ModelError
from fame.scenario import Scenario

ACTION = "tello_msgs/srv/TelloAction"
FLOW = '<startEvent id="s"/>' + "".join(
    f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ("st", "te")
)
WORLD = """model: mission.bpmn
world:
  size: [6, 4]
  robots:
    Drone: {type: drone, at: [2, 2]}
"""


def asked(task: str, said: Any = None, **variables: Any) -> fame.Instance:
    """Run a process of one task on a robot beside a node that offers tello_action; `said` hears the requests."""
    simulation = fame.Simulation(
        read_text(process(f'{FLOW}{task}<endEvent id="e"/>'), file="m.bpmn"), variables=variables, robot="Drone"
    )
    heard: list[str] = [] if said is None else said
    node = simulation.middleware.node("driver", "Drone")
    node.service("tello_action", ACTION, lambda request: heard.append(request.cmd) or {"rc": 7})
    (instance,) = simulation.run().instances
    return instance


def service_task(inside: str = "", attributes: str = "", **said: str) -> str:
    written = {"service": "tello_action", "type": ACTION, "payload": "{cmd: ${cmd}}", **said}
    return f'<serviceTask id="t" {attributes}>{properties(**written)}{inside}</serviceTask>'


# ---- service tasks ---------------------------------------------------------------------------------------------------


def test_a_service_task_asks_and_keeps_the_response_under_the_name_of_the_service() -> None:
    heard: list[str] = []
    instance = asked(service_task(), heard, cmd="up")
    assert (instance.status, heard) == ("completed", ["up"])
    assert instance.variables["tello_action"].rc == 7


def test_the_result_variable_takes_the_response() -> None:
    assert asked(service_task(attributes='camunda:resultVariable="answer"'), cmd="up").variables["answer"].rc == 7


def test_the_data_object_at_its_output_takes_the_fields() -> None:
    arrow = '<dataOutputAssociation id="a"><targetRef>d</targetRef></dataOutputAssociation>'
    held = f'<dataObjectReference id="d" dataObjectRef="o">{properties(rc_tello="")}</dataObjectReference>'
    held += '<dataObject id="o"/>'
    assert asked(service_task(arrow) + held, cmd="up").variables["rc_tello"] == 7


@pytest.mark.parametrize("text", ["${msg.rc + 1}", "${rc + 1}", "=rc + 1"])
def test_an_output_mapping_finds_the_response(text: str) -> None:
    said = properties(service="tello_action", type=ACTION, payload="{cmd: up}").replace(
        "</extensionElements>",
        f'<camunda:inputOutput><camunda:outputParameter name="code">{text}</camunda:outputParameter>'
        "</camunda:inputOutput></extensionElements>",
    )
    variables = asked(f'<serviceTask id="t">{said}</serviceTask>').variables
    assert variables["code"] == 8
    assert "rc" not in variables


def test_beside_a_mapping_the_result_variable_takes_it_too() -> None:
    said = properties(service="tello_action", type=ACTION, payload="{cmd: up}").replace(
        "</extensionElements>",
        '<camunda:inputOutput><camunda:outputParameter name="code">${rc}</camunda:outputParameter>'
        "</camunda:inputOutput></extensionElements>",
    )
    variables = asked(f'<serviceTask id="t" camunda:resultVariable="answer">{said}</serviceTask>').variables
    assert (variables["code"], variables["answer"].rc) == (7, 7)


def test_the_web_modelers_form_asks_too() -> None:
    heard: list[str] = []
    said = f'<ros:service name="tello_action" type="{ACTION}"/><ros:payload data="{{cmd: land}}"/>'
    assert asked(f'<serviceTask id="t">{extensions(said)}</serviceTask>', heard).status == "completed"
    assert heard == ["land"]


def test_a_name_that_is_not_set_leaves_the_request_at_its_default() -> None:
    heard: list[str] = []
    assert asked(service_task(), heard).status == "completed"
    assert heard == [""]


def test_a_service_that_nobody_offers_is_an_error_that_events_catch() -> None:
    caught = '<boundaryEvent id="b" attachedToRef="t"><errorEventDefinition/></boundaryEvent>'
    instance = asked(service_task(service="nowhere") + caught, cmd="up")
    assert (instance.status, instance.visits["b"]) == ("completed", 1)
    failed = asked(service_task(service="nowhere"), cmd="up")
    assert failed.status == "failed"
    assert "no node offers the service /Drone/nowhere" in str(failed.error)


@pytest.mark.parametrize(
    ("said", "complaint"),
    [
        ({"type": ""}, "calls the service 'tello_action' without a type: expected the property type, pkg/srv/Name"),
        ({"type": "tello_msgs/srv/TeloAction"}, "no such service type; did you mean tello_msgs/srv/TelloAction?"),
    ],
)  # fmt: skip
def test_a_wrong_type_is_refused_before_anything_moves(said: dict[str, str], complaint: str) -> None:
    with pytest.raises(ModelError, match=complaint.replace("?", r"\?")) as caught:
        asked(service_task(**said))
    assert (caught.value.file, caught.value.element) == ("m.bpmn", "t")


# ---- scripts ---------------------------------------------------------------------------------------------------------

PYTHON = f'answer = (await robot.call("tello_action", "{ACTION}", cmd="takeoff")).rc'
JAVASCRIPT = f"""
const env = this.environment.variables, client = env.ros_node.createClient('{ACTION}', 'tello_action');
client.waitForService(1000).then(() => client.sendRequest({{cmd: 'takeoff'}}, (response) => {{
    env.answer = response.rc;
    next();
}}));"""


@pytest.mark.parametrize(("format", "text"), [("python", PYTHON), ("javascript", JAVASCRIPT)])
def test_scripts_ask_the_same_service(format: str, text: str) -> None:
    heard: list[str] = []
    task = f'<scriptTask id="t" scriptFormat="{format}"><script><![CDATA[{text}]]></script></scriptTask>'
    assert asked(task, heard).variables["answer"] == 7
    assert heard == ["takeoff"]


# ---- the drone -------------------------------------------------------------------------------------------------------


class Pilot:
    """Somebody who asks the drone of a field."""

    def __init__(self, ground: Ground) -> None:
        self.ground = ground
        ground.run(0)
        self.client = ground.middleware.node("pilot", "Drone").client("tello_action", ACTION)

    def ask(self, command: str) -> int:
        answers: list[int] = []
        self.client.call({"cmd": command}, lambda response: answers.append(response.rc))
        self.ground.run(self.ground.scheduler.now / SECOND + 0.1)
        return answers[0]


def test_the_drone_takes_off_and_lands_by_its_service() -> None:
    pilot = Pilot(Ground({"size": [12, 8], "robots": {"Drone": {"type": "drone", "at": [2, 4]}}}, 1))
    drone = pilot.ground.world.robots["Drone"]
    assert pilot.ask("flip f") == 0
    assert drone.status["landed"]
    assert pilot.ask("takeoff") == 1
    assert pilot.ask("land") == 3
    pilot.ground.run(5)
    assert drone.appearance.altitude == pytest.approx(1.5, abs=0.05)
    assert pilot.ask(" Land ") == 1
    pilot.ground.run(12)
    assert drone.status["landed"]
    drone.fault("rotors")
    assert pilot.ask("takeoff") == 2


def test_a_mission_flies_the_drone_by_service_tasks(tmp_path: Path) -> None:
    chain = ["start", "up", "pause", "look", "down", "rest", "end"]
    flow = "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(chain))
    named = f'<ros:service name="tello_action" type="{ACTION}"/>'
    asks = f'<serviceTask id="{{}}">{extensions(named + "{}")}</serviceTask>'
    tasks = asks.format("up", '<ros:payload data="{cmd: takeoff}"/>') + asks.format(
        "down", '<ros:payload><ros:parameter name="cmd:" value="land"/></ros:payload>'
    )
    look = 'assert robot.latest("odom", "nav_msgs/msg/Odometry").pose.pose.position.z > 1.4'
    tasks += f'<scriptTask id="look"><script><![CDATA[{look}]]></script></scriptTask>'
    waits = "<timerEventDefinition><timeDuration>PT5S</timeDuration></timerEventDefinition>"
    pauses = "".join(f'<intermediateCatchEvent id="{id}">{waits}</intermediateCatchEvent>' for id in ("pause", "rest"))
    ends = '<startEvent id="start"/><endEvent id="end"/>'
    (tmp_path / "mission.bpmn").write_text(process(flow + tasks + pauses + ends, attributes='name="Drone"'))
    (tmp_path / "mission.yaml").write_text(WORLD)
    result = Scenario.load(tmp_path / "mission.yaml").run()
    assert (result.status, result.messages) == ("completed", [])
    assert result.world["robots"]["Drone"]["landed"]
