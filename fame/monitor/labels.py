"""What people say of recorded runs, beside a model: its next training uses it.

``joint_monitor.skops`` has ``joint_monitor.labels.json``: of each run its hash, file and number, the label, who said so
and when. A benign run trains, also if it is unlike the others; an anomalous one does not. Of bags, the tables of what
the model reads are kept in the folder ``joint_monitor.labels``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.monitor.copies import run_hash
from fame.monitor.data_files import LabelledRun, Special, is_bag, read_labelled_runs
from fame.text import read_json, write_file

Said = Mapping[str, Mapping[str, str]]
"""What was said last of a run, by its hash."""
LABELS = ("benign", "anomalous")
_KEYS = ("file", "run", "label", "who", "when")


def _path(model: str | Path) -> Path:
    return Path(model).with_suffix(".labels.json")


def table_beside(model: str | Path, file: str | Path) -> Path:
    """Return the table of a file of runs: of a bag one that belongs to a model, under a name of its own."""
    if not is_bag(Path(file)):
        return Path(file)
    digest = sha256(str(Path(file).resolve()).encode()).hexdigest()[:8]
    return Path(model).with_suffix(".labels") / f"{Path(file).stem}-{digest}.csv"


def read_labels(model: str | Path) -> Said:
    """Return what was said of runs. Raises ConfigError for a damaged file."""
    path = _path(model)
    try:
        said = read_json(path.read_text("utf-8"), longest=100_000_000) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise ConfigError(f"is not what fame monitor label writes: {error}", file=str(path)) from None
    wrong = [each for each in said.values() if not _is_said(each)] if isinstance(said, dict) else [said]
    if wrong:
        wanted = f"the hash of each run with texts as {', '.join(_KEYS)}, the label one of {', '.join(LABELS)}"
        text = f"is not what fame monitor label writes: expected {wanted}, got {json.dumps(wrong[0])[:80]}"
        raise ConfigError(text, file=str(path))
    return dict(said)


def _is_said(each: Any) -> bool:
    texts = isinstance(each, dict) and all(isinstance(each.get(key), str) for key in _KEYS)
    return texts and each["label"] in LABELS and bool(each["file"]) and each["run"].isdecimal()


def add_labels(model: str | Path, runs: Sequence[tuple[int, LabelledRun]], label: str, who: str) -> None:
    """Say what runs are, each with its number in its file. Raises ConfigError."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    said = {
        run_hash(run.samples.channels()): {
            "file": str(Path(run.file).resolve()), "run": str(number), "label": label, "who": who, "when": when
        }
        for number, run in runs
    }  # fmt: skip
    anew = {(each["file"], each["run"]) for each in said.values()}
    before = {key: each for key, each in read_labels(model).items() if (each["file"], each["run"]) not in anew}
    _write(model, {**before, **said})


def remove_labels(model: str | Path, runs: Sequence[tuple[str, str]]) -> int:
    """Take back what was said of runs, each a file, which may be gone, and a number (empty: all of the file). Returns
    of how many. Raises ConfigError for a run without a label."""
    said, removed = read_labels(model), set[str]()
    for file, number in runs:
        at = str(Path(file).resolve())
        found = {key for key, each in said.items() if each["file"] == at and number in ("", each["run"])}
        if not found:
            known = ", ".join(f"{each['file']}:{each['run']}" for each in said.values()) or "none"
            name = f"{file}:{number}" if number else file
            raise ConfigError(f"has no label of {name}; it has {known}", file=str(_path(model)))
        removed |= found
    _write(model, {key: each for key, each in said.items() if key not in removed})
    return len(removed)


def _write(model: str | Path, said: Said) -> None:
    write_file(_path(model), json.dumps(said, indent=1) + "\n")


def labelled_runs(
    model: str | Path, columns: Sequence[str], special: Special
) -> list[tuple[Mapping[str, str], LabelledRun]]:
    """Return what was said of runs, each with the run, if its file still has it. Raises ConfigError for a lost file."""
    said, first = read_labels(model), dict[str, LabelledRun]()
    for file, number in {each["file"]: each["run"] for each in said.values()}.items():
        try:
            runs = _whole_runs(file, columns, special)
        except ConfigError as error:
            text = f"has a label of run {number} of a file that cannot be used ({error})"
            mend = f"fame monitor label {file} --remove --model {model} takes back what was said of its runs"
            raise ConfigError(f"{text}: {mend}", file=str(_path(model))) from None
        for run in runs:
            first.setdefault(_hash(run), run)
    return [(each, first[key]) for key, each in said.items() if key in first]


def with_labels(
    runs: Sequence[LabelledRun], model: str | Path, columns: Sequence[str], special: Special
) -> tuple[list[LabelledRun], list[int], list[int], list[str]]:
    """Return the runs, with more that are benign by what was said; the numbers of benign and of anomalous ones; and the
    names of those whose files no longer have what was labelled.

    Raises ConfigError for a lost file."""
    hashes = _hashes(runs, columns, special)
    said = read_labels(model)
    labels = {key: each["label"] for key, each in said.items()}
    found = labelled_runs(model, columns, special)
    more = [run for each, run in found if each["label"] == LABELS[0]]
    there = {_hash(run) for _, run in found}
    lost = [f"{each['file']}:{each['run']}" for key, each in said.items() if key not in there]
    every = [*runs, *(run for run in more if _hash(run) not in hashes)]
    benign, anomalous = ([at for at, key in enumerate(hashes) if labels.get(key) == label] for label in LABELS)
    return every, [*benign, *range(len(runs), len(every))], anomalous, lost


def _hashes(runs: Sequence[LabelledRun], columns: Sequence[str], special: Special) -> list[str]:
    """Return the hash of each run, which is that of the whole where a part of it trains (`start`, `end`)."""
    if not special.start and special.end == math.inf:
        return [_hash(run) for run in runs]
    whole = {file: _whole_runs(file, columns, special) for file in {run.file for run in runs}}
    return [_hash(next((each for each in whole[run.file] if _is_part(run, each)), run)) for run in runs]


def _is_part(run: LabelledRun, whole: LabelledRun) -> bool:
    part, every = run.samples, whole.samples
    begin = int(np.searchsorted(every.stamps, part.stamps[0])) if len(part) else len(every)
    return len(part) > 0 and np.array_equal(every.values[begin : begin + len(part)], part.values)


def _whole_runs(file: str, columns: Sequence[str], special: Special) -> list[LabelledRun]:
    return read_labelled_runs([file], columns, special._replace(start=0.0, end=math.inf))


def _hash(run: LabelledRun) -> str:
    return run_hash(run.samples.channels()) if len(run.samples) else ""
