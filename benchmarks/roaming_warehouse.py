"""The warehouse between three machines whose links come and go, over Zenoh with a router on each: does it complete?

Network namespaces on a switch: one with the world and the dispatcher, two with the carriers' engines. The link of one
of them after the other is taken down by ``ip link set`` for up to `LONGEST_GAP` s, at moments that the seed draws. All
signals of the model are sent with ``delivery=acknowledged``, and what it says of time fits that (`OFTEN_LATE`). One
JSON line per run, then how many completed. Run as ``python -m benchmarks.roaming_warehouse [RUNS [FIRST_SEED]]`` (root;
it makes the namespaces itself).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from lxml import etree

from fame.bpmn.reader.xml import BPMN, CAMUNDA
from tests.networked_machines import ADDRESSES, Machines, machines

ROOT = Path(__file__).resolve().parent.parent
SPEED, PATIENCE = 1.0, 900.0
"""Simulated seconds per second; s of a run, at most."""
LONGEST_GAP, LONGEST_PEACE = 4.0, 8.0
"""s for which a link is down, and then up."""
LEASE = "40"
"""FAME_LEASE (s): ten times the longest gap, so that connections outlive gaps (docs/network.md)."""
ENGINES = {0: ["Dispatcher"], 1: ["Carrier_1", "Carrier_2"], 2: ["Carrier_3"]}
ZENOH = ["--middleware", "zenoh", "--router", "127.0.0.1"]


OFTEN_LATE = {
    "{header: {frame_id: ${name}}, point: {x: ${cost}}}": (
        "{header: {frame_id: '${name} ${parcel}'}, point: {x: ${cost}}}"
    ),
    "bids[bid.header.frame_id] = bid.point.x": (
        "bidder, wanted = bid.header.frame_id.split()\nif wanted == parcel:\n    bids[bidder] = bid.point.x"
    ),
    "${winner}": "${winner} ${parcel}",
    "parcel_awarded == name": "parcel_awarded == f'{name} {parcel}'",
    "PT2S": "PT60S",
    "PT3S": "PT20S",
}
"""What the model says where signals come at once, and where they may take as long as a gap and TCP's repetitions: bids
and awards name their parcel, and robots wait for longer."""


def roaming(source: Path, target: Path) -> None:
    """Write a model that fits signals which come late, and whose thrown signals are all acknowledged."""
    tree = etree.parse(source)
    changed = set()
    for element in tree.iter(f"{{{BPMN}}}script", f"{{{BPMN}}}timeDuration", f"{{{BPMN}}}conditionExpression"):
        if element.text in OFTEN_LATE:
            changed.add(element.text)
            element.text = OFTEN_LATE[element.text]
    for element in tree.iter(f"{{{CAMUNDA}}}property"):
        if element.get("name") == "payload" and element.get("value") in OFTEN_LATE:
            changed.add(element.get("value"))
            element.set("value", OFTEN_LATE[element.get("value")])
    assert changed == OFTEN_LATE.keys()
    thrown = f".//{{{BPMN}}}signalEventDefinition"
    for kind in ("intermediateThrowEvent", "endEvent"):
        for event in tree.iter(f"{{{BPMN}}}{kind}"):
            if event.find(thrown) is not None:
                properties = event.find(f".//{{{CAMUNDA}}}properties")
                assert properties is not None
                etree.SubElement(properties, f"{{{CAMUNDA}}}property", name="delivery", value="acknowledged")
    tree.write(target, encoding="utf-8", xml_declaration=True)


class Team:
    """Everything that runs on the machines."""

    def __init__(self, place: Machines, folder: Path) -> None:
        self.place, self.folder = place, folder
        self.processes: list[subprocess.Popen[str]] = []

    def start(self, machine: int, *words: str, name: str, ready: str) -> subprocess.Popen[str]:
        """Start a command of FAME, and wait until it says that it is ready."""
        path = self.folder / f"{name}.txt"
        with path.open("w") as log:
            command = self.place.inside(machine, sys.executable, "-m", "fame", *words)
            made = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
                cwd=ROOT,
                env=os.environ | {"FAME_LEASE": LEASE},
            )
        self.processes.append(made)
        until = time.monotonic() + 60
        while ready not in path.read_text() and made.poll() is None and time.monotonic() < until:
            time.sleep(0.05)
        return made

    def end(self) -> None:
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def run(seed: int, folder: Path) -> dict[str, Any]:
    """One run: whether the mission ended on all robots, how long it took (s) and how often a link was down."""
    random, downs, result = Random(f"roaming {seed}"), 0, "not over"
    roaming(ROOT / "models" / "warehouse.bpmn", folder / "warehouse.bpmn")
    with machines(3) as place:
        team = Team(place, folder)
        try:
            for machine, address in enumerate(ADDRESSES):
                others = ["--connect", ADDRESSES[0]] if machine else []
                words = ("router", "--network", address, *others)
                team.start(machine, *words, name=f"router{machine}", ready="Ctrl-C")
            world = ("world", "examples/warehouse.yaml", "--seed", str(seed), "--speed", f"{SPEED:g}", *ZENOH)
            team.start(0, *world, name="world", ready="Ctrl-C")
            for machine, names in ENGINES.items():
                types = ("--type", "carrier") if machine else ()
                words = ("engine", *names, *types, "--use-sim-time", "--insecure", *ZENOH)
                team.start(machine, *words, name=f"engine{machine}", ready="waits for its process")
            sent = team.start(0, "deploy", str(folder / "warehouse.bpmn"), "--until-ended", *ZENOH, name="deploy",
                              ready="started")  # fmt: skip
            begun = time.monotonic()
            while sent.poll() is None and time.monotonic() < begun + PATIENCE:
                _wait(sent, random.uniform(1, LONGEST_PEACE))
                number = random.randrange(1, 3)
                if sent.poll() is None:
                    downs += 1
                    place.set("down", number)
                    _wait(sent, random.uniform(0.5, LONGEST_GAP))
                    place.set("up", number)
            took = time.monotonic() - begun
            result = "not over" if sent.poll() is None else "completed" if sent.returncode == 0 else "failed"
        finally:
            team.end()
    return {"seed": seed, "result": result, "took_s": round(took), "downs": downs}


def _wait(process: subprocess.Popen[str], seconds: float) -> None:
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return


def main(runs: int = 20, first: int = 1) -> int:
    """Print each run; exit code 1 unless all completed."""
    completed = 0
    for seed in range(first, first + runs):
        with TemporaryDirectory(prefix="fame-roaming-") as folder:
            found = run(seed, Path(folder))
        completed += found["result"] == "completed"
        print(json.dumps(found), flush=True)
    print(json.dumps({"completed": completed, "of": runs}))
    return int(completed < runs)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
