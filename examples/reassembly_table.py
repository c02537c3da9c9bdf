"""The losses of a reassembly, free and obstructed, beside the published ones: python examples/reassembly_table.py.

Free reference runs train one autoencoder per joint; cross-validated losses of all of them set the thresholds, which
promise a rate of false alarms. Network, cut-offs and rate were fixed before any obstructed run existed. Then come runs
with other seeds: free ones, some with a blocked shoulder, some with a blocked lid. Printed are the largest (and mean)
loss of joints 5, 4 and 0, averaged over the runs of a scenario, and how many runs raise an alarm: with one threshold
for all joints, the largest of them, and with one per joint. With ``--model FILE.skops`` the model is stored there;
`models/reassembly.skops`, which the mission of `reassembly.yaml` uses, was made so.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fame.errors import FameError
from fame.monitor import LowPass, Samples
from fame.monitor.arrays import Floats
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.train import Training, fit, losses
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.pipeline.training_checks import warnings_of
from robots.arm.dynamics import UR5E
from robots.arm.reassembly import SCENARIOS, Disturbance, recorded

MODEL = Path(__file__).resolve().parent.parent / "models" / "reassembly.skops"
TRAINING = Training(detector="autoencoder", before=20.0, cutoff=5.0, false_alarms="0.01 per run", margin=1.5)
"""As `fame monitor train` has it by default, but for the margin; the cut-offs are those of the joint monitor."""
COLUMNS = tuple(f"Efforts.{joint}" for joint in UR5E.chain.joints)
JOINTS = (5, 4, 0)
PUBLISHED = {
    "none": (0.36, 0.05, 0.31, 0.06, 0.17, 0.06),
    "blocked_shoulder": (0.38, 0.06, 0.34, 0.07, 0.33, 0.08),
    "blocked_lid": (1.52, 0.10, 1.48, 0.11, 0.16, 0.05),
}
REFERENCE, TEST = 1, 5001
"""The first seed of the runs that train, and of those that test."""


class Losses(NamedTuple):
    """Of the runs of a scenario: the largest and the mean loss (runs, joints)."""

    largest: Floats
    mean: Floats


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=120, metavar="N", help="runs that train and set thresholds")
    parser.add_argument("--free", type=int, default=60, metavar="N", help="free runs that test")
    parser.add_argument("--obstructed", type=int, default=30, metavar="N", help="runs of each obstruction that test")
    parser.add_argument("--seed", type=int, default=TEST, metavar="N", help="of the first run that tests")
    parser.add_argument("--model", type=Path, metavar="FILE.skops", help="store the model (default: do not)")
    arguments = parser.parse_args()
    reference = [samples(seed) for seed in progress("reference", range(REFERENCE, REFERENCE + arguments.reference))]
    model = fit(reference, TRAINING, report=lambda text: print(text, file=sys.stderr))
    for text in warnings_of(model):
        print(f"warning: {text}", file=sys.stderr)
    if arguments.model is not None:
        model.save(arguments.model)
    counts = {"none": arguments.free, "blocked_shoulder": arguments.obstructed, "blocked_lid": arguments.obstructed}
    found, seed = {}, arguments.seed
    for scenario in SCENARIOS:
        found[scenario] = judged(model, scenario, range(seed, seed + counts[scenario]))
        seed += counts[scenario]
    tell(model, found)


def progress(name: str, seeds: range) -> Iterator[int]:
    """Yield seeds, and tell how many runs are simulated."""
    for number, seed in enumerate(seeds):
        if number % 20 == 0:
            print(f"{name}: {number} of {len(seeds)} runs", file=sys.stderr)
        yield seed


def samples(seed: int, scenario: Disturbance = "none") -> Samples:
    """The efforts of one run, named as the joint monitor names them."""
    run = recorded(seed, scenario)
    return Samples(run.efforts, run.stamps, COLUMNS)


def judged(model: TrainedModel, scenario: Disturbance, seeds: range) -> Losses:
    """What the pipeline makes of runs with these seeds."""
    every = []
    for seed in progress(scenario, seeds):
        filtered = processors.run([LowPass(cutoff=model.before)], {"x": samples(seed, scenario)})["x"]
        every.append(losses(model, filtered, TRAINING.stride).values)
    return Losses(np.array([run.max(axis=0) for run in every]), np.array([run.mean(axis=0) for run in every]))


def tell(model: TrainedModel, found: dict[Disturbance, Losses]) -> None:
    thresholds = np.array(model.thresholds)
    free = found["none"].largest.mean(axis=0)
    print(f"{'maximum (mean) loss':22}" + "".join(f"{f'joint {joint}':>22}" for joint in JOINTS))
    for scenario, (largest, mean) in found.items():
        ours = [f"{largest[:, joint].mean():.3f} ({mean[:, joint].mean():.3f})" for joint in JOINTS]
        times = [f"x {largest[:, joint].mean() / free[joint]:.2f}" for joint in JOINTS]
        said, of_none = PUBLISHED[scenario], PUBLISHED["none"]
        print(f"{scenario:22}" + "".join(f"{text:>22}" for text in ours))
        print(f"{'  times free':22}" + "".join(f"{text:>22}" for text in times))
        print(f"{'  published':22}" + "".join(f"{f'{said[2 * n]:.2f} ({said[2 * n + 1]:.2f})':>22}" for n in range(3)))
        print(
            f"{'  published, times':22}" + "".join(f"{f'x {said[2 * n] / of_none[2 * n]:.2f}':>22}" for n in range(3))
        )
    print("\nthresholds of joints 5, 4, 0: " + ", ".join(f"{thresholds[joint]:.3f}" for joint in JOINTS))
    print(f"one for all: {thresholds.max():.3f}\n\nruns with an alarm      one for all   per joint")
    for scenario, (largest, _) in found.items():
        common, own = ((largest > limit).any(axis=1).sum() for limit in (thresholds.max(), thresholds))
        print(f"{scenario:22}{f'{common} of {len(largest)}':>13}{f'{own} of {len(largest)}':>12}")
        seen = (largest > thresholds).sum(axis=0)
        print(f"{'  by joint 0 to 5':22}{'':13}{', '.join(map(str, seen)):>12}")


if __name__ == "__main__":
    try:
        main()
    except FameError as error:
        print(f"{Path(__file__).name}: error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
