"""examples/mining.py compares a diagram with recordings of its runs: what fits, and what does not."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from recorded_runs import record
from test_log_conversion import ORDERS

from fame.scenario import Scenario

SCRIPT = Path(__file__).parent.parent / "examples" / "mining.py"
pytestmark = pytest.mark.filterwarnings("ignore")  # of pm4py and pandas


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """The program, in a folder with a recording of `ORDERS`."""
    pytest.importorskip("pm4py")
    monkeypatch.chdir(tmp_path)
    Path("orders.bpmn").write_text(ORDERS)
    record(Scenario.load("orders.bpmn", duration=10), Path("run.mcap"))

    def run(model: str, recording: str) -> None:
        monkeypatch.setattr(sys, "argv", ["mining.py", model, recording])
        runpy.run_path(str(SCRIPT), run_name="__main__")

    return run


@pytest.mark.long
def test_what_was_drawn_fits_and_what_was_not_does_not(
    mine: Callable[[str, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    other = ORDERS.replace('sourceRef="s2" targetRef="take"', 'sourceRef="s2" targetRef="close"')
    other = other.replace('sourceRef="close" targetRef="e2"', 'sourceRef="close" targetRef="take"')
    other = other.replace('sourceRef="pack" targetRef="close"', 'sourceRef="pack" targetRef="e2"')
    Path("other.bpmn").write_text(other)  # closes an order before it is packed
    mine("other.bpmn", "run.mcap")
    found = {}  # the fitness of the drawn and of the discovered model, by diagram
    for part in re.split(r"^(?=\S)", capsys.readouterr().out, flags=re.MULTILINE):
        values = re.findall(r"fitness ([\d.]+)", part)
        if len(values) == 2:
            found[part.split(":")[0]] = float(values[0]), float(values[1])
    assert found["Pack_Orders"] == (1.0, 1.0)
    drawn, discovered = found["Order"]
    assert drawn < discovered == 1.0


@pytest.mark.parametrize(
    ("model", "recording", "text"),
    [
        ("none.bpmn", "run.mcap", "none.bpmn: cannot be read: No such file or directory; did you mean 'other.bpmn'?"),
        ("orders.bpmn", "none", "none: cannot be read: No such file or directory"),
        ("orders.bpmn", "orders.bpmn", "orders.bpmn: is not an MCAP file"),
        ("other.bpmn", "run.mcap", "run.mcap: nothing of other.bpmn was executed: expected recordings of this model"),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    mine: Callable[[str, str], None], model: str, recording: str, text: str
) -> None:
    Path("other.bpmn").write_text(ORDERS.replace('id="', 'id="other_').replace('Ref="', 'Ref="other_'))
    with pytest.raises(SystemExit) as ended:
        mine(model, recording)
    assert ended.value.code == text
