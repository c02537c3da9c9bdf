"""FAME runs the missions of a team of robots straight from BPMN 2.0 collaboration diagrams.

::

    import fame

    definitions = fame.read("mission.bpmn")
    simulation = fame.Simulation(definitions, process="main", variables={"x": 0})
    simulation.run()
    simulation.instances[0].status
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fame.errors import (
    ConfigError,
    DeploymentError,
    FameError,
    MessageError,
    MissionError,
    ModelError,
    UnavailableError,
)

if TYPE_CHECKING:
    from fame.bpmn.reader import read
    from fame.bpmn.writer import write
    from fame.engine.host import BpmnError
    from fame.observation import EventLog
    from fame.scenario import Scenario
    from fame.simulation import Simulation
    from fame.splitter import split

__all__ = [
    "BpmnError", "ConfigError", "DeploymentError", "EventLog", "FameError", "MessageError", "MissionError",
    "ModelError", "Scenario", "Simulation", "UnavailableError", "read", "split", "write",
]  # fmt: skip

_HOMES = {
    "BpmnError": "engine.host",
    "EventLog": "observation",
    "Scenario": "scenario",
    "Simulation": "simulation",
    "read": "bpmn.reader",
    "split": "splitter",
    "write": "bpmn.writer",
}


def __getattr__(name: str) -> Any:
    """Heavy parts are imported when they are first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'fame' has no attribute {name!r}")
    return getattr(import_module(f"fame.{_HOMES[name]}"), name)
