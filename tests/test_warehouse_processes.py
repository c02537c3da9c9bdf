"""The warehouse between processes: bids, doors, parcels and Nav2's actions over DDS and over Zenoh."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from domains import PROCESSES
from middleware_contract import needs

ROOT = Path(__file__).parents[1]
SPEED = "4"

pytestmark = pytest.mark.processes


def smaller(folder: Path) -> Path:
    """The example with two carriers, and one parcel, for a station that can be reached."""
    scenario: dict[str, Any] = yaml.safe_load((ROOT / "examples" / "warehouse.yaml").read_text())
    world = scenario["world"]
    world["parcels"] = [parcel for parcel in world["parcels"] if parcel["name"] == "parcel_4"]
    del world["robots"]["Carrier_2"]
    scenario["properties"] = {"charge": scenario["properties"]["charge"]}
    scenario["model"] = str(ROOT / "models" / "warehouse.bpmn")
    path = folder / "warehouse.yaml"
    path.write_text(json.dumps(scenario))
    return path


@pytest.mark.parametrize(
    "middleware",
    [
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
    ],
)
def test_carriers_bid_and_deliver_a_parcel(middleware: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fame", "run", str(smaller(tmp_path)), "--middleware", middleware]
    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [*command, "--speed", SPEED, "--json"],
        env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    said = json.loads(done.stdout)
    assert (done.returncode, said["status"]) == (0, "completed"), done
    stations = {name: parcel["station"] for name, parcel in said["world"]["parcels"].items()}
    assert stations == {"parcel_4": "packing_1"}
    assert [one["verdict"] for one in said["properties"]] == ["holds"]
