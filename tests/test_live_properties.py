"""Properties of a running team: judged from the events that its engines publish, and again from the recording."""

import json
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from bpmn_text import process, properties as deadline
from collaborations import team, text_of

from fame.bpmn import read
from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.cli import main
from fame.clock import SECOND
from fame.deploy import STRING
from fame.deploy.requests import TaskRequest
from fame.log import Recording, live_judge, team_recorder
from fame.log.channels import EVENTS, PROPERTIES
from fame.log.clocks import DAY
from fame.log.judge import judge_log
from fame.log.live_judge import LiveJudge
from fame.log.recording_file import RecordingFile
from fame.log.team_judge import BATTERY
from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
from fame.middleware import messages
from fame.middleware.interface import LATCHED, QoS
from fame.middleware.simulated_time import CLOCK, CLOCK_TYPE
from fame.monitor.pipeline.configuration import Port
from fame.monitor.pipeline.sinks import BagWriter
from fame.properties import Property, parse
from fame.scenario import Scenario
from fame.version import PROTOCOL
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
            TeamRecorderOptions(delay=SECOND // 20),
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


def test_clocks_of_another_date_are_compared_with_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a run in processes without a world: it begins in 1970."""
    monkeypatch.setattr(Judged, "_tick", lambda judged: None)
    judged = Judged(tmp_path / "run.mcap", SENTENCES, team(TEAM))
    monkeypatch.setattr(team_recorder, "now_since", lambda epoch: judged.field.scheduler.now + 20_000 * DAY)
    judged.deploy("A", "B")
    judged.field.run(5)
    assert judged.verdicts() == {**WORDS, "close": "holds"}
    with Recording(judged.path) as recording:
        times = [message.time for message in recording.messages(["/go", "/done"])]
        assert (len(times), recording.duration < 10) == (2, True)
    judged.close()


def test_the_battery_that_a_property_reads_is_recorded_although_no_model_names_its_topic(tmp_path: Path) -> None:
    made = properties(full="always A.battery > 0.1", low="always A.battery > 0.6", other="always B.battery > 0.1")
    judged = Judged(tmp_path / "run.mcap", made, team(TEAM))
    robot = judged.field.middleware.node("robot", "A")
    battery, other = robot.publisher("battery_state", BATTERY), robot.publisher("spare_state", "std_msgs/msg/Int8")
    judged.deploy("A", "B")
    judged.field.run(1)
    for publisher, message in ((battery, {"percentage": 0.5}), (other, {"data": 1})):
        publisher.publish(messages.create(publisher.type, message))
    judged.field.run(1)
    assert judged.verdicts() == {"full": "holds", "low": "violated", "other": "not known"}
    with Recording(tmp_path / "run.mcap") as recording:
        assert "/A/battery_state" in recording.topics
        assert "/A/spare_state" not in recording.topics
    judged.close()


def test_what_a_lost_mission_would_have_done_is_not_known(tmp_path: Path) -> None:
    made = properties(end="B completes", order="B throws /done only after A throws /go")
    judged = Judged(tmp_path / "run.mcap", made, team(TEAM))
    with closing(judged):
        judged.deploy("A", "B")
        judged.field.run(1)
        judged.field.engines.pop(1).close()
        judged.field.engine("B")
        judged.field.run(8)
        assert judged.verdicts() == {"end": "not known", "order": "not known"}
        assert {each.text for each in judged.judging.judgements} == {
            "the engine of B restarted, and its mission is lost"
        }


def test_a_deadline_runs_on_while_a_person_suspends_its_robot(tmp_path: Path) -> None:
    model = tmp_path / "sign.bpmn"
    model.write_text(process(f'<userTask id="Sign">{deadline(deadline="PT5S")}</userTask>'))
    judged = Judged(tmp_path / "run.mcap", list(Scenario.load(model).properties), read(model))
    with closing(judged):
        judged.field.engine("P")
        judged.field.run(1)
        judged.field.deploy("P", model.read_text())
        judged.field.run(1)
        ask = TaskRequest(id="1", element="", act="suspend", who="ann@desk").to_json()
        judged.field.middleware.node("person").publisher("/P/bpmn_task", STRING).publish(messages.create(STRING, ask))
        judged.field.run(1)
        assert judged.field.engines[0].state == "suspended"
        judged.field.run(2)
        assert judged.notes == []
        judged.field.run(3)
        assert judged.notes == [
            'property deadline_Sign is violated: P starts "Sign" at 1 s, and not: P ends "Sign" by 6 s'
        ]
        assert judged.verdicts() == {"deadline_Sign": "violated"}


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


def test_a_bag_of_a_team_is_judged_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As its live verdicts are, but nobody has measured the clocks: what compares those of two robots is not known."""
    judged = Judged(tmp_path / "run.mcap", SENTENCES, team(TEAM))
    types = {"/go": "std_msgs/msg/Empty", "/done": "std_msgs/msg/Empty"}
    types |= {f"/{robot}/{name}": "std_msgs/msg/String" for robot in "AB" for name in ("bpmn_events", "bpmn_model")}
    bag = BagWriter(tmp_path / "bag", [Port("", topic, type, (), QoS()) for topic, type in types.items()], list(types))
    node, now = judged.field.middleware.node("bag"), judged.field.scheduler
    for topic, type in types.items():
        put = partial(lambda topic, message: bag.put(topic, now.now / SECOND, message), topic)
        node.subscription(topic, type, put, LATCHED if topic.endswith("model") else QoS())
    judged.deploy("A", "B")
    judged.field.run(5)
    bag.close()
    live = judged.verdicts()
    judged.close()
    place = tmp_path / "team.properties.yaml"
    place.write_text("properties:\n" + "".join(f"  {one.name}: {one.sentence}\n" for one in SENTENCES))
    assert main(["log", "judge", "--json", str(place), str(tmp_path / "bag")]) == 3
    (found,) = json.loads(capsys.readouterr().out)["runs"].values()
    verdicts = {one["property"]: one["verdict"] for one in found}
    assert verdicts == live | dict.fromkeys(("answer", "late", "close"), "not known")
    with monkeypatch.context() as newer:
        newer.setattr("fame.version.PROTOCOL", PROTOCOL + 1)
        assert main(["log", "judge", str(place), str(tmp_path / "bag")]) == 2
    assert "events of A are not read: A runs an older FAME" in capsys.readouterr().err
    (tmp_path / "bag" / "metadata.yaml").write_text("nothing")
    assert main(["log", "judge", str(place), str(tmp_path / "bag")]) == 2


def test_of_whom_nothing_is_heard_nothing_is_known(tmp_path: Path) -> None:
    judged = Judged(tmp_path / "run.mcap", SENTENCES, team(TEAM))
    judged.deploy("A")
    judged.field.run(8)
    assert judged.verdicts() == dict.fromkeys(WORDS, "not known")
    assert {each.text for each in judged.judging.judgements} == {"nothing of B was recorded"}
    assert judged.notes == []
    judged.close()


def test_what_was_not_kept_before_all_robots_had_come_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_judge, "_EARLY", 2)
    made = properties(never="never A fails", end="A completes", go="never A throws /go", low="always /go.data < 3")
    judging = LiveJudge(made)
    for time, what in enumerate(("start", "fail", "end")):
        judging.put(EVENTS, time, {"robot": "A", "events": [{"instance": 1, "scope": 1, "marks": [["A", what, ""]]}]})
    judging.on_model("A", {"process": "A", "models": [{"name": "t.bpmn", "xml": text_of({"A": ["throw go"]})}]})
    judging.end(complete=True)
    assert {each.verdict for each in judging.judgements} == {"not known"}
