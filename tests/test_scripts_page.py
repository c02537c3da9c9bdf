"""What docs/scripts.md says of scripts and expressions is what they find."""

import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from bpmn_text import document, process

from fame.bpmn import read_text
from fame.cli import main
from fame.scripting import NAMES, Robot
from fame.scripting.juel import JUEL
from fame.simulation import Simulation

PAGE = (Path(__file__).parent.parent / "docs" / "scripts.md").read_text("utf-8")
SPANS = set(re.findall(r"`([^`]+)`", PAGE))


@pytest.mark.parametrize("name", NAMES)
def test_it_names_what_scripts_find(name: str) -> None:
    assert any(re.match(rf"(await |raise )?{name}\b", span) or f" {name}." in span for span in SPANS)


@pytest.mark.parametrize("name", [name for name in dir(Robot) if not name.startswith("_")])
def test_it_names_what_the_robot_has(name: str) -> None:
    assert any(f"robot.{name}" in span for span in SPANS)


def test_a_script_knows_the_time_of_the_mission() -> None:
    script = "<script>a = robot.now\nawait sleep(2.5)\nb = robot.now</script>"
    content = f"""<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
    <scriptTask id="t">{script}</scriptTask>"""
    variables = Simulation(read_text(process(content))).run().instances[0].variables
    assert (variables["a"], variables["b"]) == (0.0, 2.5)


def test_a_script_knows_the_date_of_the_mission() -> None:
    content = """<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
    <scriptTask id="t"><script>await sleep(90)
date = robot.date</script></scriptTask>"""
    epoch = datetime(2026, 3, 1, 23, 59, tzinfo=UTC)
    variables = Simulation(read_text(process(content)), epoch=epoch).run().instances[0].variables
    assert variables["date"] == datetime(2026, 3, 2, 0, 0, 30, tzinfo=UTC)
    assert Simulation(read_text(process(content))).run().instances[0].variables["date"].year == 1970


def test_the_functions_of_expressions_are_those_that_there_are() -> None:
    text = PAGE[PAGE.index("Functions are") : PAGE.index("Methods of")]
    assert set(re.findall(r"`([a-z]+)`", text)) == set(JUEL.functions) - {"cycle", "duration"}


@pytest.mark.parametrize("percentage", [0.1, 0.3])
@pytest.mark.parametrize("charging", [False, True])
def test_one_condition_means_the_same_in_four_languages(percentage: float, charging: bool) -> None:
    pytest.importorskip("quickjs")
    rows = re.findall(r"^\| .* \| `(.*charging\)?\}?)` \|", PAGE, re.MULTILINE)
    languages = ["", "javascript", "", ""]
    assert len(rows) == len(languages)
    for text, language in zip(rows, languages, strict=True):
        variables = {"percentage": percentage, "charging": charging}
        assert holds(text, variables, language) is (percentage < 0.2 and not charging), text


def holds(condition: str, variables: dict, language: str = "") -> bool:
    """Whether a gateway takes the flow with this condition."""
    text = condition.replace("&", "&amp;").replace("<", "&lt;")
    attribute = f' language="{language}"' if language else ""
    content = f"""<startEvent id="s"/><exclusiveGateway id="g" default="no"/><task id="t"/><task id="e"/>
    <sequenceFlow id="f" sourceRef="s" targetRef="g"/><sequenceFlow id="no" sourceRef="g" targetRef="e"/>
    <sequenceFlow id="yes" sourceRef="g" targetRef="t"><conditionExpression{attribute}>{text}</conditionExpression>
    </sequenceFlow>"""
    return Simulation(read_text(process(content)), variables=variables).run().instances[0].visits["t"] == 1


@pytest.mark.parametrize(
    ("condition", "true"),
    [
        ("len(ready) == 5 and not late", False),
        ("${x > 3 ? true : false}", True),
        ("${x > 3 and not empty ready}", True),
        ("${name.startsWith('Tractor') && ready.size() == 2}", True),
        ("${count(ready) == 2}", True),
        ("=count(ready) = 2", True),
        ('=(if x > 3 then "far" else "near") = "far"', True),
        ("=nothing = null", True),
    ],
)
def test_its_expressions_mean_what_it_says(condition: str, true: bool) -> None:
    variables = {"ready": ["a", "b"], "late": False, "x": 4, "name": "Tractor_1"}
    assert holds(condition, variables) == true


OWN = """<collaboration id="c"><participant id="p" name="PICKER" processRef="a"/>
<participant id="q" name="CARRIER" processRef="b"/></collaboration><signal id="x" name="load"/>
<process id="a"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/><scriptTask id="t"><script>
import weighing
{assignment}</script></scriptTask><sequenceFlow id="g" sourceRef="t" targetRef="e"/><endEvent id="e"><extensionElements>
<camunda:properties><camunda:property name="type" value="{type}"/><camunda:property name="payload" value="{payload}"/>
</camunda:properties></extensionElements><signalEventDefinition signalRef="x"/></endEvent></process>
<process id="b"><startEvent id="s2"><extensionElements><camunda:inputOutput>
<camunda:outputParameter name="mass">{output}</camunda:outputParameter></camunda:inputOutput></extensionElements>
<signalEventDefinition signalRef="x"/></startEvent>
</process>"""


def test_own_types_and_modules_are_found_as_their_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parent.parent / "docs" / "own_code.md").read_text("utf-8")
    spans = re.findall(r"`([^`\n]+)`", page)
    for name, text in re.findall(r"`([\w/]+\.(?:msg|py))`[^`]*:\n\n```\w+\n(.*?)```", page, re.DOTALL):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    after = {
        word: next(span for span in spans if span.startswith(word)) for word in ("farm_msgs/msg/", "{parcel", "${msg")
    }
    type, payload, output = after.values()
    assignment = next(span for span in spans if span.startswith("mass = "))
    model = OWN.format(assignment=assignment, type=type, payload=payload, output=output)
    (tmp_path / "mission.bpmn").write_text(document(model))
    monkeypatch.syspath_prepend(str(tmp_path))
    log = tmp_path / "run.csv"
    assert main(["run", str(tmp_path / "mission.bpmn"), "--types", str(tmp_path / "msgs"), "--log", str(log)]) == 0
    assert "CARRIER" in log.read_text()
