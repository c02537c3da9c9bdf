"""A film shows the diagram of a run: tokens in the colours of their robots, flows that were taken, signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bpmn_text import document, process
from PIL import Image, ImageColor
from recorded_runs import record

from fame.bpmn import read_text
from fame.bpmn.model import Definitions
from fame.cli import main
from fame.clock import SECOND
from fame.errors import ModelError
from fame.log.recording import Recording
from fame.robot.events import Event
from fame.scenario import Scenario, film_diagram, films
from fame.scenario.film_diagram import CAPTION, DiagramFilm
from fame.view import Replay
from sim2d.style import robot_colour

pytest.importorskip("resvg_py", reason="needs the package resvg-py")

ROOT = Path(__file__).parent.parent
MISSION = str(ROOT / "models" / "ground_vehicles.bpmn")
REX, DINGO = "#2364c9", "#d9630b"


def shape(id: str, x: int, width: int = 100) -> str:
    bounds = f'<dc:Bounds x="{x}" y="80" width="{width}" height="80"/>'
    return f'<bpmndi:BPMNShape bpmnElement="{id}">{bounds}</bpmndi:BPMNShape>'


def edge(id: str, start: int, end: int) -> str:
    points = "".join(f'<di:waypoint x="{x}" y="120"/>' for x in (start, end))
    return f'<bpmndi:BPMNEdge bpmnElement="{id}">{points}</bpmndi:BPMNEdge>'


WIDE = read_text(
    document(
        """<signal id="S" name="arrived"/><process id="P" isExecutable="true"><startEvent id="s"/>
        <intermediateThrowEvent id="t"><signalEventDefinition signalRef="S"/></intermediateThrowEvent>
        <userTask id="far" name="Far away"/><sequenceFlow id="st" sourceRef="s" targetRef="t"/>
        <sequenceFlow id="tf" sourceRef="t" targetRef="far"/></process><bpmndi:BPMNDiagram id="d"><bpmndi:BPMNPlane
        bpmnElement="P">"""
        + shape("s", 100, 80)
        + shape("t", 300, 80)
        + shape("far", 3000)
        + edge("st", 180, 300)
        + edge("tf", 380, 3000)
        + "</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"
    ),
    file="wide.bpmn",
)
"""A mission whose last task is four windows away from its start."""


def share(image: Image.Image, colour: str) -> float:
    """The share of the pixels of an image that have a colour."""
    pixels = np.asarray(image.convert("RGB"), dtype=np.int16)
    return float((abs(pixels - np.array(ImageColor.getrgb(colour)[:3])) <= 24).all(axis=2).mean())


def film() -> DiagramFilm:
    return DiagramFilm(WIDE, {"REX": REX, "DINGO": DINGO}, 800, 400)


def at(element: str, time: float, what: str = "enter", robot: str = "REX") -> Event:
    return Event(round(time * SECOND), robot, 1, 1, element, what)


def test_a_token_has_the_colour_of_its_robot_while_it_rests() -> None:
    before, during, after = film().frames([at("s", 1), at("s", 2, "leave")], [0.5, 1.5, 2.5])
    assert share(during, REX) > 1e-4
    assert share(before, REX) == share(after, REX) == 0


def test_two_robots_at_an_element_have_a_token_each() -> None:
    (frame,) = film().frames([at("s", 0), at("s", 0, robot="DINGO")], [1.0])
    assert share(frame, REX) > 1e-5
    assert share(frame, DINGO) > 1e-4


def test_a_token_ends_with_its_instance() -> None:
    *_, last = film().frames([at("s", 0), at("s", 0, robot="DINGO"), at("P", 1, "end")], [0.5, 1.5])
    assert share(last, REX) == 0
    assert share(last, DINGO) > 1e-4


def test_a_flow_lights_up_when_it_is_taken_and_fades() -> None:
    taken, *_, later = film().frames([at("st", 1, "take")], [1.0 + number / 10 for number in range(9)])
    assert share(taken, REX) != share(later, REX)
    assert share(later, REX) == 0


def test_the_window_follows_the_tokens() -> None:
    events = [at("s", 0), at("s", 1, "leave"), at("far", 1)]
    frames = list(film().frames(events, [number / 10 for number in range(60)]))
    assert share(frames[0], REX) > 1e-4  # the start
    assert share(frames[-1], REX) > 1e-4  # the task, which no window shows together with the start
    assert frames[0].size == frames[-1].size == film().size


def test_what_comes_again_and_again_does_not_draw_the_window_there() -> None:
    loop = [event for number in range(100) for event in (at("t", 1 + number / 5), at("t", 1.1 + number / 5, "leave"))]
    events = sorted([*loop, at("far", 8)], key=lambda event: event.time)
    *_, last = film().frames(events, [number / 10 for number in range(150)])
    assert share(last, REX) > 1e-4
    box = last.crop((700, 0, 800, last.height - CAPTION))
    assert share(box, REX) > 0  # the task stands at the right end of the diagram


def test_the_window_leaves_at_once_where_no_token_is() -> None:
    events = [at("s", 0), at("far", 2, robot="DINGO"), at("far", 3.5, "leave", robot="DINGO")]
    frames = list(film().frames(events, [number / 10 for number in range(50)]))
    assert share(frames[34], DINGO) > 1e-4
    assert [share(frame, REX) > 1e-4 for frame in frames[40:]] == [True] * 10  # at the start, where REX still is


def test_what_passes_at_once_does_not_draw_the_window_there() -> None:
    events = [at("s", 0), at("far", 2, robot="DINGO"), at("far", 2, "leave", robot="DINGO")]
    frames = list(film().frames(events, [number / 10 for number in range(40)]))
    assert all(share(frame, REX) > 1e-4 for frame in frames)


def test_a_signal_is_named_when_it_is_thrown() -> None:
    def caption(frame: Image.Image) -> Image.Image:
        return frame.crop((0, frame.height - CAPTION, frame.width, frame.height))

    silent, said, *_, over = film().frames([at("t", 1, "leave")], [0.5 + number for number in range(20)])
    assert share(caption(said), REX) > 1e-3
    assert share(caption(silent), REX) == share(caption(over), REX) == 0


def test_a_diagram_of_any_size_is_drawn_in_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    source = WIDE.source.replace(b'x="3000" y="80"', b'x="3000000" y="80"')
    monkeypatch.setattr(film_diagram, "_PIXELS", 1e5)
    drawn = DiagramFilm(read_text(source.decode()), {"REX": REX}, 800, 400)
    (image,) = drawn.frames([], [0.0])
    assert image.width == 800
    assert drawn._still.width * drawn._still.height < 2e5


def unable(model: Definitions) -> None:
    """In place of the layout: a model for which there is none."""
    raise ModelError("it cannot be laid out")


def test_a_recording_with_neither_diagram_nor_world_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plain.bpmn").write_text(process('<startEvent id="s"/>'))
    monkeypatch.setattr("fame.layout.lay_out", unable)
    run = str(tmp_path / "run.mcap")
    main(["run", str(tmp_path / "plain.bpmn"), "--quiet", "--log", run])
    assert main(["draw", run, "-o", str(tmp_path / "x.gif")]) == 2
    assert "run.mcap: has neither a drawn diagram nor a simulated world to show" in capsys.readouterr().err


def test_a_run_without_a_world_has_a_film_of_its_diagram(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "wide.bpmn").write_bytes(WIDE.source)
    run, film = str(tmp_path / "run.mcap"), tmp_path / "run.webp"
    words = ["run", str(tmp_path / "wide.bpmn"), "--duration", "1", "--quiet", "--log", run]
    main([*words, "--animate", str(film)])
    with Image.open(film) as image:
        assert image.width == 800
        image.seek(image.n_frames - 1)
        assert share(image, REX) > 1e-5
    capsys.readouterr()
    assert main(["draw", run, "-o", str(film), "--show", "world"]) == 2
    assert "run.mcap: has no simulated world to draw" in capsys.readouterr().err


def test_what_has_neither_diagram_nor_world_is_refused_before_it_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plain.bpmn").write_text(process('<startEvent id="s"/>'))
    monkeypatch.setattr("fame.layout.lay_out", unable)
    film = tmp_path / "x.gif"
    assert main(["run", str(tmp_path / "plain.bpmn"), "--animate", str(film)]) == 2
    told = capsys.readouterr()
    assert told.err == f"fame: error: {film}: cannot be drawn: the scenario has no world\n"
    assert told.out == ""


def test_robots_have_the_colours_that_they_have_on_the_page(tmp_path: Path) -> None:
    recording = record(
        Scenario.load(ROOT / "examples" / "cookbook" / "patrol" / "mission.bpmn", duration=2), tmp_path / "run.mcap"
    )
    with Replay(recording) as replay:
        mission = replay.mission()
    names = [mission["robots"][robot]["name"] for robot in mission["order"]]
    assert names == ["DESK", "GUARD"]  # which a run begins with the other way round
    assert films._colours(films.read_run(recording)) == {name: robot_colour(at) for at, name in enumerate(names)}


def test_a_film_shows_diagram_and_world_or_one_of_them(tmp_path: Path) -> None:
    run = tmp_path / "run.mcap"
    main(["run", str(ROOT / "examples" / "ground_vehicles.yaml"), "--duration", "1", "--quiet", "--log", str(run)])
    sizes = {}
    for show in ("both", "diagram", "world"):
        assert main(["draw", str(run), "-o", str(tmp_path / f"{show}.gif"), "--show", show]) == 0
        with Image.open(tmp_path / f"{show}.gif") as image:
            sizes[show] = image.size
    assert sizes["both"][0] == sizes["diagram"][0] == 800
    assert sizes["both"][1] > sizes["diagram"][1]
    with Recording(run) as recording:
        assert {event.robot for event in recording.events()} >= {"REX"}
