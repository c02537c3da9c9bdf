"""examples/mining.py compares a diagram with recordings of its runs: what fits, and what does not."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from test_log_conversion import ORDERS

from fame.log import logging_to
from fame.scenario import Scenario

SCRIPT = Path(__file__).parent.parent / "examples" / "mining.py"


def fitness(model: Path, recording: Path) -> dict[str, tuple[float, float]]:
    """Fitness of the drawn and of the discovered model, by diagram."""
    command = [sys.executable, "-W", "ignore", str(SCRIPT), str(model), str(recording)]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200).stdout
    found = {}
    for part in re.split(r"^(?=\S)", output, flags=re.MULTILINE):
        values = re.findall(r"fitness ([\d.]+)", part)
        if len(values) == 2:
            found[part.split(":")[0]] = float(values[0]), float(values[1])
    return found


def test_what_was_drawn_fits_and_what_was_not_does_not(tmp_path: Path) -> None:
    pytest.importorskip("pm4py")
    (tmp_path / "orders.bpmn").write_text(ORDERS)
    scenario = Scenario.load(tmp_path / "orders.bpmn", duration=10)
    with logging_to(tmp_path / "run.mcap", scenario.closures()) as log:
        scenario.run(observer=log)
    other = ORDERS.replace('sourceRef="s2" targetRef="take"', 'sourceRef="s2" targetRef="close"')
    other = other.replace('sourceRef="close" targetRef="e2"', 'sourceRef="close" targetRef="take"')
    other = other.replace('sourceRef="pack" targetRef="close"', 'sourceRef="pack" targetRef="e2"')
    (tmp_path / "other.bpmn").write_text(other)  # closes an order before it is packed
    found = fitness(tmp_path / "other.bpmn", tmp_path / "run.mcap")
    assert found["Pack_Orders"] == (1.0, 1.0)
    drawn, discovered = found["Order"]
    assert drawn < discovered == 1.0


def test_what_cannot_be_compared_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("pm4py")
    (tmp_path / "orders.bpmn").write_text(ORDERS)
    (tmp_path / "other.bpmn").write_text(ORDERS.replace('id="', 'id="other_').replace('Ref="', 'Ref="other_'))
    scenario = Scenario.load(tmp_path / "orders.bpmn", duration=10)
    with logging_to(tmp_path / "run.mcap", scenario.closures()) as log:
        scenario.run(observer=log)
    for model, recording, text in (
        ("none.bpmn", "run.mcap", "none.bpmn: cannot be read: No such file or directory; did you mean 'other.bpmn'?"),
        ("orders.bpmn", "none", "none: cannot be read: No such file or directory"),
        ("orders.bpmn", "orders.bpmn", "orders.bpmn: is not an MCAP file"),
        ("other.bpmn", "run.mcap", "run.mcap: nothing of other.bpmn was executed: expected recordings of this model"),
    ):
        command = [sys.executable, "-W", "ignore", str(SCRIPT), model, recording]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=200)
        assert done.returncode == 1
        assert done.stderr.splitlines()[-1] == text
        assert "Traceback" not in done.stderr
