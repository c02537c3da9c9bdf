"""Drawing: the diagram as SVG."""

import re
from collections import Counter
from pathlib import Path

import pytest
from bpmn_text import document, process
from gallery import gallery
from lxml import etree

from fame.bpmn import read, read_text
from fame.bpmn.draw import diagram
from fame.bpmn.draw.diagram import draw
from fame.bpmn.draw.style import STYLES
from fame.bpmn.draw.svg import arrow, fitted, middle, overlap, polyline, text_width, wrap
from fame.bpmn.model import Bounds
from fame.errors import ModelError

ROOT = Path(__file__).parent.parent
SVG = "{http://www.w3.org/2000/svg}"
GALLERY = read_text(gallery(), file="gallery.bpmn")


def drawn(*visited: str) -> etree._Element:
    """The gallery as a tree."""
    return etree.fromstring(draw(GALLERY, visited).encode())


def group(root: etree._Element, id: str) -> etree._Element:
    """What one element is drawn as."""
    (found,) = [one for one in root.iter(f"{SVG}g") if one.get("id") == id]
    return found


def words(element: etree._Element) -> str:
    """All lettering in it."""
    return " ".join(str(piece) for piece in element.itertext())


def strokes(element: etree._Element, tag: str) -> list[float]:
    """The widths of the lines of the direct children with that tag."""
    return [float(one.get("stroke-width", "1")) for one in element.findall(f"{SVG}{tag}")]


def test_everything_with_a_shape_or_an_edge_is_drawn_once() -> None:
    ids = Counter(one.get("id") for one in drawn().iter(f"{SVG}g") if one.get("id"))
    assert ids == Counter([shape.element for shape in GALLERY.shapes] + [edge.element for edge in GALLERY.edges])


def test_the_picture_is_as_large_as_what_is_in_it() -> None:
    root = drawn()
    assert root.get("viewBox") == f"0 0 {root.get('width')} {root.get('height')}"
    assert root.get("width") == "1224"
    numbers = [float(value) for value in re.findall(r"-?\d+\.?\d*", " ".join(root.xpath("//@x | //@cx")))]
    assert max(numbers) <= 1330


def test_names_are_escaped_and_in_lines() -> None:
    root = drawn()
    assert words(group(root, "userTask")).split() == ["userTask", "<1>"]
    assert [one.text for one in group(root, "loop_0").iter(f"{SVG}tspan")] == [
        "a name that is",
        "so long that it",
        "needs lines",
    ]
    assert words(group(root, "note")).split() == ["a", "text", "annotation", "&", "more"]


def test_pools_and_lanes_carry_their_names_upright_in_their_bands() -> None:
    root = drawn()
    for id, name in (("Pool", "DRONE & co"), ("Lane", "lane")):
        turned = group(root, id).find(f"{SVG}g[@transform]")
        assert turned is not None
        assert "rotate(-90)" in str(turned.get("transform"))
        assert words(turned) == name
    assert group(root, "Box").find(f"{SVG}g") is None
    assert words(group(root, "Box")) == "black box"


def test_events_have_one_thin_two_or_one_thick_ring() -> None:
    root = drawn()
    assert strokes(group(root, "startEvent_none"), "circle") == [2]
    assert strokes(group(root, "intermediateCatchEvent_timer"), "circle") == [1.5, 1.5]
    assert strokes(group(root, "endEvent_none"), "circle") == [4]


def test_what_does_not_interrupt_is_dashed() -> None:
    root = drawn()
    for id, dashed in (("on_timer", True), ("on_error", False), ("inner", True), ("startEvent_signal", False)):
        ring = group(root, id).find(f"{SVG}circle")
        assert ring is not None
        assert (ring.get("stroke-dasharray") is not None) is dashed


@pytest.mark.parametrize("trigger", ["message", "signal", "escalation", "compensate", "link"])
def test_a_trigger_is_solid_where_it_is_thrown_and_an_outline_where_it_is_caught(trigger: str) -> None:
    root = drawn()
    thrown = group(root, f"intermediateThrowEvent_{trigger}")[2][0]
    ink = thrown.get("stroke")
    assert thrown.get("fill") == ink
    if trigger in ("message", "signal", "link"):
        caught = group(root, f"intermediateCatchEvent_{trigger}")[2][0]
        assert caught.get("fill") != ink


def test_every_kind_of_task_but_the_plain_one_has_a_pictogram_of_its_own() -> None:
    root = drawn()
    tags = ["userTask", "manualTask", "scriptTask", "serviceTask", "sendTask", "receiveTask", "businessRuleTask"]
    pictures = {etree.tostring(group(root, tag).find(f"{SVG}g")[0]) for tag in tags}  # type: ignore[index]
    assert len(pictures) == len(tags)
    assert group(root, "task").find(f"{SVG}g") is None


def test_call_activities_are_thick_event_sub_processes_dotted_transactions_double() -> None:
    root = drawn()
    assert strokes(group(root, "call"), "rect") == [5]
    assert strokes(group(root, "task"), "rect") == [2]
    handler = group(root, "on_signal").find(f"{SVG}rect")
    assert handler is not None
    assert handler.get("stroke-dasharray") == "1 5"
    assert len(group(root, "transaction").findall(f"{SVG}rect")) == 2


def test_loops_and_compensation_have_markers() -> None:
    root = drawn()
    markers = [
        etree.tostring(group(root, id).findall(f"{SVG}g")[-1][0]) for id in ("loop_0", "loop_1", "loop_2", "handler")
    ]
    assert len(set(markers)) == 4
    assert len(group(root, "adhoc").findall(f"{SVG}g")) == 2


def test_flows_have_heads_conditions_a_diamond_messages_a_circle_and_associations_none() -> None:
    root = drawn()
    assert len(group(root, "F1").findall(f"{SVG}polygon")) == 2
    assert len(group(root, "F2").findall(f"{SVG}polygon")) == 1
    assert len(group(root, "M1").findall(f"{SVG}circle")) == 1
    assert [one.tag for one in group(root, "A1")] == [f"{SVG}path"]


def test_a_default_flow_is_crossed() -> None:
    edge = '<bpmndi:BPMNEdge bpmnElement="{}"><di:waypoint x="0" y="0"/><di:waypoint x="90" y="0"/></bpmndi:BPMNEdge>'
    definitions = read_text(
        document(
            '<process id="P"><exclusiveGateway id="g" default="f"/><task id="t"/><sequenceFlow id="f" sourceRef="g" '
            'targetRef="t"/><sequenceFlow id="o" sourceRef="g" targetRef="t"/></process><bpmndi:BPMNDiagram>'
            "<bpmndi:BPMNPlane "
            'bpmnElement="P"><bpmndi:BPMNShape bpmnElement="g"><dc:Bounds x="0" y="0" width="50" height="50"/>'
            f"</bpmndi:BPMNShape>{edge.format('f')}{edge.format('o')}</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"
        )
    )
    root = etree.fromstring(draw(definitions).encode())
    assert group(root, "f").find(f"{SVG}polyline") is not None
    assert group(root, "o").find(f"{SVG}polyline") is None


def test_other_diagrams_stand_below_the_first_under_their_name() -> None:
    root = drawn()
    lettering = [words(one) for one in root.findall(f"{SVG}text")]
    assert lettering == ["Drawn elsewhere"]
    assert len(root.findall(f"{SVG}g")) == 2


def test_a_sub_process_is_open_if_its_content_is_drawn_in_it_whatever_its_shape_says() -> None:
    root = drawn()
    assert group(root, "collapsed").find(f"{SVG}g") is not None
    closed = read_text(gallery().replace('bpmnElement="on_signal" isExpanded="true"', 'bpmnElement="on_signal"'))
    assert group(etree.fromstring(draw(closed).encode()), "on_signal").find(f"{SVG}g") is None


def test_what_was_visited_is_green_and_has_its_number() -> None:
    root = drawn("task", "F1", "userTask", "F1", "userTask", "userTask")
    for id in ("task", "userTask", "F1"):
        assert STYLES["completed"].stroke in etree.tostring(group(root, id)).decode()
    assert STYLES["completed"].stroke not in etree.tostring(group(root, "manualTask")).decode()
    badges = [words(one) for one in root.iter(f"{SVG}text") if one.get("fill") == "#ffffff"]
    assert sorted(badges) == ["1", "2", "3"]
    assert draw(GALLERY, Counter({"task": 2})) == draw(GALLERY, ["task", "task"])


OUTCOMES = {
    "task": {"failed": 1},
    "userTask": {"waiting": 1},
    "manualTask": {"cancelled": 1},
    "scriptTask": {"completed": 1},
}


def test_failed_waiting_cancelled_and_completed_differ_in_colour_and_without() -> None:
    root = etree.fromstring(draw(GALLERY, OUTCOMES).encode())
    colours = {group(root, id).find(f"{SVG}rect").get("stroke") for id in OUTCOMES}  # type: ignore[union-attr]
    assert len(colours) == len(OUTCOMES)
    badges = [one.getparent() for one in root.iter(f"{SVG}title")]
    assert sorted(one.findtext(f"{SVG}title") for one in badges) == ["cancelled", "completed", "failed", "waiting"]
    assert len({one.find(f".//{SVG}path").get("d") for one in badges}) == len(OUTCOMES)


def test_the_symbols_of_the_outcomes_are_explained_below_the_diagram() -> None:
    root = etree.fromstring(
        draw(GALLERY, {"task": {"failed": 1, "completed": 2}, "elsewhere": {"waiting": 1}}).encode()
    )
    assert [words(one) for one in root.findall(f"{SVG}text")][-2:] == ["failed", "completed"]


def test_the_picture_has_room_for_its_legend_and_for_the_titles_of_its_diagrams() -> None:
    content = '<startEvent id="S"/><subProcess id="sub" name="Inspect the northern orchard"><task id="t"/></subProcess>'
    event, below = plane("P", "S 0 0 36 36"), plane("sub", "t 0 0 100 80")
    for planes, lettering in ((event, "completed"), (event + below, "Inspect the northern orchard")):
        root = etree.fromstring(
            draw(read_text(document(f'<process id="P">{content}</process>{planes}')), ["S"]).encode()
        )
        (text,) = [one for one in root.findall(f"{SVG}text") if words(one) == lettering]
        left, size = float(text[0].get("x", "")), float(text.get("font-size", ""))
        assert float(root.get("width", "")) == pytest.approx(
            left + text_width(lettering, size) + diagram.MARGIN, abs=0.01
        )


def test_of_several_outcomes_a_failure_gives_the_colour_and_each_has_its_number() -> None:
    root = etree.fromstring(draw(GALLERY, {"task": {"completed": 4, "failed": 1}}).encode())
    assert group(root, "task").find(f"{SVG}rect").get("stroke") == STYLES["failed"].stroke  # type: ignore[union-attr]
    assert [words(one.getparent()) for one in root.iter(f"{SVG}title")] == ["completed 4", "failed 1"]


def test_the_picture_has_room_for_the_numbers_of_an_event_at_its_edge() -> None:
    definitions = read_text(document(f'<process id="P"><startEvent id="S"/></process>{plane("P", "S 0 0 36 36")}'))
    root = etree.fromstring(draw(definitions, {"S": {"failed": 1234, "completed": 5678}}).encode())
    lefts = [box_of(pill)[0] for pill in group(root, "S").getparent().iter(f"{SVG}rect")]  # type: ignore[union-attr]
    moved = float(re.findall(r"translate\(([\d.]+)", etree.tostring(root).decode())[0])
    assert len(lefts) == 2
    assert moved + min(lefts) >= 0


def test_numbers_of_a_run_cover_no_name_of_the_missions() -> None:
    for name in ("agriculture", "ground_vehicles"):
        definitions = read(ROOT / "models" / f"{name}.bpmn")
        ids = [*(shape.element for shape in definitions.shapes), *(edge.element for edge in definitions.edges)]
        root = etree.fromstring(draw(definitions, dict.fromkeys(ids, 12)).encode())
        pills = [box_of(one) for one in root.iter(f"{SVG}rect") if one.get("rx") == "8" and one.get("height") == "16"]
        picture = diagram._picture(definitions, {})
        assert len(list(diagram._content(definitions, picture))) == 1
        names = [label.box for label in picture.labels.values()]
        assert len(pills) > 15
        for x, y, width, height in pills:
            for box in names:
                across = min(x + width, box.x + box.width) - max(x, box.x)
                down = min(y + height, box.y + box.height) - max(y, box.y)
                assert min(across, down) <= 4, (name, x, y, box)


def box_of(rect: etree._Element) -> tuple[float, float, float, float]:
    """The place and size of a rectangle in the frame of its diagram."""
    x, y, width, height = (float(rect.get(key, "0")) for key in ("x", "y", "width", "height"))
    return x, y, width, height


def test_colours_of_the_modeler_are_kept() -> None:
    shape = (
        '<bpmndi:BPMNShape bpmnElement="t" xmlns:bioc="http://bpmn.io/schema/bpmn/biocolor/1.0" bioc:stroke="#0d4372" '
        'bioc:fill="#bbdefb" id="x"><dc:Bounds x="0" y="0" width="100" height="80"/></bpmndi:BPMNShape>'
    )
    plane = f'<bpmndi:BPMNDiagram><bpmndi:BPMNPlane bpmnElement="P">{shape}</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>'
    picture = draw(read_text(document(f'<process id="P"><task id="t"/></process>{plane}')))
    assert 'fill="#bbdefb" stroke="#0d4372"' in picture


def test_a_file_without_a_diagram_is_laid_out() -> None:
    assert '<g id="t">' in draw(read_text(process('<task id="t"/>')))


def test_a_file_with_nothing_that_is_drawn_has_no_picture() -> None:
    with pytest.raises(ModelError, match=r"plain\.bpmn: expected a pool, or a process with a flow node"):
        draw(read_text(process(""), file="plain.bpmn"))


def test_the_same_file_gives_the_same_picture() -> None:
    assert draw(GALLERY) == draw(read_text(gallery(), file="gallery.bpmn"))


# ---- lines and lettering ---------------------------------------------------------------------------------------------


def test_lines_break_between_words_then_at_seams_then_anywhere() -> None:
    assert wrap("go to the target", text_width("go to the", 12), 12) == ["go to the", "target"]
    assert wrap("target_position", text_width("target_po", 12), 12) == ["target_", "position"]
    assert wrap("GoToTarget", text_width("GoToTar", 12), 12) == ["GoTo", "Target"]
    assert wrap("a\nb", 100, 12) == ["a", "b"]
    assert wrap("Application received", 50, 11) == ["Application", "received"]
    assert all(text_width(line, 12) <= 30 for line in wrap("x" * 40, 30, 12, anywhere=True))


def test_a_label_takes_the_lines_that_its_box_has_room_for() -> None:
    assert fitted("target found", Bounds(0, 0, text_width("target found", 11) * 0.9, 14), 11) == ["target found"]
    assert fitted("target found", Bounds(0, 0, 40, 27), 11) == ["target", "found"]


def test_an_arrow_points_where_the_line_ends() -> None:
    assert arrow([(0, 0), (0, 0), (20, 0)]) == [(10, -4), (20, 0), (10, 4)]
    assert arrow([(5, 5), (5, 5)])[1] == (5, 5)


def test_the_middle_of_a_line_is_measured_along_it() -> None:
    assert middle([(0, 0), (10, 0), (10, 30)]) == (10, 10)
    assert middle([(3, 3), (3, 3)]) == (3, 3)


def test_bends_are_round() -> None:
    assert polyline([(0, 0), (20, 0), (20, 20)]) == "M0 0L15 0Q20 0 20 5L20 20"


# ---- names -----------------------------------------------------------------------------------------------------------


def plane(element: str, shapes: str) -> str:
    """A diagram of an element with these shapes: ``id x y width height`` each."""
    written = "".join(
        f'<bpmndi:BPMNShape bpmnElement="{id}"><dc:Bounds x="{x}" y="{y}" width="{w}" height="{h}"/></bpmndi:BPMNShape>'
        for id, x, y, w, h in (shape.split() for shape in shapes.split(", "))
    )
    shown = f'<bpmndi:BPMNPlane bpmnElement="{element}">{written}</bpmndi:BPMNPlane>'
    return f"<bpmndi:BPMNDiagram>{shown}</bpmndi:BPMNDiagram>"


def alone(content: str, shapes: str) -> etree._Element:
    """A drawing of a process with this content and these shapes."""
    content = f'<process id="P">{content}</process>{plane("P", shapes)}'
    return etree.fromstring(draw(read_text(document(content))).encode())


def lines(root: etree._Element, id: str) -> list[tuple[str, Bounds]]:
    """The lettering of an element, and the box of each line."""
    found = []
    for text in group(root, id).iter(f"{SVG}text"):
        size = float(str(text.get("font-size")))
        for line in text.iter(f"{SVG}tspan"):
            width, base = text_width(str(line.text), size), float(str(line.get("y")))
            found.append((str(line.text), Bounds(float(str(line.get("x"))) - width / 2, base - size, width, size)))
    return found


def test_a_word_that_is_too_long_for_its_box_is_smaller_and_whole() -> None:
    root = alone('<task id="t" name="Acknowledgement processing"/>', "t 0 0 100 80")
    assert [line for line, _ in lines(root, "t")] == ["Acknowledgement", "processing"]
    assert all(box.x > 0 and box.x + box.width < 100 for _, box in lines(root, "t"))


def test_a_word_beside_its_shape_is_never_broken() -> None:
    root = alone('<startEvent id="s" name="Applicationhasbeenreceived"/>', "s 100 0 36 36")
    assert [line for line, _ in lines(root, "s")] == ["Applicationhasbeenreceived"]


@pytest.mark.parametrize(
    "name",
    ["Review the application", "Enter all of the data of the customer", "Approve or reject the long application"],
)
def test_the_pictogram_of_a_task_is_clear_of_its_name(name: str) -> None:
    root = alone(f'<userTask id="t" name="{name}"/>', "t 0 0 100 80")
    assert " ".join(line for line, _ in lines(root, "t")) == name
    assert not any(overlap(box, Bounds(6, 6, 18, 18)) for _, box in lines(root, "t"))
    assert all(box.y + box.height <= 80 for _, box in lines(root, "t"))


@pytest.mark.parametrize(("x", "y"), [(82, 62), (32, 62), (32, -18), (-18, 22)])
def test_the_name_of_a_boundary_event_does_not_cover_its_task(x: int, y: int) -> None:
    content = '<task id="t" name="Do it"/><boundaryEvent id="b" name="too late" attachedToRef="t"/>'
    root = alone(content, f"t 0 0 100 80, b {x} {y} 36 36")
    assert not any(overlap(box, Bounds(0, 0, 100, 80)) for _, box in lines(root, "b"))
