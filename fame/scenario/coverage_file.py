"""Read the coverage of tests that ``fame test --cov-json`` has written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fame.errors import ConfigError, display_name


@dataclass(frozen=True, slots=True)
class CoveredProcess:
    """What tests have entered of a process of a file (absolute).

    `elements` and `flows` are texts (``3 of 4``), `missing` names of elements, `excused` id -> reason, `tests` id ->
    those that enter the element.
    """

    file: Path
    name: str
    elements: str
    flows: str
    tests: Mapping[str, Sequence[str]]
    missing: Sequence[str]
    excused: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class CoverageReport:
    """The coverage of processes, and the tests of each requirement."""

    requirements: Mapping[str, Sequence[str]]
    processes: Sequence[CoveredProcess]


def read_coverage(path: Path) -> CoverageReport:
    """Read a file. Raises ConfigError."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return CoverageReport(_tests(found["requirements"]), [_process(one) for one in found["processes"]])
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise ConfigError("expected the coverage that fame test --cov-json FILE writes", file=str(path)) from None


def _process(found: Mapping[str, Any]) -> CoveredProcess:
    return CoveredProcess(
        Path(_text(found["file"])).resolve(),
        _text(found["name"]),
        _count(found["elements"]),
        _count(found["flows"]),
        _tests(found["tests"]),
        [display_name(_text(one["id"]), _text(one["name"])) for one in found["missing"]],
        {id: _text(reason) for id, reason in found["excused"].items()},
    )


def _count(found: Mapping[str, Any]) -> str:
    return f"{int(found['covered'])} of {int(found['total'])}"


def _tests(found: Mapping[str, Any]) -> Mapping[str, Sequence[str]]:
    return {id: [_text(test) for test in tests] for id, tests in found.items()}


def _text(value: object) -> str:
    """A text that can be written to a page. Raises TypeError or ValueError."""
    if not isinstance(value, str):
        raise TypeError(value)
    return value.encode().decode()
