"""Heat maps: what the elements of each model did in all recordings of a folder."""

# ruff: noqa: E501 (a model as XML)

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bpmn_text import process
from view_page import PHONE, eventually, flaws, opened, until

import fame
from fame.bpmn import read_text
from fame.errors import ConfigError, FameError
from fame.intervals import nearest_rank
from fame.log import logging_to
from fame.view import HeatMap
from fame.view.heat import ElementHeat

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MODEL = """<startEvent id="s"/><subProcess id="Visit" name="Visit">
    <startEvent id="in"/><scriptTask id="Look" name="Look"><script>{script}</script></scriptTask>
    <intermediateCatchEvent id="Rest" name="rest">
      <timerEventDefinition><timeDuration>PT{rest}S</timeDuration></timerEventDefinition></intermediateCatchEvent>
    <sequenceFlow id="i1" sourceRef="in" targetRef="Look"/><sequenceFlow id="i2" sourceRef="Look" targetRef="Rest"/>
  </subProcess><sequenceFlow id="f1" sourceRef="s" targetRef="Visit"/>"""
DIAGRAM = """<bpmndi:BPMNDiagram id="d"><bpmndi:BPMNPlane id="pl" bpmnElement="P">
  <bpmndi:BPMNShape id="d1" bpmnElement="Visit" isExpanded="true"><dc:Bounds x="0" y="0" width="400" height="200"/></bpmndi:BPMNShape>
  <bpmndi:BPMNShape id="d2" bpmnElement="Look"><dc:Bounds x="60" y="60" width="100" height="80"/></bpmndi:BPMNShape>
  <bpmndi:BPMNShape id="d3" bpmnElement="Rest"><dc:Bounds x="260" y="80" width="36" height="36"/></bpmndi:BPMNShape>
</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""


def record(path: Path, rest: float, script: str = "await sleep(1)") -> None:
    definitions = read_text(process(MODEL.format(rest=rest, script=script), DIAGRAM), file="visit.bpmn")
    with logging_to(path, [definitions]) as log:
        fame.Simulation(definitions, observer=log, robot="REX").run()


@pytest.fixture
def heat(tmp_path: Path) -> Iterator[HeatMap]:
    """Two runs of one model, of which the second fails; one of another."""
    record(tmp_path / "a.mcap", 3)
    record(tmp_path / "b.mcap", 3, "await sleep(1)")
    record(tmp_path / "sub" / "other.mcap", 5, "raise BpmnError('lost')")
    with HeatMap(tmp_path, show=lambda path: f"http://page/{path.name}") as found:
        found.wait()
        yield found


def by_name(heat: HeatMap, model: str) -> dict[str, Any]:
    mission = heat.mission()
    file = mission["models"].index("visit.bpmn") if model == "first" else len(mission["models"]) - 1
    found = mission["heat"]["elements"]
    return {
        one["id"]: found[str(number)]
        for number, one in enumerate(mission["elements"])
        if one["file"] == file and str(number) in found
    }


def test_runs_of_one_model_are_counted_together(heat: HeatMap) -> None:
    first = by_name(heat, "first")
    assert first["Look"] == {"times": 2, "failures": 0, "p50": 1.0, "p95": 1.0, "waiting": 0.0}
    assert first["Rest"] == {"times": 2, "failures": 0, "p50": 3.0, "p95": 3.0, "waiting": 6.0}
    assert first["f1"]["times"] == 2


def test_an_activity_waits_while_something_inside_it_does(heat: HeatMap) -> None:
    visit = by_name(heat, "first")["Visit"]
    assert (visit["p50"], visit["waiting"]) == (4.0, 6.0)


def test_another_content_is_another_model_and_failures_are_counted_there(heat: HeatMap) -> None:
    models = heat.mission()["heat"]["models"]
    assert [(one["name"], one["runs"]) for one in models] == [("visit.bpmn", 2), ("visit.bpmn", 1)]
    assert models[0]["hash"] != models[1]["hash"]
    other = by_name(heat, "other")
    assert (other["Look"]["failures"], other["Look"]["p50"]) == (1, None)
    assert "Rest" not in other


def test_an_element_lists_its_runs_and_a_run_has_a_page(heat: HeatMap) -> None:
    look = next(number for number, one in enumerate(heat.mission()["elements"]) if one["id"] == "Look")
    runs = heat.control({"do": "runs", "element": look})["runs"]
    assert [one["name"] for one in runs] == ["a.mcap", "b.mcap"]
    assert heat.control({"do": "show", "run": runs[1]["run"]}) == {"address": "http://page/b.mcap"}
    with pytest.raises(FameError, match="expected a run or an element"):
        heat.control({"do": "show", "run": 99})


def test_a_percentile_is_a_value_that_was_seen() -> None:
    assert [nearest_rank([3.0, 1.0, 2.0, 4.0], fraction) for fraction in (0.5, 0.95)] == [2.0, 4.0]


def test_what_cannot_be_read_is_told_and_counts_as_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path / "a.mcap", 3)
    record(tmp_path / "c.mcap", 3)
    (tmp_path / "b.mcap").write_text("nothing")
    add = HeatMap._add
    monkeypatch.setattr(HeatMap, "_add", lambda self, run, replay: 1 / 0 if run == 2 else add(self, run, replay))
    with HeatMap(tmp_path) as heat:
        heat.wait()
        assert heat.mission()["chips"][0][0] == "1 of 3 runs"
        assert ["b.mcap" in heat.notices[1][0], "c.mcap" in heat.notices[2][0]] == [True, True]


def test_a_recording_is_read_once_and_again_only_when_it_was_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, summed = [], []
    add, to_json = HeatMap._add, ElementHeat.to_json
    monkeypatch.setattr(HeatMap, "_add", lambda self, run, replay: (read.append(run), add(self, run, replay)))
    monkeypatch.setattr(ElementHeat, "to_json", lambda self: (summed.append(self), to_json(self))[1])
    monkeypatch.setattr("fame.view.heat._POLL", 0.02)
    folder = tmp_path / "runs"
    for name in ("a", "b"):
        record(folder / f"{name}.mcap", 3)
    with HeatMap(folder) as heat:
        heat.wait()
        first = heat.mission()["heat"]["elements"]
        assert (read, len(summed)) == ([0, 1], len(first))
        assert heat.mission()["heat"]["elements"] == first
        assert len(summed) == len(first)  # another load of the page sums nothing again
        for name, rest in (("b", 5), ("c", 3)):
            record(tmp_path / "new.mcap", rest)
            (tmp_path / "new.mcap").replace(folder / f"{name}.mcap")
        eventually(lambda: [one["runs"] for one in heat.mission()["heat"]["models"]] == [2, 1])
        assert sorted(read) == [0, 1, 1, 2]
        assert by_name(heat, "first")["Rest"] == {"times": 2, "failures": 0, "p50": 3.0, "p95": 3.0, "waiting": 6.0}


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no recordings"):
        HeatMap(tmp_path)


def test_the_page_colours_the_diagram_and_lists_runs(chromium: Browser, heat: HeatMap) -> None:
    with opened(chromium, heat, **PHONE) as page:
        until(page, "document.querySelectorAll('.is-hot').length >= 2")
        page.get_by_role("button", name="Waiting").tap()
        until(page, "[...document.querySelectorAll('.badge.heat')].map((one) => one.textContent).includes('6 s')")
        page.locator("[data-id=Rest]").first.tap()
        until(page, "document.querySelector('#inspector').innerText.includes('b.mcap')")
        assert flaws(page, "heat", (1440, "light"), (1024, "light"), (390, "dark")) == []
