"""A run as one file: the page of `fame view` without a server."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64decode
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from airport import airport
from bpmn_text import process
from recorded_runs import record
from view_page import PHONE, becomes, flaws, opened, opened_file, until

from fame.cli import main
from fame.scenario import Scenario
from fame.view import Replay
from fame.view.page_content import PageContent
from fame.view.page_file import joined, write_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EXAMPLES = Path(__file__).parent.parent / "examples"
PAGE = Path(__file__).parent.parent / "fame" / "view" / "page"
EVIL = "</script><img src=x onerror='window.hit=1'><!-- <script>window.hit=1</script>"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that logs, publishes and sets what looks like markup, under a name that does."""
    text = EVIL.replace("&", "&amp;").replace("<", "&lt;")
    model = tmp_path_factory.mktemp("small") / "small.bpmn"
    model.write_text(
        process(
            f"""<startEvent id="S" name="{text}"/><sequenceFlow id="f" sourceRef="S" targetRef="T"/>
            <scriptTask id="T" name="{text}" scriptFormat="python"><documentation>{text}</documentation>
            <script>evil = {text!r}; print(evil)</script></scriptTask>
            <sequenceFlow id="g" sourceRef="T" targetRef="E"/><endEvent id="E"/>"""
        )
    )
    return record(Scenario.load(model, duration=1), model.with_suffix(".mcap"))


def written(recording: Path, *words: str) -> Path:
    path = recording.with_suffix(".html")
    assert main(["view", str(recording), "-o", str(path), *words]) == 0
    return path


def test_the_file_names_nothing_outside_of_itself_and_allows_nothing(small: Path) -> None:
    page = written(small).read_text()
    policy = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    hashed = "'sha256-[A-Za-z0-9+/]{43}='"
    allowed = f"script-src {hashed}; style-src {hashed}; img-src data:; base-uri 'none'; form-action 'none'"
    assert len(policy) == 1
    assert re.fullmatch(f"default-src 'none'; {allowed}", policy[0])
    head = page.partition("<script>")[0]
    assert not re.findall(r'(?:src|href)="(?!data:)', head)
    assert head.index("Content-Security-Policy") < head.index("<style>") < head.index('id="mission.json"')


def test_nothing_of_a_recording_is_outside_of_what_is_packed(small: Path) -> None:
    page = written(small).read_text()
    assert "onerror" not in page.replace(joined(), "")
    assert page.count("</script>") == page.count("<script ") + 1


def test_every_module_that_the_page_imports_is_in_the_script_before_those_that_need_it() -> None:
    script = joined()
    assert not re.search(r"^(import|export)\b|await import|</script|<!--", script, re.MULTILINE)
    places = {found[1]: found.start() for found in re.finditer(r"^const \$(\w+) = \(\(\) => \{$", script, re.MULTILINE)}
    assert places.keys() == {path.stem for path in PAGE.glob("*.js")} - {"types"}  # which has nothing that runs
    for found in re.finditer(r"^const \{[^}]*\} = \$(\w+);$", script, re.MULTILINE):
        assert places[found[1]] < found.start()


def test_a_page_does_not_replace_its_recording(agriculture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = agriculture.read_bytes()
    assert main(["view", str(agriculture), "-o", str(agriculture)]) == 2
    assert "expected a new file, got one that is read" in capsys.readouterr().err
    assert agriculture.read_bytes() == before


def test_only_a_recording_becomes_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words in (["model.bpmn"], [], ["run.mcap", "--branch", "1"]):
        assert main(["view", *words, "-o", str(tmp_path / "run.html")]) == 2
        assert "--output writes a recording (RUN.mcap) as a page, without --branch" in capsys.readouterr().err
    assert not (tmp_path / "run.html").exists()


# ---- what is in it ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def agriculture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("agriculture") / "run.mcap"
    return record(Scenario.load(EXAMPLES / "agriculture.yaml", duration=20), path)


def parts(page: Path) -> dict[str, Any]:
    """What a page has, unpacked."""
    found = re.findall(r'<script type="text/plain" id="([^"]+)">([^<]*)</script>', page.read_text())
    return {name: json.loads(gzip.decompress(b64decode(packed))) for name, packed in found}


def blocks(page: Path) -> list[dict[str, Any]]:
    return [part for name, part in parts(page).items() if name.startswith("block/")]


def test_what_is_in_the_file_is_listed(agriculture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(agriculture)
    said = capsys.readouterr()
    assert re.fullmatch(r".*run\.html: \d\.\d MB\n", said.out)
    lines = dict(line.partition(": ")[::2] for line in said.err.splitlines()[1:])
    assert lines["models"].startswith("agriculture.bpmn, TakeOff.bpmn")
    assert lines["robots"] == "Drone, Tractor_1, Tractor_2, Tractor_3"
    assert re.search(r"\bto_goal \(\d+\)", lines["variables"])
    assert re.search(r"/weed_found \(\d\)", lines["messages"])
    assert lines["log"] == "none"
    assert lines["scripts"] == "of 23 elements"


@pytest.mark.parametrize(
    ("kind", "left"),
    [
        ("variables", {"variables": False, "messages": True, "poses": True, "properties": True}),
        ("messages", {"variables": True, "messages": False, "poses": True, "properties": True}),
        ("world,properties", {"variables": True, "messages": True, "poses": False, "properties": False}),
    ],
)
def test_what_is_left_out_is_nowhere_in_the_file_which_says_so(
    agriculture: Path, kind: str, left: dict[str, bool]
) -> None:
    page = written(agriculture, "--without", kind)
    found = blocks(page)
    assert {name: any(block[name] for block in found) for name in left} == left
    keys = {"variables": "variables", "poses": "poses"}
    assert all(any(block["key"][keys[name]] for block in found) == left[name] for name in keys)
    assert parts(page)["mission.json"]["notices"] == [f"Not in this file: {', '.join(sorted(kind.split(',')))}."]
    assert any(block["t"] for block in found)


def test_messages_of_one_topic_are_left_out(agriculture: Path) -> None:
    found = blocks(written(agriculture, "--without", "/weed_found"))
    assert {row[1] for block in found for row in block["messages"]} == {
        "/weed_position",
        "/tractor_position",
        "/closest_tractor",
    }


def test_lines_of_the_log_scripts_and_the_command_are_left_out(small: Path) -> None:
    for words, some in (((), True), (("--without", "log,scripts", "--without", "command"), False)):
        found = parts(written(small, *words))
        mission, block = found["mission.json"], found["block/0.json"]
        assert any(text.startswith("</script>") for text in block["d"].values()) == some
        assert "completed" in block["d"].values()  # by the place of its event
        assert block["w"][int(next(at for at, text in block["d"].items() if text == "completed"))] == 6
        assert any("script" in element for element in mission["elements"]) == some


def test_a_variable_with_the_name_of_a_kind_is_listed_as_it_is_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "m.bpmn"
    model.write_text(
        process(
            """<startEvent id="S"/><sequenceFlow id="f" sourceRef="S" targetRef="T"/>
            <scriptTask id="T" scriptFormat="python"><script>log = 1</script></scriptTask>
            <sequenceFlow id="g" sourceRef="T" targetRef="U"/><userTask id="U"/>"""
        )
    )
    recording = record(Scenario.load(model, duration=1), model.with_suffix(".mcap"))
    (block,) = blocks(written(recording, "--without", "log"))
    assert [row[3] for row in block["variables"]] == [{"log": 1}]
    assert "variables: log (1)" in capsys.readouterr().err.splitlines()


def test_elements_keep_the_order_of_their_keys() -> None:
    element = dict.fromkeys(("number", "id", "name", "kind", "form", "file", "line", "plane", "about", "inside"), 0)
    mission = {"elements": [element], "chips": [], "notices": [], "messages": False}
    (left,) = PageContent().mission(mission, Counter())["elements"]
    assert [*left] == [key for key in element if key != "form"], "the bytes of a page do not depend on the hash seed"


def test_nothing_is_left_out_that_the_recording_does_not_have(
    agriculture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(agriculture), "-o", str(agriculture.with_name("not.html")), "--without", "/weeds"]) == 2
    assert "--without /weeds: expected variables, messages, world" in capsys.readouterr().err
    assert main(["view", str(agriculture), "--without", "log"]) == 2
    assert "--without is for a page that is written" in capsys.readouterr().err


def test_a_file_that_would_be_too_large_is_thinned_and_says_of_what(
    agriculture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = written(agriculture)
    values = {
        at: [state(block, at) for block in blocks(whole) if block["start"] <= at][-1]
        for at in range(0, 20 * 10**9, 4 * 10**9)
    }
    length = len(whole.read_bytes())
    thin = written(agriculture, "--size", str((length - 30_000) / 1e6))
    assert len(thin.read_bytes()) <= length - 30_000
    notice = parts(thin)["mission.json"]["notices"][0]
    span = re.fullmatch(r"Thinned to a value each (\d|0\.\d) s: positions, variables .*\bto_goal\b.*\.", notice)
    assert span
    assert notice in capsys.readouterr().err
    assert float(span[1]) in (0.2, 0.5, 1)
    assert {at: [state(block, at) for block in blocks(thin) if block["start"] <= at][-1] for at in values} == values
    assert [block["t"] for block in blocks(thin)] == [block["t"] for block in blocks(whole)]
    assert [block["waits"] for block in blocks(thin)] == [block["waits"] for block in blocks(whole)]


def state(block: dict[str, Any], at: int) -> list[object]:
    """Variables and positions just before an instant."""
    variables = {
        (r, s): {name: value for name, (value, _) in values.items()} for r, s, values in block["key"]["variables"]
    }
    for time, r, s, values, gone in block["variables"]:
        if time < at and values is None:
            variables.pop((r, s), None)
        elif time < at:
            known = variables.setdefault((r, s), {})
            known |= values
            for name in gone:
                known.pop(name, None)
    poses = dict(block["key"]["poses"]) | {r: pose for time, r, pose in block["poses"] if time < at}
    return [variables, poses]


def test_what_cannot_be_thinned_enough_is_written_and_said(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(small, "--size", "0.1")
    assert "larger than 0.1 MB: events and what tokens wait for are not thinned" in capsys.readouterr().err


# ---- in a browser ----------------------------------------------------------------------------------------------------

STATE = """(time) => {
  const state = fame.store.stateAt(time);
  const of = (map) => [...map].map((entry) => JSON.stringify(entry)).sort();
  return [of(state.tokens), of(state.counts), of([...state.variables].map(([key, one]) => [key, [...one.values]])),
    of([...state.waits].map(([r, some]) => [r, [...some]])), of(state.poses)];
}"""


def test_a_file_shows_what_the_server_shows_without_a_network(chromium: Browser, tmp_path: Path) -> None:
    path = record(Scenario.load(EXAMPLES / "agriculture.yaml", duration=40), tmp_path / "run.mcap")
    with Replay(path) as replay:
        write_page(tmp_path / "run.html", replay)
        with opened(chromium, replay) as page:
            moments = [page.evaluate("fame.store.end") * part // 10 for part in range(11)]
            served = [page.evaluate(STATE, moment) for moment in moments]
    with opened_file(chromium, tmp_path / "run.html") as page:
        assert [page.evaluate(STATE, moment) for moment in reversed(moments)] == served[::-1]
        page.keyboard.press("End")
        until(page, f"fame.shows({moments[-1]})")
        page.keyboard.press("Home")
        page.evaluate("fame.player.speed = 100")
        page.keyboard.press(" ")
        until(page, "!fame.player.playing && fame.player.time === fame.store.end")
        assert page.locator("#world canvas").count()
        assert page.locator(".drawing .shape, .drawing [data-id]").count() > 20


MISSIONS = {
    "agriculture": (lambda _: Scenario.load(EXAMPLES / "agriculture.yaml", duration=30), "weed_found"),
    "warehouse": (lambda _: Scenario.load(EXAMPLES / "warehouse.yaml", duration=60), "no_valid_path"),
    "airport": (airport, "unload"),
}
"""Missions, and a text that is in their runs."""


@pytest.fixture(scope="module", params=MISSIONS)
def mission(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The page of a mission as a file, and a text that is in it."""
    scenario, text = MISSIONS[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    return written(record(scenario(folder), folder / "run.mcap")), text


def test_a_file_is_played_rewound_and_searched_without_a_network(chromium: Browser, mission: tuple[Path, str]) -> None:
    path, text = mission
    with opened_file(chromium, path) as page:
        page.keyboard.press("/")
        page.keyboard.type(text)
        page.keyboard.press("Enter")
        status = "document.querySelector('#inspector [role=status]').textContent"
        until(page, f"/^[1-9][0-9]* found/.test({status}) && fame.player.time > 0")
        first = page.evaluate("fame.player.time")
        assert first in page.evaluate("fame.inspector.search.times()")
        until(page, f"fame.shows({first})")
        page.locator(".query").fill("nowhere")
        until(page, f"{status} === 'Nothing in this run has “nowhere”.'")
        page.locator("#title").click()
        page.keyboard.press("Home")
        page.evaluate("fame.player.speed = 100")
        page.keyboard.press(" ")
        until(page, "!fame.player.playing && fame.player.time === fame.store.end")
        page.keyboard.press("Home")
        until(page, "fame.shows(0)")


@pytest.mark.parametrize("tab", ["team", "needs", "map", "diagram", "log", "search"])
def test_a_file_has_no_barriers_on_a_desk_and_on_a_phone(
    chromium: Browser, mission: tuple[Path, str], tab: str
) -> None:
    path, text = mission
    with opened_file(chromium, path, tab="log" if tab == "search" else tab, **PHONE) as page:
        page.evaluate("fame.player.seek(fame.store.end / 2)")
        if tab == "search":
            page.evaluate(f"fame.inspector.openSearch(), fame.inspector.search.find('{text}')")
            until(page, "document.querySelector('.matches')")
        assert flaws(page, f"{path.parent.name}_{tab}", (1440, "light"), (390, "dark")) == []


def test_a_text_is_searched_in_what_a_server_sends_and_of_one_robot(chromium: Browser, agriculture: Path) -> None:
    with Replay(agriculture) as replay, opened(chromium, replay) as page:
        page.get_by_role("tab", name="Search").click()
        page.locator(".query").fill("ODOM")
        found = "[...document.querySelectorAll('.matches b')].map((one) => one.textContent)"
        everywhere = until(page, f"fame.inspector.search.part === 1 && {found}.length")
        page.get_by_label("Robot", exact=True).select_option("Drone")
        until(page, f"{found}.length < {everywhere}")
        page.locator(".matches .link").first.click()
        until(page, "fame.selected.element >= 0")
        page.locator(".searching [title='Next match']").click()
        until(page, "fame.player.time > 0")
        page.locator(".searching [title='Previous match']").click()
        until(page, "document.querySelector('.query').value === 'ODOM'")


def test_what_comes_while_a_run_is_followed_is_searched_too(chromium: Browser, small: Path) -> None:
    with Replay(small) as replay, opened(chromium, replay) as page:
        page.evaluate("fame.inspector.choose('search'), fame.inspector.search.find('hurray')")
        until(page, "fame.inspector.search.part === 1 && document.querySelector('.query')")
        becomes(page, "fame.inspector.search.all.length", 0)
        page.evaluate(
            """() => {
              const { data } = fame.store.blocks[0];
              data.columns.t.push(9e8); data.columns.r.push(0); data.columns.i.push(1); data.columns.s.push(1);
              data.columns.e.push(-1); data.columns.w.push(7); data.details.set(data.columns.t.length - 1, "Hurray!");
              fame.store.blocks[0].events += 1;
            }"""
        )
        page.evaluate("fame.inspector.search.last = -Infinity, fame.inspector.choose('search')")
        until(page, "document.querySelector('.matches b')?.textContent === 'Hurray!'")


def test_without_a_world_there_is_no_map(chromium: Browser, small: Path) -> None:
    with opened_file(chromium, written(small), tab="map", **PHONE) as page:
        until(page, "fame.tabs.name === 'diagram'")
        page.get_by_role("tab", name="Diagram").wait_for()
        page.get_by_role("tab", name="Map").wait_for(state="hidden")


def test_markup_in_a_recording_stays_text_in_its_file(chromium: Browser, small: Path) -> None:
    with opened_file(chromium, written(small)) as page:
        page.evaluate("fame.player.seek(fame.store.end)")
        page.evaluate("fame.select({robot: 0, element: fame.mission.elements.findIndex((one) => one.id === 'T')})")
        page.evaluate("fame.inspector.search.find('window')")
        for tab in ("topics", "log", "search", "state"):
            page.evaluate(f"fame.inspector.choose('{tab}')")
            until(
                page, f"document.querySelector('#inspector').textContent.includes('window.hit') || '{tab}' === 'topics'"
            )
        assert page.evaluate("window.hit") is None
        assert page.locator("img").count() == 0


def test_a_file_is_shown_in_a_sandbox_that_keeps_nothing(chromium: Browser, small: Path) -> None:
    frame = small.with_name("frame.html")
    frame.write_text(f'<iframe sandbox="allow-scripts" src="{written(small).name}" width="900" height="600"></iframe>')
    context = chromium.new_context(offline=True)
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(frame.as_uri())
    inside = page.frames[1]
    until(inside, "fame.state !== null && fame.tabs.name === 'diagram'")
    inside.evaluate("fame.theme(), fame.tabs.choose('log'), fame.inspector.choose('log')")
    until(inside, "document.querySelector('#inspector').textContent.includes('window.hit')")
    context.close()
    assert not wrong


def test_a_part_that_is_damaged_is_said(chromium: Browser, small: Path) -> None:
    path = written(small)
    path.write_text(path.read_text().replace('id="mission.json">H4sI', 'id="mission.json">H4sA'))
    context = chromium.new_context(offline=True)
    page = context.new_page()
    page.goto(path.as_uri())
    until(page, "document.body.textContent.includes('The page could not be loaded')")
    context.close()
