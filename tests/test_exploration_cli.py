"""``fame check --explore`` and ``fame deploy --explore`` on the command line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from collaborations import text_of

from fame.cli import main


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.bpmn"
    path.write_text(text_of({"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}))
    return path


def test_the_first_line_says_that_all_states_were_explored(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", "models/ground_vehicles.bpmn"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("models/ground_vehicles.bpmn: all states explored (REX, DINGO; delivery run and fast)")


def test_a_search_that_is_cut_says_so_first_and_passes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", "models/agriculture.bpmn", "--limit", "20"]) == 0
    assert "NOT all states explored (the limit of 20 states is reached" in capsys.readouterr().out.splitlines()[0]


def test_a_lost_signal_fails_the_check_with_its_run(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(broken), "--delivery", "run"]) == 1
    shown = capsys.readouterr().out
    assert "error: lost signal: A waits at" in shown
    assert "B misses /go: it does not listen" in shown
    assert "from here on the mission cannot complete" in shown


def test_json(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(broken), "--json"]) == 1
    (result,) = json.loads(capsys.readouterr().out)["explorations"]
    assert result["exhaustive"] is True
    assert result["findings"][0]["kind"] == "lost"
    assert result["findings"][0]["run"][-1]["text"]


def test_traces_are_tests_that_fail_today_and_pass_once_it_is_mended(broken: Path, tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    assert main(["check", "--explore", str(broken), "--delivery", "run", "--trace", str(folder)]) == 1
    (test,) = folder.glob("test_*.py")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 1
    broken.write_text(text_of({"A": ["throw go", "catch done"], "B": ["work", "queue go", "throw done"]}))
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stdout


def test_options_that_need_explore(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "models/ground_vehicles.bpmn", "--limit", "5"]) == 2
    assert "--limit needs --explore" in capsys.readouterr().err
    assert main(["check", "--explore", "models/agriculture.bpmn", "--robots", "Tractor"]) == 2
    assert "expected POOL=N" in capsys.readouterr().err
    assert main(["check", "--explore", "models/agriculture.bpmn", "--limit", "0"]) == 2


def test_a_model_with_errors_is_not_explored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.bpmn"
    path.write_text(text_of({"A": ["run x = (", "work"]}))
    assert main(["check", "--explore", str(path)]) == 2
    assert "has errors: nothing is explored" in capsys.readouterr().err


def test_a_mission_that_may_deadlock_is_not_deployed(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["deploy", "--explore", str(broken)]) == 1
    assert "nothing is sent: lost signal: A waits at" in capsys.readouterr().err
