"""On the page a person takes a robot over, steers it with keys and a pad, and lets its mission continue."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from test_view_control import running
from view_page import PHONE, Finger, becomes, eventually, opened, says, shot, until

from fame.scenario import Scenario
from fame.view import LiveRun, RunControl

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CARS = Path(__file__).parents[1] / "examples" / "ground_vehicles.yaml"


@pytest.fixture
def cars() -> Iterator[LiveRun]:
    """Two cars on their way, at wall-clock speed."""
    with running(Scenario.load(CARS), RunControl(speed=20.0)) as (live, _):
        eventually(lambda: live._time > 9_000_000_000)
        live.control({"do": "speed", "speed": 2})
        yield live


@pytest.fixture
def page(chromium: Browser, cars: LiveRun) -> Iterator[Page]:
    with opened(chromium, cars, tab="team", refused=True) as found:
        until(found, "fame.team.rows.length === 2")
        yield found


def place(live: LiveRun) -> tuple[float, float]:
    pose = live._run.world.robots["REX"].pose
    return pose.x, pose.y


def come(live: LiveRun, before: tuple[float, float]) -> float:
    return math.dist(before, place(live))


def told(live: LiveRun) -> list[str]:
    return [str(detail) for block in live._packer.blocks for detail in block.details.values()]


def take_over(page: Page) -> None:
    page.locator(".robot", has_text="REX").get_by_role("button", name="Take over").click()
    page.locator("#steer").wait_for()


def test_keys_steer_a_robot_that_was_taken_over_and_resume_gives_it_back(page: Page, cars: LiveRun) -> None:
    take_over(page)
    until(page, "fame.team.rows.find((row) => row.name === 'REX').state === 'suspended'")
    assert cars.control_of_run.speed == 1.0
    before = place(cars)
    page.keyboard.down("s")
    eventually(lambda: come(cars, before) > 0.2)
    shot(page, "keys")
    page.keyboard.up("s")
    eventually(lambda: cars._run.world.robots["REX"].drive.speed == 0)
    page.wait_for_timeout(3500)  # longer than a lease
    assert cars._run.nodes[0].suspension.holder == "a person"
    page.locator("#steer").get_by_role("button", name="Resume").click()
    until(page, "fame.team.rows.find((row) => row.name === 'REX').state === 'running'")
    page.locator("#steer").wait_for(state="hidden")
    eventually(lambda: {"taken over by a person", "continued by a person"} <= set(told(cars)))


def test_a_pad_steers_by_touch_on_a_phone(chromium: Browser, cars: LiveRun) -> None:
    with opened(chromium, cars, tab="team", **PHONE) as page:
        until(page, "fame.team.rows.length === 2")
        page.locator(".robot", has_text="REX").get_by_role("button", name="Take over").tap()
        page.locator("#steer .pad").wait_for()
        before, box = place(cars), page.locator("#steer .pad").bounding_box()
        assert box is not None
        finger, middle = Finger(page), box["x"] + box["width"] / 2
        finger.put((middle, box["y"] + box["height"] / 2))
        finger.move((middle, box["y"] + box["height"] - 5))
        eventually(lambda: come(cars, before) > 0.1)
        shot(page, "pad_390")
        finger.lift()
        eventually(lambda: cars._run.world.robots["REX"].drive.speed == 0)


def test_a_lost_connection_stops_the_robot_and_its_mission_stays_suspended(chromium: Browser, cars: LiveRun) -> None:
    with opened(chromium, cars, tab="team") as page:
        until(page, "fame.team.rows.length === 2")
        take_over(page)
        before = place(cars)
        page.keyboard.down("s")
        eventually(lambda: come(cars, before) > 0.1)
        page.close()
    eventually(lambda: cars._run.world.robots["REX"].drive.speed == 0)
    eventually(lambda: "a person steers no longer: lost" in told(cars))
    suspension = cars._run.nodes[0].suspension
    assert (suspension.by, suspension.holder) == ("a person", "")


def test_who_loses_the_robot_to_another_is_told(page: Page, cars: LiveRun) -> None:
    take_over(page)
    cars.control({"do": "suspend", "robot": "REX", "who": "bob"})
    until(page, "document.getElementById('steer').hidden")
    says(page, "#toast", "REX has stopped, its mission is suspended")


def test_the_drawn_activity_is_failed_from_the_panel(page: Page, cars: LiveRun) -> None:
    take_over(page)
    becomes(page, "[...document.querySelectorAll('#steer option')].map((one) => one.textContent)", ["Explore"])
    page.locator("#steer").get_by_role("button", name="Fail").click()
    eventually(lambda: "failed by a person" in told(cars))


def test_another_page_cannot_steer_what_this_one_holds(page: Page, cars: LiveRun) -> None:
    take_over(page)
    post: Any = page.evaluate(
        "fame.post({do: 'steer', robot: 'REX', lease: 'another', speed: 1, turn: 0}).catch((error) => error.message)"
    )
    assert post == "REX: a person steers it; fame suspend stops it"
