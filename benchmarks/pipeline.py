"""What monitoring costs: python benchmarks/pipeline.py [--seconds S] [--pipelines N].

With `--channels N --detector NAME [--frequency HZ]`: what the pipeline, as one node, costs for N channels at HZ by that
detector, which learns from generated runs in a process of its own. `memory` is what the node adds at most, MB, and
`training` the peak of the training.

One JSON line per measurement. `share` is the CPU time per second of data, as a part of one core, of six joints at
500 Hz: through low-pass, an autoencoder per joint, low-pass of the losses, threshold (as four nodes on topics, and as
one); recorded as CSV with 18 columns. Beside the inference stand scikit-learn's and onnxruntime's for the same windows.
`latency` is from the stamp of the sample that raises the alarm to the alarm, in ms of the nodes' clock. All is in one
process with simulated time, which goes as fast as it can; publishing the samples is not counted. Of three rounds the
quickest counts.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor.pipeline.configuration import Configuration, Port, Stage, load
from fame.monitor.pipeline.detectors import ChannelAutoencoders
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.recording import RecordingNode
from fame.monitor.pipeline.train import Training, learned
from fame.monitor.pipeline.trained_model import TrainedModel

RATE, JOINTS = 500, tuple(f"joint_{number}" for number in range(6))
JOINT_STATE = "sensor_msgs/msg/JointState"
MONITOR = Path(__file__).resolve().parent.parent / "models" / "monitoring" / "joint_monitor"
UNITS = ("low_pass", "autoencoders", "loss_low_pass", "threshold")
RUNS, NEVER = 5, 1e9
"""Runs that train a detector of many channels, and a threshold that no loss exceeds."""


def samples(seconds: float, push: float = 0.0) -> list[Any]:
    """Joint states; from the middle on somebody pushes joint 3."""
    random = np.random.default_rng(0)
    stamps = np.arange(1, round(seconds * RATE) + 1) / RATE
    efforts = 0.1 * random.standard_normal((len(stamps), 6))
    efforts[len(stamps) // 2 :, 3] += push
    return [
        messages.create(
            JOINT_STATE,
            {"header": {"stamp": stamp}, "name": JOINTS, "position": row, "velocity": row, "effort": row},
        )
        for stamp, row in zip(stamps.tolist(), efforts, strict=True)
    ]


def estimators() -> list[Any]:
    """One perceptron per joint, hardly trained: only its speed is of interest."""
    from sklearn.neural_network import MLPRegressor

    data = np.random.default_rng(1).standard_normal((300, 50))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [
            MLPRegressor(hidden_layer_sizes=(16, 4, 16), activation="tanh", max_iter=1, random_state=seed).fit(
                data, data
            )
            for seed in range(6)
        ]


Build = Callable[[LocalMiddleware, Scheduler], list[Any]]


def drive(sent: list[Any], build: Build, rate: float = RATE) -> tuple[float, list[float]]:
    """CPU seconds for all of the samples, and the latency (ms) of each alarm."""
    return min((once(sent, build, rate) for _ in range(3)), key=lambda found: found[0])


def once(sent: list[Any], build: Build, rate: float) -> tuple[float, list[float]]:
    """One round."""
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    arm = middleware.node("arm")
    publisher = arm.publisher("joint_states", JOINT_STATE)
    latencies: list[float] = []

    def alarmed(message: Any) -> None:
        stamp = message.header.stamp
        latencies.append(1e-6 * (scheduler.now - stamp.sec * SECOND - stamp.nanosec))

    arm.subscription("/anomaly", JOINT_STATE, alarmed)
    nodes = build(middleware, scheduler)
    begun = time.process_time()
    for number, message in enumerate(sent, start=1):
        scheduler.run(round(number * SECOND / rate))
        publisher.publish(message)
    scheduler.run(scheduler.now + SECOND // 5)
    taken = time.process_time() - begun
    for node in nodes:
        node.close()
    return taken, latencies


def with_model(stage: Stage, model: str) -> Stage:
    """The same with another model, if it has one."""
    given = {"model": model} if "model" in stage.parameters else {}
    return replace(stage, parameters={**stage.parameters, **given})


def units(model: Path) -> list[Configuration]:
    """The joint monitor as it comes, with a model."""
    found = []
    for name in UNITS:
        unit = load(MONITOR / f"{name}.yaml")
        stages = tuple(
            replace(stage, parameters={**stage.parameters, "model": str(model)})
            if "model" in stage.parameters
            else stage
            for stage in unit.stages
        )
        found.append(replace(unit, stages=stages))
    return found


def as_one(model: Path) -> Configuration:
    """The same in one node."""
    parts = units(model)
    stages: tuple[Stage, ...] = sum((part.stages for part in parts), ())
    outputs: tuple[Port, ...] = parts[-1].outputs
    return replace(parts[0], name="monitor", stages=stages, outputs=outputs)


def inference(model: TrainedModel, made: list[Any], folder: Path) -> dict[str, float]:
    """Microseconds for the windows of one call (2 windows of 6 joints): ours, scikit-learn's, onnxruntime's."""
    import onnxruntime

    windows = np.random.default_rng(2).standard_normal((2, 50, 6))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    model.save(folder / "model.onnx")
    session = onnxruntime.InferenceSession(str(folder / "model.onnx"), options, providers=["CPUExecutionProvider"])

    def scikit() -> None:
        for channel, estimator in enumerate(made):
            rows = windows[:, :, channel]
            ((estimator.predict(rows) - rows) ** 2).mean(axis=1)

    ways = {
        "numpy": lambda: model.loss(windows),
        "scikit_learn": scikit,
        "onnxruntime": lambda: session.run(None, {"windows": windows}),
    }
    taken = {}
    for name, way in ways.items():
        times = []
        for _ in range(300):
            begun = time.perf_counter()
            way()
            times.append(time.perf_counter() - begun)
        taken[name] = round(1e6 * float(np.median(times)), 1)
    return taken


def course(seed: int, columns: Sequence[str], rate: float, seconds: float) -> Samples:
    """A run of channels that repeat, with noise."""
    random, stamps = np.random.default_rng(seed), np.arange(1, round(seconds * rate) + 1) / rate
    waves = np.sin(2 * np.pi * stamps[:, None] * (0.2 + 0.02 * np.arange(len(columns))))
    return Samples(waves + 0.1 * random.standard_normal(waves.shape), stamps, tuple(columns))


def made_of_many(columns: Sequence[str], detector: str, rate: float, seconds: float, path: Path) -> None:
    """Train a detector and store it; autoencoders hardly learn, since only their speed is of interest."""
    config = Training(detector=detector, before=20.0, cutoff=5.0, samples=4000, epochs=1)
    runs = [course(seed, columns, rate, seconds) for seed in range(RUNS)]
    model = learned(runs, config, rate)
    replace(model, thresholds=(NEVER,) * len(columns)).save(path)


def many_channels(count: int, detector: str, rate: float, seconds: float) -> dict[str, Any]:
    """Share of a core and memory (MB) of the pipeline as one node. Raises ConfigError for a detector that refuses."""
    joints = tuple(f"joint_{number}" for number in range(count))
    columns = [f"Efforts.{joint}" for joint in joints]
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "model.skops"
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
            other.submit(made_of_many, columns, detector, rate, seconds, path).result()
        new = course(RUNS, columns, rate, seconds)
        sent = [
            messages.create(JOINT_STATE, {"header": {"stamp": stamp}, "name": joints, "effort": row})
            for stamp, row in zip(new.stamps.tolist(), new.values, strict=True)
        ]
        configuration = as_one(path)
        (port,) = configuration.inputs
        configuration = replace(configuration, inputs=(replace(port, rate=rate),))
        gc.freeze()
        idle, _ = drive(sent, lambda middleware, scheduler: [], rate)
        before = peak(resource.RUSAGE_SELF)
        taken, _ = drive(
            sent, lambda middleware, scheduler: [ProcessingNode(middleware, scheduler, configuration)], rate
        )
        memory = peak(resource.RUSAGE_SELF) - before
    return {
        "what": f"{count} channels at {rate:g} Hz, {detector}", "share": round((taken - idle) / seconds, 4),
        "memory": round(memory), "training": round(peak(resource.RUSAGE_CHILDREN)),
    }  # fmt: skip


def peak(of: int) -> float:
    """The peak of the memory of this process, or of those that it has started, MB."""
    return resource.getrusage(of).ru_maxrss / 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--pipelines", type=int, default=50)
    parser.add_argument("--channels", type=int, metavar="N", help="channels of one node, instead of all else")
    parser.add_argument("--detector", default="phase", metavar="NAME")
    parser.add_argument("--frequency", type=float, default=float(RATE), metavar="HZ", help="samples per second")
    arguments = parser.parse_args()
    if arguments.channels:
        try:
            found = many_channels(arguments.channels, arguments.detector, arguments.frequency, arguments.seconds)
        except ConfigError as error:
            sys.exit(str(error))
        print(json.dumps(found), flush=True)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = estimators()
        columns = tuple(f"Efforts.{joint}" for joint in JOINTS)
        model = TrainedModel(
            columns, 50, RATE, np.zeros(6), np.ones(6), ChannelAutoencoders.of(made), (1.0,) * 6, 5.0, 20.0
        )
        model.save(path := folder / "model.skops")
        seconds, sent = arguments.seconds, samples(arguments.seconds, push=5.0)
        gc.freeze()  # the samples are no garbage, and not part of what is measured
        idle, _ = drive(sent, lambda middleware, scheduler: [])

        def tell(what: str, taken: float, **more: Any) -> None:
            print(json.dumps({"what": what, "share": round((taken - idle) / seconds, 4), **more}), flush=True)

        def many(configurations: list[Configuration]) -> Build:
            return lambda middleware, scheduler: [
                ProcessingNode(middleware, scheduler, each) for each in configurations
            ]

        taken, latencies = drive(sent, many(units(path)))
        tell("pipeline of four nodes", taken, latency=latencies)
        taken, latencies = drive(sent, many([as_one(path)]))
        tell("the same in one node", taken, latency=latencies)
        several = [replace(as_one(path), name=f"monitor_{number}") for number in range(arguments.pipelines)]
        taken, latencies = drive(sent, many(several))
        tell(f"{arguments.pipelines} pipelines", taken, latency=[min(latencies), max(latencies)])
        print(json.dumps({"what": "two windows of six joints, us", **inference(model, made, folder)}), flush=True)

        def recorder(middleware: LocalMiddleware, scheduler: Scheduler) -> list[Any]:
            (efforts,) = units(path)[0].inputs
            ports = tuple(
                replace(efforts, name=field.capitalize(), path=(field,)) for field in ("position", "velocity", "effort")
            )
            configuration = replace(units(path)[0], inputs=ports)
            (folder / "runs.csv").unlink(missing_ok=True)
            return [RecordingNode(middleware, scheduler, configuration, [folder / "runs.csv"])]

        taken, _ = drive(sent, recorder)
        rows = (folder / "runs.csv").read_text().splitlines()
        tell("recording 500 Hz x 18 columns", taken, rows=len(rows) - 1, columns=len(rows[0].split(",")) - 2)


if __name__ == "__main__":
    main()
