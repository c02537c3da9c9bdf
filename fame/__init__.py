"""FAME runs the missions of a team of robots straight from BPMN 2.0 collaboration diagrams.

::

    import fame

    definitions = fame.read("mission.bpmn")
    simulation = fame.Simulation(definitions, process="main", variables={"x": 0})
    simulation.run()
    simulation.instances[0].status
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.errors import (
    ConfigError,
    DeploymentError,
    FameError,
    MessageError,
    MissionError,
    ModelError,
    UnavailableError,
)
from fame.lazy import from_homes

if TYPE_CHECKING:
    from fame.bpmn.reader import read, write
    from fame.bpmn.split import split
    from fame.engine.host import BpmnError
    from fame.robot.events import EventLog
    from fame.scenario import Scenario
    from fame.simulation import Simulation

__all__ = [
    "BpmnError", "ConfigError", "DeploymentError", "EventLog", "FameError", "MessageError", "MissionError",
    "ModelError", "Scenario", "Simulation", "UnavailableError", "read", "split", "write",
]  # fmt: skip

_HOMES = {
    "BpmnError": "engine.host",
    "EventLog": "robot.events",
    "Scenario": "scenario",
    "Simulation": "simulation",
    "read": "bpmn.reader",
    "split": "bpmn.split",
    "write": "bpmn.reader",
}

__getattr__ = from_homes(__name__, _HOMES)
"""Heavy parts are imported when they are first asked for."""
