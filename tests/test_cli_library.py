"""``fame library``: what it lists is what the files draw, and what their documentation says."""

import json
import re
from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import extensions, process

from fame.bpmn.library import BUILT_IN
from fame.check.library import Behaviour, behaviours
from fame.cli import main
from fame.cli.models import paragraphs

KNOWN = {behaviour.name: behaviour for behaviour in behaviours()}


def data(id: str, **values: str) -> str:
    """A data object that holds variables."""
    held = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in values.items())
    properties = extensions(f"<camunda:properties>{held}</camunda:properties>")
    reference = f'<dataObjectReference id="{id}" dataObjectRef="{id}_o">{properties}</dataObjectReference>'
    return f'{reference}<dataObject id="{id}_o"/>'


def task(id: str, script: str, *, reads: str = "", sets: str = "") -> str:
    """A script task with data associations."""
    ins = f'<dataInputAssociation id="{id}_i"><sourceRef>{reads}</sourceRef></dataInputAssociation>' if reads else ""
    outs = f'<dataOutputAssociation id="{id}_u"><targetRef>{sets}</targetRef></dataOutputAssociation>' if sets else ""
    return f'<scriptTask id="{id}">{ins}{outs}<script>{script}</script></scriptTask>'


def flows(*ids: str) -> str:
    return "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


def behaviour(tmp_path: Path, content: str, name: str = "Dig") -> Behaviour:
    """The one that a file of its own draws."""
    (tmp_path / f"{name}.bpmn").write_text(process(content).replace('id="P"', f'id="{name}"'))
    return next(one for one in behaviours([tmp_path]) if one.name == name)


def test_every_file_of_the_library_is_listed_once_by_name() -> None:
    assert list(KNOWN) == sorted(path.stem for folder in BUILT_IN for path in folder.glob("*.bpmn"))


@pytest.mark.parametrize("name", KNOWN)
def test_the_inputs_are_those_that_the_documentation_says_are_needed(name: str) -> None:
    needs = [text for text in paragraphs(KNOWN[name].documentation) if text.startswith("Needs: ")]
    bare = re.sub(r"\([^)]*\)", "", needs[0].removeprefix("Needs: ")) if needs else ""
    words = re.findall(r"\b[a-z][a-z_]*\b", re.sub(r"and what \w+ needs|\band\b", "", bare))
    assert sorted(KNOWN[name].inputs) == sorted(words)


@pytest.mark.parametrize("name", KNOWN)
def test_its_own_topics_are_in_the_documentation(name: str) -> None:
    for topic in KNOWN[name].topics:
        assert re.search(rf"\b{topic.name.lstrip('~/')}\b", KNOWN[name].documentation), topic
        assert topic.type


def test_a_variable_is_needed_only_if_it_is_read_before_it_is_set(tmp_path: Path) -> None:
    objects = data("Hole", depth="", width="") + data("Fixed", speed="0.5")
    begin = task("a", "depth = width + speed", reads="Fixed")
    nodes = f'<startEvent id="s"/>{begin}{task("b", "rest = depth")}<endEvent id="e"/>'
    assert behaviour(tmp_path, objects + nodes + flows("s", "a", "b", "e")).inputs == ("width",)


@pytest.mark.parametrize(
    ("language", "text"),
    [("python", "if True:\n    depth += 1"), ("javascript", "this.environment.variables.depth.push(1); next()")],
)
def test_a_variable_that_a_script_changes_is_needed(language: str, text: str, tmp_path: Path) -> None:
    nodes = f'<startEvent id="s"/>{task("a", text)}'.replace("<scriptTask", f'<scriptTask scriptFormat="{language}"')
    assert behaviour(tmp_path, data("Hole", depth="") + nodes + flows("s", "a")).inputs == ("depth",)


def test_a_variable_that_only_one_way_sets_is_needed(tmp_path: Path) -> None:
    nodes = '<startEvent id="s"/><exclusiveGateway id="g"/>' + task("a", "depth = 1") + task("b", "rest = depth")
    drawn = data("Hole", depth="") + nodes + flows("s", "g", "a", "b") + flows("g", "b")
    assert behaviour(tmp_path, drawn).inputs == ("depth",)


def test_what_a_script_counts_up_is_needed_and_what_it_sets_first_is_not(tmp_path: Path) -> None:
    nodes = '<startEvent id="s"/>' + task("a", "count = count + 1\nlast = 3\nbest = last")
    assert behaviour(tmp_path, data("D", count="", last="", best="") + nodes + flows("s", "a")).inputs == ("count",)


def test_what_a_called_behaviour_sets_is_not_needed(tmp_path: Path) -> None:
    behaviour(
        tmp_path, data("D", depth="") + '<startEvent id="s"/>' + task("a", "depth = 2") + flows("s", "a"), "Probe"
    )
    nodes = '<startEvent id="s"/><callActivity id="c" calledElement="Probe"/>' + task("b", "rest = depth")
    found = behaviour(tmp_path, data("D", depth="") + nodes + flows("s", "c", "b"))
    assert (found.inputs, found.calls) == ((), ("Probe",))


def test_a_folder_hides_the_behaviours_of_fame(tmp_path: Path) -> None:
    found = behaviour(tmp_path, '<startEvent id="s"/>', "GoTo")
    assert found.file == str(tmp_path / "GoTo.bpmn")


def test_behaviours_are_listed_by_the_id_that_a_call_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = process('<startEvent id="s"/>').replace('id="P"', 'id="Explore"')
    (tmp_path / "my_explore.bpmn").write_text(two)
    (tmp_path / "other.bpmn").write_text(two)
    found = [(one.name, Path(one.file).name) for one in behaviours([tmp_path]) if Path(one.file).parent == tmp_path]
    assert found == [("Explore", "my_explore.bpmn"), ("Explore", "other.bpmn")]
    (tmp_path / "other.bpmn").unlink()
    assert main(["library", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert f"Explore\n  file  {tmp_path / 'my_explore.bpmn'}\n" in out
    assert "\n  file  GoTo.bpmn\n" in out
    assert main(["templates", "-o", str(tmp_path / "out"), "--library", str(tmp_path)]) == 0
    calls = json.loads((tmp_path / "out" / "library.json").read_text())
    assert [one["id"] for one in calls].count("fame.call.Explore") == 1
    assert "my_explore" not in (tmp_path / "out" / "library.json").read_text()


def test_a_person_reads_what_each_needs_subscribes_to_and_publishes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["library"]) == 0
    out = capsys.readouterr().out
    text = next(block for block in out.split("\n\n") if block.startswith("FlyTo: Fly To\n"))
    assert text.splitlines()[-3:] == [
        "  needs  x_goal, y_goal",
        "  publishes  ~/cmd_vel  geometry_msgs/msg/Twist",
        "  subscribes  ~/odom     nav_msgs/msg/Odometry",
    ]
    assert max(map(len, out.splitlines())) <= 110


def test_a_machine_reads_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["library", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["behaviours"]
    assert [one["name"] for one in told] == list(KNOWN)
    (turn,) = [one for one in told if one["name"] == "Turn"]
    assert turn["inputs"] == ["angle"]
    assert {"name": "~/odom", "type": "nav_msgs/msg/Odometry", "direction": "subscribe"} in turn["topics"]


def test_a_folder_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["library", "nowhere"]) == 2
    assert capsys.readouterr().err == "fame: error: nowhere: there is no such folder\n"
