"""Draw the pictures of docs/layout_results.md: shipped models, laid out as if they had no diagram.

python docs/layouts.py; tests/test_layout.py compares.
"""

from pathlib import Path

from fame.bpmn import read
from fame.bpmn.draw.diagram import draw
from fame.layout import lay_out

ROOT = Path(__file__).parent.parent
PICTURES = {
    "agriculture": "models/agriculture.bpmn",
    "auction": "examples/cookbook/auction/mission.bpmn",
    "compensation": "examples/cookbook/compensation/mission.bpmn",
    "convoy": "models/convoy.bpmn",
    "exclusive_zone": "examples/cookbook/exclusive_zone/mission.bpmn",
    "explore": "models/library/Explore.bpmn",
    "go_to": "models/library/GoTo.bpmn",
    "orders": "examples/cookbook/orders/mission.bpmn",
    "reassembly": "models/reassembly.bpmn",
    "sabotage": "models/sabotage.bpmn",
    "shuttle": "models/shuttle.bpmn",
    "warehouse": "models/warehouse.bpmn",
}
"""Name -> model."""


def picture(name: str) -> str:
    """Return the picture of that name as SVG."""
    return draw(lay_out(read(ROOT / PICTURES[name]), again=True))


if __name__ == "__main__":
    for name in PICTURES:
        (ROOT / "docs" / "images" / f"layout_{name}.svg").write_text(picture(name), encoding="utf-8")
