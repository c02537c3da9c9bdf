"""What people say of recorded runs, beside a model: its next training uses it.

``joint_monitor.skops`` has ``joint_monitor.labels.json``: of each run its hash, file and number, the label, who said so
and when. A benign run trains, also if it is unlike the others; an anomalous one does not.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from fame.errors import ConfigError
from fame.monitor.copies import run_hash
from fame.monitor.data_files import LabelledRun, Special, read_labelled_runs
from fame.text import write_file

Said = Mapping[str, Mapping[str, str]]
"""What was said last of a run, by its hash."""
LABELS = ("benign", "anomalous")


def _path(model: str | Path) -> Path:
    return Path(model).with_suffix(".labels.json")


def read_labels(model: str | Path) -> Said:
    """Return what was said of runs. Raises ConfigError for a damaged file."""
    path = _path(model)
    try:
        said = json.loads(path.read_text("utf-8")) if path.exists() else {}
        if wrong := [each for each in said.values() if each["label"] not in LABELS or not each["file"]]:
            raise ValueError(f"got {wrong[0]}")
    except (OSError, ValueError, TypeError, AttributeError, LookupError) as error:
        raise ConfigError(f"is not what fame monitor label writes ({error})", file=str(path)) from None
    return dict(said)


def add_labels(model: str | Path, runs: Sequence[tuple[int, LabelledRun]], label: str, who: str) -> None:
    """Say what runs are, each with its number in its file. Raises ConfigError."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    said = {
        run_hash(run.samples.channels()): {
            "file": str(Path(run.file).resolve()), "run": str(number), "label": label, "who": who, "when": when
        }
        for number, run in runs
    }  # fmt: skip
    write_file(_path(model), json.dumps({**read_labels(model), **said}, indent=1) + "\n")


def labelled_runs(said: Said, columns: Sequence[str], special: Special) -> list[tuple[Mapping[str, str], LabelledRun]]:
    """Return what was said of runs, each with the run, if its file still has it. Raises ConfigError for a lost file."""
    files = sorted({each["file"] for each in said.values()})
    runs = read_labelled_runs(files, columns, special._replace(start=0.0, end=math.inf)) if files else []
    hashes = [run_hash(run.samples.channels()) if len(run.samples) else "" for run in runs]
    first = dict(zip(reversed(hashes), reversed(runs), strict=True))
    return [(each, first[key]) for key, each in said.items() if key in first]


def with_labels(
    runs: Sequence[LabelledRun], said: Said, columns: Sequence[str], special: Special
) -> tuple[list[LabelledRun], list[int]]:
    """Return the runs, those that are anomalous empty, and more that are benign; and the numbers of benign ones.

    Raises ConfigError for a lost file."""
    labels = {key: each["label"] for key, each in said.items()}
    hashes = [run_hash(run.samples.channels()) if len(run.samples) else "" for run in runs]
    more = [run for each, run in labelled_runs(said, columns, special) if each["label"] == LABELS[0]]
    more = [run for run in more if run_hash(run.samples.channels()) not in hashes]
    kept = [_empty(run) if labels.get(key) == LABELS[1] else run for run, key in zip(runs, hashes, strict=True)]
    benign = [at for at, key in enumerate(hashes) if labels.get(key) == LABELS[0]]
    return [*kept, *more], [*benign, *range(len(kept), len(kept) + len(more))]


def _empty(run: LabelledRun) -> LabelledRun:
    return run._replace(samples=run.samples.replace(run.samples.values[:0], run.samples.stamps[:0]))
