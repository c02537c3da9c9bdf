"""The service ``watch_property``: a robot watches a property of its team, and raises a signal when it is violated."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.log.live_judge import LiveJudge
from fame.log.recording_file import Sink
from fame.log.team_recorder import TeamRecorder
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.properties import Place, Property, parse
from fame.robot.services import ServiceContext, variable

STRING = "std_msgs/msg/String"
_DELAY = SECOND // 20
"""How long events wait for those of other robots (ns): engines send 20 batches a second."""


class Alarm:
    """Publishes ``/violated/NAME`` (std_msgs/msg/String) of the property that the variables of a service give, once.

    Raises ConfigError for a name that is no name of a topic, and for a wrong sentence.
    """

    property: Property

    def __init__(self, context: ServiceContext, variables: Mapping[str, Any]) -> None:
        name = variable(variables, "property", type=str)
        if not re.fullmatch(r"[A-Za-z]\w*", name):
            raise ConfigError(f"expected a name of letters, digits and _, got {name!r}", element="property")
        self.property = parse(variable(variables, "sentence", type=str), Place(), name)
        self.node: Node = context.middleware.node(f"watch_{name}", context.namespace)
        self._publisher = self.node.publisher(f"/violated/{name}", STRING)
        self._raised = False

    def raise_signal(self, text: str) -> None:
        """Publish why it is violated."""
        if not self._raised:
            self._raised = True
            self._publisher.publish(messages.create(STRING, text))


class PropertyWatch:
    """Judges a property from the events that the robots on the network publish, from when its service task starts."""

    def __init__(self, context: ServiceContext, variables: Mapping[str, Any]) -> None:
        self._alarm = Alarm(context, variables)
        judging = LiveJudge([self._alarm.property], note=self._alarm.raise_signal, whole=False)
        self._recorder = TeamRecorder(
            context.middleware, context.scheduler, Sink, models=False, delay=_DELAY, judging=judging
        )

    def results(self) -> None:
        """Never give results: the watch does not end by itself."""

    def close(self) -> None:
        """Close all endpoints."""
        self._recorder.close()
        self._alarm.node.close()
