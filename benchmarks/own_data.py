"""A detector for a new user's data, chosen by the rule of ``--compare``: python benchmarks/own_data.py.

The data are those of tests/own_data.py: 12 channels, 16 undisturbed runs. All settings but the detector are the
defaults of training. The detector is chosen on these runs and on faults that `--compare` puts into them; the
faults of tests/own_data.py are not among these. The chosen one is then judged on other seeds, which nothing was chosen
by: undisturbed runs, and runs with each of the four faults.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import own_data

from fame.intervals import interval
from fame.monitor.pipeline.compare import compare
from fame.monitor.pipeline.train import Training, fit, losses
from fame.monitor.pipeline.trained_model import TrainedModel

TRAIN = range(16)
SEEDS = ((range(60_000, 60_200), range(61_000, 61_050)), (range(80_000, 80_200), range(81_000, 81_050)))
"""Of undisturbed runs and of those with each fault."""
JUDGED = "mahalanobis"
"""The detector of the table in docs/detector_comparison.md, beside the chosen one."""


def main() -> None:
    runs = [own_data.run(seed) for seed in TRAIN]
    found = compare(runs, Training(), report=lambda text: print(text, file=sys.stderr))
    print("detector            false alarms  faults found  median latency  us per sample")
    for item, _ in found:
        latency = "-" if item.latency is None else f"{item.latency:.2f} s"
        print(
            f"{item.detector:18}  {item.false_alarms:5} of {item.runs}  {sum(item.kinds.values()):4} of {item.faults}",
            end="",
        )
        print(f"  {latency:>14}  {item.cost:8.1f}")
    for detector in dict.fromkeys((JUDGED, found[0][0].detector)):
        for asked in ("0.01 per run", "0.06 per run"):
            model = fit(runs, replace(Training(), detector=detector, false_alarms=asked))
            assert model.calibration is not None
            print(f"\n{detector}, {model.calibration.text}")
            for undisturbed, faulty in SEEDS:
                print(f"undisturbed runs {undisturbed}: {told([alarm(model, seed) for seed in undisturbed])}")
                for fault in own_data.FAULTS:
                    print(f"{fault}, {faulty}: {told([alarm(model, seed, fault) for seed in faulty])}")


def alarm(model: TrainedModel, seed: int, fault: own_data.Fault = "none") -> bool:
    """Whether a run raises an alarm; of a fault, from its onset on."""
    found = losses(model, own_data.run(seed, fault), Training().stride)
    above = (found.values > np.array(model.thresholds)).any(axis=1)
    return bool(above[found.stamps >= (0 if fault == "none" else own_data.ONSET)].any())


def told(alarms: list[bool]) -> str:
    """A count, with the 95 % interval of its rate."""
    low, high = interval(sum(alarms), len(alarms))
    return f"alarm in {sum(alarms)} of {len(alarms)} (95 %: {low:.3f} to {high:.3f})"


if __name__ == "__main__":
    main()
