"""The network between robots: delay, loss, partitions and quality of service, in scenarios, commands and missions."""

from __future__ import annotations

from pathlib import Path

import pytest
from action_server import DRIVE, Server
from bpmn_text import process

from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware.actions import ActionClient
from fame.middleware.interface import LATCHED, SENSOR_DATA, SIGNAL, QoS
from fame.middleware.local import LocalMiddleware
from fame.middleware.messages import create
from fame.middleware.network import Delay, Link, Network, NetworkConfig, Partition
from fame.scenario import Scenario

ROOT = Path(__file__).parent.parent
INT = "std_msgs/msg/Int32"
CUT = Partition(("A", "B"), 1.0, 6.0)
LONG = Partition(("A", "B"), 1.0, 16.0)


class Pair:
    """Robot A publishes numbers, B and another node of A listen; `seen` has (s, number) of B."""

    def __init__(self, *links: Link, cuts: tuple[Partition, ...] = (), qos: QoS = SIGNAL, seed: int = 1) -> None:
        self.scheduler = Scheduler()
        self.network = Network(NetworkConfig(links, cuts), seed, self.scheduler)
        self.middleware = LocalMiddleware(self.scheduler, network=self.network)
        self.seen: list[tuple[float, int]] = []
        self.own: list[tuple[float, int]] = []
        self.publisher = self.middleware.node("engine", "A").publisher("/x", INT, qos)
        for name, robot, seen in (("engine", "B", self.seen), ("sensor", "A", self.own)):
            self.middleware.node(name, robot).subscription("/x", INT, lambda got, to=seen: self.note(got, to), qos)

    def note(self, message: object, seen: list[tuple[float, int]]) -> None:
        seen.append((self.scheduler.now / SECOND, message.data))  # type: ignore[attr-defined]

    def publish(self, *times: float) -> Pair:
        for number, time in enumerate(times):
            self.scheduler.at(round(time * SECOND), lambda n=number: self.publisher.publish(create(INT, n)))
        self.scheduler.run(60 * SECOND)
        return self

    @property
    def numbers(self) -> list[int]:
        return [number for _, number in self.seen]


def test_a_message_between_robots_takes_its_time_and_that_of_a_sensor_does_not() -> None:
    pair = Pair(Link(Delay("fixed", 0.25))).publish(0, 1)
    assert pair.seen == [(0.25, 0), (1.25, 1)]
    assert pair.own == [(0.0, 0), (1.0, 1)]


@pytest.mark.parametrize(
    "delay",
    [Delay("uniform", 0.1, 0.4), Delay("normal", 0.2, 0.1), Delay("exponential", 0.2)],
    ids=lambda one: one.kind,
)
def test_delays_have_a_distribution_and_reliable_messages_their_order(delay: Delay) -> None:
    pair = Pair(Link(delay)).publish(*[number / 100 for number in range(200)])
    assert pair.numbers == list(range(200))
    assert len({round(time - number / 100, 3) for time, number in pair.seen}) > 20


def test_best_effort_loses_and_reliable_sends_again() -> None:
    link = Link(Delay("fixed", 0.01), loss=0.3)
    lossy = Pair(link, qos=SENSOR_DATA).publish(*range(50))
    assert 25 < len(lossy.seen) < 45
    assert lossy.network.losses() == [f"the network lost {50 - len(lossy.seen)} messages on /x from A to B"]
    reliable = Pair(link).publish(*range(50))
    assert reliable.numbers == list(range(50))
    assert max(time - number for time, number in reliable.seen) > 0.1
    assert reliable.network.losses() == []


def test_messages_of_best_effort_overtake_each_other_where_they_may() -> None:
    numbers = (
        Pair(Link(Delay("fixed", 0.05), reorder=0.3), qos=SENSOR_DATA).publish(*[n / 20 for n in range(50)]).numbers
    )
    assert sorted(numbers) == list(range(50)) != numbers


def test_the_same_seed_gives_the_same_and_another_robot_changes_nothing() -> None:
    def run(seed: int, *, third: bool = False) -> list[tuple[float, int]]:
        pair = Pair(Link(Delay("exponential", 0.1), loss=0.2), qos=SENSOR_DATA, seed=seed)
        if third:
            pair.middleware.node("engine", "C").subscription("/x", INT, lambda message: None, SENSOR_DATA)
        return pair.publish(*range(30)).seen

    assert run(1) == run(1) == run(1, third=True) != run(2)


def test_a_short_partition_holds_reliable_messages_back_and_loses_others() -> None:
    assert Pair(cuts=(CUT,)).publish(0, 2, 3, 7).seen == [(0, 0), (6, 1), (6, 2), (7, 3)]
    assert Pair(cuts=(CUT,), qos=SENSOR_DATA).publish(0, 2, 3, 7).numbers == [0, 3]
    assert Pair(cuts=(Partition(("A", "B"), 1.0, 6.0000000004),)).publish(0, 2, 7).numbers == [0, 1, 2]  # within a ns
    newest = Pair(cuts=(CUT,), qos=QoS(depth=1)).publish(0, 2, 3, 7)
    assert newest.numbers == [0, 2, 3]
    assert newest.network.losses() == ["the network lost 1 message on /x from A to B"]


def test_what_is_under_way_when_a_partition_begins_stays_before_what_is_sent_in_it() -> None:
    times = 0.8, 0.9, 1.05, 1.2, 6.0, 6.1
    assert Pair(Link(Delay("fixed", 0.3)), cuts=(CUT,)).publish(*times).numbers == [0, 1, 2, 3, 4, 5]
    assert Pair(Link(Delay("fixed", 0.3)), cuts=(CUT,), qos=QoS(depth=1)).publish(*times[1:3]).numbers == [1]


def test_a_partition_longer_than_the_lease_ends_the_match() -> None:
    pair = Pair(cuts=(LONG,)).publish(0, 2, 14, 17)
    assert pair.numbers == [0, 3]
    assert pair.network.losses() == ["the network lost 2 messages on /x from A to B"]
    assert Pair(cuts=(LONG,), qos=LATCHED).publish(0, 2, 14, 17).seen == [(0, 0), (16, 2), (17, 3)]


def test_a_link_that_loses_everything_is_refused() -> None:
    for loss in (1.0, -0.1, float("nan")):
        with pytest.raises(ConfigError, match="loss: expected a probability below 1"):
            Link(loss=loss)


def test_links_are_for_pairs_and_topics_and_the_last_one_counts() -> None:
    slow, fast = Link(Delay("fixed", 1.0)), Link(Delay("fixed", 0.5), topic="/x")
    assert Pair(slow, fast).publish(0).seen == [(0.5, 0)]
    assert Pair(slow, Link(between=("B", "A"))).publish(0).seen == [(0.0, 0)]
    assert Pair(slow, Link(between=("A", "C"))).publish(0).seen == [(1.0, 0)]


def test_a_request_and_its_response_pass_the_network() -> None:
    pair = Pair(Link(Delay("fixed", 0.25)), cuts=(LONG,))
    pair.middleware.node("server", "B").service("/add", "std_srvs/srv/Trigger", lambda request: {"success": True})
    client, heard = pair.middleware.node("asker", "A").client("/add", "std_srvs/srv/Trigger"), list[float]()
    client.call(None, lambda response: heard.append(pair.scheduler.now / SECOND))
    pair.scheduler.run(2 * SECOND)
    assert (heard, client.available) == ([0.5], True)
    client.call(None, lambda response: heard.append(-1))
    pair.scheduler.run(12 * SECOND)
    assert (heard, client.available) == ([0.5], False)
    pair.scheduler.run(20 * SECOND)
    assert (heard, client.available) == ([0.5], True)
    assert pair.network.losses() == ["the network lost 1 message on /add from A to B"]


def test_the_goal_feedback_and_result_of_an_action_pass_the_network() -> None:
    pair = Pair(Link(Delay("fixed", 0.25)), cuts=(LONG,))
    server = Server(pair.middleware.node("driver", "B"), "/drive")
    client, heard = ActionClient(pair.middleware.node("engine", "A"), "/drive", DRIVE), list[tuple[float, object]]()
    pair.scheduler.after(SECOND // 2, server.step)

    def note(what: object) -> None:
        heard.append((pair.scheduler.now / SECOND, what))

    client.send({"distance": 2}, lambda outcome, result: note(outcome), lambda said: note(said.remaining))
    pair.scheduler.run(SECOND // 4 - 1)
    assert server.goals == {}
    pair.scheduler.run(SECOND - 1)
    assert heard == [(0.75, 1.0)]
    pair.scheduler.run(2 * SECOND)
    server.step()  # B is cut off from A: what it tells and its result are lost
    pair.scheduler.run(12 * SECOND)
    assert not client.available
    pair.scheduler.run(20 * SECOND)
    assert (heard, client.available) == ([(0.75, 1.0), (11.0, "gone")], True)
    lost = "\n".join(pair.network.losses())
    assert "lost 1 message on /drive/_action/feedback from B to A" in lost
    assert "on /drive/_action/get_result from B to A" in lost


@pytest.mark.parametrize("when", [2, 12, 17], ids=["in a partition", "after the lease", "after the partition"])
def test_a_goal_that_was_cancelled_in_a_partition_is_cancelled_at_its_end(when: int) -> None:
    pair = Pair(Link(Delay("fixed", 0.25)), cuts=(LONG,))
    server = Server(pair.middleware.node("driver", "B"), "/drive")
    client = ActionClient(pair.middleware.node("engine", "A"), "/drive", DRIVE)
    goal = client.send({"distance": 2}, lambda outcome, result: None)
    pair.scheduler.run(when * SECOND)
    goal.cancel()
    pair.scheduler.run(15 * SECOND)
    assert len(server.goals) == 1
    pair.scheduler.run(18 * SECOND)
    assert server.cancelled == [goal.id]


def test_the_actions_and_services_of_a_robot_itself_do_not_pass_it() -> None:
    pair = Pair(Link(Delay("fixed", 0.25), loss=0.9))
    server = Server(pair.middleware.node("driver", "A"), "/A/drive")
    client, heard = ActionClient(pair.middleware.node("engine", "A"), "/A/drive", DRIVE), list[object]()
    client.send({"distance": 1}, lambda outcome, result: heard.append(outcome), lambda said: None)
    pair.scheduler.run(0)
    server.step()
    pair.scheduler.run(0)
    assert (heard, pair.network.losses()) == (["succeeded"], [])


# ---- scenarios and the command line ----------------------------------------------------------------------------------


def scenario(folder: Path, network: str) -> Path:
    (folder / "m.bpmn").write_text(process('<startEvent id="s"/>'))
    path = folder / "s.yaml"
    path.write_text(f"model: m.bpmn\ncomputers: [P]\nnetwork: {network}\n")
    return path


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("{delay: 0.05, loss: 0.01}", Link(Delay("fixed", 0.05), 0.01)),
        ("{delay: {uniform: [0.02, 0.1]}, reorder: 0.5}", Link(Delay("uniform", 0.02, 0.1), reorder=0.5)),
        ("{links: [{topic: All done, loss: 0.1}]}", Link(loss=0.1, topic="/All_done")),
        ("{links: [{topic: done, delay: {normal: [0.1, 0.02]}}]}", Link(Delay("normal", 0.1, 0.02), topic="/done")),
    ],
)
def test_a_scenario_says_its_network(tmp_path: Path, text: str, link: Link) -> None:
    assert Scenario.load(scenario(tmp_path, text)).network == NetworkConfig((link,))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("{loss: 2}", r"network.loss: expected a number from 0 to 0.99, got 2"),
        ("{delay: fast}", r"network.delay: expected a number"),
        ("{delay: {uniform: [0.2, 0.1]}}", r"network.delay.uniform: expected two numbers of seconds"),
        ("{delay: {gamma: 1}}", r"network.delay"),
        ("{partitions: [{between: [P], from: 1, to: 2}]}", r"between: expected two robots"),
        ("{partitions: [{between: [P, Q], from: 3, to: 2}]}", r"to: expected a second after that of from"),
        ("{partitions: [{between: [P, Q], from: 1}]}", r"expected the key to"),
        ("{partitions: [{between: [P, Q], from: 1, to: 2}]}", r"unknown robot 'Q' in the network"),
    ],
)
def test_a_wrong_network_is_refused_with_its_place(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(ConfigError, match=error) as caught:
        Scenario.load(scenario(tmp_path, text))
    assert "s.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--loss", "2"], "--loss: expected a probability from 0 to 0.99, got '2'"),
        (["--network-delay", "soon"], "--network-delay: expected a number above 0, got 'soon'"),
        (["--partition", "REX@1-2"], "expected ROBOT,ROBOT@FROM-TO, as in REX,DINGO@30-60, got 'REX@1-2'"),
        (["--partition", "P,Q@1-2"], "unknown robot 'Q' in the network"),
        (["--loss", "0.1", "--middleware", "dds"], "--loss needs --middleware local"),
    ],
)
def test_wrong_options_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], error: str
) -> None:
    assert main(["run", str(scenario(tmp_path, "{}")), *words]) == 2
    assert error in capsys.readouterr().err


# ---- missions --------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_mission_with_retries_survives_loss_and_a_partition() -> None:
    cuts = tuple(Partition(("Drone", f"Tractor_{number}"), 44, 59) for number in (1, 2))
    network = NetworkConfig((Link(Delay("fixed", 0.05), loss=0.05),), cuts)
    result = Scenario.load(ROOT / "examples" / "agriculture_resilient.yaml", network=network).run()
    assert result.status == "completed"
    assert result.world is not None
    assert all(weed["by"] for weed in result.world["weeds"].values())
    assert [event.detail for event in result.reports if "lost" in event.detail] == [
        f"the network lost 1 message on /closest_tractor from Drone to Tractor_{number}" for number in (1, 2)
    ]


@pytest.mark.long
def test_one_without_retries_says_what_it_lost() -> None:
    cuts = tuple(Partition(("Drone", f"Tractor_{number}"), 40, 55) for number in (1, 2, 3))
    network = NetworkConfig((Link(loss=0.05),), cuts)
    result = Scenario.load(ROOT / "examples" / "agriculture.yaml", network=network).run()
    assert "the network lost 1 message on /closest_tractor from Drone to Tractor_1" in [
        event.detail for event in result.reports
    ]
    assert result.world is not None
    assert [name for name, weed in result.world["weeds"].items() if weed["by"] is None] != []
