from fame.bpmn.model import Definitions as Definitions
from fame.bpmn.reader import read as read, write as write
from fame.bpmn.split import split as split
from fame.check.explore.result import Exploration as Exploration
from fame.check.scope import Finding as Finding
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
from fame.log.recording import Recording as Recording
from fame.robot.events import Event as Event, EventLog as EventLog
from fame.scenario import Result as Result, Scenario as Scenario
from fame.scenario.explore.exploration import explore as explore
from fame.simulation import Simulation as Simulation
from fame.version import __version__ as __version__
