"""All robots start a deployment or none does, whoever dies, stands still, mishears or comes in between."""

import pytest
from deployment_field import TEAM, Field, made, patrol

from fame.bpmn.reader import read_text
from fame.clock import SECOND
from fame.deploy import Deployment, Report


def dead_after_loading(field: Field, id: str, sequence: int) -> Deployment:
    """A deployment whose sender sent every robot its part and then was no more."""
    sent = made(field, TEAM, id, sequence)
    sent.close()
    for robot, envelope in sent.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(0.5)
    return sent


def test_robots_whose_sender_died_before_it_told_anybody_to_start_keep_what_they_had():
    field = Field("A", "B")
    field.deploy(TEAM)
    kept = [field.engines[name].running for name in "AB"]
    dead_after_loading(field, "d2", 2)
    assert [field.engines[name].state for name in "AB"] == ["ready", "ready"]
    field.pass_time(10)
    assert [field.engines[name].running for name in "AB"] == kept
    reasons = [report.reason for report in field.said if report.answer == "aborted"]
    assert ["before it started any robot" in reason for reason in reasons] == [True, True]


def test_a_robot_whose_sender_died_after_it_told_another_to_start_starts_too():
    field = Field("A", "B")
    sent = dead_after_loading(field, "d1", 1)
    field.send("A", sent._envelope("A", "start").to_json())
    field.pass_time(10)
    assert [field.engines[name].deployed for name in "AB"] == ["d1", "d1"]


def test_a_sender_that_is_alive_is_waited_for_however_long_the_others_take():
    field = Field("A")
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)
    sent.begin()
    field.pass_time(9)
    assert (field.engines["A"].state, sent.done) == ("ready", False)
    field.pass_time(3)
    assert (field.engines["A"].state, sent.failed) == ("waiting", True)
    assert sent.robots["B"].reason == "did not answer within 10 s"


class HardOfHearing(Deployment):
    """It does not hear the first answer of each robot: on the status topic a newer report took its place."""

    lost: tuple[str, ...] = ()

    def _on_report(self, robot, message):
        report = Report.from_json(message.data)
        if report.answer and report.deployment == self.id and robot not in self.lost:
            self.lost = (*self.lost, robot)
        else:
            super()._on_report(robot, message)


@pytest.mark.parametrize("newer", [True, False])
def test_who_misses_an_answer_asks_again_and_ends_with_the_truth(newer):
    field = Field("A", "B")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    older = HardOfHearing(read_text(TEAM, file="team.bpmn"), id="d1", sequence=1, **options)
    older.begin()
    if newer:
        assert not field.deploy(TEAM, id="d2", sequence=2).failed
    else:
        field.pass_time(12)
    assert older.lost == ("A", "B") or older.lost == ("B", "A")
    assert (older.done, older.failed) == (True, newer)
    assert ("superseded" in {each.state for each in older.robots.values()}) is newer
    assert {engine.deployed for engine in field.engines.values()} == {"d2" if newer else "d1"}


# ---- what is decided stays decided -----------------------------------------------------------------------------------


def test_a_robot_that_is_ready_takes_a_newer_one_only_when_the_older_is_decided():
    field = Field("A", "B")
    older = dead_after_loading(field, "d1", 1)
    newer = made(field, TEAM, "d2", 2)
    newer.close()
    field.send("A", newer.envelopes["A"].to_json())
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].deployment) == ("superseded", "d1")
    for name in "AB":  # its sender had told them already: they keep their word
        field.send(name, older._envelope(name, "start").to_json())
    field.pass_time(0.1)
    assert [field.engines[name].deployed for name in "AB"] == ["d1", "d1"]
    assert field.engines["A"].state == "ready"


def test_a_sender_that_is_not_through_makes_room_for_a_newer_one_at_once():
    field = Field("A")
    older = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)  # B never answers
    older.begin()
    field.pass_time(1)
    assert field.engines["A"].state == "ready"
    field.send("A", patrol(5))
    field.pass_time(0.1)
    assert (older.failed, older.robots["A"].state) == (True, "superseded")
    assert field.variables("A") == {"mark": 5}


def test_two_deployments_at_the_same_instant_end_with_one_of_them_everywhere():
    field = Field("A", "B")
    pair = [made(field, TEAM, id, 7) for id in ("d1", "d2")]
    for sent in pair:
        sent.begin()
    field.pass_time(15)
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}
    assert [sent.failed for sent in pair] == [True, False]


class Deaf(Deployment):
    """Nothing that it says to `lost` robots arrives while `words` are left, once they are started."""

    lost: tuple[str, ...] = ()
    words = 0

    def _send(self, robot, envelope):
        if robot in self.lost and envelope.phase != "load" and self.words:
            self.words -= 1
        else:
            super()._send(robot, envelope)


THREE = TEAM.replace(
    'name="B" processRef="pb"/>', 'name="B" processRef="pb"><participantMultiplicity minimum="1"/></participant>'
)


def test_a_robot_that_comes_back_in_between_without_its_process_does_not_keep_the_others_from_it():
    field = Field("A", "B_1", "B_2")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    sent = Deaf(read_text(THREE, file="team.bpmn"), id="d1", sequence=1, **options)
    sent.lost, sent.words = ("B_1", "B_2"), 2
    sent.begin()
    field.pass_time(0.5)
    assert [engine.state for engine in field.engines.values()] == ["running", "ready", "ready"]
    killed = field.engines["B_2"]
    killed.status.close()
    killed.candidate.close()
    killed.node.close()
    field.add("B_2")
    field.pass_time(3)
    assert [engine.deployed for engine in field.engines.values()] == ["d1", "d1", ""]
    assert (sent.failed, sent.robots["B_2"].state) == (True, "refused")


class Stopped(Deployment):
    """A sender whose process is stopped for a while, after its robots have got their parts."""

    until = 0.0

    def _on_timer(self):
        if not self._stands(self._on_timer):
            super()._on_timer()

    def _on_report(self, robot, message):
        if not self._stands(lambda: self._on_report(robot, message)):
            super()._on_report(robot, message)

    def _stands(self, again) -> bool:
        stands = self._protocol.state.phase == "load" and self.scheduler.now < self.until * SECOND
        if stands:
            self.scheduler.at(round(self.until * SECOND), again)
        return stands


@pytest.mark.parametrize("seconds", [3.0, 5.5, 6.9, 7.1, 9.0])
def test_a_sender_that_was_stopped_starts_all_or_nobody(seconds):
    field = Field("A", "B")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    sent = Stopped(read_text(TEAM, file="team.bpmn"), id="d1", sequence=1, **options)
    sent.begin()
    field.pass_time(0.021)
    sent.until = seconds
    field.pass_time(15)
    deployed = "d1" if seconds < 5 else ""
    assert [engine.deployed for engine in field.engines.values()] == [deployed, deployed]
    assert sent.failed is (seconds > 5)


def test_a_sender_that_leaves_before_it_is_through_calls_it_off():
    field = Field("A")
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)
    sent.begin()
    field.pass_time(1)
    sent.close()
    field.pass_time(0.1)
    assert (field.engines["A"].state, field.answers()[-1]) == ("waiting", "aborted")


def test_a_sender_whose_clock_is_behind_is_newer_all_the_same():
    field = Field("A", "B")
    field.deploy(TEAM, "d1", 10**15)
    sent = field.deploy(TEAM, "d2", 5)
    assert (sent.failed, sent.sequence) == (False, 10**15 + 1)
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_an_older_model_does_not_take_the_turn_of_a_newer_one_that_waits():
    field = Field("A")
    texts = {id: made_for_one(field, id, sequence) for id, sequence in (("d1", 1), ("d2", 3), ("d3", 2))}
    for text in texts.values():
        field.send("A", text)
    field.pass_time(0.1)
    answers = [(report.deployment, report.answer) for report in field.said if report.answer]
    assert answers == [("d1", "superseded"), ("d3", "stale"), ("d2", "ready")]


def made_for_one(field: Field, id: str, sequence: int) -> str:
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), id, sequence)
    sent.close()
    return sent.envelopes["A"].to_json()


def test_an_engine_that_ends_says_so_to_whoever_waits_for_it():
    field = Field("A")
    for id, sequence in (("d1", 1), ("d2", 2)):
        field.send("A", made_for_one(field, id, sequence))
        field.pass_time(0.1)
    field.engines["A"].close()
    field.pass_time(0.1)
    ended = [report.deployment for report in field.said if report.reason == "the engine ends"]
    assert ended == ["d2", "d1"]
