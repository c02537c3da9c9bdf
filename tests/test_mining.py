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
