"""The models that come with FAME: they hold what the guidelines ask, and they are drawn as a careful person draws."""

import ast
import builtins
import math
import re
from collections.abc import Iterator
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path

import pytest

from fame.bpmn import read
from fame.bpmn.model import (
    Body,
    Bounds,
    CallActivity,
    Definitions,
    Edge,
    Event,
    FlowNode,
    Shape,
    SignalDefinition,
    SubProcess,
    Task,
    Topic,
)
from fame.rooms import SERVICES

MODELS = Path(__file__).parent.parent / "models"
LIBRARY = [path for folder in ("library", "monitoring") for path in sorted((MODELS / folder).glob("*.bpmn"))]
LIBRARY.append(MODELS / "delivery" / "Deliver.bpmn")  # that of one mission
NEW = MODELS.parent / "examples" / "project" / "mission.bpmn"  # of fame new
FILES = [*sorted(MODELS.glob("*.bpmn")), MODELS / "delivery" / "delivery.bpmn", NEW, *LIBRARY]

COOKBOOK = sorted((MODELS.parent / "examples" / "cookbook").glob("*/*.bpmn"))

every_model = pytest.mark.parametrize("model", FILES, ids=lambda file: file.stem, indirect=True)
every_drawing = pytest.mark.parametrize(
    "model", [*FILES, *COOKBOOK], ids=lambda file: f"{file.parent.name}/{file.stem}", indirect=True
)
read_once = cache(read)


@pytest.fixture
def model(request: pytest.FixtureRequest) -> Definitions:
    """The model of a file."""
    return read_once(request.param)


def nodes(model: Definitions) -> Iterator[FlowNode]:
    for process in model.processes:
        yield from process.body.walk()


def bodies(model: Definitions) -> Iterator[Body]:
    for process in model.processes:
        yield process.body
    yield from (node.body for node in nodes(model) if isinstance(node, SubProcess))


def topics(model: Definitions) -> Iterator[tuple[Event, Topic]]:
    for node in nodes(model):
        if isinstance(node, Event):
            yield from ((node, what.topic) for what in node.definitions if isinstance(what, SignalDefinition))


def scripts(model: Definitions) -> Iterator[tuple[str, str]]:
    for node in nodes(model):
        if isinstance(node, Task) and node.script:
            assert node.script.language == "python"
            yield node.id, node.script.text


# ---- what they say ---------------------------------------------------------------------------------------------------


@every_model
def test_it_is_read_without_a_warning(model: Definitions) -> None:
    assert [note for note in model.notes if note.level == "warning"] == []


@every_model
def test_every_process_says_what_it_is_for(model: Definitions) -> None:
    assert all(process.documentation for process in model.processes)


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_a_library_file_holds_the_one_process_that_it_is_named_after(file: Path) -> None:
    assert [process.id for process in read(file).processes] == [file.stem]


def test_no_two_files_that_run_together_have_ids_in_common() -> None:
    """Missions are alternatives; the library runs with any of them. Events of a run name elements by id alone."""
    there = {file: {part.id for body in bodies(read(file)) for part in (*body.nodes, *body.flows)} for file in FILES}
    for a, b in combinations(FILES, 2):
        assert (a not in LIBRARY and b not in LIBRARY) or not there[a] & there[b], (a.stem, b.stem)


@every_model
def test_every_called_process_is_in_the_library(model: Definitions) -> None:
    called = {node.called for node in nodes(model) if isinstance(node, CallActivity)}
    nav2 = {file.stem for file in (MODELS / "nav2").glob("*.bpmn")}
    assert called <= {file.stem for file in LIBRARY} | nav2


@every_model
def test_tasks_are_units_ros_services_or_scripts_of_at_most_15_lines(model: Definitions) -> None:
    tasks = [node for node in nodes(model) if isinstance(node, Task)]
    services = [node for node in tasks if node.kind == "service"]
    assert all(node.kind == "script" for node in tasks if node not in services)
    assert all(node.operation in SERVICES or node.topic is not None for node in services)
    assert all(len(text.strip().splitlines()) <= 15 for _, text in scripts(model))


@every_model
def test_no_script_holds_control_flow_or_waits_or_polls(model: Definitions) -> None:
    plain = (ast.Assign, ast.AugAssign, ast.Expr, ast.Import)
    for id, text in scripts(model):
        tree = ast.parse(text)
        assert all(isinstance(statement, plain) for statement in tree.body), id
        assert not any(isinstance(part, (ast.Await, ast.IfExp, ast.NamedExpr)) for part in ast.walk(tree)), id
        assert not re.search(r"\b(sleep|receive|until|latest|subscribe)\(", text), id


@every_model
def test_all_communication_is_signals_with_a_type_and_throws_have_a_payload(model: Definitions) -> None:
    assert model.message_flows == ()
    for event, topic in topics(model):
        assert topic.type, event.id
        assert topic.name == event.name, event.id
        assert event.place in ("start", "catch", "boundary") or topic.payload, event.id
    assert b"<bpmn:signal " in model.source or not list(topics(model))


@every_model
def test_what_decides_or_is_sent_is_declared_by_a_data_object(model: Definitions) -> None:
    declared = {name for body in bodies(model) for data in body.data_objects for name in data.names}
    conditions = [flow.condition.text for body in bodies(model) for flow in body.flows if flow.condition]
    payloads = [topic.payload.text for _, topic in topics(model) if topic.payload]
    conditions = [text.removeprefix("${").removesuffix("}") if text.startswith("${") else text for text in conditions]
    expressions = conditions + [inner for text in payloads for inner in re.findall(r"\$\{(.*?)\}", text)]
    names = {part.id for text in expressions for part in ast.walk(ast.parse(text)) if isinstance(part, ast.Name)}
    assert names - set(dir(builtins)) <= declared


@every_model
def test_every_choice_has_a_default(model: Definitions) -> None:
    for body in bodies(model):
        defaults = {getattr(node, "default", "") for node in body.nodes}
        for node in body.nodes:
            if len(node.outgoing) > 1 and getattr(node, "kind", "") == "exclusive":
                open_ends = [flow.id for flow in body.flows if flow.id in node.outgoing and not flow.condition]
                assert open_ends == [id for id in node.outgoing if id in defaults], node.id
                assert len(open_ends) == 1, node.id


def test_the_ground_vehicle_mission_is_that_of_the_paper() -> None:
    model = read(MODELS / "ground_vehicles.bpmn")
    assert [pool.name for pool in model.participants] == ["REX", "DINGO"]
    data = {data.name: dict(data.values) for body in bodies(model) for data in body.data_objects}
    assert {name: list(values) for name, values in data.items()} == {
        "map": ["x_min", "x_max", "y_min", "y_max"],
        "target position": ["x_target", "y_target"],
    }
    said = {
        (topic.name, event.place): (topic.type, topic.payload and topic.payload.text) for event, topic in topics(model)
    }
    assert said == {
        ("done", "catch"): ("std_msgs/msg/Bool", None),
        ("target_found", "start"): ("geometry_msgs/msg/Vector3", None),
        ("done", "end"): ("std_msgs/msg/Bool", "true"),
    }
    assert [id for id, text in scripts(model) if '"led"' in text] == ["Activity_Fire"]


def test_the_agriculture_mission_is_that_of_the_paper() -> None:
    model = read(MODELS / "agriculture.bpmn")
    assert [(pool.name, pool.multi_instance) for pool in model.participants] == [("Drone", False), ("Tractor", True)]
    assert [process.instances for process in model.processes] == [None, 1]
    data = {data.name: {*data.names} for body in bodies(model) for data in body.data_objects}
    assert data["field"] == {"x_min", "x_max", "y_min", "y_max"}
    assert data["Weed Position"] == {"x_weed", "y_weed"}
    assert data["Tractor Position"] == {"x_tractor", "y_tractor", "tractor_name"}
    assert data["Closest Tractor"] == {"closest_tractor"}
    types = {topic.name: topic.type for _, topic in topics(model)}
    assert types["weed_found"] == types["weed_position"] == "geometry_msgs/msg/Vector3"
    assert types["tractor_position"] == "geometry_msgs/msg/Vector3Stamped"
    assert types["closest_tractor"] == "std_msgs/msg/String"
    labels = [node.name for node in nodes(model)]
    calls = [node.name for node in nodes(model) if isinstance(node, CallActivity)]
    assert calls == ["Take Off", "Explore", "Return to Base", "Land", "Go To"]
    assert {"I'm the closest tractor?", "Weed Found", "Update Closest", "Get Position", "Cut Grass"} <= {*labels}
    handler = next(node for node in nodes(model) if node.name == "Weed Found")
    assert isinstance(handler, SubProcess)
    assert handler.triggered_by_event
    assert handler.resume


def test_explore_goes_places_and_detects_at_the_same_time() -> None:
    explore, survey = (read(MODELS / "library" / f"{name}.bpmn") for name in ("Explore", "Survey"))
    search = next(node for node in nodes(explore) if isinstance(node, SubProcess))
    for body, behaviours in ((search.body, {"GoTo", "Detect"}), (survey.processes[0].body, {"FlyTo", "DetectWeed"})):
        assert behaviours <= {node.called for node in body.nodes if isinstance(node, CallActivity)}
        assert any(getattr(node, "kind", "") == "parallel" for node in body.nodes)


# ---- how they are drawn ----------------------------------------------------------------------------------------------

Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""


def box(bounds: Bounds, margin: float = 0) -> Box:
    x, y = bounds.x - margin, bounds.y - margin
    return x, y, x + bounds.width + 2 * margin, y + bounds.height + 2 * margin


def overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def inside(a: Box, b: Box) -> bool:
    return a[0] >= b[0] and a[1] >= b[1] and a[2] <= b[2] and a[3] <= b[3]


def crosses(a: tuple[float, float], b: tuple[float, float], area: Box) -> bool:
    """Whether the line from `a` to `b` runs through the area (clipped as by Liang and Barsky)."""
    low, high = 0.0, 1.0
    for axis in (0, 1):
        run = b[axis] - a[axis]
        if run == 0:
            if not area[axis] < a[axis] < area[axis + 2]:
                return False
            continue
        near, far = sorted(((area[axis] - a[axis]) / run, (area[axis + 2] - a[axis]) / run))
        low, high = max(low, near), min(high, far)
    return high - low > 1e-6


def on_border(shape: Shape, point: tuple[float, float]) -> bool:
    b = shape.bounds
    across, down = point[0] - b.x - b.width / 2, point[1] - b.y - b.height / 2
    if shape.kind.endswith("Event"):
        return abs(math.hypot(across, down) - b.width / 2) < 1
    if shape.kind.endswith("Gateway"):
        return abs(abs(across) / b.width + abs(down) / b.height - 0.5) < 0.02
    return inside((*point, *point), box(b, 1)) and not inside((*point, *point), box(b, -1))


def containers(model: Definitions) -> dict[str, str]:
    """Element -> the pool or sub-process that it is drawn in."""
    pools = {pool.process: pool.id for pool in model.participants}
    homes = [(process.body, pools.get(process.id, "")) for process in model.processes]
    homes += [(node.body, node.id) for node in nodes(model) if isinstance(node, SubProcess)]
    return {element.id: home for body, home in homes for element in (*body.nodes, *body.data_objects, *body.flows)}


def ancestors(id: str, homes: dict[str, str]) -> Iterator[str]:
    while id := homes.get(id, ""):
        yield id


def flows(model: Definitions) -> Iterator[tuple[Edge, str, str]]:
    ends = {flow.id: (flow.source, flow.target) for body in bodies(model) for flow in body.flows}
    return ((edge, *ends[edge.element]) for edge in model.edges if edge.element in ends)


def labels(model: Definitions) -> list[tuple[str, Bounds]]:
    of_shapes = [(shape.element, shape.label) for shape in model.shapes if shape.label]
    return of_shapes + [(edge.element, edge.label) for edge in model.edges if edge.label]


@every_drawing
def test_everything_is_drawn_once(model: Definitions) -> None:
    drawn = sorted([shape.element for shape in model.shapes] + [edge.element for edge, _, _ in flows(model)])
    there = [element.id for body in bodies(model) for element in (*body.nodes, *body.data_objects, *body.flows)]
    assert drawn == sorted([*there, *(pool.id for pool in model.participants)])


@every_drawing
def test_no_shape_overlaps_another(model: Definitions) -> None:
    homes = containers(model)
    hosts = {node.id: node.attached_to for node in nodes(model) if isinstance(node, Event)}
    for a, b in combinations(model.shapes, 2):
        apart = b.element not in (*ancestors(a.element, homes), hosts.get(a.element))
        if apart and a.element not in (*ancestors(b.element, homes), hosts.get(b.element)):
            assert not overlap(box(a.bounds, 4), box(b.bounds, 4)), (a.element, b.element)


@every_drawing
def test_everything_is_inside_of_its_pool_or_sub_process(model: Definitions) -> None:
    shapes = {shape.element: shape for shape in model.shapes}
    for id, home in containers(model).items():
        if home and id in shapes:
            for bounds in filter(None, (shapes[id].bounds, shapes[id].label)):
                assert inside(box(bounds), box(shapes[home].bounds, -5)), id


@every_drawing
def test_flows_run_at_right_angles_from_border_to_border(model: Definitions) -> None:
    shapes = {shape.element: shape for shape in model.shapes}
    for edge, source, target in flows(model):
        assert on_border(shapes[source], edge.waypoints[0]), edge.element
        assert on_border(shapes[target], edge.waypoints[-1]), edge.element
        assert all(a[0] == b[0] or a[1] == b[1] for a, b in pairwise(edge.waypoints)), edge.element


@every_drawing
def test_no_line_runs_through_a_shape_or_a_label(model: Definitions) -> None:
    homes = containers(model)
    for edge, source, target in flows(model):
        around = {source, target, *ancestors(source, homes), *ancestors(target, homes)}
        hosts = {node.attached_to for node in nodes(model) if isinstance(node, Event) and node.id in around}
        boxes = [(shape.element, shape.bounds) for shape in model.shapes if shape.element not in around | hosts]
        for id, bounds in [*boxes, *labels(model)]:
            assert not any(crosses(a, b, box(bounds)) for a, b in pairwise(edge.waypoints)), (edge.element, id)


@every_drawing
def test_no_label_covers_a_shape_or_another_label(model: Definitions) -> None:
    homes = containers(model)
    texts = [(id, box(bounds)) for id, bounds in labels(model)]
    for id, label in texts:
        around = set(ancestors(id, homes))
        assert not [s.element for s in model.shapes if s.element not in around and overlap(label, box(s.bounds))], id
    assert not [(a, b) for (a, one), (b, other) in combinations(texts, 2) if overlap(one, other)]
