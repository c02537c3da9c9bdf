"""Judge a team on the network while it is recorded or shown: what `fame.log.judge` says of the recording afterwards.

A bound is over when the clock of the mission has passed it by the doubt of the clocks, and what was sent until then had
time to arrive. What comes later is recorded with that time, so that a replay gives the same verdict.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from fame.bpmn.model import Definitions
from fame.bpmn.reader import read
from fame.errors import ConfigError, ModelError
from fame.log.channels import EVENTS, PROPERTIES
from fame.log.judge import team_of_model
from fame.log.recording_file import Sink
from fame.log.team_judge import TeamJudge, reads
from fame.middleware import messages
from fame.middleware.interface import TopicInfo
from fame.properties import Judgement, Property
from fame.properties.vocabulary import Vocabulary

_EARLY = 100_000
"""Messages that are kept until all robots that the properties name are known: with more, nothing so far is known."""


class LiveJudge(Sink):
    """Judges what a recording gets, and passes that on, with judgements, to the sink that `over` names.

    `team` is what is known of the team, or `model` its model: without them, nothing is judged before all robots that
    the properties name have come. `note` gets violations. `whole`: whether what a robot did before counts.
    """

    properties: Sequence[Property]

    def __init__(
        self,
        properties: Sequence[Property],
        model: Definitions | None = None,
        team: Vocabulary | None = None,
        note: Callable[[str], object] = lambda text: None,
        *,
        whole: bool = True,
    ) -> None:
        self.properties, self._note = properties, note
        self._judge = TeamJudge(properties, team, measured=True, whole=whole)
        self._judge.judge.watch = self._watch
        self._processes, self._models = team_of_model(model if team is None else None)
        self._ready, self._wrong, self._last = team is not None, "", 0
        self._early: list[Callable[[], object]] = []
        self._overflow = False
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._told: set[str] = set()
        self._sink = Sink()
        self.judgements: list[Judgement] = []
        if team is None and self._processes:
            self._meet()

    def over(self, sink: Sink) -> LiveJudge:
        """Pass everything on to this sink from now on."""
        self._sink = sink
        self._declare()
        return self

    def _declare(self) -> None:
        for data in self._judge.judge.declared():
            self._sink.put(PROPERTIES, self._last, data)

    def on_model(self, robot: str, model: Mapping[str, Any]) -> None:
        if self._ready and robot in self._processes:
            return
        self._processes.setdefault(robot, str(model.get("process", "")))
        with suppress(ModelError):
            self._models += [read(str(each["xml"]).encode(), file=str(each["name"])) for each in model["models"]]
        self._meet()

    def kept(self) -> dict[str, Any]:
        """Return what it has to keep, as plain data; nothing before all robots have come."""
        return self._judge.kept() if self._ready else {}

    def take_up(self, kept: Mapping[str, Any]) -> None:
        """Go on from what another one has kept."""
        self._judge.take_up(kept)
        self._judge.judge.watch, self._ready = self._watch, True

    def reads(self, info: TopicInfo) -> bool:
        """Return whether it needs the messages of a topic, as far as the robots are known."""
        return reads(self._judge.judge, info)

    @property
    def so_far(self) -> list[Judgement]:
        """The judgements until now."""
        return self._judge.judge.judgements()

    def _meet(self) -> None:
        try:
            self._judge.meet(self._processes, self._models)
        except ConfigError as error:  # a robot that is still to come, or a wrong name
            self._wrong = error.text
            return
        self._ready, early, self._early = True, self._early, []
        self._judge.judge.watch = self._watch
        self._declare()
        for take in early:
            take()
        if self._overflow:
            why = f"not all robots were known after {_EARLY:,} messages, and further ones were not kept"
            self._judge.judge.lose(None, why)

    def _watch(self, time: int, judgement: Judgement) -> None:
        """Record a change, and note a violation."""
        self._sink.put(PROPERTIES, max(time, self._last), judgement.to_json())
        if judgement.verdict == "violated" and judgement.name not in self._told:
            self._told.add(judgement.name)
            self._note(str(judgement))
            robot, element = next(reversed(judgement.elements), ("", ""))
            if robot:
                report = {"instance": 0, "scope": 0, "marks": [[element, "report", str(judgement)]]}
                self._sink.put(EVENTS, max(time, self._last), {"robot": robot, "events": [report]})

    # ---- what is recorded --------------------------------------------------------------------------------------------

    def _take(self, time: int, take: Callable[[], object]) -> None:
        if self._ready:
            take()
        elif len(self._early) < _EARLY:
            self._early.append(take)
        else:
            self._overflow = True
        self._last = max(time, self._last)

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        self.tick(time)
        self._sink.put(topic, time, data)
        self._take(time, lambda: self._judge.put(topic, time, data))

    def message_channel(self, topic: str, type: str, node: str) -> int:
        number = self._sink.message_channel(topic, type, node)
        self._channels[number] = topic, type, node
        return number

    def message(self, channel: int, time: int, message: messages.Message) -> None:
        self.tick(time)
        self._sink.message(channel, time, message)
        self._take(time, lambda: self._judge.message(time, *self._channels[channel], lambda: message))

    @property
    def now(self) -> int:
        """What was before this time (ns) is judged."""
        return self._judge.judge.now

    @property
    def due(self) -> int | None:
        """The next time (ns) after which `tick` has to be called; None: never."""
        return self._judge.judge.due if self._ready else None

    def tick(self, time: int) -> None:
        """All before this time (ns) has been taken."""
        if self._ready:
            self._judge.judge.advance(time)

    def describe(self, metadata: Mapping[str, str]) -> None:
        self._sink.describe(metadata)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        self._sink.attach(name, media_type, data)

    def flush(self) -> None:
        self._sink.flush()

    # ---- the end -----------------------------------------------------------------------------------------------------

    def end(self, *, complete: bool) -> None:
        """Make the final `judgements`; the recording has them as metadata."""
        if self._ready:
            self.judgements = self._judge.finish(self._last, complete=complete)
        else:
            text = self._wrong or "no robot has come"
            self.judgements = [Judgement(each.name, each.sentence, "not known", text=text) for each in self.properties]
        self._sink.describe({"properties": json.dumps([each.to_json() for each in self.judgements])})

    def finish(self) -> None:
        self._sink.finish()
