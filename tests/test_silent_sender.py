"""A sender that is killed, or cut off, at any moment: all its robots start or all keep what they had."""

from collections.abc import Iterable
from dataclasses import replace
from time import time

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from deployment_field import TEAM, Field, definitions, kill, made, patrol, process

from fame.bpmn.reader import read_text
from fame.deploy import Deployment
from fame.deploy.envelope import signed
from fame.deploy.options import DeploymentOptions
from fame.deploy.requests import AbortClient
from fame.middleware import local

ALONE = definitions(
    '<collaboration id="c"><participant id="A" name="A" processRef="pa"/></collaboration>',
    process("pa", '<startEvent id="sa"/><userTask id="ua"/>', ("sa", "ua")),
)
THREE = TEAM.replace(
    'name="B" processRef="pb"/>', 'name="B" processRef="pb"><participantMultiplicity minimum="1"/></participant>'
)
TEAMS = {1: (ALONE, ("A",)), 3: (THREE, ("A", "B_1", "B_2"))}


class Killed(Deployment):
    """A sender that is killed after it has sent so many words."""

    words = 0

    def _send(self, robot, envelope):
        if self.words > 0:
            super()._send(robot, envelope)
        self.words -= 1
        if self.words == 0:
            kill(self)
            self.node.close()


def sent(field: Field, text: str, robots: Iterable[str], id: str, kind: type[Deployment] = Deployment) -> Deployment:
    return kind(
        read_text(text, file="team.bpmn"),
        id=id,
        sequence=1,
        scheduler=field.scheduler,
        middleware=field.middleware,
        ended=lambda deployment: None,
        options=DeploymentOptions(robots=list(robots)),
    )


@pytest.mark.long_but("1*", "3-1")
@pytest.mark.parametrize(("robots", "words"), [(1, 1), (1, 2), *((3, words) for words in range(1, 7))], ids=str)
def test_a_sender_that_is_killed_after_any_word_leaves_no_half_deployment_and_nobody_waiting(robots, words):
    text, names = TEAMS[robots]
    field = Field(*names)
    assert not field.deploy(text, "d0").failed
    killed = sent(field, text, names, "d1", Killed)
    killed.words = words
    killed.begin()
    field.pass_time(10)
    assert len({engine.deployed for engine in field.engines.values()}) == 1
    assert {engine.state for engine in field.engines.values()} <= {"running", "idle"}
    assert field.engines["A"].deployed == ("d1" if words > robots else "d0")
    assert not field.deploy(text, "d2").failed


@pytest.mark.parametrize("robots", [1, 3])
def test_the_next_deployment_after_a_killed_sender_is_answered(robots):
    text, names = TEAMS[robots]
    field = Field(*names)
    killed = sent(field, text, names, "d1", Killed)
    killed.words = robots
    killed.begin()
    field.pass_time(0.1)
    assert {engine.state for engine in field.engines.values()} == {"ready"}
    following = field.deploy(text, "d2")
    assert not following.failed
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


# ---- partitions ------------------------------------------------------------------------------------------------------


class Parted(Field):
    """A field in which nothing gets to robots that are `islands`, or from them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *robots: str) -> None:
        self.islands: tuple[str, ...] = ()
        field = self

        class Publisher(local.LocalPublisher):
            def publish(self, message):
                whole = self.matched
                self.matched = [end for end in whole if field.reaches(self.node.namespace, end.node.namespace)]
                super().publish(message)
                self.matched = whole

            def send_history(self, subscription):
                if field.reaches(self.node.namespace, subscription.node.namespace):
                    super().send_history(subscription)

        monkeypatch.setattr(local, "LocalPublisher", Publisher)
        super().__init__(*robots)

    def reaches(self, one: str, other: str) -> bool:
        return one == other or not {one, other} & set(self.islands)


def settled(field: Field) -> tuple[set[str], set[str]]:
    """What runs where, and how the robots stand."""
    engines = field.engines.values()
    return {engine.deployed for engine in engines}, {engine.state for engine in engines}


@pytest.mark.parametrize("cut", [("A",), ("B",), ("A", "B")], ids=str)
@pytest.mark.parametrize("late", [0.0, 0.021, 0.0215, 0.03, 0.1])
def test_a_partition_of_15_s_at_any_moment_leaves_no_half_deployment(monkeypatch, cut, late):
    field = Parted(monkeypatch, "A", "B")
    deployment = sent(field, TEAM, "AB", "d1")
    deployment.begin()
    field.pass_time(late)
    field.islands = tuple(cut)
    field.pass_time(15)
    field.islands = ()
    field.pass_time(10)
    deployed, states = settled(field)
    assert len(deployed) == 1
    assert not states & {"ready", "holding", "loading"}


def ready_without_a_sender(monkeypatch, *told: str) -> Parted:
    """A and B are ready, the sender told some to start and is gone, and B is cut off."""
    field = Parted(monkeypatch, "A", "B")
    dead = made(field, TEAM, "d1", 1)
    for robot, envelope in dead.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(0.1)
    assert settled(field)[1] == {"ready"}
    field.islands = ("B",)
    for robot in told:
        field.send(robot, dead._envelope(robot, "start").to_json())
    return field


def test_a_robot_that_hears_nobody_holds_says_so_and_does_not_decide_alone(monkeypatch):
    field, notes = ready_without_a_sender(monkeypatch, "A"), []
    field.engines["B"]._on_report = lambda event: notes.append(event.detail)
    field.pass_time(600)
    assert [field.engines[name].state for name in "AB"] == ["running", "holding"]
    assert [note.partition(":")[0] for note in notes] == ["holds deployment d1"]
    assert field.engines["B"].deployed == ""
    field.islands = ()
    field.pass_time(2)
    assert [field.engines[name].deployed for name in "AB"] == ["d1", "d1"]


def test_robots_that_hear_each_other_again_and_were_not_told_to_start_keep_what_they_had(monkeypatch):
    field = ready_without_a_sender(monkeypatch)
    field.pass_time(60)
    assert settled(field) == ({""}, {"holding"})
    field.islands = ()
    field.pass_time(3)
    assert settled(field) == ({""}, {"waiting"})


def holding(field: Field) -> Deployment:
    """B runs d0 and has promised d1, whose sender is silent: A does not know what became of it."""
    assert not field.deploy(TEAM, "d0").failed
    dead = made(field, TEAM, "d1", 1)
    field.send("B", dead.envelopes["B"].to_json())
    field.pass_time(20)
    assert (field.engines["B"].state, is_held(field)) == ("holding", True)
    return dead


def is_held(field: Field) -> bool:
    return field.engines["B"].running.engine.held is not None


def candidate(field: Field) -> str:
    return next(report.candidate for report in reversed(field.said) if report.robot == "B")


def test_a_newer_deployment_ends_what_a_robot_holds():
    field = Field("A", "B")
    holding(field)
    assert not field.deploy(TEAM, "d2", 2).failed
    assert (field.engines["B"].state, field.engines["B"].deployed, is_held(field)) == ("running", "d2", False)
    assert [report.deployment for report in field.said if report.answer == "stale"] == ["d1"]


def test_a_newer_deployment_that_fails_leaves_the_robot_holding_for_the_older_one():
    field = Field("A", "B")
    dead = holding(field)
    running = field.engines["B"].running
    newer = made(field, TEAM, "d2", 2)
    field.send("B", newer.envelopes["B"].to_json())
    field.pass_time(1)
    assert (candidate(field), is_held(field)) == ("d2", True)
    field.send("B", newer._envelope("B", "abort").to_json())
    field.pass_time(2)
    assert (field.engines["B"].state, candidate(field), is_held(field)) == ("holding", "d1", True)
    field.send("B", dead._envelope("B", "start").to_json())  # it has said that it asks: it takes no plain start
    field.pass_time(1)
    assert field.engines["B"].state == "holding"
    field.send("B", dead._envelope("B", "abort").to_json())
    field.pass_time(1)
    assert (field.engines["B"].state, is_held(field), field.engines["B"].running) == ("running", False, running)


def test_a_bare_model_does_not_end_what_a_robot_holds(monkeypatch):
    field = ready_without_a_sender(monkeypatch, "A")
    field.engines["A"].close()
    field.islands = ()
    field.pass_time(20)
    field.send("B", made(field, TEAM, "d2", 2).envelopes["B"].model)
    field.pass_time(2)
    refused = [report for report in field.said if report.answer == "refused"][-1]
    assert "what became of it at A is not known; fame abort B ends that" in refused.reason


def test_an_engine_that_ends_while_it_is_ready_has_not_aborted_what_others_may_have_started():
    field = Field("A", "B_1", "B_2")
    dead = sent(field, THREE, ["A", "B_1", "B_2"], "d1")
    for robot, envelope in dead.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(4.9)
    field.engines["B_2"].close()
    field.pass_time(10)
    assert [field.engines[name].state for name in ("A", "B_1")] == ["holding", "holding"]
    field.send("A", replace(dead._envelope("A", "start"), begun=True).to_json())
    field.pass_time(3)
    assert [field.engines[name].deployed for name in ("A", "B_1")] == ["d1", "d1"]


def test_a_person_aborts_what_a_robot_holds(monkeypatch):
    field = ready_without_a_sender(monkeypatch, "A")
    field.engines["A"].close()
    field.islands = ()
    field.pass_time(20)
    answers: list[tuple[str, str]] = []
    for _ in range(2):
        node = field.middleware.node("person")
        end = AbortClient("B", node=node, scheduler=field.scheduler, ended=lambda *said: answers.append(said))
        field.pass_time(2)
        end.close()
    assert answers == [("aborted", ""), ("idle", "")]
    assert field.engines["B"].state == "waiting"


def test_an_abort_that_was_refused_is_no_abort_when_the_robot_starts():
    team, stranger = Ed25519PrivateKey.generate(), Ed25519PrivateKey.generate()
    field = Field("A", trusted=[team.public_key()])
    robot = field.engines["A"]
    sender = sent(field, ALONE, ["A"], "d1")
    tell = lambda envelope: field.send("A", signed(envelope, team, born=robot.born, now=time()).to_json())  # noqa: E731
    tell(sender.envelopes["A"])
    field.pass_time(1)
    answers: list[tuple[str, str]] = []
    node = field.middleware.node("stranger")
    end = AbortClient("A", node=node, scheduler=field.scheduler, ended=lambda *said: answers.append(said), key=stranger)
    field.pass_time(2)
    assert (robot.state, answers) == ("ready", [])
    tell(sender._envelope("A", "start"))
    field.pass_time(2)
    end.close()
    assert (robot.deployed, answers) == ("d1", [("started", "it runs deployment d1 now")])


# ---- while it holds --------------------------------------------------------------------------------------------------

DRIVES = definitions(
    process(
        "p",
        '<startEvent id="s"/><scriptTask id="t"><script>begun = globals().get("begun", 0) + 1\n'
        "while True:\n    await sleep(1)\n    ticks = globals().get('ticks', 0) + 1</script></scriptTask>",
        ("s", "t"),
    )
)


def test_what_runs_is_suspended_in_the_safe_state_while_the_robot_holds_and_goes_on_after_it(monkeypatch):
    field = Parted(monkeypatch, "A", "B")
    field.send("B", DRIVES.replace("globals().get", "{**globals()}.get"))
    field.pass_time(3.5)
    assert (field.variables("B")["begun"], field.variables("B")["ticks"]) == (1, 3)
    dead = made(field, TEAM, "d1", 1)
    for robot, envelope in dead.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(1)
    field.islands = ("A",)
    field.pass_time(6)
    ticks = field.variables("B")["ticks"]
    assert (field.engines["B"].state, bool(ticks)) == ("holding", True)
    field.pass_time(30)
    assert field.variables("B")["ticks"] == ticks
    field.islands = ()
    field.pass_time(4)
    assert (field.engines["B"].state, field.variables("B")["begun"]) == ("running", 2)
    assert field.variables("B")["ticks"] > ticks


def test_what_runs_is_not_touched_where_the_others_answer_at_once():
    field = Field("A", "B")
    for name in "AB":
        field.send(name, DRIVES.replace("globals().get", "{**globals()}.get"))
    field.pass_time(1)
    dead = made(field, TEAM, "d1", 1)
    for robot, envelope in dead.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(10)
    assert [report.answer for report in field.said if report.answer][-2:] == ["aborted", "aborted"]
    assert [field.variables(name)["begun"] for name in "AB"] == [1, 1]


def test_the_safe_state_is_taken_up_when_the_robot_begins_to_hold():
    field = Field()
    field.add("A", safe_state=[("stopped", "std_msgs/msg/Empty", {})])
    field.listen("A", "B")  # of which B never comes
    stops = []
    field.person.subscription("/A/stopped", "std_msgs/msg/Empty", stops.append)
    field.send("A", patrol(1))
    field.pass_time(1)
    envelope = made(field, TEAM, "d1", 1).envelopes["A"]
    field.send("A", replace(envelope, promises={}).to_json())
    field.pass_time(4)
    assert (field.engines["A"].state, len(stops)) == ("ready", 0)
    field.pass_time(3)
    assert (field.engines["A"].state, len(stops)) == ("holding", 1)
