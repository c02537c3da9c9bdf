"""Mission parameters in an exploration: each robot starts with its own, as in a run."""

from pathlib import Path

import pytest
from bpmn_text import document

from fame.check.explore import Exploration
from fame.scenario import Scenario
from fame.scenario.explore.exploration import explore
from fame.testing import MissionLoader

DATA = """
<dataObjectReference id="Ref" dataObjectRef="Speed"><extensionElements><camunda:properties>
<camunda:property name="speed" value="1"/></camunda:properties></extensionElements></dataObjectReference>
<dataObject id="Speed"/>"""
READS = '<dataInputAssociation id="In"><sourceRef>Ref</sourceRef></dataInputAssociation>'
RACE = 'properties: {calm: never T starts "Race", slow: always T.y < 50}'


def scenario(folder: Path, variables: str, *, data: bool, properties: str = RACE) -> Path:
    """Robots T_1 and T_2 that race, and then wait forever at a join, if their speed is above 2."""
    (folder / "m.bpmn").write_text(
        document(f"""
<collaboration id="C"><participant id="Pool" name="T" processRef="P"><participantMultiplicity minimum="2"/>
</participant></collaboration>
<process id="P" isExecutable="true">{DATA if data else ""}
<startEvent id="Begin"/><sequenceFlow id="f0" sourceRef="Begin" targetRef="Wait"/>
<intermediateCatchEvent id="Wait"><timerEventDefinition id="D"><timeDuration>PT1S</timeDuration></timerEventDefinition>
</intermediateCatchEvent><sequenceFlow id="f1" sourceRef="Wait" targetRef="Init"/>
<scriptTask id="Init" scriptFormat="python">{READS if data else ""}<script>y = speed * 2</script></scriptTask>
<sequenceFlow id="f2" sourceRef="Init" targetRef="Gate"/><exclusiveGateway id="Gate" default="f4"/>
<sequenceFlow id="f3" sourceRef="Gate" targetRef="Race"><conditionExpression>speed &gt; 2</conditionExpression>
</sequenceFlow><scriptTask id="Race" name="Race" scriptFormat="python"><script>z = 1</script></scriptTask>
<sequenceFlow id="f4" sourceRef="Gate" targetRef="End"/><endEvent id="End"/>
<sequenceFlow id="f5" sourceRef="Race" targetRef="Both"/><parallelGateway id="Both" name="Both"/>
<sequenceFlow id="f6" sourceRef="End0" targetRef="Both"/><scriptTask id="End0" scriptFormat="python"><script>y = 1
</script></scriptTask><sequenceFlow id="f7" sourceRef="Gate" targetRef="End0">
<conditionExpression>speed &gt; 1000</conditionExpression></sequenceFlow>
<sequenceFlow id="f8" sourceRef="Both" targetRef="End2"/><endEvent id="End2"/></process>"""),
        encoding="utf-8",
    )
    path = folder / "s.yaml"
    path.write_text(f"model: m.bpmn\nduration: 20\nvariables: {variables}\n{properties}\n", encoding="utf-8")
    return path


def verdicts(found: Exploration) -> dict[str, str]:
    return {one.name: one.verdict for one in found.properties}


@pytest.mark.parametrize("data", [True, False])
@pytest.mark.parametrize("fast", ["T_1", "T_2", ""])
def test_a_robot_is_explored_with_its_own_parameters(tmp_path: Path, fast: str, data: bool) -> None:
    speeds = {robot: 99 if robot == fast else 2 for robot in ("T_1", "T_2")}
    path = scenario(tmp_path, f"{{T_1: {{speed: {speeds['T_1']}}}, T_2: {{speed: {speeds['T_2']}}}}}", data=data)
    found = explore(path)
    assert found.exhaustive
    assert verdicts(found) == dict.fromkeys(("calm", "slow"), "refuted" if fast else "proved")
    assert [one.robots for one in found.findings if one.kind == "deadlock"] == ([(fast,)] if fast else [])
    assert not [one for one in found.findings if one.kind == "error"]


@pytest.mark.parametrize("data", [True, False])
@pytest.mark.parametrize("speed", [2, 99])
def test_a_parameter_of_all_robots_is_explored(tmp_path: Path, speed: int, data: bool) -> None:
    found = explore(scenario(tmp_path, f"{{speed: {speed}}}", data=data))
    assert verdicts(found) == dict.fromkeys(("calm", "slow"), "refuted" if speed > 2 else "proved")
    assert found.local.keys() == {"T_1"}  # nothing tells the two apart


def test_a_run_and_the_exploration_agree_on_what_only_one_robot_does(tmp_path: Path) -> None:
    path = scenario(tmp_path, "{T_1: {speed: 99}}", data=True)
    run = {one.name for one in Scenario.load(path).run().judgements if one.verdict == "violated"}
    assert run == {name for name, verdict in verdicts(explore(path)).items() if verdict == "refuted"}


@pytest.mark.parametrize("data", [True, False])
def test_a_found_run_is_played_with_the_parameters(tmp_path: Path, mission: MissionLoader, data: bool) -> None:
    m = mission.by_hand(scenario(tmp_path, "{T_1: {speed: 99}, T_2: {speed: 2}}", data=data, properties=""))
    m.fire("T_1", "Wait").fire("T_2", "Wait")
    m.expect("T_2").completed(within=1)
    m.expect("T_1").waits_at("Both")


SHARED = """
<signal id="S" name="go"/><process id="P" isExecutable="true">
<startEvent id="Begin"><signalEventDefinition id="D" signalRef="S"/></startEvent>
<sequenceFlow id="f1" sourceRef="Begin" targetRef="Take"/>
<scriptTask id="Take" scriptFormat="python"><script>x = todo.pop()</script></scriptTask>
<sequenceFlow id="f2" sourceRef="Take" targetRef="End"/><endEvent id="End"/></process>"""


def test_a_list_that_instances_share_is_unknown(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(document(SHARED), encoding="utf-8")
    path = tmp_path / "s.yaml"
    path.write_text("model: m.bpmn\nvariables: {todo: [1]}\nproperties: {one: always P.x == 1}\n", encoding="utf-8")
    assert verdicts(explore(path, delivery="run")) == {"one": "not known"}
