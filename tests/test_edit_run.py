"""The run beside the model that is drawn in ``fame edit``: begun by a person, and changed with the model."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from bpmn_text import process
from test_edit import PACKAGE, opened, shape
from view_page import eventually, shot, until

from fame.edit import modeler
from fame.edit.running import EditedRun
from fame.edit.session import ModelEdit
from fame.errors import FameError
from fame.view import Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parent.parent
TIMER = "<timerEventDefinition><timeDuration>{}</timeDuration></timerEventDefinition>"
MODEL = process(
    '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
    "<scriptTask id='t'><script>import random; drawn = random.random(); open('ran', 'w').close()</script></scriptTask>"
    '<sequenceFlow id="g" sourceRef="t" targetRef="c"/>'
    f'<intermediateCatchEvent id="c">{TIMER.format("PT10S")}</intermediateCatchEvent>'
    '<sequenceFlow id="h" sourceRef="c" targetRef="u"/><userTask id="u"/>'
    '<sequenceFlow id="i" sourceRef="u" targetRef="e"/><endEvent id="e"/>'
)
COUNTED = MODEL.replace('sourceRef="c" targetRef="u"/>', 'sourceRef="c" targetRef="k"/>').replace(
    '<userTask id="u"/>',
    '<scriptTask id="k"><script>more = 1</script></scriptTask><sequenceFlow id="j" sourceRef="k" targetRef="u"/>'
    '<userTask id="u"/>',
)


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "m.bpmn"
    path.write_text(MODEL)
    return path


@pytest.fixture
def run(model: Path) -> Iterator[EditedRun]:
    with EditedRun(model) as source:
        yield source


def begin(run: EditedRun, to: str = "u") -> Any:
    """Begin a run, as fast as it goes, and wait until it has come to an element."""
    run.control({"do": "begin", "to": to, "speed": 0})
    return paused(run)


def paused(run: EditedRun) -> Any:
    """What the run says of itself, once it is paused."""
    said = []

    def is_paused() -> bool:
        said[:] = [one for one in run.news(None)[1] if one["type"] == "run" and one["paused"]]
        return bool(said)

    eventually(is_paused)
    return said[0]


def engine(run: EditedRun) -> Any:
    """The engine of the only robot."""
    assert run._run is not None
    return run._run.control_of_run.call(lambda now: now.nodes[0].engine)


def test_nothing_of_a_model_runs_until_a_person_says_so(model: Path, tmp_path: Path) -> None:
    with ModelEdit(model, tmp_path) as source:
        text, hash = (source.mission()[name] for name in ("text", "hash"))
        base = source.control({"do": "open", "base": text, "hash": hash})["base"]
        for act in ("check", "save"):
            source.control({"do": act, "base": base, "new": text})
        assert source.run.mission()["robots"] == []
        assert not (tmp_path / "ran").exists()
        begin(source.run)
        assert (tmp_path / "ran").exists()


def test_a_run_pauses_where_a_token_comes_to_an_element(run: EditedRun) -> None:
    assert (begin(run)["time"], begin(run, "c")["time"]) == (10_000_000_000, 0)
    run.control({"do": "run_to", "to": "u"})
    eventually(lambda: paused(run)["time"] == 10_000_000_000)
    with pytest.raises(FameError, match="z is not in the model that runs"):
        run.control({"do": "run_to", "to": "z"})


@pytest.mark.parametrize("speed", [-1, float("inf"), float("nan")])
def test_a_run_does_not_begin_at_a_speed_that_is_none(run: EditedRun, speed: float) -> None:
    with pytest.raises(FameError, match=r"expected a speed from 0 \(at once\) to 1e6, got"):
        run.control({"do": "begin", "speed": speed})
    with pytest.raises(FameError, match="nothing runs"):
        run.control({"do": "pause"})


def test_only_a_page_with_another_run_is_told_to_begin_anew(run: EditedRun) -> None:
    kinds = [[one["type"] for one in news] for known, news in (run.news(None), run.news(run.news(None)[0]))]
    assert kinds == [[], []]
    known = run.news(None)[0]
    begin(run)
    assert [run.news(one)[1][0]["type"] for one in (None, known)] == ["reload", "begin"]
    run.control({"do": "end"})
    assert run.news(run.news(None)[0])[1] == []


def test_the_run_goes_over_to_the_changed_model_where_it_is(run: EditedRun, model: Path) -> None:
    begin(run, "c")
    drawn = engine(run).instances[1].root_variables["drawn"]
    model.write_text(COUNTED)
    assert run.control({"do": "change"}) == {"blocked": [], "time": 0}
    mission = run.mission()
    assert [(one["id"], one["file"]) for one in mission["elements"] if one["id"] in "ck"] == [
        ("c", 0),
        ("c", 1),
        ("k", 1),
    ]
    run.control({"do": "run_to", "to": "u"})
    eventually(lambda: paused(run)["time"] == 10_000_000_000)
    instance = engine(run).instances[1]
    assert instance.root_variables.items() >= {"more": 1, "drawn": drawn}.items()
    block = run.block(len(run.mission()["blocks"]) - 1)
    now = {mission["elements"][number]["id"] for number in block["e"]}
    assert {"c", "k", "u"} <= now  # by the numbers of the changed model
    assert all(mission["elements"][number]["file"] == 1 for number in block["e"])


def test_a_token_that_cannot_go_over_is_told_and_the_same_seed_comes_to_the_same_instant(
    run: EditedRun, model: Path
) -> None:
    begin(run)
    before = engine(run).instances[1].root_variables["drawn"]
    model.write_text(COUNTED.replace('"u"', '"v"'))
    (blocked,) = run.control({"do": "change"})["blocked"]
    assert (blocked["element"], blocked["text"]) == ("u", "u: the new model has no element u")
    assert list(engine(run).instances[1].waiting) == ["u"]  # which goes on as it was
    run.control({"do": "again", "speed": 0})
    eventually(lambda: paused(run)["repeats"] is None)
    assert paused(run)["time"] == 10_000_000_000
    variables = engine(run).instances[1].root_variables
    assert (variables["drawn"], variables["more"]) == (before, 1)


@pytest.mark.parametrize("text", [MODEL.replace("import random", "import"), "<a"])
def test_a_model_that_cannot_run_leaves_the_run_as_it_was(run: EditedRun, model: Path, text: str) -> None:
    begin(run)
    model.write_text(text)
    for act in ("change", "again", "begin"):
        with pytest.raises(FameError, match=r"m.bpmn:"):
            run.control({"do": act})
    assert paused(run)["time"] == 10_000_000_000


def test_what_a_scenario_says_besides_its_model_cannot_change_under_a_run(tmp_path: Path, model: Path) -> None:
    scenario = tmp_path / "day.yaml"
    scenario.write_text("model: m.bpmn\nseed: 1\n")
    with EditedRun(scenario) as run:
        begin(run)
        scenario.write_text("model: m.bpmn\nseed: 2\n")
        with pytest.raises(FameError, match="only the model of a run can change, not its seed"):
            run.control({"do": "change"})
        run.control({"do": "end"})
        with pytest.raises(FameError, match="nothing runs"):
            run.control({"do": "pause"})


def test_the_run_is_behind_the_token_of_the_page(model: Path, tmp_path: Path) -> None:
    with ModelEdit(model, tmp_path) as source, Server(source) as server:
        assert b'"number":0' in urlopen(f"{server.address}run/mission.json").read()
        for address, headers in (
            (f"http://127.0.0.1:{server.port}/x/run/control", {}),
            (f"{server.address}run/control", {"Origin": "http://evil.example"}),
        ):
            with pytest.raises(HTTPError):
                urlopen(Request(address, b'{"do": "begin"}', headers))
        assert source.run.mission()["number"] == 0


# ---- in the browser --------------------------------------------------------------------------------------------------


@pytest.fixture
def library(node_modules: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return modeler.unpack((node_modules.parent / PACKAGE).read_bytes(), PACKAGE)


def _id(page: Page, name: str) -> Any:
    """The ids of an element with a label, and of the flow behind it."""
    return page.evaluate(
        """name => { const [one] = edit.modeler.get('elementRegistry').filter(
            one => one.businessObject.name === name && one.type !== 'label');
            return [one.id, one.outgoing[0]?.id]; }""",
        name,
    )


def test_agriculture_gets_an_activity_drawn_in_while_it_runs(
    chromium: Browser,
    library: Path,
    tmp_path: Path,
) -> None:
    for name in ("models", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    with (
        ModelEdit(tmp_path / "examples" / "agriculture.yaml", library) as source,
        Server(source) as server,
        opened(chromium, server) as page,
    ):
        page.locator("#speed").select_option("0")
        cut, behind = _id(page, "Cut Grass")
        shape(page, cut).click(button="right")
        page.locator("#here").click()
        until(page, "edit.running.status?.stopped === 'A token has come there.'")
        until(page, "document.querySelectorAll('.disc').length === 2")  # of the drone, and of the tractor
        page.locator("#world canvas").wait_for()
        box = page.evaluate(
            "id => document.querySelector(`g[data-element-id='${id}']`).getBoundingClientRect().toJSON()", behind
        )
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.locator("[data-action='create.task']").click()
        page.mouse.move(x, y + 60)
        page.mouse.move(x, y, steps=5)
        page.mouse.click(x, y)
        page.keyboard.type("Tell")
        page.mouse.click(640, 10)
        until(page, "edit.drawn.includes('Tell')")
        page.keyboard.press("Control+s")
        until(page, "edit.running.hash === edit.hash && !edit.dirty")
        task, _ = _id(page, "Tell")
        shape(page, task).click(button="right", position={"x": 15, "y": 8})  # a flow is in the middle
        page.locator("#here").click()
        until(page, "edit.running.status.stopped === 'A token has come there.' && edit.running.status.time > 40e9")
        shot(page, "edit-run")

        explore, _ = _id(page, "Explore")
        page.evaluate(
            """id => edit.modeler.get('modeling').updateProperties(
            edit.modeler.get('elementRegistry').get(id), { id: "Search" })""",
            explore,
        )
        until(page, "edit.dirty")
        page.locator("#save").click()
        page.locator("#blocked", has_text=f"({explore}): the new model has no element {explore}").wait_for()
        time = page.evaluate("edit.running.status.time")
        shot(page, "edit-blocked")
        page.locator("#again").click()
        until(page, f"edit.running.mission.number === 2 && edit.running.status?.time === {time} && !edit.running.gone")
        until(page, "document.querySelector('.has-token[data-element-id=Search]') !== null")
        page.locator("#play").click()
        until(page, "edit.running.status.over && document.querySelector('#clock').innerText.includes('completed')")
        until(page, "edit.running.world.ground.weeds.every(weed => weed.cut !== null)")
        assert source.run._run is not None
        tractors = [one for one in source.run._run._run.nodes if one.name != "Drone"]  # type: ignore[union-attr]
        assert sum(one.visits[task] for node in tractors for one in node.instances) == 5
