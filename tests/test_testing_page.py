"""docs/testing.md is true: its three tests run on the mission of docs/tutorial.md, and the third fails first."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fame.testing import MissionLoader

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
TESTS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
WORLD = next(text for text in re.findall(r"```yaml\n(.*?)```", TUTORIAL, re.DOTALL) if "patrol.bpmn" in text)
MODEL = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"
  xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="t"><collaboration id="c">
<participant id="A" name="SCOUT" processRef="P"/><participant id="B" name="HELPER" processRef="Q"/></collaboration>
<process id="P" isExecutable="true"><startEvent id="s"/><callActivity id="g" name="Go To" calledElement="GoTo">
<property id="p" name="__targetRef_placeholder"/><dataInputAssociation id="i"><sourceRef>d</sourceRef>
<targetRef>p</targetRef></dataInputAssociation></callActivity><scriptTask id="l" name="Green light"
scriptFormat="python"><script>LIGHT</script></scriptTask><endEvent id="e">PROPERTIES<signalEventDefinition id="x"
signalRef="arrived"/></endEvent><sequenceFlow id="f1" sourceRef="s" targetRef="g"/><sequenceFlow id="f2" sourceRef="g"
targetRef="l"/><sequenceFlow id="f3" sourceRef="l" targetRef="e"/>MENDED<dataObjectReference id="d" name="goal"
dataObjectRef="o">GOAL</dataObjectReference><dataObject id="o"/></process><process id="Q" isExecutable="true">
<startEvent id="t"><dataOutputAssociation id="j"><targetRef>h</targetRef></dataOutputAssociation>
<signalEventDefinition id="y" signalRef="arrived"/></startEvent><callActivity id="k" name="Go To" calledElement="GoTo"/>
<endEvent id="z"/><sequenceFlow id="f4" sourceRef="t" targetRef="k"/><sequenceFlow id="f5" sourceRef="k" targetRef="z"/>
<dataObjectReference id="h" name="place" dataObjectRef="u">PLACE</dataObjectReference><dataObject id="u"/></process>
<signal id="arrived" name="arrived"/></definitions>"""
MENDED = """<boundaryEvent id="n" attachedToRef="g"><errorEventDefinition id="w" errorRef="r"/></boundaryEvent>
<scriptTask id="q" name="Red light" scriptFormat="python"><script>RED</script></scriptTask><endEvent id="v"/>
<sequenceFlow id="f6" sourceRef="n" targetRef="q"/><sequenceFlow id="f7" sourceRef="q" targetRef="v"/>"""


def properties(**named: str) -> str:
    inside = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in named.items())
    return f"<extensionElements><camunda:properties>{inside}</camunda:properties></extensionElements>"


def tutorial(*, mended: bool) -> str:
    """The mission of the tutorial, and with the change that docs/testing.md describes."""
    (light,) = re.findall(r"```python\n(.*?)```", TUTORIAL, re.DOTALL)
    red = re.search(r"script\s+`(robot\.publish\([^`]*r=1\.0\))`", PAGE)
    assert red is not None
    model = MODEL.replace("MENDED", MENDED.replace("RED", red[1]) if mended else "").replace("LIGHT", light.strip())
    if mended:
        model = model.replace("<signal ", '<error id="r" errorCode="unreachable"/><signal ', 1)
    said = properties(type="geometry_msgs/msg/Vector3", payload="{x: ${x_goal}, y: ${y_goal}}")
    model = model.replace("PROPERTIES", said).replace("GOAL", properties(x_goal="4.5", y_goal="1.0"))
    return model.replace("PLACE", properties(x_goal="", y_goal=""))


@pytest.mark.long
@pytest.mark.parametrize(("mended", "outcome"), [(False, "1 failed, 2 passed"), (True, "3 passed")])
def test_the_tests_of_the_page_end_as_it_says(tmp_path: Path, mended: bool, outcome: str) -> None:
    (tmp_path / "patrol.bpmn").write_text(tutorial(mended=mended))
    (tmp_path / "patrol.yaml").write_text(WORLD)
    (tmp_path / "test_patrol.py").write_text(TESTS)
    code = "import sys; from fame.cli import main; sys.exit(main(['test', 'test_patrol.py', '--cov-model']))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert outcome in done.stdout, done.stdout + done.stderr
    assert done.returncode == (0 if mended else 1)  # also: no crash when the process of pytest ends
    assert ("error unreachable was not caught" in done.stdout) is not mended
    if mended:
        assert "total: 100.0 %" in done.stdout


def test_the_test_by_hand_of_the_page_passes(tmp_path: Path, mission: MissionLoader) -> None:
    (tmp_path / "patrol.bpmn").write_text(tutorial(mended=True))
    names: dict[str, Any] = {}
    exec(re.findall(r"```python\n(def test_a_lost_signal.*?)```", PAGE, re.DOTALL)[0], names)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        names["test_a_lost_signal"](mission)
