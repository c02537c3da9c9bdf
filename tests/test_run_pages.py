"""The site to publish: each example and pattern as a page of its run."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent.parent / "docs"))
import run_pages

ROOT = run_pages.ROOT
PATTERN = {"patrol": ROOT / "examples" / "cookbook" / "patrol" / "mission.bpmn"}


def test_each_example_and_each_pattern_has_a_run_that_pages_lead_to() -> None:
    names = {*run_pages.runs()}
    assert {path.parent.name for path in ROOT.glob("examples/cookbook/*/README.md")} < names
    pages = ("docs/cookbook", "examples/README")
    marks = "".join(run_pages.marked(page, (ROOT / f"{page}.md").read_text(encoding="utf-8")) for page in pages)
    linked = {found[1] for found in run_pages.MARK.finditer(marks)}
    assert names - linked == set()
    assert all((ROOT / "examples" / f"{name}.yaml").exists() for name in linked - names)  # as of a campaign


def test_a_page_is_made_once_for_a_state_of_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_pages, "digest", lambda: "one")
    page = run_pages.kept_pages(tmp_path, PATTERN)["patrol"]
    assert ">patrol</title>" in page.read_text(encoding="utf-8")
    page.write_text("kept")
    assert run_pages.kept_pages(tmp_path, PATTERN)["patrol"].read_text() == "kept"
    monkeypatch.setattr(run_pages, "digest", lambda: "other")
    assert run_pages.kept_pages(tmp_path, PATTERN)["patrol"].read_text(encoding="utf-8") != "kept"
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["patrol.html"]  # without its recording


def test_the_digest_is_that_of_code_models_and_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "examples").mkdir()
    monkeypatch.setattr(run_pages, "ROOT", tmp_path)
    found = [run_pages.digest()]
    for name in ("README.md", "examples/a.yaml", "examples/b.yaml"):
        (tmp_path / name).write_text("")
        found.append(run_pages.digest())
    (tmp_path / "examples" / "a.yaml").write_text("changed")
    found.append(run_pages.digest())
    assert found[0] == found[1]
    assert len({*found}) == 4


def test_the_site_to_publish_links_to_runs_and_shows_them_and_the_other_one_does_not(tmp_path: Path) -> None:
    site, run = tmp_path / "site", tmp_path / "patrol.html"
    (site / "docs").mkdir(parents=True)
    run.write_text("a run")
    page = site / "docs" / "cookbook.html"
    page.write_text("<p>a <!-- run patrol --></p><p>b <!-- run unknown --></p><!-- run patrol here -->")
    run_pages.publish(site, tmp_path / "published", {"patrol": run})
    shown = (tmp_path / "published" / "docs" / "cookbook.html").read_text(encoding="utf-8")
    addresses = re.findall(r'(?:src|href)="([^"]*)"', shown)
    assert addresses == ["../runs/patrol.html"] * 3
    assert all((tmp_path / "published" / "docs" / address).read_text() == "a run" for address in addresses)
    assert "<iframe" in shown
    assert "<!--" not in shown
    assert not (site / "runs").exists()
    assert "<a" not in page.read_text()
