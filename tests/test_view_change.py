"""A running team is changed from the page: what a model would do is shown before it is sent, by its hash alone."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from bpmn_text import process
from view_page import PHONE, READY, eventually, flaws, says, until

from fame.bpmn import read_text
from fame.bpmn.difference import difference
from fame.clock import WallScheduler
from fame.deploy import EngineNode
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.deploy.signing import new_keys, read_private, read_trusted
from fame.edit import modeler
from fame.edit.session import ModelEdit
from fame.errors import FameError
from fame.middleware.local import LocalMiddleware
from fame.view import Server, TeamView
from fame.view.change import ModelChange, _Examination
from fame.view.people import Person

if TYPE_CHECKING:
    from playwright.sync_api import Browser

BODY = """<startEvent id="s"/><userTask id="Sign" name="Sign"/>{more}<endEvent id="e"/>
  <sequenceFlow id="f0" sourceRef="s" targetRef="Sign"/><sequenceFlow id="f1" sourceRef="Sign" targetRef="{then}"/>"""
SHAPES = """<bpmndi:BPMNDiagram id="d"><bpmndi:BPMNPlane id="pl" bpmnElement="REX">
  <bpmndi:BPMNShape id="d1" bpmnElement="Sign"><dc:Bounds x="{x}" y="0" width="100" height="80"/></bpmndi:BPMNShape>
  <bpmndi:BPMNShape id="d2" bpmnElement="{task}"><dc:Bounds x="160" y="0" width="100" height="80"/></bpmndi:BPMNShape>
</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""
TASK = """<scriptTask id="{id}" name="{id}"><script>{script}</script></scriptTask>
  <sequenceFlow id="f2" sourceRef="{id}" targetRef="e"/>"""


def model(id: str, script: str, x: int = 0) -> str:
    text = process(BODY.format(more=TASK.format(id=id, script=script), then=id), SHAPES.format(x=x, task=id))
    return text.replace('id="P"', 'id="REX" name="REX"')


OLD, NEW = model("Cut", "n = 1"), model("Mow", "n = 2", x=5)


def test_a_difference_is_one_of_meaning() -> None:
    old, new = read_text(OLD, file="old"), read_text("\n\n" + NEW, file="new")
    assert {(one.element.id, one.how) for one in difference(old, new)} == {
        ("Mow", "added"), ("Cut", "removed"), ("f1", "changed"), ("f2", "changed"), ("Sign", "moved"),
    }  # fmt: skip
    assert difference(old, read_text(OLD.replace("\n", "\n\n"), file="same")) == []


def test_a_changed_script_has_both_texts() -> None:
    old, new = read_text(OLD, file="old"), read_text(model("Cut", "n = 3"), file="new")
    (one,) = difference(old, new)
    assert (one.how, one.what, one.old_texts, one.new_texts) == ("changed", ("script",), ("n = 1",), ("n = 3",))


def test_robots_that_run_different_versions_show_the_code_that_is_new_to_each() -> None:
    runs = {"A": model("Cut", "n = 1"), "B": model("Cut", "n = 2"), "C": model("Cut", "n = 2")}
    change = ModelChange(lambda *_: None, runs.__getitem__)
    envelopes = dict.fromkeys(runs, SimpleNamespace(model=model("Cut", "n = 3")))
    about = _Examination(dry=SimpleNamespace(envelopes=envelopes))  # type: ignore[arg-type]
    change._compare(about)
    change.close()
    assert [(one.old_texts, robots) for one, robots in about.changes] == [(("n = 1",), ["A"]), (("n = 2",), ["B", "C"])]


def test_robots_on_a_busy_machine_have_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.middleware.wire_base.load_of_machine", lambda: 3.0)
    waits = []

    def send(model: object, options: DeploymentOptions, end: Callable[[Any], object]) -> None:
        waits.append(options.patience_of(2))
        end(None)

    with closing(ModelChange(send, str)) as change:
        change._sent(_Examination(model=read_text(OLD, file="old")), migrate=False)
    assert waits == [15.0]


def test_a_robot_that_runs_something_and_has_no_pool_is_named() -> None:
    runs = {"A": OLD, "B": OLD, "C": ""}
    about = _Examination(dry=SimpleNamespace(robots={"A": None}))  # type: ignore[arg-type]
    with ModelChange(lambda *_: None, runs.__getitem__, robots=lambda: runs) as change:
        assert change._others(about) == ["B"]
        assert change._others(_Examination()) == []


def test_the_editor_has_the_page_below_its_own(team: Team, tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(NEW)
    team.propose(NEW)
    with ModelEdit(tmp_path / "m.bpmn", tmp_path) as edit:
        assert edit.mission()["team"] is False
        edit.change = team.change
        with Server(edit) as server:
            hash = team.shown()["hash"]
            shown = json.load(urlopen(f"{server.address}change/mission.json"))["change"]
            assert {one["id"] for one in shown["changes"]} == {"Mow", "Cut", "f1", "f2", "Sign"}
            command = json.dumps({"do": "migrate", "hash": hash, "force": True}).encode()
            assert "REX: started" in urlopen(f"{server.address}change/control", command).read().decode()
            assert edit.mission()["team"] is True


@pytest.mark.processes
def test_a_team_is_beside_the_editor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    modeler.home().mkdir(parents=True)
    (modeler.home() / "LICENSE").touch()
    (tmp_path / "m.bpmn").write_text(NEW)
    words = [sys.executable, "-m", "fame", "edit", str(tmp_path / "m.bpmn"), "--team", "--no-open"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as page:
        assert page.stdout is not None
        address = page.stdout.readline().strip()
        eventually(lambda: b"no robot" in urlopen(f"{address}change/mission.json").read())
        page.terminate()
        assert page.wait(60) == 0


def test_an_error_that_nobody_foresaw_is_told_and_the_next_model_is_examined(team: Team, monkeypatch: Any) -> None:
    monkeypatch.setattr(team.view, "_running", lambda robot: 1 / 0)
    monkeypatch.setattr(team.change, "_running", lambda robot: 1 / 0)
    team.propose(NEW)
    eventually(lambda: "ZeroDivisionError" in team.change.mission()["change"]["error"])
    monkeypatch.undo()
    team.propose(model("Mow", "n = 4"))
    assert team.shown()["error"] == ""


class Team:
    """A robot that runs the old model, and the page, in a thread of their own."""

    def __init__(self, key: Any = None, trusted: Sequence[Any] = ()) -> None:
        self.scheduler = WallScheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.view = TeamView(self.middleware, self.scheduler, control=True, key=key, who="ann@desk")
        self.view.allow_change()
        assert self.view.change is not None
        self.change = self.view.change
        options = EngineOptions(trusted=trusted)
        self.engine = EngineNode("REX", scheduler=self.scheduler, middleware=self.middleware, options=options)
        self.thread = threading.Thread(target=self.scheduler.run)
        self.thread.start()
        try:
            self.propose(OLD)
            self.change.control({"do": "deploy", "hash": self.shown()["hash"]})
            eventually(lambda: self.view._running("REX"))
        except FameError:
            self.close()
            raise

    def propose(self, text: str) -> None:
        before = self.change._version
        self.view.control({"do": "change", "name": "../../new model.bpmn", "source": text})
        eventually(lambda: self.change._version > before)

    def shown(self) -> dict[str, Any]:
        eventually(lambda: self.change.mission()["control"])
        found: dict[str, Any] = self.change.mission()["change"]
        return found

    def said(self) -> str:
        return str([detail for block in self.view._packer.blocks for detail in block.details.values()])

    def close(self) -> None:
        self.change.close()
        self.scheduler.stop()
        self.thread.join()
        self.view.close()
        self.engine.close()
        self.middleware.close()


@pytest.fixture
def team() -> Iterator[Team]:
    team = Team()
    yield team
    team.close()


def test_a_dropped_model_shows_what_it_would_change_and_then_migrates(team: Team) -> None:
    team.propose(NEW)
    eventually(lambda: team.shown()["changes"])
    shown = team.shown()
    assert {(one["id"], one["how"]) for one in shown["changes"]} >= {("Mow", "added"), ("Cut", "removed")}
    assert next(one["code"] for one in shown["changes"] if one["id"] == "Mow") == [[], ["n = 2"]]
    assert [(one["name"], one["fate"]) for one in shown["robots"][0]["tokens"]] == [("Sign", "keep")]
    assert shown["objection"] == ""
    assert "explored" in shown["explored"]["text"]
    assert [one["name"] for one in shown["ghosts"]] == ["Cut"]
    with pytest.raises(FameError, match="has changed since it was shown"):
        team.change.control({"do": "migrate", "hash": "0" * 64})
    team.shown()
    assert "REX: started" in team.change.control({"do": "migrate", "hash": shown["hash"]})["said"]
    eventually(lambda: "by ann@desk (unverified)" in team.said() and "migrated" in team.said())
    eventually(lambda: 'id="Mow"' in team.view._running("REX"))
    team.propose(OLD)
    team.change.control({"do": "deploy", "hash": team.shown()["hash"]})
    eventually(lambda: re.search(r"deployed model \w+ by ann@desk \(unverified\)", team.said()))


def test_a_model_that_is_saved_is_examined_again(team: Team, tmp_path: Path) -> None:
    file = tmp_path / "drawn.bpmn"
    file.write_text(OLD)
    with ModelChange(team.view._deploy, team.view._running, path=file) as change:
        eventually(lambda: change.mission()["change"]["explored"])
        assert change.mission()["change"]["changes"] == []
        file.write_text(NEW)
        eventually(lambda: "Mow" in {one["id"] for one in change.mission()["change"]["changes"]})


def test_what_the_page_sends_is_signed_by_its_key(tmp_path: Path) -> None:
    pytest.importorskip("cryptography")
    secret, public = new_keys(tmp_path / "team")
    with pytest.raises(FameError, match="not signed"):
        Team(None, read_trusted([public])).close()
    team = Team(read_private(secret), read_trusted([public]))
    try:
        team.propose(NEW)
        team.change.control({"do": "deploy", "hash": team.shown()["hash"]})
        eventually(lambda: re.search(r"deployed model \w+ by key \w+", team.said()))
    finally:
        team.close()


def test_what_may_follow_a_migration_is_shown_with_the_run_that_leads_to_it(team: Team) -> None:
    team.propose(model("Mow", "raise BpmnError('stuck')"))
    eventually(lambda: team.shown()["changes"])
    shown = team.shown()
    (error,) = (one for one in shown["explored"]["findings"] if one["level"] == "error")
    assert "stuck" in error["text"]
    assert any("Sign" in step for step in error["steps"])
    assert shown["objection"] == error["text"]
    with pytest.raises(FameError, match="stuck"):
        team.change.control({"do": "migrate", "hash": shown["hash"]})


def test_nothing_is_sent_of_a_model_that_is_wrong(team: Team) -> None:
    team.propose("<half a")
    eventually(lambda: team.change.mission()["change"]["error"])
    assert team.change.mission()["control"] == []
    with pytest.raises(FameError, match="cannot be sent"):
        team.change.control({"do": "deploy", "hash": ""})


def test_a_page_without_the_right_or_of_a_person_has_no_such_page(team: Team) -> None:
    ann = Person("ann", "nurse")
    with Server(team.view, people=[ann]) as server:
        assert urlopen(server.address + "change/mission.json").status == 200
        with pytest.raises(HTTPError, match="403") as refused:
            urlopen(server.addresses[ann] + "change/mission.json")
        refused.value.close()
        with pytest.raises(FameError, match="may only complete tasks"):
            ann.check({"do": "change"}, [])
    with TeamView(team.middleware, team.scheduler, control=True) as other, Server(other) as server:
        assert "change" not in other.mission()["control"]
        with pytest.raises(FameError, match="expected one of"):
            other.control({"do": "change", "source": NEW})
        with pytest.raises(HTTPError, match="404") as missing:
            urlopen(server.address + "change/mission.json")
        missing.value.close()


def test_the_page_asks_before_code_runs(chromium: Browser, team: Team, tmp_path: Path) -> None:
    file = tmp_path / "new.bpmn"
    file.write_text(NEW)
    with Server(team.view) as server:
        page = chromium.new_page(**PHONE)
        page.set_default_timeout(60_000)
        page.goto(server.address)
        until(page, READY)
        page.locator("input[type=file]").set_input_files(file)
        page.wait_for_url("**/change/**")
        until(page, "document.querySelector('.ghost') && fame.mission.control.includes('migrate')")
        assert flaws(page, "change", (1440, "light"), (1024, "light"), (390, "dark")) == []
        page.get_by_role("button", name="Migrate …").tap()
        assert flaws(page, "migrate", (390, "dark")) == []
        says(page, "dialog.ask", "n = 2")
        page.get_by_role("button", name="Migrate", exact=True).tap()
        assert page.locator("dialog.ask").is_visible()  # nobody has said that it may run
        page.locator("dialog input[type=checkbox]").tap()
        page.get_by_role("button", name="Migrate", exact=True).tap()
        eventually(lambda: "migrated" in team.said())
        page.close()


def test_a_dropped_model_takes_the_place_of_the_one_before_at_once_and_is_examined_once(team: Team) -> None:
    before = team.shown()["hash"]
    team.view.control({"do": "change", "name": "other.bpmn", "source": NEW})
    assert team.change.mission()["control"] == []  # nobody can send the one before
    assert team.shown()["hash"] != before
    assert team.change._stamps == team.change._stamped()


DROP = """(text) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], 'other.bpmn'));
  dispatchEvent(new DragEvent('drop', { dataTransfer, cancelable: true }));
}"""


def test_a_model_is_dropped_on_the_page_and_deployed(chromium: Browser, team: Team) -> None:
    with Server(team.view) as server:
        page = chromium.new_page()
        page.set_default_timeout(60_000)
        page.goto(server.address)
        until(page, READY)
        page.evaluate(DROP, NEW)
        page.wait_for_url("**/change/**")
        page.get_by_role("button", name="Deploy …").click()
        page.locator("dialog input[type=checkbox]").check()
        page.get_by_role("button", name="Deploy", exact=True).click()
        eventually(lambda: 'id="Mow"' in team.view._running("REX"))
        page.close()
