"""``fame diff``: two versions of a model are compared by element and meaning."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path

import pytest
from bpmn_text import process
from lxml import etree

from fame.bpmn import read_bytes, read_text
from fame.bpmn.reader.xml import BPMN, is_reference
from fame.cli import main
from fame.edit.changes import ModelDifference, compare, lines, model_text, picture

ROOT = Path(__file__).parent.parent
OTHERS = [path for path in (ROOT / "tests" / "other_tools").glob("*.[bx]*") if path.stem not in ("beta", "xpdl")]
FILES = sorted(OTHERS) + sorted((ROOT / "models").rglob("*.bpmn"))
DEFAULTS = {
    "startEvent": {"isInterrupting": "true"}, "boundaryEvent": {"cancelActivity": "true"},
    "subProcess": {"triggeredByEvent": "false"}, "userTask": {"isForCompensation": "false"},
    "multiInstanceLoopCharacteristics": {"isSequential": "false"},
}  # fmt: skip
FLOWS = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
TASK = '<scriptTask id="t" name="Count"><script>a = 1\nb = 2</script></scriptTask>'
DRAWN = """<bpmndi:BPMNDiagram id="d"><bpmndi:BPMNPlane id="pl" bpmnElement="P">
<bpmndi:BPMNShape id="d1" bpmnElement="s"><dc:Bounds x="0" y="22" width="36" height="36"/></bpmndi:BPMNShape>
<bpmndi:BPMNShape id="d2" bpmnElement="t"><dc:Bounds x="90" y="0" width="100" height="80"/></bpmndi:BPMNShape>
<bpmndi:BPMNEdge id="d3" bpmnElement="f"><di:waypoint x="36" y="40"/><di:waypoint x="90" y="40"/></bpmndi:BPMNEdge>
</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""
OLD = process(FLOWS + TASK, DRAWN)


def compared(old: str, new: str) -> ModelDifference:
    return compare(read_text(old, file="old.bpmn"), read_text(new, file="new.bpmn"))


def written(old: str, new: str) -> list[str]:
    return list(lines(compared(old, new)))


def rewritten(source: bytes, seed: int) -> bytes:
    """A file as another program might write it: prefixes, order of attributes and elements, default values, spaces."""
    chance = random.Random(seed)
    old = etree.fromstring(source, etree.XMLParser(remove_comments=True, remove_pis=True))
    uris = sorted({uri for one in old.iter() for uri in one.nsmap.values() if ":" in uri})
    prefixes = {f"n{number}": uri for number, uri in enumerate(uris)}
    back = {uri: prefix for prefix, uri in prefixes.items()}
    root = _copied(old, back, etree.Element(old.tag, nsmap=prefixes), chance)
    return etree.tostring(root, encoding="utf-16", xml_declaration=True, pretty_print=True)


def _copied(old: etree._Element, back: dict[str, str], new: etree._Element, chance: random.Random) -> etree._Element:
    def name(text: str) -> str:
        prefix, colon, local = text.partition(":")
        return f"{back[uri]}:{local}" if colon and (uri := old.nsmap.get(prefix)) in back else text

    defaults = DEFAULTS.get(str(old.tag).removeprefix(f"{{{BPMN}}}"), {})
    attributes = [*old.items(), *(one for one in defaults.items() if one[0] not in old.attrib)]
    chance.shuffle(attributes)
    for key, value in attributes:
        new.set(key, name(value) if is_reference(key) or key.endswith("}type") else value)
    is_name = str(old.tag).endswith(("Ref", "Refs", "}incoming", "}outgoing"))
    new.text = name(old.text or "") if is_name else old.text
    inside = list(old)  # flows keep their order: a gateway tries their conditions in it

    def shuffled(one: etree._Element) -> float:
        return chance.random() if one.get("id") and not one.tag.endswith("}sequenceFlow") else 0

    if str(old.tag).endswith("}process") or str(old.tag).endswith("}subProcess"):
        inside.sort(key=lambda one: (one.tag.endswith("}sequenceFlow"), shuffled(one)))
    for one in inside:
        etree.SubElement(new, one.tag).tail = one.tail
        _copied(one, back, new[-1], chance)
    return new


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_prefixes_attributes_spaces_defaults_and_order_are_no_difference(path: Path) -> None:
    source = path.read_bytes()
    again = rewritten(source, 1)
    old, new = read_bytes(source, file="same"), read_bytes(again, file="same")
    assert list(lines(compare(old, new))) == []
    assert model_text(old) == model_text(new)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (TASK, TASK.replace("b = 2", "b = 3"),
         ['~ scriptTask "Count" (t)  new.bpmn:{}', "    script:", "      @@ -1,2 +1,2 @@",
          "       a = 1", "      -b = 2", "      +b = 3"]),
        ('targetRef="t"/>', 'targetRef="t"><conditionExpression>a > 1</conditionExpression></sequenceFlow>',
         ["~ sequenceFlow f  new.bpmn:{}", "    condition: none → a > 1"]),
        ('<startEvent id="s"/>', '<startEvent id="s"><timerEventDefinition><timeDuration>PT5S</timeDuration>'
         "</timerEventDefinition></startEvent>",
         ["~ startEvent s  new.bpmn:{}", "    event: none → timer", "    timer kind: none → duration",
          "    timer: none → PT5S"]),
        ('x="90" y="0"', 'x="80" y="5"', ['1 shape moved: "Count" (t)']),
        ('<startEvent id="s"/>', '<startEvent id="s" ns:mark="7" xmlns:ns="urn:x"/>',
         ["1 element with other extensions or documentation, the same for FAME: s"]),
        (TASK, TASK.replace('id="t"', 'id="t" startQuantity="2"'),
         ['1 element with other extensions or documentation, the same for FAME: "Count" (t)']),
        (TASK, TASK.replace("<script>", '<documentation textFormat="text/html"></documentation><script>'),
         ['1 element with other extensions or documentation, the same for FAME: "Count" (t)']),
        (TASK, TASK.replace("<script>", '<documentation textFormat="text/plain"></documentation><script>'), []),
        ("<bpmndi:BPMNDiagram", "<collaboration><documentation>why</documentation></collaboration><bpmndi:BPMNDiagram",
         ["1 element with other extensions or documentation, the same for FAME: definitions"]),
        (TASK, TASK.replace('id="t"', 'id="t" startQuantity="1"'), []),
        ('targetNamespace="', 'targetNamespace="urn:other:',
         ["~ root definitions  new.bpmn:{}", "    targetNamespace: http://fame → urn:other:http://fame"]),
    ],
)  # fmt: skip
def test_a_difference_is_told_by_element_and_meaning(old: str, new: str, said: list[str]) -> None:
    assert old in OLD
    found = written(OLD, OLD.replace(old, new))
    assert [line.rpartition(":")[0] if "new.bpmn:" in line else line for line in found] == [
        line.removesuffix(":{}") for line in said
    ]
    assert [line for line in found if line.endswith(":0")] == []


REFERS = f"""{FLOWS}<task id="t" name="Count"><ioSpecification><dataInput id="i"/></ioSpecification>
<dataInputAssociation id="a"><sourceRef>o</sourceRef><targetRef>i</targetRef></dataInputAssociation></task>
<dataObjectReference id="o" dataObjectRef="b"/><dataObject id="b"/><endEvent id="e" name="done">
<signalEventDefinition id="se" signalRef="S"/></endEvent>"""
MODELER = 'xmlns:m="http://camunda.org/schema/modeler/1.0" m:executionPlatform="Camunda Cloud"'


@pytest.mark.parametrize(
    ("old", "new", "element", "said"),
    [
        ('signalRef="S"', 'signalRef="x"', '~ endEvent "done" (e)', "signalEventDefinition signalRef: S → x{}"),
        ('<signal id="S" name="done"/>', "", '~ endEvent "done" (e)', "signalEventDefinition signalRef: S → S{}"),
        ("<targetRef>i<", "<targetRef>x<", '~ task "Count" (t)', "dataInputAssociation targetRef: i → x{}"),
        ('id="pl" bpmnElement="P"', 'id="pl" bpmnElement="x"', "~ root definitions",
         "BPMNPlane bpmnElement: P → x{}"),
        ('id="pl" bpmnElement="P"', 'id="pl" bpmnElement="t"', "~ root definitions",
         "BPMNPlane bpmnElement: P → t"),
        ('id="Definitions"', f'id="Definitions" {MODELER}', "~ root definitions",
         "executionPlatform: none → Camunda Cloud"),
    ],
)  # fmt: skip
def test_a_reference_to_what_the_file_does_not_have_is_a_difference(
    old: str, new: str, element: str, said: str
) -> None:
    before = process(REFERS, f'<signal id="S" name="done"/>{DRAWN}')
    after = before.replace(old, new)
    found = written(before, after)
    assert found[0].partition("  ")[0] == element
    assert not found[0].endswith(":0")
    assert found[1:] == ["    " + said.format(" (not in the file)")]
    assert not written(after, rewritten(after.encode(), 3).decode("utf-16").partition("?>")[2])
    texts = [set(model_text(read_text(one)).splitlines()) for one in (before, after)]
    assert any(said.partition(" → ")[2].format(" (not in the file)") in line for line in texts[1] - texts[0])


def test_what_has_moved_into_a_sub_process_is_no_new_element() -> None:
    found = written(OLD, process(f'<subProcess id="sub">{FLOWS}{TASK}</subProcess>', DRAWN))
    assert [line.split()[:2] for line in found[::2]] == [
        ["+", "subProcess"], ["the", "sub-process"], ["the", "sub-process"], ["the", "sub-process"],
    ]  # fmt: skip
    assert found[2].strip() == "the sub-process that it is in: P → sub"


GATE = """<exclusiveGateway id="t"/><task id="a"/><task id="b"/>
<sequenceFlow id="g" sourceRef="t" targetRef="a"><conditionExpression>x > 1</conditionExpression></sequenceFlow>
<sequenceFlow id="h" sourceRef="t" targetRef="b"><conditionExpression>x > 2</conditionExpression></sequenceFlow>"""


@pytest.mark.parametrize("id", ["startEvent_3", "startEvent_", "startEvent__1", "startEvent__2"])
def test_an_element_without_an_id_gets_none_that_the_file_has(id: str) -> None:
    old, new = (process(f'<startEvent/><startEvent/><{tag} id="{id}"/>') for tag in ("userTask", "endEvent"))
    said = written(old, new)
    assert [line for line in said if line.startswith(("+", "-", "~"))][:1] == [f"~ endEvent {id}  new.bpmn:3"]
    assert not [line for line in said if "startEvent" in line.replace(id, "")]
    assert len({one.id for one in read_text(old).elements()}) == 4
    assert not written(old, old)


def test_the_order_in_which_a_gateway_tries_its_conditions_is_a_difference() -> None:
    first, g, h = GATE.splitlines()
    found = written(process(FLOWS + GATE), process("\n".join((FLOWS + first, h, g))))
    assert found[1:] == ["    order of its conditions: g, h → h, g"]


def test_what_cannot_be_executed_is_compared_although_no_model_has_it() -> None:
    bad = '<startEvent id="s"/><boundaryEvent id="b" attachedToRef="{}"/>'
    found = written(process(bad.format("nobody")), process(bad.format("no_one")))
    assert [line[0] for line in found] == ["-", "+", "1"]
    assert "no_one" in found[1]


def test_git_compares_what_models_say_and_an_unreadable_version_as_text(tmp_path: Path, capsys: object) -> None:
    def git(*words: str) -> str:
        named = ("-c", "user.name=A", "-c", "user.email=a@b.c", "-c", f"diff.bpmn.textconv={textconv}")
        return subprocess.run(
            ["git", *named, *words], cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout  # fmt: skip

    textconv = "python3 -m fame diff --textconv"
    textconv = f"{ROOT}/.venv/bin/{textconv}" if (ROOT / ".venv").exists() else textconv
    (tmp_path / ".gitattributes").write_text("*.bpmn diff=bpmn\n")
    model = tmp_path / "m.bpmn"
    model.write_text(OLD)
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "old")
    model.write_bytes(rewritten(OLD.encode(), 3))
    assert git("diff") == ""
    model.write_text(OLD.replace("b = 2", "b = 3"))
    changed = [line for line in git("diff").splitlines() if line[0] in "+-" and line[:3] not in ("+++", "---")]
    assert changed == ["-    b = 2", "+    b = 3"]
    model.write_text(OLD.replace("</process>", ""))
    assert "+cannot be read: not well-formed XML" in git("diff")


def test_the_command_says_by_its_exit_code_and_as_json_whether_they_differ(tmp_path: Path, capsys: object) -> None:
    old, new, broken = (tmp_path / name for name in ("old.bpmn", "new.bpmn", "broken.bpmn"))
    old.write_text(OLD)
    new.write_text(OLD.replace('name="Count"', 'name="Number"').replace('x="0"', 'x="9"'))
    broken.write_text("<a/>")
    run = lambda *words: main(["diff", *map(str, words)])  # noqa: E731
    assert [run(old, old), run(old, new), run(old, broken), run(old, tmp_path / "none"), run(old)] == [0, 1, 2, 2, 2]
    capsys.readouterr()  # type: ignore[attr-defined]
    assert run(old, new, "--json", "-o", tmp_path / "d.svg") == 1
    found = json.loads(capsys.readouterr().out)  # type: ignore[attr-defined]
    assert (found["same"], found["moved"]) == (False, ["s"])
    assert found["changes"][0]["values"] == [{"name": "name", "old": "Count", "new": "Number"}]
    assert "1 changed, 1 moved" in (tmp_path / "d.svg").read_text()


def test_the_picture_shows_what_is_new_and_what_is_gone_where_it_was() -> None:
    later = OLD.replace('id="t" name="Count"', 'id="u" name="Mow"').replace('bpmnElement="t"', 'bpmnElement="u"')
    svg = picture(compared(OLD, later.replace('targetRef="t"', 'targetRef="u"')))
    colours = {id: svg.partition(f'id="{id}"')[0].rpartition("<g")[2] + svg.partition(f'id="{id}"')[2] for id in "tu"}
    assert "#cf222e" in colours["t"].partition("</g>")[0]
    assert "#1a7f37" in colours["u"].partition("</g>")[0]
    assert "1 added, 1 removed, 1 changed" in svg
