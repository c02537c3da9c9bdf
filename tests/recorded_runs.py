"""Runs of scenarios, recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fame.log import logging_to
from fame.scenario import Scenario


def record(scenario: Scenario, path: Path, **options: Any) -> Path:
    """Run a scenario with a log at `path`; `options` are those of `logging_to`."""
    with logging_to(path, scenario.closures(), **options) as log:
        scenario.run(observer=log)
    return path
