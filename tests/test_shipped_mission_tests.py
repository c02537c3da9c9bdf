"""The tests in examples/tests pass, and cover every element and flow of their models."""

import json
from pathlib import Path

from fame_test_runs import fame_test

ROOT = Path(__file__).parent.parent


def test_they_pass_and_cover_all_missions(tmp_path: Path) -> None:
    report = tmp_path / "coverage.json"
    words = ["-k", "not in_the_world", "--cov-model", "--cov-fail-under", "100", "--cov-json", str(report)]
    code, shown = fame_test("examples/tests", *words, folder=ROOT)
    assert code == 0, shown
    tested = {Path(process["file"]).name for process in json.loads(report.read_text())["processes"]}
    missions = {path.name for folder in ("models", "models/delivery") for path in (ROOT / folder).glob("*.bpmn")}
    assert tested == missions
