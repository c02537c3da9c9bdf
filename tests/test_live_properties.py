"""Properties of a running team: judged from the events that its engines publish, and again from the recording."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from collaborations import team

from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.clock import SECOND
from fame.log import Recording
from fame.log.channels import PROPERTIES
from fame.log.judge import judge_log
from fame.log.live_judge import LiveJudge
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder
from fame.middleware import messages
from fame.middleware.simulated_time import CLOCK, CLOCK_TYPE
from fame.properties import Property, parse
from tests.test_live_team import Field

TEAM = {"A": ["timer PT2S", "throw go", "timer PT9S"], "B": ["catch go", "timer PT1S", "throw done", "timer PT9S"]}


def properties(**sentences: str) -> list[Property]:
    return [parse(sentence, name=name) for name, sentence in sentences.items()]


class Judged:
    """A team with the time of a simulated clock, and a recorder that judges it."""

    def __init__(self, path: Path, made: list[Property], model: Definitions | None) -> None:
        self.field, self.path, self.properties, self.notes = Field(), path, made, list[str]()
        self._clock = self.field.middleware.node("clock").publisher(CLOCK, CLOCK_TYPE)
        self._tick()
        self.model = model
        self.judging = LiveJudge(made, model, note=self.notes.append)
        self._stream = path.open("wb")
        self.recorder = TeamRecorder(
            self.field.middleware,
            self.field.scheduler,
            lambda: RecordingFile(self._stream),
            delay=SECOND // 20,
            judging=self.judging,
        )

    def _tick(self) -> None:
        now = self.field.scheduler.now
        clock = {"sec": now // SECOND, "nanosec": now % SECOND}
        self._clock.publish(messages.create(CLOCK_TYPE, {"clock": clock}))
        self.field.scheduler.after(SECOND // 100, self._tick)

    def deploy(self, *robots: str) -> None:
        files = {part.name: part.source.decode() for part in split(team(TEAM))}
        for robot in robots:
            self.field.engine(robot)
        self.field.run(1)
        for robot in robots:
            self.field.deploy(robot, files[robot])

    def verdicts(self) -> dict[str, str]:
        """Stop recording; the final verdicts, which the recording gives as well."""
        self.recorder.close()
        self._stream.close()
        assert judge_log(self.path, self.properties, self.model) == self.judging.judgements
        with Recording(self.path) as recording:
            assert json.loads(recording.metadata["properties"]) == [
                json.loads(json.dumps(each.to_json())) for each in self.judging.judgements
            ]
        return {each.name: each.verdict for each in self.judging.judgements}

    def close(self) -> None:
        self._stream.close()
        for engine in self.field.engines:
            engine.close()
        self.field.middleware.close()


SENTENCES = properties(
    answer="after A throws /go, B throws /done within 2 s",
    late="after A throws /go, B throws /done within 500 ms",
    close="after A throws /go, B throws /done within 1 s",
    own="after B catches /go, B throws /done within 1 s",
    order="B throws /done only after A throws /go",
    end="B completes within 60 s",
)
WORDS = {
    "answer": "holds", "late": "violated", "close": "not known", "own": "holds", "order": "holds", "end": "pending"
}  # fmt: skip


@pytest.fixture(params=["with its model", "as its robots come"])
def judged(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Judged]:
    found = Judged(tmp_path / "run.mcap", SENTENCES, team(TEAM) if request.param == "with its model" else None)
    yield found
    found.close()


def test_a_team_is_judged_while_it_runs(judged: Judged) -> None:
    judged.deploy("A", "B")
    judged.field.run(2.3)
    assert judged.notes == []
    judged.field.run(0.5)
    assert [note[:25] for note in judged.notes] == ["property late is violated"]
    judged.field.run(2)
    assert judged.verdicts() == WORDS
    close = next(each for each in judged.judging.judgements if each.name == "close")
    assert close.text.startswith("a bound is within the doubt of the clocks (0.0")


def test_a_recording_has_each_change_where_it_happened(judged: Judged) -> None:
    judged.deploy("A", "B")
    judged.field.run(5)
    judged.verdicts()
    with Recording(judged.path) as recording:
        every = [(message.time, message.json()) for message in recording.messages([PROPERTIES])]
    told = [(time, each) for time, each in every if "names" not in each]
    late = [(time / SECOND, each["verdict"], each["slack"]) for time, each in told if each["property"] == "late"]
    assert [each[1] for each in late] == ["pending", "violated"]
    assert late[0][0] == 3
    assert 3.5 < late[1][0] < 3.6
    answer = [each for _, each in told if each["property"] == "answer"]
    assert [(each["verdict"], each["slack"], len(each["elements"])) for each in answer] == [
        ("pending", None, 1), ("holds", 1.0, 0)
    ]  # fmt: skip


def test_who_comes_late_is_judged_from_its_first_step(judged: Judged) -> None:
    judged.deploy("A")
    judged.field.run(3)
    judged.deploy("B")
    judged.field.run(3)
    found = judged.verdicts()
    assert (found["order"], found["end"], found["own"]) == ("not triggered", "pending", "not triggered")
    assert found["late"] == "violated"  # A threw it while nobody listened


def test_what_a_lost_batch_may_have_contained_is_not_known(judged: Judged, monkeypatch: pytest.MonkeyPatch) -> None:
    judged.deploy("A", "B")
    judged.field.run(2.6)
    with monkeypatch.context() as patch:
        patch.setattr(judged.recorder.team, "feed", lambda robot, batch: None)
        judged.field.run(0.6)  # with the answer in it
    judged.field.run(0.7)
    assert [note.partition(": ")[0] for note in judged.notes] == [
        f"property {name} is violated" for name in ("late", "close", "own")
    ]  # B was silent when its time was over
    judged.field.run(6)
    assert judged.verdicts() == dict.fromkeys(WORDS, "not known")


def test_of_whom_nothing_is_heard_nothing_is_known(tmp_path: Path) -> None:
    judged = Judged(tmp_path / "run.mcap", SENTENCES, team(TEAM))
    judged.deploy("A")
    judged.field.run(8)
    assert judged.verdicts() == dict.fromkeys(WORDS, "not known")
    assert {each.text for each in judged.judging.judgements} == {"nothing of B was recorded"}
    assert judged.notes == []
    judged.close()
