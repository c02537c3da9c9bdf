"""Phases of a mission that waits: an arm whose runs differ in how long it waits, judged by time and by element.

The reassembly of `examples/reassembly.yaml` without its monitor; the jaws rest for a random time after each of their
movements. `phase` learns from the same 19 undisturbed runs, once with only their times and once with the element of
the mission that was active, at 0.05 false alarms per run; then other seeds, undisturbed and obstructed, are judged.
``python -m benchmarks.waiting_arm`` (4 minutes).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from lxml import etree

from benchmarks.shares import told
from fame.bpmn.reader.xml import BPMN
from fame.log import logging_to
from fame.monitor.data_files import LabelledRun, read_labelled_runs
from fame.monitor.judge import judge_trained
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.recording import RecordingOptions, record_bag
from fame.monitor.pipeline.train import Training, fit
from fame.scenario import Fault, Scenario

ROOT = Path(__file__).resolve().parent.parent
INPUTS = ROOT / "models" / "monitoring" / "joint_monitor" / "low_pass.yaml"
FAULTS = {"undisturbed": (), "blocked_shoulder": (Fault("Arm", 7, "blocked_shoulder"),),
          "blocked_lid": (Fault("Arm", 1, "blocked_lid"),)}  # fmt: skip
TRAIN = range(1, 20)
JUDGED = {"undisturbed": range(101, 121), "blocked_shoulder": range(201, 209), "blocked_lid": range(301, 309)}
WAIT = "import random\n{}\npause = f'PT{{random.uniform(0.4, 3):.2f}}S'"


def waiting(folder: Path) -> Path:
    """Write the mission whose arm waits; the path of its scenario."""
    root = etree.parse(ROOT / "models" / "reassembly.bpmn").getroot()
    process = next(each for each in root.iter(f"{{{BPMN}}}process") if each.get("name") == "Watch the joints")
    (pool,) = (each for each in root.iter(f"{{{BPMN}}}participant") if each.get("processRef") == process.get("id"))
    gone = {each.get("id") for each in (*process.iter(), pool)} - {None}
    shapes = [each for each in root.iter() if each.get("bpmnElement") in gone]
    for each in (process, pool, *shapes):
        each.getparent().remove(each)
    for script in root.iter(f"{{{BPMN}}}script"):
        if "steps.pop" in script.text:
            script.text = WAIT.format(script.text)
    for duration in root.iter(f"{{{BPMN}}}timeDuration"):
        if duration.text == "PT0.4S":
            duration.text = "${pause}"
    (folder / "waiting.bpmn").write_bytes(etree.tostring(root))
    text = (ROOT / "examples" / "reassembly.yaml").read_text().partition("properties:")[0]
    text = text.replace("../models/reassembly.bpmn", "waiting.bpmn").replace("computers: [Monitor]\n", "")
    (folder / "waiting.yaml").write_text(text)
    return folder / "waiting.yaml"


def run(scenario: Path, seed: int, kind: str) -> LabelledRun:
    """One run: the efforts of the joints, and which element was active."""
    print(f"{kind}: seed {seed}", file=sys.stderr)
    mission = Scenario.load(scenario, seed=seed, faults=FAULTS[kind])
    recording, csv = (scenario.with_name(f"{seed}{ending}") for ending in (".mcap", ".csv"))
    with logging_to(recording, mission.closures(), topics="all") as log:
        mission.run(observer=log)
    record_bag(recording, load(INPUTS), [csv], RecordingOptions(namespace="Arm", elements=True))
    (found,) = read_labelled_runs([csv])
    recording.unlink()
    csv.unlink()
    return found


def main() -> None:
    config = Training(detector="phase", before=20.0, stride=10, false_alarms="0.05 per run", folds=len(TRAIN))
    with TemporaryDirectory(prefix="fame-waiting-") as folder:
        scenario = waiting(Path(folder))
        train = [run(scenario, seed, "undisturbed").samples for seed in TRAIN]
        judged = {kind: [run(scenario, seed, kind) for seed in seeds] for kind, seeds in JUDGED.items()}
    print(f"| phases | {' | '.join(judged)} |\n|{' --- |' * (len(judged) + 1)}")
    for name in ("time since the start", "element of the mission"):
        by_time = name.startswith("time")
        model = fit([replace(each, elements=()) for each in train] if by_time else train, config)
        assert bool(model.elements) != by_time
        found = {kind: judge_trained(model, runs, name).runs for kind, runs in judged.items()}
        alarms = [told((sum(each.verdict == "anomalous" for each in runs), len(runs))) for runs in found.values()]
        print(f"| {name} | {' | '.join(alarms)} |", flush=True)


if __name__ == "__main__":
    main()
