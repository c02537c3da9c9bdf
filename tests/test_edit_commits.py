"""What is drawn in ``fame edit``, compared with the last commit."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from test_edit import OLD, PACKAGE, drawn, opened
from view_page import shot, until

from fame.edit import modeler
from fame.edit.session import ModelEdit
from fame.errors import FameError
from fame.view import Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs the program git")
OTHER = OLD.replace('name="Count"', 'name="Number"')


def git(folder: Path, *words: str) -> None:
    named = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", *words]
    subprocess.run(named, check=True, capture_output=True)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model that was changed after its last commit."""
    path = tmp_path / "day" / "m.bpmn"
    path.parent.mkdir()
    path.write_text(OTHER, "utf-8")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    path.write_text(OLD, "utf-8")
    return path


def test_what_is_drawn_is_compared_with_the_last_commit(model: Path) -> None:
    with ModelEdit(model, model.parent) as edit:
        found = drawn(edit, OLD.replace("a = 1", "a = 7"), "commit")
        assert found["how"] == {"t": "changed"}
        assert "    name: Number → Count" in found["lines"]
        assert drawn(edit, OTHER, "commit") == {"lines": [], "how": {}}


@pytest.mark.parametrize("lacks", [".git", "commit of it"])
def test_without_a_commit_that_is_said(model: Path, lacks: str) -> None:
    if lacks == ".git":
        shutil.rmtree(model.parent.parent / ".git")
    else:
        git(model.parent, "rm", "-q", "--cached", "m.bpmn")
        git(model.parent, "commit", "-qm", "two")
    with (
        ModelEdit(model, model.parent) as edit,
        pytest.raises(FameError, match="there is no last commit of it"),
    ):
        drawn(edit, OLD, "commit")


def test_the_diagram_shows_what_has_changed_while_it_is_drawn(
    chromium: Browser, node_modules: Path, tmp_path: Path, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    library = modeler.unpack((node_modules.parent / PACKAGE).read_bytes(), PACKAGE)
    with ModelEdit(model, library) as source, Server(source) as server, opened(chromium, server) as page:
        page.locator("#commits").click()
        page.locator("#since", has_text="name: Number → Count").wait_for()
        until(page, "document.querySelector('.since-changed')?.dataset.elementId === 't'")
        page.evaluate(
            """edit.modeler.get('modeling').appendShape(
            edit.modeler.get('elementRegistry').get('t'), { type: 'bpmn:UserTask' })"""
        )
        page.locator("#since", has_text="+ userTask").wait_for()
        shot(page, "edit-commits")
        page.locator("#commits").click()
        until(page, "document.querySelector('.since-added, .since-changed') === null")
