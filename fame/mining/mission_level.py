"""What somebody drew: a log at level ``mission`` leaves out what is inside called files, and messages of sensors."""

from __future__ import annotations

from collections.abc import Sequence

from fame.bpmn.model import Definitions
from fame.errors import ConfigError
from fame.log.elements import element_info
from fame.log.recording import RecordedMessage, Recording
from fame.middleware.interface import ENGINE


class MissionLevel:
    """The activities and labelled elements in the files of the missions (`elements`, ids), and signals that they name.

    Raises ConfigError if the recording lacks the missions.
    """

    def __init__(self, recording: Recording, models: Sequence[Definitions]) -> None:
        named = {run.models[0] for runs in recording.runs.values() for run in runs if run.models}
        missions = [model for model in models if model.file in (named or {next(iter(recording.models), "")})]
        if not missions:
            raise ConfigError("lacks the model of its mission: select --level all", file=str(recording.file))
        self._robots = frozenset(recording.robots)
        self.elements: frozenset[str] = frozenset(
            id
            for id, info in element_info(missions).items()
            if info.activity or (info.name and info.tag != "sequenceFlow")
        )
        nodes = [node for file in missions for process in file.processes for node in process.body.walk()]
        names = {topic.qualified for node in nodes for topic, _ in node.topics()}
        self._topics = {name.replace("~", f"/{robot}", 1) for name in names for robot in self._robots}

    def has_signal(self, message: RecordedMessage) -> bool:
        """Return whether a message is a signal of the mission, which no robot's own part has sent."""
        own = message.topic.split("/")[1] in self._robots
        return message.topic in self._topics and (not own or message.node.endswith(f"/{ENGINE}"))
