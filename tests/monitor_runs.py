"""Runs for tests of monitors, as files: CSV tables and bags of joint states; and what a command says of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fame.cli import main
from fame.monitor.pipeline.processor import Samples

STATE, EMPTY = "sensor_msgs/msg/JointState", "std_msgs/msg/Empty"


def write_runs(path: Path, runs: Sequence[Samples], label: Callable[[int, int], int] | None = None) -> Path:
    """A file of `fame monitor record`; `label` gives that of a run and row."""
    lines = [",".join(("stamp", "run", *runs[0].names, *([] if label is None else ["label"])))]
    for number, run in enumerate(runs):
        for row, (stamp, values) in enumerate(zip(run.stamps.tolist(), run.values.tolist(), strict=True)):
            labels = [] if label is None else [label(number, row)]
            lines.append(",".join(map(repr, (stamp, number, *values, *labels))))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_bag(
    path: Path,
    names: Sequence[Any],
    stamps: np.ndarray,
    values: np.ndarray,
    *,
    arrivals: np.ndarray | None = None,
    field: str = "position",
    storage: Any = None,
    signals: Sequence[int] = (),
) -> Path:
    """Joint states whose `field` holds the values (n, names); `signals` are the rows before which the task starts and
    ends. `names` are of all rows, or a sequence for each; they come at `arrivals` if given, else at their stamps."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = (STATE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time", EMPTY)
    state, header, time, empty = (store.types[name] for name in types)
    with Writer(path, version=9, storage_plugin=storage or StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/joint_states", STATE, typestore=store)
        topics = zip(signals, ("/task_start", "/task_end"), strict=False)
        told = {row: writer.add_connection(topic, EMPTY, typestore=store) for row, topic in topics}
        for number, (stamp, row) in enumerate(zip(stamps, values, strict=True)):
            at, of = round(stamp * 1e9), names if isinstance(names[0], str) else names[number]
            if number in told:
                writer.write(told[number], at - 1, store.serialize_cdr(empty(), EMPTY))
            parts = {"position": np.zeros(0), "velocity": np.zeros(0), "effort": np.zeros(0), field: np.array(row)}
            message = state(header(time(at // 10**9, at % 10**9), ""), list(of), **parts)
            arrived = at if arrivals is None else round(arrivals[number] * 1e9)
            writer.write(connection, arrived, store.serialize_cdr(message, STATE))
    return path


def told(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, Any]:
    """The exit code of a command, and what it says as JSON."""
    code = main([*map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)
