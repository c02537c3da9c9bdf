"""The service ``watch_property``: a robot watches a property of its team, and raises a signal when it is violated.

What the watch knows is a variable of its process, `WATCHED`, as text. So it is part of the robot's durable state: a
watch that starts again goes on from there. What robots did meanwhile that the property names is lost, and not known.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.clock import SECOND, Entry, date_text
from fame.engine.encoding import decode, encode
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.log.live_judge import LiveJudge
from fame.log.recording_file import Sink
from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
from fame.properties import Location, Property, parse
from fame.robot.services import ServiceContext, ServiceTopic, variable

STRING = "std_msgs/msg/String"
WATCHED = "watched"
_DELAY = SECOND // 20
"""How long events wait for those of other robots (ns): engines send 20 batches a second."""
_FINDING = 3 * SECOND
"""The same at first, where a watch goes on: time to find the robots and to hear what they have done (ns)."""


class Alarm:
    """Throws ``/violated/NAME`` (std_msgs/msg/String) of the property that the variables of a service give.

    Raises ConfigError for a name that cannot be a topic's, and for a wrong sentence.
    """

    property: Property

    def __init__(self, context: ServiceContext, variables: Mapping[str, Any]) -> None:
        name = variable(variables, "property", type=str)
        topic = _topic(name)
        self.property = parse(variable(variables, "sentence", type=str), Location(), name)
        self.throw: Callable[[str], object] = context.signals(topic, STRING)


def topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topic of the alarm that the variables of a service give. Raises ConfigError for a wrong sentence."""
    name = variables.get("property")
    if variables.get("sentence") is not None:
        parse(variable(variables, "sentence", type=str), Location(), str(name or ""))
    return [ServiceTopic(_topic(str(name)), STRING, True)] if name is not None else None


def _topic(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise ConfigError(f"expected a name of ASCII letters, digits and _, got {name!r}", element="property")
    return f"/violated/{name}"


class _Noticing(Sink):
    """Calls `notice` for each message."""

    def __init__(self, notice: Callable[[], object]) -> None:
        self._notice = notice

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        self._notice()


class PropertyWatch:
    """Judges a property from the events that the robots on the network publish, from when its service task starts."""

    def __init__(self, context: ServiceContext, variables: dict[str, Any]) -> None:
        self._context, self._variables, self._alarm = context, variables, Alarm(context, variables)
        self._judging = LiveJudge([self._alarm.property], note=lambda text: self._notice(), whole=False)
        self._raised = False
        self._entry: Entry | None = None
        options, sink = TeamRecorderOptions(models=False, delay=_DELAY), _Noticing(self._notice)
        self._recorder = TeamRecorder(
            context.middleware, context.scheduler, lambda: sink, options, judging=self._judging
        )
        self._found: Entry = context.scheduler.after(_FINDING, self._on_found)
        if WATCHED in variables:
            self._take_up(decode(json.loads(variables[WATCHED])))

    def _take_up(self, kept: Mapping[str, Any]) -> None:
        team = self._recorder.team
        team.epoch, team.delay, self._raised = parse_datetime(kept["epoch"]), _FINDING, kept["raised"]
        self._judging.take_up(kept)

    def _on_found(self) -> None:
        self._recorder.team.delay = _DELAY

    def _notice(self) -> None:
        """Look at the end of this instant whether something has changed."""
        if self._entry is None:
            self._entry = self._context.scheduler.soon(self._keep)

    def _keep(self) -> None:
        """Keep what the watch knows and throw the signal, as one stimulus of the robot."""
        self._entry = None
        kept, epoch = self._judging.kept(), self._recorder.team.epoch
        if not kept or epoch is None:
            return
        (judgement,) = self._judging.so_far
        throws = judgement.verdict == "violated" and not self._raised
        self._raised |= throws
        text = json.dumps(encode({**kept, "epoch": date_text(epoch), "raised": self._raised}))
        if text != self._variables.get(WATCHED):
            self._variables[WATCHED] = text
            if throws:
                self._alarm.throw(str(judgement))
            self._context.changed()

    def results(self) -> None:
        """Return None: the watch does not end by itself."""

    def close(self) -> None:
        self._found.cancel()
        self._recorder.close()
        if self._entry is not None:
            self._entry.cancel()
