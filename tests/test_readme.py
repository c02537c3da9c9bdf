"""What README and docs say is true: commands exist, Python runs, links lead somewhere."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from fame import cli
from fame.rooms import COMMANDS
from sim2d.robot import BUILT_IN

ROOT = Path(__file__).parent.parent
DOCS = sorted((ROOT / "docs").glob("*.md"))
parser = cache(cli.parser)


def read(name: str) -> str:
    """What people have written of a page: without the reference, which tests/test_docs.py compares with the code."""
    return re.sub(r"<!-- generated.*?<!-- end -->", "", (ROOT / name).read_text("utf-8"), flags=re.DOTALL)


def blocks(name: str, language: str) -> list[str]:
    """The code blocks at the margin of a page."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", read(name), re.MULTILINE | re.DOTALL)
    return [text for kind, text in found if kind == language]


def commands(page: str) -> list[str]:
    lines = [line.strip() for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    return [re.sub(r"( &)?( +#.*)?$", "", line) for line in lines if line.startswith("fame ")]


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))], ids=lambda page: str(page.relative_to(ROOT))
)
def test_the_commands_of_a_page_exist_and_so_do_their_files(page: Path) -> None:
    told = [
        shlex.split(command)
        for command in commands(
            read(str(page.relative_to(ROOT))).replace("wlan0", "127.0.0.1").replace("eth0", "127.0.0.1")
        )
    ]
    for words in told:
        arguments = parser().parse_args(words[1:])
        assert arguments.command
        assert getattr(arguments, "type", None) in {None, *BUILT_IN}
    files = {word for words in told for word in words if word.startswith(("models/", "examples/"))}
    assert {name for name in files if not (ROOT / name).is_file()} == set()


TEAM = (*COMMANDS["team"], "team", "topic", "param")
EXTRA_OF = {"campaign": "campaign", "test": "test", "view": "view", "router": "zenoh", "keys": "dds", "demo": "sim"}


def extras_needed(words: list[str]) -> Iterator[str]:
    """The extras without which a command cannot do what a page says."""
    name, part = words[1], words[2] if len(words) > 2 else ""
    if (name in TEAM and name not in EXTRA_OF) or (name, part) in {("log", "record"), ("monitor", "record")}:
        chosen = words[words.index("--middleware") + 1] if "--middleware" in words else "dds"
        yield from () if chosen == "ros" else (chosen,)
    if name == "monitor" and part in ("train", "judge", "model", "adm"):
        yield "ml"
    if name in ("run", "draw", "world", "campaign") and not any(word.endswith(".bpmn") for word in words):
        yield "sim"
    if name in EXTRA_OF:
        yield EXTRA_OF[name]
    if "--metrics" in words:
        yield "metrics"


@pytest.mark.parametrize("page", ["README.md", "examples/README.md", *(f"docs/{path.name}" for path in DOCS)])
def test_a_page_names_the_extras_that_its_commands_need(page: str) -> None:
    named = {extra for each in re.findall(r"\[([a-z,]+)\]['\"]", read(page)) for extra in each.split(",")}
    needed = {extra for command in commands(read(page)) for extra in extras_needed(shlex.split(command))}
    assert needed - named - ({"dds"} if "zenoh" in named else set()) == set()


RESULTS = re.compile(r"(performance|\w+_results|detector_comparison|exploration_examples)")
"""Pages of what was measured."""
MARK = re.compile(r"\[✓\]\(\S+\)")
"""A link to the test of a rule, no word: test_semantics_page.py compares them with the tests."""
BUDGET = 55_000
"""Words of all pages that people have written of docs, README and examples/README: more are not kept true."""


def test_a_page_is_read_in_ten_minutes() -> None:
    """What people have written of it: tables of the reference are looked up."""
    assert len(read("README.md").split()) <= 610
    words = {page.name: len(read(f"docs/{page.name}").split()) for page in DOCS}
    assert {name: count for name, count in words.items() if count > (2000 if RESULTS.match(name) else 1500)} == {}


def test_there_are_not_more_words_than_are_kept_true() -> None:
    pages = ["README.md", "examples/README.md", *(f"docs/{page.name}" for page in DOCS if not RESULTS.match(page.name))]
    assert sum(len(MARK.sub("", read(page)).split()) for page in pages) <= BUDGET


@pytest.mark.long
def test_the_python_of_the_page_runs_and_gives_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    (code,) = blocks("docs/python.md", "python")
    names: dict = {}
    exec(compile(code, "python.md", "exec"), names)
    (instance,) = names["sim"].instances
    assert (instance.status, instance.error, names["sim"].now) == ("running", None, 1.0)
    assert instance.variables["x_target"] == 2.0
    assert list(instance.waiting) == ["Gateway_Answer"]
    assert names["result"].status == "completed"


def test_the_tree_of_errors_is_that_of_the_code() -> None:
    import fame.errors

    (tree,) = [block for block in blocks("docs/python.md", "") if block.startswith("FameError")]
    assert tree.splitlines() == [
        line[4:] for line in (fame.errors.__doc__ or "").split("::\n\n")[1].partition("\n\n")[0].splitlines()
    ]


def test_the_mission_that_the_tutorial_draws_completes(tmp_path: Path) -> None:
    """The files that somebody gets who follows its steps."""
    from fame.cli import main

    (scenario,) = re.findall(r"```yaml\n(.*?)```", read("docs/tutorial.md"), re.DOTALL)
    (tmp_path / "patrol.yaml").write_text(re.sub(r"^   ", "", scenario, flags=re.MULTILINE))
    (tmp_path / "patrol.bpmn").write_text(PATROL)
    assert main(["check", str(tmp_path / "patrol.bpmn")]) == 0
    assert main(["run", str(tmp_path / "patrol.yaml"), "--quiet"]) == 0


PATROL = """\
<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"
             xmlns:camunda="http://camunda.org/schema/1.0/bpmn" id="D" targetNamespace="http://bpmn.io/schema/bpmn">
  <collaboration id="C">
    <participant id="Scout" name="SCOUT" processRef="A"/><participant id="Helper" name="HELPER" processRef="B"/>
  </collaboration>
  <process id="A" isExecutable="true">
    <startEvent id="a1"/>
    <callActivity id="a2" name="Go To" calledElement="GoTo">
      <property id="a2p" name="__targetRef_placeholder"/>
      <dataInputAssociation id="a2i"><sourceRef>a5</sourceRef><targetRef>a2p</targetRef></dataInputAssociation>
    </callActivity>
    <scriptTask id="a3" name="Beep" scriptFormat="python">
      <script>robot.publish("led", "std_msgs/msg/ColorRGBA", g=1.0)</script>
    </scriptTask>
    <endEvent id="a4" name="arrived">
      <extensionElements><camunda:properties>
        <camunda:property name="type" value="geometry_msgs/msg/Vector3"/>
        <camunda:property name="payload" value="{x: ${x_goal}, y: ${y_goal}}"/>
      </camunda:properties></extensionElements>
      <signalEventDefinition id="a4s" signalRef="S"/>
    </endEvent>
    <sequenceFlow id="a12" sourceRef="a1" targetRef="a2"/>
    <sequenceFlow id="a23" sourceRef="a2" targetRef="a3"/>
    <sequenceFlow id="a34" sourceRef="a3" targetRef="a4"/>
    <dataObjectReference id="a5" name="goal" dataObjectRef="a6">
      <extensionElements><camunda:properties>
        <camunda:property name="x_goal" value="4.5"/><camunda:property name="y_goal" value="1.0"/>
      </camunda:properties></extensionElements>
    </dataObjectReference>
    <dataObject id="a6"/>
  </process>
  <process id="B" isExecutable="true">
    <startEvent id="b1" name="arrived">
      <dataOutputAssociation id="b1o"><targetRef>b4</targetRef></dataOutputAssociation>
      <signalEventDefinition id="b1s" signalRef="S"/>
    </startEvent>
    <callActivity id="b2" name="Go To" calledElement="GoTo"/>
    <endEvent id="b3"/>
    <sequenceFlow id="b12" sourceRef="b1" targetRef="b2"/>
    <sequenceFlow id="b23" sourceRef="b2" targetRef="b3"/>
    <dataObjectReference id="b4" name="goal" dataObjectRef="b5">
      <extensionElements><camunda:properties>
        <camunda:property name="x_goal"/><camunda:property name="y_goal"/>
      </camunda:properties></extensionElements>
    </dataObjectReference>
    <dataObject id="b5"/>
  </process>
  <signal id="S" name="arrived"/>
</definitions>
"""
