"""The page in a real browser: tokens where the events say, at whatever way one gets there; nothing of a model is markup."""

# ruff: noqa: E501 (expressions of JavaScript, and a model as XML)

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bpmn_text import document
from recorded_runs import record
from view_page import OVERLAPPING, READY, becomes, beyond, frames, opened, says, until

from fame.log import Recording
from fame.scenario import Scenario
from fame.view import ModelWatch, Replay

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

EXAMPLES = Path(__file__).parent.parent / "examples"

STATE = """(time) => {
  fame.store.cursor = %s ? null : fame.store.cursor;
  const state = fame.store.stateAt(time);
  const rows = [...state.tokens.values()].map((one) => [one.r, one.i, one.s, one.e, one.n, one.since].join("/"));
  const counts = [...state.counts].filter(([, one]) => one.some(Boolean)).map(([key, one]) => `${key}=${one}`);
  const variables = [...state.variables.values()].flatMap((one) => [...one.values].map(([name, [value]]) => `${one.r}/${one.s}/${name}=${JSON.stringify(value)}`));
  const waits = [...state.waits].flatMap(([r, some]) => [...some.keys()].map((key) => `${r}/${key}`));
  return [rows, counts, variables, waits].map((some) => some.sort().join(";"));
}"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=60)
    return record(scenario, tmp_path_factory.mktemp("view") / "agriculture.mcap")


@pytest.fixture(scope="module")
def shared(chromium: Browser, recording: Path) -> Iterator[Page]:
    with Replay(recording) as replay, opened(chromium, replay) as found:
        yield found


@pytest.fixture
def page(shared: Page) -> Page:
    """The page, as it is when somebody opens it."""
    address, again, _ = shared.url.partition("#")[0].partition("?")
    shared.set_viewport_size({"width": 1280, "height": 720})
    shared.evaluate("sessionStorage.clear(), localStorage.clear()")
    shared.goto(address if again else f"{address}?again")  # the same address would not be loaded anew
    until(shared, READY)
    return shared


def test_an_instant_that_is_not_read_yet_is_shown_from_the_key_before_it(page: Page) -> None:
    moments = [int(page.evaluate("fame.store.end") * part) for part in (0.9, 0.35, 0.55)]
    whole = [page.evaluate(STATE % "true", moment) for moment in moments]
    page.evaluate("fame.news = () => {}")  # which has all blocks, and may come only now
    page.evaluate("fame.store.complete = false; fame.store.blocks.length = 1; fame.store.blocks[0].end = 0")
    for moment, shown in zip(moments, whole, strict=True):
        page.evaluate(f"fame.player.seek({moment})")
        until(page, f"fame.state !== null && fame.state.time === {moment}")
        assert page.evaluate("fame.state === fame.store.aheadState")
        assert page.evaluate(STATE % "false", moment) == shown


def test_tokens_are_where_the_recording_says(page: Page, recording: Path) -> None:
    with Recording(recording) as source:
        moments = random.Random(7).sample(range(0, source.end), 12)
        for moment in moments:
            waiting = {
                (name, token["key"])
                for name, robot in source.state(moment).robots.items()
                for token in robot.tokens.values()
            }
            shown = page.evaluate(
                """(time) => [...fame.store.stateAt(time).waits].flatMap(([r, some]) => [...some.keys()].map((key) => [fame.mission.robots[r].name, key]))""",
                moment,
            )
            assert {tuple(one) for one in shown} == waiting
            entered = {name: {id for _, id in robot.active} for name, robot in source.state(moment).robots.items()}
            held = page.evaluate(
                """(time) => [...fame.store.stateAt(time).tokens.values()].map((one) => [fame.mission.robots[one.r].name, fame.mission.elements[one.e].id])""",
                moment,
            )
            found: dict[str, set[str]] = {name: set() for name in entered}
            for name, id in held:
                found[name].add(id)
            assert found == entered


def test_scrubbing_equals_direct_seeking(page: Page, recording: Path) -> None:
    with Recording(recording) as source:
        end = source.end
    chance = random.Random(3)
    for _ in range(40):
        moment = chance.randrange(end)
        if chance.random() < 0.4:  # a short way, forth or back
            moment = min(end, max(0, page.evaluate("fame.player.time") + chance.randrange(-(10**9), 10**9)))
        page.evaluate("(time) => fame.player.seek(time)", moment)
        scrubbed = page.evaluate(STATE % "false", moment)
        assert scrubbed == page.evaluate(STATE % "true", moment)


def test_the_drawing_has_a_disc_for_each_token_of_the_mission(page: Page) -> None:
    page.evaluate("fame.player.seek(40e9)")
    until(page, "fame.shows(40e9)")
    shown = "document.querySelectorAll('.under .disc').length"
    expected = "[...fame.state.tokens.values()].filter((one) => fame.diagram.current.shapes.has(one.e)).length"
    assert page.evaluate(f"{shown} === {expected} && {expected} > 0")


def test_a_diagram_that_would_be_too_small_opens_on_a_pool_with_an_overview_of_the_whole(page: Page) -> None:
    until(page, "!fame.diagram.opening && fame.diagram.view.scale >= 0.9")
    overview = page.locator("canvas.whole")
    assert overview.is_visible()
    before = page.evaluate("fame.diagram.view.sight()")
    overview.click(position={"x": 2, "y": 2})
    box = overview.bounding_box()
    assert box is not None
    overview.click(position={"x": box["width"] - 2, "y": box["height"] - 2})
    until(page, f"fame.diagram.view.sight()[0] > {before[0] + 100}")
    page.keyboard.press("f")
    until(page, "fame.diagram.overview.canvas.hidden")


def test_robots_that_have_not_begun_say_what_they_wait_for(page: Page) -> None:
    page.evaluate("fame.tabs.choose('team'); fame.player.seek(1e9)")
    until(page, "fame.team.shown === 1e9")
    states = page.locator(".robot .state").all_inner_texts()
    assert [" ".join(state.split()) for state in states] == ["running", *["waits for weed_position"] * 3]
    page.evaluate("fame.tabs.choose('diagram')")
    until(page, "document.querySelector('#inspector').innerText.includes('waits for weed_position')")


def test_the_names_of_small_shapes_are_cut_or_left_out(page: Page) -> None:
    left_out = "[...document.querySelectorAll('.drawing g:not(.frame):not(.dot) > text')].filter((one) => one.hasAttribute('hidden')).length"
    page.set_viewport_size({"width": 390, "height": 844})
    frames(page)
    page.evaluate("fame.diagram.fit()")
    until(page, "fame.diagram.current.level < 0.3")
    cut = page.evaluate(left_out)
    page.get_by_title("Names at small zoom, cut short").click()
    until(page, f"{left_out} > {cut}")


def test_the_cursor_goes_from_event_to_event(page: Page) -> None:
    page.evaluate("fame.player.seek(30e9)")
    before = page.evaluate("fame.player.time")
    page.keyboard.press("ArrowRight")
    until(page, f"fame.player.time > {before}")
    after = page.evaluate("fame.player.time")
    assert page.evaluate("(time) => fame.store.blocks.some((one) => one.data.columns.t.includes(time))", after)
    page.keyboard.press("ArrowLeft")
    until(page, f"fame.player.time < {after}")
    page.keyboard.press("End")
    until(page, "fame.player.time === fame.store.end")
    page.keyboard.press("Home")
    until(page, "fame.player.time === 0")


def test_playing_moves_the_cursor_and_stops_at_the_end(page: Page) -> None:
    page.evaluate("fame.player.seek(fame.store.end - 2e9)")
    page.evaluate("fame.player.speed = 10")
    page.keyboard.press(" ")
    until(page, "!fame.player.playing && fame.player.time === fame.store.end")


def test_a_link_holds_time_robot_and_element(page: Page) -> None:
    page.evaluate("fame.player.seek(42.5e9)")
    page.evaluate("fame.select({robot: 1, element: fame.mission.elements.findIndex((one) => one.id === 'TakeOff')})")
    link = page.evaluate("fame.link()")
    assert "t=42.5" in link
    page.evaluate("fame.player.seek(0), fame.select({robot: -1, element: -1})")
    until(page, "location.hash === '#t=0'")  # the page writes its address a moment later; the same one is no news
    page.evaluate("(link) => { location.hash = link; }", link)
    until(page, "fame.player.time === 42.5e9 && fame.selected.robot === 1")
    becomes(page, "fame.mission.elements[fame.selected.element].id", "TakeOff")


def test_a_called_process_opens_with_a_breadcrumb(page: Page) -> None:
    page.evaluate(
        "fame.select({element: fame.mission.elements.findIndex((one) => one.name === 'Take Off' && one.inside >= 0)})"
    )
    page.get_by_role("button", name="Open").click()
    until(page, "document.querySelector('.crumbs').textContent === 'agriculture\u203aTake Off'")
    page.locator(".crumbs button").click()
    until(page, "document.querySelector('.crumbs').textContent === 'agriculture'")


def test_signals_are_arrows_between_the_robots(page: Page) -> None:
    page.evaluate("fame.player.seek(60e9)")
    arrows = until(page, "fame.timeline.bars.arrows && fame.timeline.bars.arrows.length && fame.timeline.bars.arrows")
    names = page.evaluate("fame.mission.robots.map((one) => one.name)")
    found = {(one["topic"], names[one["sender"]], names[one["receiver"]]) for one in arrows}
    assert ("/weed_position", "Drone", "Tractor_1") in found
    assert all(one["from"] <= one["until"] for one in arrows)


PANELS = {"team": ["team", "needs", "world"], "diagram": ["diagram", "world", "inspector", "time"]}
"""What is seen at once on a desk."""
TABS = {"team": ["team"], "needs": ["needs"], "map": ["world"], "diagram": ["diagram"], "log": ["inspector", "time"]}
"""What is seen of them on phones and tablets."""


def test_the_page_fits_its_window_in_each_tab(page: Page) -> None:
    page.evaluate("fame.player.seek(40e9)")
    for width, height in ((1440, 844), (1280, 720), (1024, 768), (820, 1180), (390, 844), (360, 640)):
        page.set_viewport_size({"width": width, "height": height})
        for tab, panels in (PANELS if width > 1100 else TABS).items():
            page.evaluate(f"fame.tabs.choose('{tab}')")
            frames(page)
            root = "document.documentElement"
            until(page, f"{root}.scrollWidth <= innerWidth && {root}.scrollHeight <= innerHeight")
            assert beyond(page) == [], (width, tab)
            for panel in panels:
                box = page.locator(f"#{panel}").bounding_box()
                assert box is not None
                assert box["width"] > 150
                assert box["height"] > 120
                assert box["x"] + box["width"] <= width
                assert box["y"] + box["height"] <= height


_FORTY_BLOCKS = """async () => {
  const empty = { scopes: [], variables: [], waits: [], circles: [], messages: [], poses: [], world: [], properties: [] };
  const key = { scopes: [], tokens: [], waits: [], circles: [], counts: [], variables: [], poses: [], world: {} };
  const none = Object.fromEntries(Object.keys(empty).map((name) => [name, 0]));
  const block = (number) => ({
    ...structuredClone(empty), number, start: number * 10, end: number * 10 + 9, first: 0, size: 100, key, at: none,
    d: {}, t: [number * 10], r: [0], i: [1], s: [1], e: [0], w: [7], properties: [[number * 10, number]],
  });
  const store = new fame.store.constructor(async (number) => block(number));
  store.room = 1000;
  store.index(Array.from({ length: 40 }, (_, number) => [number, number * 10, number * 10 + 9, 1]), 399);
  const loaded = () => store.blocks.filter((one) => one.data).map((one) => one.number);
  const loadAhead = async (time) => {
    for (let next; (next = store.missing(time).slice(0, 2)).length; )
      await Promise.all(next.map(({ number }) => store.want(number)));
    return loaded();
  };
  const start = await loadAhead(0);
  store.stateAt(305);
  await store.want(30);
  const jump = await loadAhead(305);
  const state = store.stateAt(305).block.number;
  const last = await store.find(0, 1, (data, at) => data.columns.t[at] === 390);
  return { start, jump, state, last, sizes: [store.size, loaded().length], judged: store.blocks.map((one) => one.properties[0][1]) };
}"""


def test_blocks_that_nobody_looks_at_leave_memory_and_come_again(page: Page) -> None:
    found = page.evaluate(_FORTY_BLOCKS)
    assert found["start"] == [*range(10)]  # as many as fit, with some room beyond
    assert {29, 30, 31} <= {*found["jump"]}
    assert len(found["jump"]) == 10
    assert found["state"] == 30
    assert found["last"] == 390  # a search goes through all blocks
    assert found["sizes"] == [1000, 10]
    assert found["judged"] == [*range(40)]  # what was judged stays


def test_the_help_is_text(page: Page) -> None:
    page.keyboard.press("?")
    said = page.locator("#help").inner_text()
    assert "play, pause" in said
    assert "a robot, all robots" in said
    assert "[object" not in page.locator("body").inner_text()


def test_a_link_made_while_it_plays_has_a_time_in_ns(page: Page) -> None:
    page.evaluate("fame.player.speed = 0.1")
    page.keyboard.press(" ")
    until(page, "fame.player.time > 1e7")
    page.keyboard.press(" ")
    assert page.evaluate("Number.isInteger(fame.player.time)")
    until(page, r"/^#t=[\d]+\.[\d]{1,9}$/.test(location.hash)")


def test_a_variable_and_a_field_of_a_message_are_plotted_with_their_value_at_the_cursor(
    page: Page, recording: Path
) -> None:
    page.evaluate("fame.select({robot: fame.mission.robots.findIndex((one) => one.name === 'Drone')})")
    page.evaluate("fame.player.seek(40e9)")
    page.locator('#inspector tr[data-key="to_goal"] button[title="Plot it over time"]').first.click()
    page.evaluate("fame.inspector.choose('topics')")
    page.locator('#inspector tr[data-key="/weed_found"] select').select_option(label="x")
    values = "[...document.querySelectorAll('.lane.plot')].map((one) => [one.querySelector('b').textContent, one.querySelector('small').textContent])"
    with Recording(recording) as source:
        published = [(one.time, source.decode(one)["x"]) for one in source.messages(["/weed_found"])]
        written = [
            (one.time, change["set"]["to_goal"])
            for one in source.messages(["/fame/variables"])
            if (data := json.loads(one.data))["robot"] == "Drone"
            for change in data["changes"]
            if "to_goal" in change.get("set", {})
        ]
    assert len(published) > 1
    assert len(written) > 100
    for moment in (0, 12_340_000_000, 40_000_000_000, 60_000_000_000, 25_000_000_000):
        page.evaluate(f"fame.player.seek({moment})")
        expected = [
            [title, next((f"{number:.6g}" for at, number in reversed(found) if at <= moment), "\N{EN DASH}")]
            for title, found in (("to_goal", written), ("/weed_found.x", published))
        ]
        until(page, f"{values}.every(([, text], at) => {[text for _, text in expected]}[at] === text)")
        assert page.evaluate(values) == expected
    page.locator('.lane.plot button[title="Remove the plot"]').first.click()
    until(page, "document.querySelectorAll('.lane.plot').length === 1")


def test_the_inspector_has_the_colours_of_the_robots_in_both_themes(page: Page) -> None:
    page.evaluate("fame.player.seek(40e9)")
    page.evaluate(
        "window.colours = (css) => [...new Set([...document.querySelectorAll(css)].map((one) => getComputedStyle(one).backgroundColor))].join()"
    )
    shown = [""]
    for theme in ("light", "dark"):
        page.evaluate(f"fame.setTheme('{theme}')")
        until(page, f"!{shown}.includes(colours('.body .swatch'))")
        shown.append(
            until(page, "colours('.body .swatch') === colours('.lane:not(.property) i') && colours('.lane i')")
        )


def test_a_plot_has_the_colour_of_the_robot_whose_variable_or_topic_it_shows(page: Page) -> None:
    for robot, name in enumerate(("Drone", "Tractor_1", "Tractor_2")):
        swatch = page.evaluate(f"fame.timeline.plots.colour({{r: {robot}}})")
        assert page.evaluate(f"fame.timeline.plots.colour({{r: -1, topic: '/{name}/odom', path: ['x']}})") == swatch
        assert page.evaluate("fame.timeline.plots.colour({r: -1, topic: '/weed_found', path: ['x']})") != swatch


def test_the_inspector_says_who_publishes_and_why_the_last_message_did_not_count(page: Page) -> None:
    page.evaluate("fame.player.seek(40e9)")
    until(page, "document.querySelector('.waits').textContent.includes('/Drone/odom is published by /Drone/robot')")
    why = """(missed) => fame.inspector.waits.lastMessages({topics: ['/a'], since: 6e9, ...missed}, 7e9).textContent"""
    assert page.evaluate(why, {}) == "no message has come since the token waits"
    missed = {"missed": {"time": 5e9, "why": "nothing waited for it then"}}
    assert page.evaluate(why, missed) == "last message 0:05.000 did not count: nothing waited for it then"


POOLS = """<collaboration id="C"><participant id="Pool" name="Harvester" processRef="P"/><participant id="Pool2" name="Seeder" processRef="P2"/></collaboration>
  <process id="P"><laneSet id="L"><lane id="Lane" name="Reaper"><flowNodeRef>T</flowNodeRef></lane></laneSet><task id="T"/></process>
  <process id="P2"><laneSet id="L2"><lane id="Lane2" name="Sower"/></laneSet>{events}</process>
  <bpmndi:BPMNDiagram id="D"><bpmndi:BPMNPlane id="Pl" bpmnElement="C">
    <bpmndi:BPMNShape id="s1" bpmnElement="Pool" isHorizontal="false"><dc:Bounds x="0" y="0" width="300" height="900"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="s2" bpmnElement="Lane" isHorizontal="false"><dc:Bounds x="0" y="30" width="300" height="870"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="s4" bpmnElement="Pool2" isHorizontal="true"><dc:Bounds x="-600" y="400" width="900" height="200"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="s5" bpmnElement="Lane2" isHorizontal="true"><dc:Bounds x="-570" y="400" width="870" height="200"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="s3" bpmnElement="T"><dc:Bounds x="100" y="600" width="100" height="80"/></bpmndi:BPMNShape>{shapes}
  </bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""
EVENT = '<intermediateThrowEvent id="E{n}" name="the boxes were delivered {n}"/>'
SHAPE = """<bpmndi:BPMNShape id="e{n}" bpmnElement="E{n}"><dc:Bounds x="-{n}00" y="450" width="36" height="36"/>
  <bpmndi:BPMNLabel><dc:Bounds x="-{n}40" y="490" width="120" height="14"/></bpmndi:BPMNLabel></bpmndi:BPMNShape>"""


def test_names_of_pools_and_lanes_stay_while_one_scrolls_above_where_they_are_upright(
    chromium: Browser, tmp_path: Path
) -> None:
    model = tmp_path / "pools.bpmn"
    events, shapes = ("".join(text.format(n=n) for n in range(1, 6)) for text in (EVENT, SHAPE))
    model.write_text(document(POOLS.format(events=events, shapes=shapes)))
    with ModelWatch(model) as watch, opened(chromium, watch) as page:
        places = """((paper) => Object.fromEntries([...document.querySelectorAll('.pin')].map((one) => [one.querySelector('text').textContent,
          ((box) => [Math.round(box.x - paper.x), Math.round(box.y - paper.y)])(one.querySelector('rect').getBoundingClientRect())])))(fame.diagram.paper.getBoundingClientRect())"""
        until(page, "document.querySelector('.pin')")
        page.evaluate("fame.diagram.view.zoom(1 / fame.diagram.view.scale)")
        page.evaluate("fame.diagram.view.shift(-300 - fame.diagram.view.x, -300 - fame.diagram.view.y)")
        pinned = until(
            page, places, holds=lambda at: all(name in at and at[name][axis] == far for name, axis, far in PINNED)
        )
        page.evaluate("fame.load(fame.mission)")  # as when the model is saved
        becomes(page, places, pinned)
        moved = """(async () => { const drawn = fame.load(fame.mission); fame.diagram.view.shift(0, -50);
          const before = PLACES; await drawn; return [before, PLACES]; })()""".replace("PLACES", places)
        before, after = page.evaluate(moved)
        assert before == after != pinned  # also while it is drawn anew
        names = "[...document.querySelectorAll('.drawing text:not([hidden])')].map((one) => (({x, y, width, height}) => [x, y, width, height])(one.getBoundingClientRect()))"
        assert len(page.evaluate(names)) == 5  # not those of pools
        assert page.evaluate(f"({OVERLAPPING})({names})") == []


PINNED = (("Seeder", 0, 0), ("Sower", 0, 20), ("Harvester", 1, 0), ("Reaper", 1, 20))
"""Names, the axis (x or y) on which they stay, and where (px)."""


# ---- nothing is markup -----------------------------------------------------------------------------------------------

ATTACK = '<img src=x onerror="window.hit=1"><script>window.hit=1</script>'
ESCAPED = ATTACK.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
MODEL = f"""<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:bpmndi="http://www.omg.org/spec/BPMN/20100524/DI"
    xmlns:dc="http://www.omg.org/spec/DD/20100524/DC" xmlns:di="http://www.omg.org/spec/DD/20100524/DI" id="d" targetNamespace="x">
  <bpmn:process id="P" name="{ESCAPED}" isExecutable="true">
    <bpmn:startEvent id="S" name="{ESCAPED}"><bpmn:outgoing>F</bpmn:outgoing></bpmn:startEvent>
    <bpmn:sequenceFlow id="F" name="{ESCAPED}" sourceRef="S" targetRef="T"/>
    <bpmn:scriptTask id="T" name="{ESCAPED}" scriptFormat="python"><bpmn:documentation>{ESCAPED}</bpmn:documentation><bpmn:incoming>F</bpmn:incoming><bpmn:outgoing>G</bpmn:outgoing>
      <bpmn:script>evil = {ESCAPED!r}; things = {{evil: [evil]}}; print(evil)</bpmn:script></bpmn:scriptTask>
    <bpmn:sequenceFlow id="G" sourceRef="T" targetRef="U"/>
    <bpmn:userTask id="U" name="{ESCAPED}"><bpmn:incoming>G</bpmn:incoming></bpmn:userTask>
  </bpmn:process>
  <bpmndi:BPMNDiagram id="D"><bpmndi:BPMNPlane id="Pl" bpmnElement="P">
    <bpmndi:BPMNShape id="S_di" bpmnElement="S"><dc:Bounds x="100" y="100" width="36" height="36"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="T_di" bpmnElement="T"><dc:Bounds x="200" y="78" width="100" height="80"/></bpmndi:BPMNShape>
    <bpmndi:BPMNShape id="U_di" bpmnElement="U"><dc:Bounds x="400" y="78" width="100" height="80"/></bpmndi:BPMNShape>
    <bpmndi:BPMNEdge id="F_di" bpmnElement="F"><di:waypoint x="136" y="118"/><di:waypoint x="200" y="118"/></bpmndi:BPMNEdge>
    <bpmndi:BPMNEdge id="G_di" bpmnElement="G"><di:waypoint x="300" y="118"/><di:waypoint x="400" y="118"/></bpmndi:BPMNEdge>
  </bpmndi:BPMNPlane></bpmndi:BPMNDiagram>
</bpmn:definitions>"""


def test_markup_in_a_model_is_text(chromium: Browser, tmp_path: Path) -> None:
    model = tmp_path / "evil.bpmn"
    model.write_text(MODEL.replace('name="' + ESCAPED + '" isExecutable', 'name="evil" isExecutable'), encoding="utf-8")
    path = record(Scenario.load(model, duration=1), tmp_path / "evil.mcap")
    with Replay(path) as replay, opened(chromium, replay) as page:
        page.evaluate("fame.player.seek(fame.store.end)")
        page.evaluate("fame.select({robot: 0, element: fame.mission.elements.findIndex((one) => one.id === 'T')})")
        for tab in ("state", "topics", "log", "state"):
            page.evaluate(f"fame.inspector.choose('{tab}')")
            frames(page)
        says(page, "#inspector", ATTACK)
        assert page.evaluate("window.hit") is None
        assert page.evaluate("document.querySelectorAll('img, script:not([src])').length") == 0


def test_a_drawing_is_taken_apart_into_known_shapes(chromium: Browser, recording: Path) -> None:
    with Replay(recording) as replay, opened(chromium, replay, blocked=True) as page:
        page.evaluate(
            """(() => {
              const svg = `<svg xmlns="http://www.w3.org/2000/svg"><g id="a" onload="window.hit=1"><script>window.hit=1</script>
                <foreignObject><b onclick="window.hit=1">x</b></foreignObject><a href="javascript:window.hit=1"><rect fill="url(https://evil)" width="5"/></a></g></svg>`;
              const made = fame.diagram.built({svg, shapes: {}, edges: {}, frames: [], width: 1, height: 1});
              document.body.append(made.drawing);
              window.names = [...made.drawing.querySelectorAll('*')].map((one) => [one.localName, [...one.attributes].map((each) => each.name).join()]);
            })()"""
        )
        assert page.evaluate("window.names") == [["g", "data-id"]]
        assert page.evaluate("window.hit") is None
