"""Read the coverage of tests that ``fame test --cov-json`` has written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.dataclasses import dataclass
from fame.errors import ConfigError, display_name


@dataclass(frozen=True, slots=True)
class CoveredProcess:
    """What tests have entered of a process of a file (absolute), which had the SHA-256 `digest`.

    `elements` and `flows` are texts (``3 of 4``), `missing` names of elements, `excused` id -> reason, `tests` id ->
    those that enter the element.
    """

    file: Path
    digest: str
    name: str
    elements: str
    flows: str
    tests: Mapping[str, Sequence[str]]
    missing: Sequence[str]
    excused: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class CoverageReport:
    """The coverage of processes, the tests of each requirement, and the outcomes of tests that have not passed."""

    requirements: Mapping[str, Sequence[str]]
    not_passed: Mapping[str, str]
    processes: Sequence[CoveredProcess]


def read_coverage(path: Path) -> CoverageReport:
    """Read a file. Raises ConfigError."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if "processes" in report and "not_passed" not in report:
            text = "does not say which tests passed: write it again with fame test --cov-json FILE"
            raise ConfigError(text, file=str(path))
        outcomes = {_text(test): _text(outcome) for test, outcome in report["not_passed"].items()}
        processes = [_process(one) for one in report["processes"]]
        return CoverageReport(_tests(report["requirements"]), outcomes, processes)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise ConfigError("expected the coverage that fame test --cov-json FILE writes", file=str(path)) from None


def _process(process: Mapping[str, Any]) -> CoveredProcess:
    return CoveredProcess(
        Path(_text(process["file"])).resolve(),
        _text(process["sha256"]),
        _text(process["name"]),
        _count(process["elements"]),
        _count(process["flows"]),
        _tests(process["tests"]),
        [display_name(_text(one["id"]), _text(one["name"])) for one in process["missing"]],
        {id: _text(reason) for id, reason in process["excused"].items()},
    )


def _count(counts: Mapping[str, Any]) -> str:
    return f"{int(counts['covered'])} of {int(counts['total'])}"


def _tests(by_id: Mapping[str, Any]) -> Mapping[str, Sequence[str]]:
    return {id: [_text(test) for test in tests] for id, tests in by_id.items()}


def _text(value: object) -> str:
    """A text that can be written to a page. Raises TypeError or ValueError."""
    if not isinstance(value, str):
        raise TypeError(value)
    return value.encode().decode()
