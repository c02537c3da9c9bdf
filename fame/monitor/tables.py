"""Recorded CSV files as runs: what `fame record` wrote, and any table of numbers with a header.

A column ``stamp`` (s) is needed; a column ``run`` parts a file into runs, and every file begins a new one. A cell may
be empty: another topic spoke in that row. Rows that lack any of the columns asked for are left out, and so is a last
line without an end in a file of `fame record`: it was torn when its writer was killed.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fame.errors import ConfigError
from fame.monitor.pipeline.processor import Floats, Samples

STAMP, RUN = "stamp", "run"
_OTHER = (STAMP, RUN, "label")


def read_runs(paths: Sequence[str | Path], columns: Sequence[str] = ()) -> list[Samples]:
    """Every run of these files: values (n, columns), stamps, and the names of the columns.

    `columns` by default are all but stamp, run and label, of the first file. Raises ConfigError.
    """
    if not paths:
        raise ConfigError("no files to read; expected Files: [runs.csv]", element="Files")
    runs: list[Samples] = []
    for path in map(Path, paths):
        names, cells = _read(path)
        columns = tuple(columns) or tuple(name for name in names if name not in _OTHER)
        if not columns:
            raise ConfigError(f"has no columns but {', '.join(names)}: nothing to learn from", file=str(path))
        for name in (STAMP, *columns):
            if name not in names:
                raise ConfigError(f"has no column {name!r}; it has {', '.join(names)}", file=str(path))
        values = cells[:, [names.index(name) for name in columns]]
        stamps = cells[:, names.index(STAMP)]
        whole = np.isfinite(values).all(axis=1) & np.isfinite(stamps)
        numbers = cells[:, names.index(RUN)] if RUN in names else np.zeros(len(cells))
        if not whole.any():
            raise ConfigError(f"has no row with all of {', '.join(columns)}", file=str(path))
        values, stamps, numbers = values[whole], stamps[whole], numbers[whole]
        for rows in np.split(np.arange(len(values)), np.flatnonzero(np.diff(np.nan_to_num(numbers)) != 0) + 1):
            order = rows[np.argsort(stamps[rows], kind="stable")]
            runs.append(Samples(values[order], stamps[order], tuple(columns)))
    return runs


def hash_files(paths: Sequence[str | Path]) -> str:
    """SHA-256 of their content, in order. Raises ConfigError."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            with Path(path).open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    return digest.hexdigest()


def rate_of(runs: Sequence[Samples]) -> float:
    """The usual rate (Hz) of the samples. Raises ConfigError if they do not tell."""
    steps = np.concatenate([np.diff(run.stamps) for run in runs]) if runs else np.zeros(0)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if not usual > 0:
        raise ConfigError("the stamps do not grow: no rate can be told from them")
    return 1 / usual


def _read(path: Path) -> tuple[list[str], Floats]:
    """Header and numbers; NaN where a cell is empty. Raises ConfigError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except UnicodeDecodeError:
        raise ConfigError("is no UTF-8 text", file=str(path)) from None
    lines = text.splitlines()
    try:
        names = [name.strip() for name in next(csv.reader(lines[:1]), [])]
    except csv.Error as error:
        raise ConfigError(f"has no header: {error}", file=str(path), line=1) from None
    if not names or any(_is_number(name) for name in names):
        raise ConfigError("has no header; expected stamp,effort_0,...", file=str(path), line=1)
    if names[:2] == [STAMP, RUN] and not text.endswith("\n"):
        lines.pop()
    while lines and not lines[-1].strip():
        lines.pop()
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ConfigError(f"has several columns {twice[0]!r}; expected unique names", file=str(path), line=1)
    if len(lines) < 2:
        raise ConfigError("has no rows", file=str(path))
    try:
        cells = np.loadtxt(lines[1:], delimiter=",", ndmin=2, comments=None)
        if cells.shape == (len(lines) - 1, len(names)):
            return names, cells
    except ValueError:  # empty cells, or something wrong
        pass
    return names, _cell_by_cell(path, names, lines)


def _cell_by_cell(path: Path, names: list[str], lines: list[str]) -> Floats:
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            row = next(csv.reader([line]), [])
            rows.append([float(cell) if cell.strip() else np.nan for cell in row])
        except csv.Error as error:
            raise ConfigError(f"is no row of numbers: {error}", file=str(path), line=number) from None
        except ValueError as error:
            text = f"expected a number, got {str(error).rpartition(':')[2].strip()}"
            raise ConfigError(text, file=str(path), line=number) from None
        if len(row) != len(names):
            text = f"expected {len(names)} cells, got {len(row)}"
            raise ConfigError(text, file=str(path), line=number)
    return np.array(rows, dtype=np.float64)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
