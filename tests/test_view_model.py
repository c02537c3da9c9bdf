"""A model is watched while it is drawn: its findings are on the page at each save."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bpmn_text import process
from view_page import eventually, frames, opened, says, until, violations

import fame.view.watch
from fame.errors import ConfigError
from fame.view import ModelWatch

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MODELS = Path(__file__).parent.parent / "models"


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "mission.bpmn"
    path.write_bytes((MODELS / "ground_vehicles.bpmn").read_bytes())
    shutil.copytree(MODELS / "library", tmp_path / "library")
    return path


@pytest.fixture
def watch(model: Path) -> Iterator[ModelWatch]:
    with ModelWatch(model) as found:
        yield found


def break_it(model: Path) -> None:
    model.write_text(
        model.read_text(encoding="utf-8").replace('calledElement="Explore"', 'calledElement="Nowhere"'), "utf-8"
    )


def test_a_model_without_problems_says_so(watch: ModelWatch) -> None:
    assert watch.mission()["chips"] == [("no problems found", "completed", "fame check has no finding")]


def test_a_save_brings_its_findings(watch: ModelWatch, model: Path) -> None:
    break_it(model)
    eventually(lambda: watch.mission()["findings"])
    finding = watch.mission()["findings"][0]
    element = watch.mission()["elements"][finding["element"]]
    assert (finding["severity"], element["name"]) == ("error", "Explore")
    assert "Nowhere" in finding["text"]


def test_a_page_from_before_a_save_still_gets_its_diagrams(watch: ModelWatch, model: Path) -> None:
    """Those of called processes are fetched one after the other; then the page is told to load again."""
    last = len(watch.mission()["planes"]) - 1
    drawing = watch.plane(last)
    break_it(model)
    eventually(lambda: watch.mission()["findings"])
    assert len(watch.mission()["planes"]) <= last
    assert watch.plane(last) == drawing
    with pytest.raises(LookupError):
        watch.plane(last + 1)


def test_a_file_that_is_not_bpmn_keeps_the_last_diagram(watch: ModelWatch, model: Path) -> None:
    model.write_text("<half a", encoding="utf-8")
    eventually(lambda: watch.mission()["findings"])
    assert watch.mission()["findings"][0]["severity"] == "error"
    assert len(watch.mission()["planes"]) > 1


def test_a_file_that_is_replaced_is_read_again(watch: ModelWatch, model: Path) -> None:
    model.unlink()
    eventually(lambda: watch.news(0)[0] > 0)
    model.write_bytes((MODELS / "agriculture.bpmn").read_bytes())
    eventually(lambda: any(one.get("name") == "Weed Found" for one in watch.mission()["elements"]))


@pytest.mark.long
def test_an_error_that_nobody_foresaw_is_shown_and_the_file_is_followed(
    watch: ModelWatch, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        broken.setattr("fame.view.watch.check", lambda *_, **__: {}["x"])
        break_it(model)
        eventually(lambda: watch.mission()["findings"])
        assert watch.mission()["findings"][0]["text"] == "it could not be checked: KeyError: 'x'"
        assert len(watch.mission()["planes"]) > 1
    model.write_bytes((MODELS / "agriculture.bpmn").read_bytes())
    eventually(lambda: any(one.get("name") == "Weed Found" for one in watch.mission()["elements"]))


def test_a_scenario_is_watched_with_its_model() -> None:
    with ModelWatch(MODELS.parent / "examples" / "agriculture.yaml") as watch:
        assert watch.mission()["planes"][0]["title"] == "agriculture"
        assert not [one for one in watch.mission()["findings"] if one["severity"] == "error"]


def texts(watch: ModelWatch) -> list[str]:
    return [one["text"] for one in watch.mission()["findings"]]


def scenario_of(folder: Path) -> Path:
    """A scenario with the model m.bpmn, which calls Sub, and a world file; of these three there is none."""
    path = folder / "s.yaml"
    path.write_text("model: m.bpmn\nworld: w.yaml\n", "utf-8")
    return path


CALLS = process(
    """<startEvent id="S"/><sequenceFlow id="f" sourceRef="S" targetRef="C"/>
    <callActivity id="C" name="Do it" calledElement="Sub"/><sequenceFlow id="g" sourceRef="C" targetRef="E"/>
    <endEvent id="E"/>"""
)
SUB = process('<startEvent id="S"/>').replace('id="P"', 'id="Sub"')


def test_variables_that_a_scenario_gives_are_no_finding(tmp_path: Path) -> None:
    task = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/><scriptTask id="t"><script>a = given'
    (tmp_path / "m.bpmn").write_text(process(f"{task}</script></scriptTask>"))
    (tmp_path / "day.yaml").write_text("model: m.bpmn\nvariables: {P: {given: 1}}\n")
    for name, count in (("m.bpmn", 1), ("day.yaml", 0)):
        with ModelWatch(tmp_path / name) as source:
            assert len(source.mission()["findings"]) == count


def test_what_a_scenario_needs_is_followed_while_it_is_missing_or_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fame.view.watch._POLL", 0.01)
    (tmp_path / "w.yaml").write_text("robots: nonsense\n", "utf-8")
    with ModelWatch(scenario_of(tmp_path)) as watch:
        assert watch.mission()["findings"][0]["where"] == "w.yaml"
        (tmp_path / "w.yaml").write_text("bounds: [0, 0, 9, 9]\n", "utf-8")
        eventually(lambda: "got 'm.bpmn'" in texts(watch)[0])
        (tmp_path / "m.bpmn").write_text("<half a", "utf-8")
        eventually(lambda: watch.mission()["findings"][0]["where"] == "m.bpmn")
        (tmp_path / "m.bpmn").write_text(CALLS, "utf-8")
        eventually(lambda: "found neither a process of this file nor Sub.bpmn" in texts(watch)[0])
        (tmp_path / "library").mkdir()
        (tmp_path / "library" / "any.bpmn").write_text(SUB, "utf-8")
        eventually(lambda: not [text for text in texts(watch) if "Sub.bpmn" in text])
        assert [Path(name).name for name in watch.mission()["models"]] == ["m.bpmn", "any.bpmn"]
        (tmp_path / "w.yaml").write_text("robots: nonsense\n", "utf-8")
        eventually(lambda: watch.mission()["findings"][0]["where"] == "w.yaml")


def test_what_is_saved_while_the_files_are_read_is_read_again(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, checks = fame.view.watch.check, list[int]()

    def save_then_check(*arguments: Any, **options: Any) -> Any:
        found = real(*arguments, **options)
        if not checks:
            break_it(model)
        checks.append(len(found))
        return found

    monkeypatch.setattr("fame.view.watch._POLL", 0.01)
    monkeypatch.setattr("fame.view.watch.check", save_then_check)
    with ModelWatch(model) as watch:
        eventually(lambda: "Nowhere" in "".join(texts(watch)))


def test_a_page_loads_its_model_once_and_again_when_it_is_another(chromium: Browser, watch: ModelWatch) -> None:
    loads, told = [], []
    mission, news = watch.mission, watch.news
    watch.mission = lambda: loads.append(1) or mission()
    watch.news = lambda known: told.append(known) or news(known)
    with opened(chromium, watch) as page:
        eventually(lambda: len(told) > 1)  # the page has been told what the model is
        watch._version += 1
        until(page, "fame.mission.version === 1")
    assert len(loads) == 2


def test_a_page_loads_what_was_saved_before_it_was_connected(chromium: Browser, watch: ModelWatch) -> None:
    mission, loads = watch.mission, list[int]()

    def then_save() -> Any:
        loads.append(watch._version)
        found, watch._version = mission(), 1
        return found

    watch.mission = then_save  # type: ignore[method-assign]
    with opened(chromium, watch) as page:
        until(page, "fame.version === 1")
    assert loads == [0, 1]


def test_of_diagrams_on_their_way_the_last_one_is_shown_and_none_of_an_earlier_model(
    chromium: Browser, watch: ModelWatch
) -> None:
    with opened(chromium, watch) as page:
        found = page.evaluate(
            """(async () => {
              const { diagram, fetch } = fame, answers = [];
              fame.fetch = (path) => new Promise((done) => answers.push(() => done(fetch.call(fame, path))));
              const first = diagram.open(1), last = diagram.open(2);
              answers[1](); await last; answers[0](); await first;
              const shown = [diagram.plane, diagram.current === diagram.planes.get(2), diagram.crumbs.children.length];
              const old = diagram.load(3), again = diagram.load(3), saved = fame.load(fame.mission);
              answers[3](); await saved; answers[2]();
              return [...shown, await old, await again, diagram.planes.has(3), answers.length];
            })()"""
        )
    assert found == [2, True, 5, None, None, False, 4]


def test_a_reading_while_the_page_is_made_is_news_to_it(watch: ModelWatch, monkeypatch: pytest.MonkeyPatch) -> None:
    real = fame.view.watch._chips

    def read_then_chips(findings: Any) -> Any:
        watch._version += 1
        return real(findings)

    monkeypatch.setattr("fame.view.watch._chips", read_then_chips)
    assert watch.news(watch.mission()["version"])[1] == [{"type": "reload", "version": 1}]


def test_no_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        ModelWatch(tmp_path / "none.bpmn")


def test_the_page_marks_the_element_and_follows_the_file(chromium: Browser, watch: ModelWatch, model: Path) -> None:
    with opened(chromium, watch) as page:
        until(page, "document.querySelector('.chip.completed') !== null")
        break_it(model)
        until(page, "document.querySelector('.badge.error title').textContent.includes('Nowhere')")
        says(page, "#inspector", "Nowhere")
        assert violations(page) == []
        model.write_bytes((MODELS / "ground_vehicles.bpmn").read_bytes())
        until(page, "document.querySelector('.badge.error') === null")


def test_what_is_chosen_and_open_stays_so_when_elements_have_other_numbers(
    chromium: Browser, watch: ModelWatch, model: Path
) -> None:
    with opened(chromium, watch) as page:
        page.evaluate(
            """(async () => {
              const { elements } = fame.mission, explore = elements.findIndex((one) => one.id === "Activity_Explore");
              fame.select({ element: explore });
              await fame.diagram.open(elements[explore].inside, explore);
            })()"""
        )
        text, first = model.read_text("utf-8"), '<bpmn:startEvent id="Event_MissionStarts"'
        model.write_text(text.replace(first, f'<bpmn:task id="New" />{first}'), "utf-8")
        until(page, "fame.drawing && fame.mission.elements.some((one) => one.id === 'New')")
        shown = "[fame.mission.elements[fame.selected.element].id, fame.diagram.crumbs.lastChild.textContent]"
        assert page.evaluate(shown) == ["Activity_Explore", "Explore"]


def test_a_save_is_shown_in_one_frame_once_its_diagram_is_there(
    chromium: Browser, watch: ModelWatch, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = """['#chips', '#inspector', '.badge.error'].map((name) => document.querySelector(name)?.textContent
      .match(/1 error|Nowhere/)?.[0] ?? '').join()"""
    plane, comes = watch.plane, threading.Event()
    comes.set()
    monkeypatch.setattr(watch, "plane", lambda number: (comes.wait(60), plane(number))[1])
    with opened(chromium, watch) as page:
        until(page, "document.querySelector('#inspector .quiet')")
        frames(page)
        page.evaluate("fame.inspector.pause = 1e9")  # as if it took long to show
        comes.clear()
        break_it(model)
        until(page, "fame.findings.size")
        frames(page)
        assert page.evaluate(shown) == ",,"
        comes.set()
        found = until(page, f"document.querySelector('.badge.error') && {shown}")  # at one look: it may be drawn anew
        assert found == "1 error,Nowhere,Nowhere"


def test_a_call_activity_says_what_it_calls(chromium: Browser, model: Path, tmp_path: Path) -> None:
    shutil.rmtree(tmp_path / "library")
    with ModelWatch(model) as watch, opened(chromium, watch) as page:
        said = "document.querySelector('#inspector').innerText"
        until(page, f'{said}.includes("FAME\'s own library supplies Explore, GoTo")')
        explore = "fame.mission.elements.findIndex((one) => one.name === 'Explore' && one.inside >= 0)"
        page.evaluate(f"fame.select({{element: {explore}}})")
        until(page, f'{said}.includes("calls Explore of FAME\'s own library")')
