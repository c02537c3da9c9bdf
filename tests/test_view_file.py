"""A run as one file: the page of `fame view` without a server."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bpmn_text import process
from recorded_runs import record
from view_page import opened, opened_file, until

from fame.cli import main
from fame.scenario import Scenario
from fame.view import Replay
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


def written(recording: Path) -> Path:
    path = recording.with_suffix(".html")
    assert main(["view", str(recording), "-o", str(path)]) == 0
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


def test_only_a_recording_becomes_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words in (["model.bpmn"], [], ["run.mcap", "--branch", "1"]):
        assert main(["view", *words, "-o", str(tmp_path / "run.html")]) == 2
        assert "--output writes a recording (RUN.mcap) as a page, without --branch" in capsys.readouterr().err
    assert not (tmp_path / "run.html").exists()


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


def test_markup_in_a_recording_stays_text_in_its_file(chromium: Browser, small: Path) -> None:
    with opened_file(chromium, written(small)) as page:
        page.evaluate("fame.player.seek(fame.store.end)")
        page.evaluate("fame.select({robot: 0, element: fame.mission.elements.findIndex((one) => one.id === 'T')})")
        for tab in ("topics", "log", "state"):
            page.evaluate(f"fame.inspector.choose('{tab}')")
            until(
                page, f"document.querySelector('#inspector').textContent.includes('window.hit') || '{tab}' === 'topics'"
            )
        assert page.evaluate("window.hit") is None
        assert page.locator("img").count() == 0


def test_a_part_that_is_damaged_is_said(chromium: Browser, small: Path) -> None:
    path = written(small)
    path.write_text(path.read_text().replace('id="mission.json">H4sI', 'id="mission.json">H4sA'))
    context = chromium.new_context(offline=True)
    page = context.new_page()
    page.goto(path.as_uri())
    until(page, "document.body.textContent.includes('The page could not be loaded')")
    context.close()
