"""What an editor has changed is written into the text of the file, which keeps everything else."""

from __future__ import annotations

import difflib
import json
import os
import subprocess
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process
from lxml import etree
from test_diff import DRAWN, FLOWS, TASK

from fame.bpmn.reader.xml import BPMN, BPMNDI, DC
from fame.edit.writer import save, save_bytes
from fame.errors import ModelError

ROOT = Path(__file__).parent.parent
OTHERS = [path for path in (ROOT / "tests" / "other_tools").glob("*.[bx]*") if path.stem not in ("beta", "xpdl")]
FILES = sorted(OTHERS) + sorted((ROOT / "models" / "library").rglob("*.bpmn"))
SHIPPED = sorted((ROOT / "models").rglob("*.bpmn"))
B, DIAGRAM = f"{{{BPMN}}}", f"{{{BPMNDI}}}"


def editor(source: bytes) -> etree._Element:
    """A file as an editor keeps it: its own prefixes, no comments, no white space."""
    old = etree.fromstring(source, etree.XMLParser(remove_comments=True, remove_pis=True))
    uris = {uri for one in old.iter() for uri in one.nsmap.values() if ":" in uri}
    root = etree.Element(old.tag, old.attrib, nsmap={f"n{number}": uri for number, uri in enumerate(sorted(uris))})
    root.extend(deepcopy(one) for one in old)
    for one in root.iter():
        one.tail = None
        one.text = None if len(one) else one.text
    etree.cleanup_namespaces(root, keep_ns_prefixes=list(root.nsmap))
    return root


def as_text(root: etree._Element) -> str:
    return etree.tostring(root, encoding="unicode")


def meaning(source: bytes) -> str:
    """What an editor sees."""
    return etree.canonicalize(as_text(editor(source)), rewrite_prefixes=True)  # type: ignore[no-any-return]


def saved(source: bytes, edit: Callable[[etree._Element], object]) -> tuple[bytes, list[str]]:
    """The file after an edit, with the lines that differ; an editor sees in it what it has written."""
    base, new = editor(source), editor(source)
    edit(new)
    text = save_bytes(source, as_text(base), as_text(new))
    assert meaning(text) == meaning(as_text(new).encode())
    before, after = map(decoded, (source, text))
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    return text, [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---")]


def bounds(root: etree._Element) -> list[etree._Element]:
    return list(root.iter(f"{{{DC}}}Bounds"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_that_was_opened_and_saved_is_the_same_byte_for_byte(path: Path) -> None:
    text, differs = saved(path.read_bytes(), lambda root: None)
    assert (text, differs) == (path.read_bytes(), [])


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_moved_shape_changes_lines_of_its_drawing_alone(path: Path) -> None:
    source = path.read_bytes()
    if not bounds(editor(source)):
        pytest.skip("it has no shape")
    _, differs = saved(source, lambda root: bounds(root)[0].set("x", "-7.5"))
    long = source.count(b"\n") < 5
    assert len(differs) == 2
    assert long or ("Bounds" in differs[0] and differs[1].replace("-7.5", "").count('"') == differs[0].count('"'))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_an_added_element_changes_no_other_line_and_removed_again_leaves_the_file_as_it_was(path: Path) -> None:
    source = path.read_bytes()
    if b"process" not in source:
        pytest.skip("it has no process")

    def add(root: etree._Element) -> None:
        (home, *_) = root.iter(f"{B}process")
        task = etree.SubElement(home, f"{B}userTask", id="New_1", name='a < b & "c"')
        etree.SubElement(task, f"{B}documentation").text = "1 < 2\nand on"

    def remove(root: etree._Element) -> None:
        (task,) = root.iterfind(f".//{B}userTask[@id='New_1']")
        task.getparent().remove(task)

    text, differs = saved(source, add)
    if source.count(b"\n") > 5 and path.stem not in ("conversation", "signavio_timer"):  # with many elements on a line
        assert {line[0] for line in differs} == {"+"}
        assert len(differs) == 4
    again, _ = saved(text, remove)
    assert again == source


def test_comments_entities_quotation_marks_and_line_endings_stay() -> None:
    old = process(FLOWS + "<!-- why -->" + TASK, DRAWN).replace("<process ", "<!-- a -->\n<process\tname='&#65;\"'  ")
    old = old.replace("\n", "\r\n").replace("><", ">\r\n  <!-- b --><")
    text, differs = saved(old.encode(), lambda root: root.find(f".//{B}scriptTask").set("name", "B\nC"))
    assert [line[0] for line in differs] == ["-", "+"]
    assert differs[0].replace("Count", "B&#10;C")[1:] == differs[1][1:]
    assert text.count(b"\r\n") == text.count(b"\n") == old.count("\n")


def test_code_stays_a_cdata_section() -> None:
    old = process(FLOWS + TASK.replace("a = 1\nb = 2", "<![CDATA[a < 1]]>"), DRAWN)

    def edit(root: etree._Element) -> None:
        root.find(f".//{B}script").text = "a < 2\nb = 3"

    text, _ = saved(old.encode(), edit)
    assert b"<script><![CDATA[a < 2\nb = 3]]></script>" in text


def test_what_goes_into_a_sub_process_takes_its_comments_and_extensions_along() -> None:
    old = process(FLOWS + TASK.replace("<script>", "<!-- why --><script>"), DRAWN)

    def edit(root: etree._Element) -> None:
        (home,) = root.iter(f"{B}process")
        sub = etree.SubElement(home, f"{B}subProcess", id="Sub")
        sub.append(home.find(f"{B}scriptTask"))

    text, _ = saved(old.encode(), edit)
    assert TASK.replace("<script>", "<!-- why --><script>").encode() in text


def test_a_namespace_that_is_new_is_declared_once_by_a_free_prefix() -> None:
    old = process(FLOWS + TASK).replace("xmlns:camunda=", "xmlns:ns='urn:x' xmlns:camunda=")

    def edit(root: etree._Element) -> None:
        for task in root.iter(f"{B}scriptTask", f"{B}startEvent"):
            task.set("{http://camunda.org/schema/9}asyncBefore", "true")

    text, _ = saved(old.encode(), edit)
    assert text.count(b'="http://camunda.org/schema/9"') == 1


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-16", "utf-8-sig"])
def test_the_encoding_stays_and_what_it_lacks_is_written_as_a_reference(encoding: str) -> None:
    name = encoding.removesuffix("-sig")
    old = f'<?xml version="1.0" encoding="{name}"?>\n{process(FLOWS + TASK.replace("Count", "Größe"))}'.encode(encoding)
    text, _ = saved(old, lambda root: root.find(f".//{B}scriptTask").set("name", "Größe €"))
    euro = "&#8364;" if encoding == "iso-8859-1" else "€"
    assert text == old.decode(encoding).replace("Größe", f"Größe {euro}").encode(encoding)


def opened_and_edited(open_: Callable[[etree._Element], object], edit: Callable[[etree._Element], object]) -> str:
    """The file after an edit in an editor that changes what it opens."""
    base, new = editor(OLD.encode()), editor(OLD.encode())
    for root in (base, new):
        open_(root)
    edit(new)
    return save(OLD, as_text(base), as_text(new))


def by(dx: float, *, of: str = "") -> Callable[[etree._Element], None]:
    """Move all that is drawn, or the shape of an element."""

    def move(root: etree._Element) -> None:
        for one in root.iter(f"{{{DC}}}Bounds", "{http://www.omg.org/spec/DD/20100524/DI}waypoint"):
            if not of or one.getparent().get("bpmnElement") == of:
                one.set("x", f"{float(one.get('x', '')) + dx:g}")

    return move


def test_a_diagram_that_the_editor_moves_as_it_opens_a_file_stays_where_the_file_has_it() -> None:
    assert opened_and_edited(by(80), by(7, of="t")) == OLD.replace('x="90" y="0"', 'x="97" y="0"')


def put_apart(root: etree._Element) -> None:
    """Put the shape of the task into a diagram of its own."""
    (shape,) = root.iterfind(f".//{DIAGRAM}BPMNShape[@bpmnElement='t']")
    diagram = etree.SubElement(root, f"{DIAGRAM}BPMNDiagram", id="own")
    etree.SubElement(diagram, f"{DIAGRAM}BPMNPlane", id="own_plane", bpmnElement="t").append(shape)


def test_a_diagram_that_the_editor_adds_is_not_written_unless_it_is_changed() -> None:
    rename = lambda root: root.find(f".//{B}scriptTask").set("name", "Number")  # noqa: E731
    assert opened_and_edited(put_apart, rename) == OLD.replace('name="Count"', 'name="Number"')
    changed = opened_and_edited(put_apart, by(7, of="t"))
    assert changed.count('bpmnElement="t"') == 2  # the plane, and the shape on it alone
    assert changed.index('id="own_plane"') < changed.index('x="97"')


def test_what_is_no_xml_is_refused() -> None:
    with pytest.raises(ModelError, match=r"m\.bpmn:1: not well-formed XML"):
        save(OLD, OLD, "<a", file="m.bpmn")


OLD = process(FLOWS + TASK, DRAWN)

# ---- bpmn-moddle -----------------------------------------------------------------------------------------------------

EDITS = """
const { BpmnModdle } = require("bpmn-moddle");
const camunda = require("camunda-bpmn-moddle/resources/camunda.json");
const moddle = new BpmnModdle({ camunda });
const open = async (text) => (await moddle.fromXML(text)).rootElement;
const write = async (root) => (await moddle.toXML(root, { format: true })).xml;
const processes = (root) => (root.rootElements ?? []).filter((one) => one.$type === "bpmn:Process");
const nodes = (root) => processes(root).flatMap((one) => one.flowElements ?? []);
const planes = (root) => (root.diagrams ?? []).map((one) => one.plane).filter(Boolean);
const added = (home, type, values) => {
    const one = moddle.create(type, values);
    one.$parent = home;
    home.get(type.startsWith("bpmndi") ? "planeElement" : "flowElements").push(one);
    return one;
};
const edits = {
    moved: (root) => {
        for (const plane of planes(root)) for (const one of plane.planeElement ?? []) {
            if (one.bounds) one.bounds.x += 7.5;
            for (const point of one.waypoint ?? []) point.x += 7.5;
        }
    },
    named: (root) => nodes(root).forEach((one) => { one.name = `<${one.id}> & "${one.name}"\\n2`; }),
    added: (root) => {
        const [home] = processes(root), [source] = nodes(root);
        if (!source) return;
        const properties = moddle.create("camunda:Properties", { values: [
            moddle.create("camunda:Property", { name: "type", value: "std_msgs/msg/String" })] });
        const task = added(home, "bpmn:ScriptTask", { id: "New_1", script: "a < 1\\nb = ']]>'", incoming: [],
            extensionElements: moddle.create("bpmn:ExtensionElements", { values: [properties] }) });
        const flow = added(home, "bpmn:SequenceFlow", { id: "New_2", sourceRef: source, targetRef: task,
            conditionExpression: moddle.create("bpmn:FormalExpression", { body: "a > 1 && b" }) });
        task.incoming.push(flow);
        source.get("outgoing")?.push(flow);
        const [plane] = planes(root);
        if (plane) added(plane, "bpmndi:BPMNShape", { id: "New_3", bpmnElement: task,
            bounds: moddle.create("dc:Bounds", { x: 1, y: 2, width: 100, height: 80 }) });
    },
    removed: (root) => {
        const gone = new Set(nodes(root).filter((one) => one.$type === "bpmn:SequenceFlow").slice(-2));
        for (const one of processes(root)) one.flowElements = one.flowElements?.filter((each) => !gone.has(each));
        for (const one of nodes(root)) {
            if (gone.has(one.default)) delete one.default;
            for (const name of ["incoming", "outgoing"])
                if (one[name]?.length) one[name] = one[name].filter((each) => !gone.has(each));
        }
        for (const plane of planes(root))
            plane.planeElement = plane.planeElement?.filter((each) => !gone.has(each.bpmnElement));
    },
    inside: (root) => {
        const [home] = processes(root).filter((one) => one.flowElements?.length);
        if (!home) return;
        const some = home.flowElements.splice(0, 3), sub = added(home, "bpmn:SubProcess", { id: "New_4" });
        for (const one of some) one.$parent = sub;
        sub.flowElements = some;
    },
};
const all = async ({ files, texts }) => {
    const found = {};
    for (const [path, text] of Object.entries(files ?? {})) {
        try { await open(text); } catch { continue; }
        found[path] = { base: await write(await open(text)) };
        for (const [name, edit] of Object.entries(edits)) {
            const root = await open(text);
            edit(root);
            found[path][name] = await write(root);
        }
    }
    return texts ? Promise.all(texts.map(async (text) => write(await open(text)))) : found;
};
let given = "";
process.stdin.on("data", (data) => { given += data; });
process.stdin.on("end", () => all(JSON.parse(given)).then((found) => console.log(JSON.stringify(found))));
"""


def by_moddle(node_modules: Path, **given: Any) -> Any:
    done = subprocess.run(
        ["node", "-e", EDITS], input=json.dumps(given), env={**os.environ, "NODE_PATH": str(node_modules)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def unordered(text: str) -> list[str]:
    """What an editor sees, line by line, whatever the prefixes and the order of elements."""
    return sorted(etree.canonicalize(text, rewrite_prefixes=True, strip_text=False).split("\n"))


def decoded(source: bytes) -> str:
    encoding = etree.fromstring(source).getroottree().docinfo.encoding or "utf-8"
    return source.decode("utf-16" if source[:1] in (b"\xff", b"\xfe") else encoding)


def test_bpmn_moddle_writes_of_what_was_saved_what_it_has_written(node_modules: Path) -> None:
    edited = by_moddle(node_modules, files={str(path): decoded(path.read_bytes()) for path in [*OTHERS, *SHIPPED]})
    assert len(edited) > 40
    texts, expected = [], []
    for path, versions in edited.items():
        source, base = Path(path).read_bytes(), versions.pop("base")
        assert save_bytes(source, base, base) == source
        for name, new in versions.items():
            texts.append(decoded(save_bytes(source, base, new)))
            expected.append((path, name, new))
    again = by_moddle(node_modules, texts=texts)
    wrong = [
        (path, name)
        for (path, name, new), text in zip(expected, again, strict=True)
        if unordered(text) != unordered(new)
    ]
    assert wrong == []
