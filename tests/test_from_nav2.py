"""docs/from_nav2.md: the patrol as a diagram does what its script and its state machine say."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from fame.bpmn import read
from fame.bpmn.draw.diagram import draw
from fame.cli import main
from fame.scenario import Scenario

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "from_nav2.md").read_text(encoding="utf-8")


def test_the_patrol_of_the_page_passes_its_places_and_reports_the_one_without_a_way() -> None:
    lines: list[tuple[str, str]] = []
    scenario = Scenario.load(DOCS / "from_nav2.yaml")
    result = scenario.run(
        observer=lambda event: lines.append((event.robot, event.detail)) if event.what == "log" else None
    )
    assert result.status == "completed"
    assert lines == [("REX", "no way to 4 3"), ("DINGO", "no way to 4 3")]


def test_the_three_patrols_have_the_same_places() -> None:
    (written,) = re.findall(r"ROUNDS = (.*)", PAGE)
    processes = read(DOCS / "from_nav2.bpmn").processes
    plans = [node.script.text for one in processes for node in one.body.nodes if node.label == "Plan Round"]
    drawn = [ast.literal_eval(plan.partition("=")[2].strip()) for plan in plans]
    assert drawn == [[list(place) for place in places] for places in ast.literal_eval(written).values()]


def test_the_picture_of_the_page_is_that_of_the_model() -> None:
    assert (DOCS / "images" / "from_nav2.svg").read_text(encoding="utf-8") == draw(read(DOCS / "from_nav2.bpmn"))


def test_no_order_of_messages_leaves_a_robot_waiting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(DOCS / "from_nav2.bpmn")]) == 0
    assert "all states explored" in capsys.readouterr().out
