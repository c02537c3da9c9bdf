"""FAME runs the missions of a team of robots straight from BPMN 2.0 collaboration diagrams.

::

    import fame

    definitions = fame.read("mission.bpmn")
    simulation = fame.Simulation(definitions, process="main", variables={"x": 0})
    simulation.run()
    simulation.instances[0].status

Names are imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.imports import attach

__version__ = "0.2.0"

if TYPE_CHECKING:
    from fame.bpmn.reader import read as read, write as write
    from fame.bpmn.split import split as split
    from fame.engine.host import BpmnError as BpmnError
    from fame.errors import (
        ConfigError as ConfigError,
        DeploymentError as DeploymentError,
        FameError as FameError,
        MessageError as MessageError,
        MissionError as MissionError,
        ModelError as ModelError,
        UnavailableError as UnavailableError,
    )
    from fame.robot.events import EventLog as EventLog
    from fame.scenario import Scenario as Scenario
    from fame.scenario.exploration import explore as explore
    from fame.simulation import Simulation as Simulation
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "bpmn.reader": ["read", "write"],
            "bpmn.split": ["split"],
            "engine.host": ["BpmnError"],
            "errors": [
                "ConfigError",
                "DeploymentError",
                "FameError",
                "MessageError",
                "MissionError",
                "ModelError",
                "UnavailableError",
            ],
            "robot.events": ["EventLog"],
            "scenario": ["Scenario"],
            "scenario.exploration": ["explore"],
            "simulation": ["Simulation"],
        },
    )
