"""Each build has its version: the release that it leads to, how many commits there are, and the last."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from fame import version
from fame.version import RELEASE, of_checkout

ROOT = Path(__file__).parent.parent
pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs the program git")


def git(folder: Path, *words: str) -> str:
    command = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "commit", "--quiet", "--allow-empty", "-m", "first")
    git(tmp_path, "commit", "--quiet", "--allow-empty", "-m", "second")
    return tmp_path


def test_two_commits_have_two_versions(checkout: Path) -> None:
    first = of_checkout(checkout)
    git(checkout, "commit", "--quiet", "--allow-empty", "-m", "third")
    assert first.startswith(f"{RELEASE}.dev2+g")
    assert of_checkout(checkout).startswith(f"{RELEASE}.dev3+g{git(checkout, 'rev-parse', '--short=8', 'HEAD')}")


def test_the_commit_of_a_release_is_the_release(checkout: Path) -> None:
    git(checkout, "tag", "v0.0.1")
    assert of_checkout(checkout) != RELEASE
    git(checkout, "tag", f"v{RELEASE}")
    assert of_checkout(checkout) == RELEASE


def test_a_folder_without_git_says_nothing_of_its_commit(tmp_path: Path) -> None:
    assert of_checkout(tmp_path) == ""
    (tmp_path / ".git").write_text("gitdir: nowhere")
    assert of_checkout(tmp_path) == ""


def test_an_installation_has_the_version_that_it_was_built_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(version, "__file__", str(tmp_path / "fame" / "version.py"))
    assert version.current.__wrapped__() == f"{RELEASE}.dev0"
    (tmp_path / "fame").mkdir()
    (tmp_path / "fame" / "BUILD").write_text("0.3.0.dev7+g1234abcd\n")
    assert version.current.__wrapped__() == "0.3.0.dev7+g1234abcd"


def test_the_package_and_its_citation_name_the_same_release() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert str(citation["version"]) == RELEASE
