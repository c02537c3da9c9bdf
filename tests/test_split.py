"""Collaborations are split into one file per pool, and robots are assigned to pools."""

import json
import os
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from lxml import etree

import fame
from fame.bpmn import fragments
from fame.bpmn.conversion import convert
from fame.bpmn.library import Library
from fame.bpmn.pools import assign_pools, pools_of
from fame.bpmn.reader import read_bytes, read_text
from fame.bpmn.reader.xml import parse
from fame.bpmn.split import split
from fame.cli import main

MISSION = "models/ground_vehicles.bpmn"


def collaboration(*pools: str) -> fame.bpmn.model.Definitions:
    participants = "".join(
        f'<participant id="P{n}" {pool} processRef="p{n}"/>' if "name" in pool else f'<participant id="P{n}" {pool}/>'
        for n, pool in enumerate(pools)
    )
    processes = "".join(f'<process id="p{n}"><startEvent id="s{n}"/></process>' for n, _ in enumerate(pools))
    return read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">'
        f'<collaboration id="c">{participants}</collaboration>{processes}</definitions>',
        file="team.bpmn",
    )


@pytest.fixture
def parts():
    return split(fame.read(MISSION))


def test_each_pool_becomes_a_file_of_its_own(parts):
    assert [part.filename for part in parts] == ["REX.bpmn", "DINGO.bpmn"]


def test_a_name_without_letters_is_no_hidden_file() -> None:
    names = ["..", "\N{ROBOT FACE}", "_", "-x.", "a/b"]
    made = split(collaboration(*(f'name="{name}"' for name in names)))
    assert [part.filename for part in made] == ["p0.bpmn", "p1.bpmn", "p2.bpmn", "x.bpmn", "a_b.bpmn"]


def test_however_many_pools_there_are_the_whole_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read, original = list[str](), fragments.full_tree
    monkeypatch.setattr(fragments, "full_tree", lambda whole: read.append(whole.file) or original(whole))
    assert len(split(collaboration(*(f'name="R{number}"' for number in range(9))))) == 9
    assert read == ["team.bpmn"]


def test_a_part_holds_all_that_it_calls_and_nothing_of_the_others(parts):
    rex = read_bytes(parts[0].source, file="REX.bpmn")
    assert [pool.name for pool in rex.participants] == ["REX"]
    nowhere = Library()
    nowhere.path = lambda file: iter(())  # type: ignore[method-assign]
    called = {process.name or process.id for _, process in nowhere.closure(rex, rex.processes[0])}
    assert len(called) >= 5
    dingo = read_bytes(parts[1].source)
    assert "Explore" not in {process.id for process in dingo.processes}


def test_a_part_runs_like_the_pool_it_was(parts):
    dingo = read_bytes(parts[1].source, file="DINGO.bpmn")
    simulation = fame.Simulation(dingo, "DINGO", robot="DINGO").run()
    assert simulation.instances == []
    simulation.signal("target_found", {"x": 1.0, "y": 2.0})
    (instance,) = simulation.instances
    assert (instance.variables["x_target"], instance.variables["y_target"]) == (1.0, 2.0)


def test_types_said_in_one_pool_are_written_into_the_others(parts):
    from fame.bpmn.topics import topic_table

    for part in parts:
        assert topic_table(read_bytes(part.source))["/done"].declared == "std_msgs/msg/Bool"


def test_pools_are_bound_to_robots_without_regard_to_case():
    pools = pools_of(collaboration('name="Drone"'))
    assert {robot: pool.name for robot, pool in assign_pools(pools, ["drone"]).items()} == {"drone": "Drone"}


def test_a_multi_instance_pool_is_every_robot_with_its_name_and_a_number():
    definitions = read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><collaboration id="c">'
        '<participant id="P" name="Tractor" processRef="p"><participantMultiplicity minimum="1" maximum="9"/>'
        '</participant></collaboration><process id="p"><startEvent id="s"/></process></definitions>'
    )
    pools = pools_of(definitions)
    assert list(assign_pools(pools, ["Tractor_2", "tractor_10"])) == ["Tractor_2", "tractor_10"]
    with pytest.raises(fame.ConfigError, match="Tractor_<number>"):
        assign_pools(pools, ["Tractor_x"])
    assert assign_pools(pools, []) == {}


def test_a_robot_that_no_pool_knows_is_named_with_the_pools_there_are():
    with pytest.raises(fame.ConfigError, match=r"robot 'Bob'.*A, B"):
        assign_pools(pools_of(collaboration('name="A"', 'name="B"')), ["A", "B", "Bob"])


def test_names_that_fall_together_are_refused():
    with pytest.raises(fame.ModelError, match="two pools have the name 'rex'"):
        pools_of(collaboration('name="REX"', 'name="rex"'))
    with pytest.raises(fame.ConfigError, match="case only"):
        assign_pools(pools_of(collaboration('name="REX"')), ["REX", "rex"])


def test_a_pool_whose_name_no_robot_can_have_is_named():
    with pytest.raises(fame.ModelError, match=r"'Go To' cannot name a robot: expected ASCII letters, digits and _"):
        assign_pools(pools_of(collaboration('name="Go To"')), [])


def test_no_pool_is_written_over_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "team.bpmn"
    model.write_bytes(collaboration('name="A_B"', 'name="A B"').source)
    assert main(["split", str(model), "-o", str(tmp_path / "out")]) == 2
    assert "pools 'A_B' and 'A B' would be written to one file, A_B.bpmn: rename one" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_black_box_alone_leaves_nothing_to_run():
    with pytest.raises(fame.ModelError, match=r"black boxes: P0"):
        pools_of(collaboration(""))


# ---- namespaces ------------------------------------------------------------------------------------------------------

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
FOREIGN = '<f:v xmlns:f="urn:f" xmlns:xs="http://www.w3.org/2001/XMLSchema" xsi:type="xs:int">3</f:v>'
NAMESPACES = (
    'xmlns:di="http://www.omg.org/spec/DD/20100524/DI" xmlns:omgdc="http://www.omg.org/spec/DD/20100524/DC"'
    ' xmlns:bpmndi="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
)
DIAGRAM = (
    '<bpmndi:BPMNDiagram><bpmndi:BPMNPlane bpmnElement="c"><bpmndi:BPMNEdge bpmnElement="f">'
    '<di:waypoint xsi:type="omgdc:Point" x="1" y="2"/><di:waypoint xsi:type="omgdc:Point" x="3" y="4"/>'
    "</bpmndi:BPMNEdge></bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"
)


def written_by_others(condition: str, script: str, attributes: str = f'xmlns="{BPMN}"') -> fame.bpmn.model.Definitions:
    """A pool whose script and condition are written under other declarations of namespaces."""
    text = (
        f'<definitions {attributes} {NAMESPACES} targetNamespace="t"><collaboration id="c">'
        '<participant id="P" name="REX" processRef="p"/></collaboration><process id="p"><startEvent id="s"/>'
        f'<scriptTask id="t"><extensionElements>{FOREIGN}</extensionElements>{script}</scriptTask>'
        f'<sequenceFlow id="f" sourceRef="s" targetRef="t">{condition}</sequenceFlow></process>{DIAGRAM}</definitions>'
    )
    return read_text(text, file="team.bpmn")


DECLARED_ANEW = {
    "as .NET writes": f'<q1:{{}} xmlns="" xmlns:q1="{BPMN}">{{}}</q1:{{}}>',
    "one prefix for two": f'<q1:{{}} xmlns:q1="{BPMN}" xmlns="urn:other">{{}}</q1:{{}}>',
    "with a type": f'<q:{{}} xmlns:q="{BPMN}" xmlns="" xsi:type="q:tFormalExpression">{{}}</q:{{}}>',
}


@pytest.mark.parametrize("form", DECLARED_ANEW.values(), ids=DECLARED_ANEW.keys())
def test_what_is_written_under_other_namespace_declarations_is_kept(form: str) -> None:
    condition = form.format("conditionExpression", "x &gt; 1", "conditionExpression")
    definitions = written_by_others(condition, form.format("script", "x = 1", "script"))
    (part,) = split(definitions)
    (process,) = read_bytes(part.source).processes
    assert (process.body.flows[0].condition.text, process.body.nodes[1].script.text) == ("x > 1", "x = 1")


def test_types_of_points_and_of_unknown_values_keep_their_namespace() -> None:
    (part,) = split(written_by_others("", "<script>x = 1</script>"))
    assert part.source.count(b'<di:waypoint xsi:type="omgdc:Point"') == 2
    assert b'xsi:type="xs:int">3<' in part.source
    assert b'xmlns:xs="http://www.w3.org/2001/XMLSchema"' in part.source


def test_a_converted_file_keeps_them_too() -> None:
    conversion = '<zeebe:taskDefinition xmlns:zeebe="http://camunda.org/schema/zeebe/1.0" type="a/b"/>'
    definitions = written_by_others("", "<script>x = 1</script>")
    source = definitions.source.replace(b"<f:v", conversion.encode() + b"<f:v", 1)
    new = convert(read_bytes(source, file="team.bpmn"))
    assert new.count(b'<di:waypoint xsi:type="omgdc:Point"') == 2
    assert b'xsi:type="xs:int">3<' in new
    assert b"zeebe" not in new


def test_a_part_that_would_read_differently_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.bpmn.split.repair_prefixes", lambda root: None)
    form = DECLARED_ANEW["as .NET writes"]
    with pytest.raises(fame.ModelError, match=r"team.bpmn:1: t: its part cannot be split off, script would differ"):
        split(written_by_others("", form.format("script", "x = 1", "script")))


WARNINGS = """
const { BpmnModdle } = require("bpmn-moddle"), fs = require("fs");
const camunda = require("camunda-bpmn-moddle/resources/camunda.json");
const read = (file) => new BpmnModdle({ camunda }).fromXML(fs.readFileSync(file, "utf8"));
const texts = ({ warnings }) => warnings.map((one) => one.message.replace(/\\s+(line|column): \\d+/g, ""));
Promise.all(process.argv.slice(1).map((file) => read(file).then(texts, () => null)))
    .then((all) => console.log(JSON.stringify(all)));
"""
"""The warnings about each file, null for one that cannot be read."""


def test_bpmn_moddle_opens_each_part_without_a_warning_that_the_whole_does_not_have(
    node_modules: Path, tmp_path: Path
) -> None:
    form = DECLARED_ANEW["as .NET writes"]
    wholes = [written_by_others("", form.format("script", "x = 1", "script"))]
    for path in sorted([*Path("models").rglob("*.bpmn"), *Path("tests/other_tools").glob("*.bpmn")]):
        with suppress(fame.ModelError):
            wholes.append(fame.read(path))
    files: list[list[str]] = []
    for number, whole in enumerate(wholes):
        with suppress(fame.ModelError):
            texts = [etree.tostring(parse(whole.source, ""), encoding="UTF-8"), *(part.source for part in split(whole))]
            files.append([f"{number}_{place}.bpmn" for place in range(len(texts))])
            for file, text in zip(files[-1], texts, strict=True):
                (tmp_path / file).write_bytes(text)
    every = [file for family in files for file in family]
    environment = {**os.environ, "NODE_PATH": str(node_modules)}
    done = subprocess.run(
        ["node", "-e", WARNINGS, *every], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    warnings = dict(zip(every, json.loads(done.stdout), strict=True))
    for whole_file, *parts in files:
        known = warnings[whole_file]
        if known is not None:
            assert {part: set(warnings[part]) - set(known) for part in parts} == {part: set() for part in parts}
    assert sum(warnings[whole_file] is not None for whole_file, *_ in files) > 20
