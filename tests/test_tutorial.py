"""docs/tutorial.md, walked in a real browser as somebody would who reads it: `make test-node`."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from modeler import Modeler, new_diagram
from test_edit import PACKAGE, opened
from view_page import until

from fame.bpmn import read_text
from fame.cli import main
from fame.edit.modeler import unpack
from fame.edit.session import ModelEdit
from fame.view import Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


@pytest.fixture
def modeler(chromium: Browser, node_modules: Path, tmp_path: Path) -> Iterator[Modeler]:
    """A new diagram, with the templates that `fame templates` writes."""
    assert main(["templates", "-o", str(tmp_path / "templates")]) == 0
    templates = [one for file in sorted((tmp_path / "templates").iterdir()) for one in json.loads(file.read_text())]
    with chromium.new_page(viewport={"width": 1160, "height": 760}) as page:
        yield new_diagram(page, node_modules / "camunda-bpmn-js" / "dist", templates)


def follow(modeler: Modeler, pictures: str) -> None:
    """Draw what the tutorial says, and check that it says all that has to be known. `pictures` have names like this."""
    start = modeler.begun_with()
    scout = modeler.create("Create pool/participant", 450, 170)
    helper = modeler.create("Create pool/participant", 450, 480)
    modeler.fill(scout, "General", Name="SCOUT")
    modeler.fill(helper, "General", Name="HELPER")
    modeler.shot(f"{pictures}_1", scout, "General", high=640)

    go = modeler.append(start, "Append task")
    light = modeler.append(go, "Append task")
    end = modeler.append(light, "Append end event")
    modeler.shot(f"{pictures}_2", start)

    modeler.change(go, "Call activity")
    assert "Called element" not in modeler.labels(go, "Called element")
    modeler.fill(go, "General", Name="Go To")
    modeler.fill(go, "Called element", Type="BPMN", Called_element="GoTo")

    modeler.shot(f"{pictures}_3", go, "Called element", high=450)

    goal = modeler.create("Create data object reference", 420, 255)
    modeler.fill(goal, "General", Name="goal")
    modeler.extend(goal, x_goal="4.5", y_goal="1.0")
    modeler.connect(goal, "Connect using data input association", go)
    modeler.shot(f"{pictures}_4", goal, "Extension properties", high=640)

    modeler.change(light, "Script task")
    (script,) = re.findall(r"```python\n(.*?)```", TUTORIAL, re.DOTALL)
    modeler.fill(light, "General", Name="Green light")
    modeler.fill(light, "Script", Format="python", Type="Inline script")
    modeler.fill(light, "Script", Script=script.strip())
    modeler.shot(f"{pictures}_5", light, "Script", high=590)

    modeler.change(end, "Signal end event")
    modeler.fill(end, "Signal", Global_signal_reference="Create new ...")
    modeler.fill(end, "Signal", Name="arrived")
    modeler.extend(end, type="geometry_msgs/msg/Vector3", payload="{x: ${x_goal}, y: ${y_goal}}")
    modeler.shot(f"{pictures}_6", end, "Extension properties", high=760)

    plan = modeler.create("Create start event", 230, 480)
    go = modeler.append(plan, "Append task")
    modeler.append(go, "Append end event")
    modeler.change(plan, "Signal start event")
    modeler.fill(plan, "Signal", Global_signal_reference="arrived")
    modeler.change(go, "Call activity")
    modeler.fill(go, "General", Name="Go To")
    modeler.fill(go, "Called element", Type="BPMN", Called_element="GoTo")
    place = modeler.create("Create data object reference", 420, 560)
    modeler.extend(place, x_goal="", y_goal="")
    modeler.connect(plan, "Connect to other element", place)

    tutorial = " ".join(TUTORIAL.split())
    assert [word for word in sorted(modeler.read) if " ".join(word.split()) not in tutorial] == []
    modeler.shot(f"{pictures}_7", plan, "Signal", high=640)


def world() -> str:
    """The scenario that the tutorial gives."""
    (scenario,) = re.findall(r"```yaml\n(.*?)```", TUTORIAL, re.DOTALL)
    return re.sub(r"^   ", "", scenario, flags=re.MULTILINE)


def test_the_mission_that_somebody_draws_in_camunda_modeler_runs(modeler: Modeler, tmp_path: Path) -> None:
    follow(modeler, "modeler")
    (tmp_path / "patrol.bpmn").write_text(modeler.save(), encoding="utf-8")
    (tmp_path / "patrol.yaml").write_text(world())
    assert main(["check", str(tmp_path / "patrol.bpmn")]) == 0
    assert main(["run", str(tmp_path / "patrol.yaml"), "--json"]) == 0


def test_the_mission_that_somebody_draws_in_fame_edit_runs_beside_it(
    chromium: Browser, node_modules: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    library = unpack((node_modules.parent / PACKAGE).read_bytes(), PACKAGE)
    (tmp_path / "patrol.yaml").write_text(world())
    with (
        ModelEdit(tmp_path / "patrol.yaml", library) as source,
        Server(source) as server,
        opened(chromium, server) as page,
    ):
        page.evaluate("window.modeler = edit.modeler")
        page.mouse.move(600, 650)
        page.mouse.down()
        page.mouse.move(335, 390, steps=5)  # the start event goes up and to the left
        page.mouse.up()
        follow(Modeler(page, (860, 560), whole=True), "tutorial")
        page.keyboard.press("Control+s")
        until(page, "document.querySelector('#state').textContent === 'saved'")
        until(page, "edit.exploring.result !== null")
        page.locator("#speed").select_option("20")
        page.locator("#play").click()
        until(page, "document.querySelector('#clock')?.textContent.includes('completed')")
        if folder := os.environ.get("FAME_SHOTS"):
            page.screenshot(path=Path(folder) / "tutorial_8.png")
    assert main(["check", str(tmp_path / "patrol.yaml")]) == 0
    picture = Path(os.environ.get("FAME_SHOTS", tmp_path)) / "tutorial_9.png"
    assert main(["run", str(tmp_path / "patrol.yaml"), "--json", "--log", str(tmp_path / "run.mcap")]) == 0
    assert main(["draw", str(tmp_path / "run.mcap"), "-o", str(picture)]) == 0


def test_the_modeler_offers_the_templates_that_fame_writes_and_fame_reads_what_is_filled_in(modeler: Modeler) -> None:
    task = modeler.append(modeler.begun_with(), "Append task")
    assert {"Go To", "Detect Weed"} <= set(modeler.templates(task))
    assert "*Template*" in TUTORIAL
    answer = modeler.append(task, "Append task")
    modeler.change(task, "Send task")
    modeler.apply(task, "ROS 2 send message")
    modeler.fill(task, "Custom properties", Message_type="geometry_msgs/msg/Point", To="${closest}")
    modeler.change(answer, "Receive task")
    modeler.apply(answer, "ROS 2 receive correlated message")
    modeler.fill(answer, "Custom properties", Correlate_by="order_id", Queue="3")
    for each, name in ((task, "order"), (answer, "done")):
        modeler.fill(each, "General", Name=name)
    (process,) = read_text(modeler.save()).processes
    sends, receives = (next(node for node in process.body.walk() if node.id == each) for each in (task, answer))
    assert (sends.topic.name, sends.topic.type, sends.topic.to.text) == (
        "order",
        "geometry_msgs/msg/Point",
        "${closest}",
    )
    assert (receives.topic.name, receives.topic.queue, receives.keys[0][0]) == ("done", 3, "order_id")
