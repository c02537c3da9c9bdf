"""Properties on the page: a lane for each, the elements that it names, and a jump to the events that broke it."""

from __future__ import annotations

from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from recorded_runs import record
from view_page import becomes, beyond, opened, says, until

from fame.log import Recording
from fame.log.channels import PROPERTIES
from fame.scenario import Scenario
from fame.view import Replay

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EXAMPLES = Path(__file__).parent.parent / "examples"
MINE = """properties:
  answer: after Drone throws /weed_found, some Tractor starts "Go To" within 12 s
  soon:   after Drone throws /weed_found, some Tractor starts "Go To" within 300 ms
  charge: always Drone.battery > 0.1
  apart:  always distance(any two Tractor) > 0.5
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    text = (EXAMPLES / "agriculture.yaml").read_text().partition("properties:")[0] + MINE
    for name in ("../models", "agriculture_world.yaml", "worlds"):
        text = text.replace(f" {name}", f" {EXAMPLES / name}")
    (folder / "mine.yaml").write_text(text)
    return record(Scenario.load(folder / "mine.yaml", duration=30), folder / "mine.mcap")


def test_a_recording_of_a_run_has_its_properties(recording: Path) -> None:
    with Recording(recording) as read:
        told = [message.json() for message in read.messages([PROPERTIES])]
    names = {each["property"]: each["names"] for each in told if "names" in each}
    assert {"answer", "soon", "charge", "apart"} <= names.keys()
    assert {robot for robot, _ in names["answer"]} >= {"Drone", "Tractor_1"}
    assert "violated" in {each["verdict"] for each in told if each["property"] == "soon"}
    with Replay(recording) as replay:
        replay.wait()
        rows = [row for block in replay._packer.blocks for row in block.lists["properties"]]
    assert len(rows) == len(told)
    assert [time for time, _ in rows] == sorted(time for time, _ in rows)


def lane(name: str) -> str:
    return f"fame.timeline.properties.lanes.find((one) => one.name === '{name}')"


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)], ids=["wide", "phone"])
def test_a_click_shows_what_broke_a_property(chromium: Browser, recording: Path, size: tuple[int, int]) -> None:
    narrow = size[0] < 1101  # one panel at a time, used by touch
    press = methodcaller("tap" if narrow else "click")
    viewport = {"width": size[0], "height": size[1]}
    with Replay(recording) as replay, opened(chromium, replay, viewport=viewport, has_touch=narrow) as page:
        until(page, f"{lane('soon')}?.spans.length > 0")
        until(page, f"{lane('answer')}.spans.length > 0 && {lane('apart')}.curve.length > 5")  # all blocks are read
        span = page.evaluate(f"{lane('soon')}.spans.find((one) => one.verdict === 'violated')")
        assert span["until"] - span["from"] == 300_000_000
        if narrow:
            press(page.get_by_role("tab", name="Log"))
        press(page.locator(".lane.property", has_text="soon"))
        card = page.locator(".verdict")
        says(page, ".verdict:not([hidden])", 'some Tractor starts "Go To" within 300 ms')
        if narrow:
            press(page.get_by_role("tab", name="Diagram"))
        until(page, "document.querySelectorAll('.is-named').length > 0")
        if narrow:
            press(page.get_by_role("tab", name="Log"))
        press(card.locator("div button").first)
        until(page, f"fame.state?.time === {span['from']}")
        becomes(page, "fame.mission.elements[fame.selected.element].name", "weed_found")
        press(card.locator("div button").last)
        until(page, f"fame.state?.time === {span['until']}")
        assert beyond(page) == []
        press(page.locator(".verdict .close"))
        until(page, "document.querySelector('.verdict').hidden && !document.querySelector('.is-named')")
