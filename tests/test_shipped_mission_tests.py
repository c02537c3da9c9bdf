"""The tests in examples/tests pass, and cover every element and flow of their models."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_they_pass_and_cover_all_missions(tmp_path: Path) -> None:
    report = tmp_path / "coverage.json"
    words = ["-k", "not in_the_world", "--cov-model", "--cov-fail-under", "100", "--cov-json", str(report)]
    command = [sys.executable, "-m", "fame", "test", "examples/tests", *words]  # its files have names of files here
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    tested = {Path(process["file"]).name for process in json.loads(report.read_text())["processes"]}
    missions = {path.name for folder in ("models", "models/delivery") for path in (ROOT / folder).glob("*.bpmn")}
    assert tested == missions
