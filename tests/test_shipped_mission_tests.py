"""The tests in examples/tests pass, and cover every element and flow of their models."""

from __future__ import annotations

from pathlib import Path

import pytest

from fame.cli import main

ROOT = Path(__file__).parent.parent


def test_they_pass_and_cover_their_models(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    code = main(["test", "examples/tests", "-k", "not in_the_world", "--cov-model", "--cov-fail-under", "100"])
    assert code == 0, capsys.readouterr().out
