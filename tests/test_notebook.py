"""What a notebook shows: the diagram of a model, a table of a result, events as a table of pandas."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest
from bpmn_text import process
from lxml import etree

import fame
from fame.bpmn.draw.diagram import draw
from fame.bpmn.reader import read_text

ROOT = Path(__file__).parent.parent
MODEL = ROOT / "models" / "ground_vehicles.bpmn"
TIMER = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"><process id="p" isExecutable="true">
<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
<intermediateCatchEvent id="t"><timerEventDefinition><timeDuration>PT1.5S</timeDuration></timerEventDefinition>
</intermediateCatchEvent></process></definitions>"""


class Cells(HTMLParser):
    """The texts of the cells and captions of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.feed(page)

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data)


def test_a_model_shows_its_diagram_and_its_name_in_one_line() -> None:
    definitions = fame.read(MODEL)
    assert definitions._repr_svg_() == draw(definitions)
    assert etree.fromstring(definitions._repr_svg_().encode()).tag == "{http://www.w3.org/2000/svg}svg"
    assert repr(definitions) == f"Definitions({str(MODEL)!r}, processes: Process_REX, Process_DINGO)"


def test_a_model_without_a_diagram_is_laid_out_and_an_empty_one_shows_its_name_alone() -> None:
    definitions = read_text(TIMER, file="timer.bpmn")
    assert str(definitions._repr_svg_()).startswith("<svg")
    assert read_text(process(""))._repr_svg_() is None
    assert repr(definitions) == "Definitions('timer.bpmn', processes: p)"


def test_a_result_shows_a_row_for_each_robot_and_its_messages() -> None:
    pytest.importorskip("pymunk")
    result = fame.Scenario.load(ROOT / "examples" / "ground_vehicles.yaml", duration=0.5).run()
    caption, *cells = Cells(result._repr_html_()).texts
    assert caption == "timeout: 0.5 s simulated"
    assert cells[:8] == [
        "robot",
        "instances",
        "elements",
        "status",
        "REX",
        "1",
        str(result.robots[0].elements),
        "running",
    ]
    assert cells[-len(result.messages) :] == result.messages


def test_the_events_of_a_run_become_a_table_with_times_in_seconds() -> None:
    pandas = pytest.importorskip("pandas")
    log = fame.EventLog()
    fame.Simulation(read_text(TIMER, file="timer.bpmn"), observer=log).run()
    table = log.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert list(table) == ["time", "robot", "instance", "scope", "element", "what", "detail"]
    assert len(table) == len(log)
    assert list(table.query("element == 't' and what == 'leave'").time) == [1.5]
    assert len(fame.EventLog().to_pandas()) == 0
