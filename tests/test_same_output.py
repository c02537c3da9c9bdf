"""The same input gives the same output, whatever the order in which Python's hashes put the items of sets."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCENARIO = """
model: {model}
world:
  size: [9, 6]
  robots:
    Car_1: {{type: car, at: [2.2, 1]}}
    Car_2: {{type: car, at: [2.1, 2]}}
    Car_3: {{type: car, at: [2.0, 3]}}
seed: 1
duration: 8
properties:
  lined_up: never Car starts "Set Off" before Car completes "To the Line"
  apart: always distance(any two Car) > 0.5
"""
CHILD = """
from contextlib import redirect_stdout
from fame.cli import main
for name, *words in (
    ("run", "run", "convoy.yaml", "--log", "run.mcap", "--quiet"),
    ("steps", "log", "convert", "run.mcap", "-o", "run.xes", "--level", "all"),
    ("objects", "log", "convert", "run.mcap", "-o", "run.ocel.json"),
    ("judged", "log", "judge", "convoy.yaml", "run.mcap", "--json"),
    ("checked", "check", "convoy.yaml", "--json"),
    ("split", "split", "model.bpmn", "-o", "split", "--json"),
    ("explored", "check", "--explore", "shuttle.bpmn"),
):
    with open(name + ".txt", "w") as file, redirect_stdout(file):
        print(main(words))
"""


@pytest.mark.long
def test_the_seed_of_hashes_is_not_seen(tmp_path: Path) -> None:
    written = []
    for seed in "12":
        folder = tmp_path / seed
        folder.mkdir()
        for name, path in (("model", "convoy"), ("shuttle", "shuttle")):
            (folder / f"{name}.bpmn").write_bytes((ROOT / f"models/{path}.bpmn").read_bytes())
        (folder / "convoy.yaml").write_text(SCENARIO.format(model="model.bpmn"))
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", CHILD], cwd=folder, env=environment, check=True)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        written.append({str(path.relative_to(folder)): path.read_bytes() for path in files})
    one, other = written
    assert one.keys() == other.keys()
    assert {"run.mcap", "run.xes", "run.ocel.json", "split/Car.bpmn"} <= one.keys()
    assert [name for name in one if timeless(one[name]) != timeless(other[name])] == []


def timeless(content: bytes) -> bytes:
    """What is written, without how long an exploration took."""
    return re.sub(rb" states in [\d.]+ s", b"", content)
