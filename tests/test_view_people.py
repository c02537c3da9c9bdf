"""The first look of the page: which robot is well, which one needs somebody, and what people do about it."""

# ruff: noqa: E501 (expressions of JavaScript)

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from test_view_control import running
from view_page import (
    OVERLAPPING,
    PHONE,
    READY,
    Finger,
    becomes,
    beyond,
    eventually,
    flaws,
    frames,
    opened,
    says,
    until,
    violations,
)

from fame.scenario import Scenario
from fame.view import LiveRun, RunControl

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

HOSPITAL = Path(__file__).parent / "hospital" / "hospital.yaml"
ROWS = "Object.fromEntries(fame.team.rows.map((row) => [row.name, row.state]))"


@pytest.fixture
def hospital() -> Iterator[LiveRun]:
    """Seven robots at wall-clock speed, of which the cleaner has an incident."""
    with running(Scenario.load(HOSPITAL), RunControl(speed=20.0), hold_errors=True) as (live, _):
        eventually(lambda: any(wait.get("error") for wait in waits(live)))
        live.control({"do": "speed", "speed": 1})
        yield live


def waits(live: LiveRun) -> list[dict[str, Any]]:
    return [token for state in live._packer.state.robots.values() for token in state.tokens.values()]


@pytest.fixture
def page(chromium: Browser, hospital: LiveRun) -> Iterator[Page]:
    with opened(chromium, hospital, tab="team", has_touch=True) as found:
        until(found, "fame.team.rows.length === 7")
        yield found


def row(name: str) -> str:
    return f"fame.team.rows.find((row) => row.name === '{name}')"


def test_robots_that_need_somebody_come_first(page: Page) -> None:
    names = ["Cleaner", "Dispatcher", "Lift", "Porter_1", "Porter_2", "Porter_3", "Porter_4"]
    states = until(page, ROWS, holds=lambda rows: list(rows) == names)
    assert list(states.values())[:3] == ["incident", "waiting", "running"]
    assert page.locator("#tabs .count:visible").inner_text() == "2"
    cells = page.locator(".robot", has_text="Cleaner").locator("[role=cell]").all_inner_texts()
    assert [cells[at] for at in (0, 1, 2, 5)] == ["Cleaner", "incident", "Rinse the brush", "Rinse the brush"]
    assert re.fullmatch(r"\d+ s", cells[3])
    assert page.locator("#needs h3").all_inner_texts() == ["Plan the round", "Rinse the brush"]  # the oldest first


def test_what_a_robot_does_is_said_in_the_words_of_the_diagram_with_the_way_to_go(
    page: Page, hospital: LiveRun
) -> None:
    hospital.control({"do": "signal", "topic": "/lift_here", "robot": "Lift", "value": ""})  # too early
    hospital.control({"do": "complete", "robot": "Dispatcher", "element": "Plan_Round", "value": '{"ward": "ward_1"}'})
    until(page, f"{row('Porter_1')}.doing === 'Go to the ward' && /^[0-9.]+ m to go$/.test({row('Porter_1')}.progress)")
    becomes(page, f"{row('Porter_3')}.doing", "Waits: lift is here")
    page.locator(".robot", has_text="Porter_3").locator(".missed", has_text="lift is here").wait_for(state="attached")
    becomes(page, f"{row('Lift')}.doing", "Check the door of the lift")
    page.evaluate("fame.tabs.choose('diagram')")  # the timeline says the same
    until(page, "document.querySelectorAll('.lane:not(.property) small').length === 7")
    said = "(row) => fame.timeline.captions[row.r].textContent === row.doing"
    until(page, f"fame.team.rows.every({said}) && {row('Cleaner')}.doing === 'Rinse the brush'")
    page.evaluate("fame.tabs.choose('team')")
    until(page, f"0.4 < {row('Porter_3')}.battery && {row('Porter_3')}.battery < 0.47")


def test_each_part_is_used_with_the_fingers_on_a_phone_and_an_incident_is_mended_with_two_touches(
    chromium: Browser, hospital: LiveRun
) -> None:
    hospital.control({"do": "set", "robot": "Cleaner", "name": "water", "value": "9"})
    with opened(chromium, hospital, tab="team", **PHONE) as page:
        finger = Finger(page)
        until(page, "document.querySelector('#tabs [data-tab=needs]').offsetWidth > 0")

        page.get_by_role("tab", name="Needs you").tap()
        says(page, ".ask.incident", "the tank has 0.0 l of water, the brush needs 2 l")
        page.locator(".ask.incident").get_by_role("button", name="Retry", exact=True).tap()
        until(page, f"{row('Cleaner')}.state === 'running'")
        page.locator(".ask.user").get_by_role("button", name="Complete").tap()
        page.locator("dialog").get_by_label("Ward").select_option(label="Ward 2")
        for label in ("Urgent", "Late"):
            page.locator("dialog").get_by_label(label).tap()
        page.locator("dialog").get_by_role("button", name="Cancel").tap()

        page.get_by_role("tab", name="Team").tap()
        page.get_by_role("button", name="Dispatcher").tap()
        until(page, "document.body.dataset.tab === 'diagram' && fame.diagram.view.scale >= 0.9")
        scale, place = "fame.diagram.view.scale", "fame.diagram.view.y"
        before = page.evaluate(scale)
        finger.put((150, 400), (250, 400))
        finger.move((110, 400), (290, 400))
        finger.lift()
        until(page, f"{scale} > {1.3 * before}")
        before = page.evaluate(place)
        finger.put((200, 400))
        finger.move((200, 450))
        finger.lift()
        until(page, f"{place} >= {before + 45}")
        page.get_by_role("button", name="Fit the diagram").tap()
        page.locator("[data-id=Plan_Round]").tap()
        until(page, "fame.mission.elements[fame.selected.element]?.id === 'Plan_Round'")

        page.get_by_role("tab", name="Log").tap()
        page.locator("#inspector .card").get_by_role("button", name="Complete").wait_for()  # at the chosen element, too
        for tab in ("Messages", "Log", "State"):
            page.locator("#inspector").get_by_role("tab", name=tab).tap()
        page.get_by_role("button", name="Signal").tap()  # with the fields of its type
        page.get_by_label("Topic").select_option(label="/round")
        page.get_by_role("button", name="Next", exact=True).tap()
        page.get_by_label("data").fill("ward_1")
        page.get_by_role("button", name="Send").tap()
        eventually(lambda: variables(hospital, "Porter_1").get("round") == "ward_1")
        page.locator("#time .lanes").tap(position={"x": 100, "y": 20})
        until(page, "!fame.player.following && fame.player.time < fame.store.end")
        page.get_by_role("button", name="Live").tap()
        until(page, "fame.player.following")
        page.get_by_role("button", name="Pause").tap()
        eventually(lambda: hospital.control_of_run.paused)
        page.get_by_role("button", name="Resume").tap()
        eventually(lambda: not hospital.control_of_run.paused)

        page.get_by_role("tab", name="Map").tap()
        number = page.evaluate(f"{row('Porter_2')}.r")
        x, y = until(page, f"[...fame.world.robots ?? []].find(([r]) => r === {number})?.[1]")
        page.locator("#world .frame").tap(position={"x": x, "y": y})
        until(page, f"fame.selected.robot === {number}")

        page.get_by_role("tab", name="Team").tap()
        page.locator(".robot", has_text="Porter_3").get_by_role("button", name="Take over").tap()
        until(page, f"{row('Porter_3')}.state === 'suspended'")
        until(page, f"{LOWEST} <= document.querySelector('#steer').getBoundingClientRect().top")
        page.locator("#steer").get_by_role("button", name="Resume").tap()
        until(page, f"{row('Porter_3')}.state !== 'suspended'")
        page.get_by_role("button", name="Light or dark").tap()
        page.get_by_role("button", name="Keyboard and legend").tap()
        page.locator("#help").get_by_role("button", name="Close").tap()
        page.locator("#help").wait_for(state="hidden")
        page.get_by_role("tab", name="Log").first.tap()
        page.get_by_role("button", name="Fault").tap()
        page.locator("dialog[open]").wait_for()
        assert beyond(page) == []
        becomes(page, SMALL, [])
        page.locator("dialog").get_by_role("button", name="Cancel").tap()
        page.get_by_role("button", name="Fault").tap()
        page.get_by_label("Robot and part").select_option(label="Porter_4: engine")
        page.get_by_role("button", name="Inject").tap()
        says(page, "#toast", "engine of Porter_4 is broken.")
        page.get_by_role("tab", name="Team").tap()
        until(page, f"{row('Porter_4')}.state === 'lost'")


def test_a_phone_can_install_the_page(page: Page) -> None:
    found = page.context.new_cdp_session(page).send("Page.getInstallabilityErrors")["installabilityErrors"]
    assert [one["errorId"] for one in found] == ["in-incognito"]  # as all pages of a test


def test_a_variable_is_set_before_the_retry(page: Page) -> None:
    page.get_by_role("button", name="Set and retry").tap()
    assert page.locator("dialog .field").first.inner_text() == "water"
    page.locator("dialog").get_by_label("water").fill("9")
    page.locator("dialog").get_by_role("button", name="Retry").tap()
    until(page, f"{row('Cleaner')}.state === 'running'")


def test_a_skipped_element_is_in_the_log_with_who_skipped_it(page: Page, hospital: LiveRun) -> None:
    page.locator(".ask.incident").get_by_role("button", name="Skip").tap()

    def told() -> list[str]:
        return [str(detail) for block in hospital._packer.blocks for detail in block.details.values()]

    eventually(lambda: "skipped by a person, on to Flow_Cleaner_Rinse_Cleaner_Again" in told())


def test_the_emergency_stop_suspends_them_all_and_ends_with_its_release(page: Page, hospital: LiveRun) -> None:
    hospital.control({"do": "signal", "topic": "/emergency_stop", "robot": "Lift", "value": ""})
    until(page, f"{row('Porter_1')}.state === 'waiting' && {row('Porter_1')}.doing === 'Release the emergency stop'")
    hospital.control({"do": "complete", "robot": "Porter_1", "element": "Porter_Release", "value": ""})
    until(page, f"{row('Porter_1')}.state === 'running'")


def test_a_task_with_a_boundary_timer_has_a_deadline(page: Page, hospital: LiveRun) -> None:
    hospital.control({"do": "complete", "robot": "Dispatcher", "element": "Plan_Round", "value": '{"ward": "ward_1"}'})
    hospital.control({"do": "speed", "speed": 20})
    until(page, "[...document.querySelectorAll('.ask .due')].some((one) => /due in [23] min/.test(one.textContent))")


def test_a_form_is_filled_in_and_checked_by_the_browser(page: Page, hospital: LiveRun) -> None:
    page.locator(".ask.user").get_by_role("button", name="Complete").tap()
    dialog = page.locator("dialog.ask")
    assert "FAME does not draw fields of type filepicker" in dialog.inner_text()
    dialog.get_by_role("button", name="Complete").tap()
    assert dialog.is_visible()  # the ward is required
    dialog.get_by_label("Ward").select_option(label="Ward 2")
    dialog.get_by_label("Boxes for each porter").fill("7")
    dialog.get_by_role("button", name="Complete").tap()
    assert dialog.is_visible()  # six at most
    dialog.get_by_label("Boxes for each porter").fill("3")
    dialog.get_by_label("Urgent").check()
    dialog.get_by_label("Late").check()
    dialog.get_by_label("Day").fill("2026-11-27")
    dialog.get_by_label("Reference").fill("AB-12")
    dialog.get_by_role("button", name="Complete").tap()
    given = {"ward": "ward_2", "boxes": 3, "urgent": True, "shift": "late", "day": "2026-11-27", "reference": "AB-12"}
    values = eventually(
        lambda: variables(hospital, "Dispatcher") if "ward" in variables(hospital, "Dispatcher") else None
    )
    assert given.items() <= values.items()


def variables(live: LiveRun, robot: str) -> dict[str, Any]:
    scopes = live._packer.state.robots[live._packer.robots.index(robot)].scopes
    return {name: value for scope in scopes.values() for name, value in scope.values.items()}


def test_who_completed_a_task_is_in_the_log(hospital: LiveRun) -> None:
    hospital.control({"do": "complete", "robot": "Dispatcher", "element": "Plan_Round", "who": "ann (shift_lead)"})
    told = [str(detail) for block in hospital._packer.blocks for detail in block.details.values()]
    assert "completed by ann (shift_lead): Plan_Round" in told


def test_a_robot_whose_engine_is_gone_is_lost(page: Page, hospital: LiveRun) -> None:
    hospital.control({"do": "fault", "robot": "Porter_2", "kind": "engine"})
    until(page, f"{row('Porter_2')}.state === 'lost'")
    assert page.evaluate("fame.team.rows[1].name") == "Porter_2"


def test_one_button_pauses_the_run_and_one_choice_sets_its_speed(page: Page, hospital: LiveRun) -> None:
    page.get_by_role("button", name="Pause").tap()
    eventually(lambda: hospital.control_of_run.paused)
    page.get_by_role("button", name="Resume").tap()
    eventually(lambda: not hospital.control_of_run.paused)
    page.get_by_label("Speed").select_option(label="2\N{MULTIPLICATION SIGN}")
    eventually(lambda: hospital.control_of_run.speed == 2.0)
    page.get_by_role("button", name="Previous event").tap()
    page.get_by_role("button", name="Play").wait_for()
    becomes(page, "document.querySelector('.speed select').title", "Speed of the replay")


def test_each_part_is_accessible_within_the_window_and_large_where_one_touches(
    chromium: Browser, hospital: LiveRun
) -> None:
    with opened(chromium, hospital, tab="team", refused=True) as page:  # a lease runs out while axe-core looks
        for width, theme in ((1440, "light"), (1024, "dark"), (390, "light"), (360, "dark")):
            page.set_viewport_size({"width": width, "height": 844})
            for part in parts(page, TABS if width <= 1100 else ("team", "diagram")):
                if width == 360:  # in other ways it is as with 390 px
                    frames(page)
                    assert beyond(page) == [], part
                else:
                    assert flaws(page, part, (width, theme)) == [], part
                if width <= 1100:
                    becomes(page, SMALL, [])


TABS = ("team", "needs", "map", "diagram", "log")


def parts(page: Page, tabs: Sequence[str]) -> Iterator[str]:
    """Each part of the page, one after the other, while it is shown."""
    for tab in tabs:
        page.evaluate(f"fame.tabs.choose('{tab}')")
        yield tab
    for tab in ("topics", "log"):
        page.evaluate(f"fame.inspector.choose('{tab}')")
        yield f"inspector_{tab}"
    page.evaluate("fame.inspector.choose('state')")
    page.evaluate("fame.tabs.choose('needs')")
    page.locator(".ask.user").get_by_role("button", name="Complete").click()
    yield "form"
    page.keyboard.press("Escape")
    page.evaluate("fame.tabs.choose('log')")
    page.get_by_role("button", name="Fault").click()
    yield "fault"
    page.keyboard.press("Escape")
    page.evaluate("fame.tabs.choose('needs')")
    page.keyboard.press("?")
    yield "help"
    page.keyboard.press("Escape")
    page.evaluate(f"fame.steer.takeOver({row('Cleaner')}.r)")
    page.get_by_role("button", name="Let go").wait_for()
    yield "steer"
    page.evaluate("fame.steer.held && fame.steer.end('suspend')")
    page.locator("#steer").wait_for(state="hidden")
    page.evaluate("fame.select({robot: -1})")  # the diagram shows all again


def test_what_is_written_of_seven_robots_is_legible_and_nothing_is_written_on_it(page: Page, hospital: LiveRun) -> None:
    hospital.control({"do": "complete", "robot": "Dispatcher", "element": "Plan_Round", "value": '{"ward": "ward_1"}'})
    page.set_viewport_size({"width": 1440, "height": 900})
    for tab in ("team", "diagram"):
        page.evaluate(f"fame.tabs.choose('{tab}')")
        frames(page)
        page.evaluate("fame.diagram.fit()")
        until(page, f"{SIZES}.every(([, size]) => size >= 9)")
        assert page.evaluate(f"({OVERLAPPING})(fame.world.written)") == []
    assert page.evaluate(ELSEWHERE) == []
    names = [text for text, _ in page.evaluate(SIZES)]
    assert {"Dispatcher", "Porter", "Lift", "Cleaner", "delivered", "yes"} <= set(names)
    assert any(text.startswith("Go to") for text in names)  # how much fits into a line depends on the fonts
    assert until(page, "fame.timeline.bars.written?.size")
    assert page.evaluate(f"({OVERLAPPING})([...fame.timeline.bars.written.values()].flat())") == []
    assert page.evaluate("fame.timeline.scroller.scrollHeight <= fame.timeline.scroller.clientHeight")  # all lanes


def test_a_chosen_robot_fills_the_diagram_and_the_details_follow_the_zoom(page: Page) -> None:
    page.evaluate("fame.tabs.choose('diagram')")
    frames(page)
    page.evaluate("fame.diagram.fit()")
    badges = "document.querySelectorAll('.under .badge').length"
    becomes(page, badges, 0)
    whole = page.evaluate("fame.diagram.view.scale")
    page.locator(".lane", has_text="Lift").click()
    until(page, f"fame.diagram.view.scale > {1.5 * whole} && {badges}")
    paper, pool = page.locator(".paper").bounding_box(), page.locator(".pin.on").bounding_box()
    assert pool is not None
    assert paper is not None
    assert page.locator(".pin.on title").text_content() == "Lift"
    assert abs(pool["y"] + pool["height"] / 2 - paper["y"] - paper["height"] / 2) < 20
    page.evaluate("fame.diagram.view.shift(-600, 0)")  # the names of pools stay
    pinned = page.locator(".pin.on").bounding_box()
    assert pinned is not None
    assert abs(pinned["x"] - paper["x"]) < 5
    page.keyboard.press("Escape")
    until(page, f"fame.diagram.view.scale === {whole}")
    page.evaluate("fame.diagram.view.zoom(0.4)")
    dots = "[...document.querySelectorAll('.drawing .dot')]"
    assert page.evaluate(f"{dots}.length") > 10
    assert page.evaluate(f"{dots}.flatMap((one) => [...one.querySelectorAll('text')]).filter({SEEN}).length") == 0
    assert "Plan the round" in page.evaluate(
        "[...document.querySelectorAll('.drawing title')].map((one) => one.textContent)"
    )


def test_panes_are_moved_collapsed_and_maximised_with_pointer_and_keys(page: Page) -> None:
    def size(part: str) -> tuple[float, float]:
        box = page.locator(part).bounding_box()
        assert box is not None
        return box["width"], box["height"]

    page.evaluate("fame.tabs.choose('diagram')")
    wide, low = size("#inspector")[0], size("#time")[1]
    splitter = page.get_by_role("separator", name="Width of the panes on the right")
    box = splitter.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 3, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] - 97, box["y"] + 200)
    page.mouse.up()
    assert abs(size("#inspector")[0] - wide - 100) < 6
    page.get_by_role("separator", name="Height of the timeline").focus()
    page.keyboard.press("ArrowUp")
    assert size("#time")[1] > low + 5
    page.keyboard.press("Enter")
    assert size("#time")[1] < 5
    page.keyboard.press("Enter")
    assert size("#time")[1] > low + 5
    page.reload()
    until(page, READY)
    assert abs(size("#inspector")[0] - wide - 100) < 6  # it stays so
    page.locator("#diagram").get_by_role("button", name="Maximise").click()
    assert size("#diagram")[0] > 1200
    assert violations(page) == []
    page.keyboard.press("Escape")
    page.locator("#inspector .body").focus()
    page.keyboard.press("m")
    assert size("#inspector")[0] > 1200
    page.keyboard.press("m")
    assert abs(size("#inspector")[0] - wide - 100) < 6


SEEN = "(one) => { const { width, bottom } = one.getBoundingClientRect(); return width > 0 && bottom > 0; }"
SIZES = f"""[...document.querySelectorAll('body *')].filter((one) => !one.childElementCount && one.textContent.trim() && ({SEEN})(one) && !one.closest('title, .unseen, option'))
  .map((one) => [one.textContent, parseFloat(getComputedStyle(one).fontSize) * (one.ownerSVGElement ? Math.hypot(one.getScreenCTM().a, one.getScreenCTM().b) : 1)])"""
LOWEST = "document.querySelector('#world .frame').getBoundingClientRect().bottom"
ELSEWHERE = """(() => {
  const { shapes, groups, pins } = fame.diagram.current, box = (one) => one.getBoundingClientRect();
  const pools = pins.frames.map(({ number }) => box(groups.get(number)));
  const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top;
  return [...groups].filter(([number, one]) => shapes.has(number) && !one.classList.contains('frame')).flatMap(([, one]) => {
    const home = pools.find((pool) => !apart(pool, box(one.firstElementChild)));
    return [...one.querySelectorAll('text:not([hidden])')].filter((name) => pools.some((pool) => pool !== home && !apart(pool, box(name)))).map((name) => name.textContent);
  });
})()"""
"""Names of a diagram that reach into another pool than that of their shape."""
SMALL = """[...document.querySelectorAll('button, select, input, textarea')].map((one) => one.closest('.choice, .field.checkbox') ?? one.closest('.who')?.closest('.robot') ?? one).filter((one) => {
  const { width, height } = one.getBoundingClientRect();
  return width && (width < 43.9 || height < 43.9);
}).map((one) => `${one.localName}.${one.className} ${one.textContent || one.title}`)"""
