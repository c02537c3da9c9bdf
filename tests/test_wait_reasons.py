"""Why a token waits: the condition and its values; the topic, who publishes, why its last message did not count."""

from collections.abc import Callable, Iterator

import pytest
from action_server import DRIVE, Server, skip_without_drive
from bpmn_text import process, properties
from middleware_contract import BACKENDS, LocalWorld, World, middlewares, world

from fame.clock import SECOND
from fame.deploy import EngineNode
from fame.errors import DeploymentError
from fame.log.live_team import LiveTeam
from fame.log.wait_reasons import explain, silences, wait_text
from fame.middleware import messages
from fame.middleware.actions import CANCEL, STATUS, ActionServer
from fame.middleware.interface import LATCHED, SENSOR_DATA, DeferredResponse
from fame.robot.robot_state import WAITING
from fame.view.blocks import Packer
from fame.view.catalogue import Catalogue
from fame.view.mission import mission_json
from tests.test_live_team import Field

SIGNALS = '<signal id="S" name="order"/><message id="M" name="part"/>'
START = '<startEvent id="Start"/><sequenceFlow id="f0" sourceRef="Start" targetRef="{0}"/>'
STRING = "std_msgs/msg/String"


@pytest.fixture
def field() -> Iterator[Field]:
    with Field() as found:
        yield found


def why(field: Field, text: str, element: str = "", before: str = "") -> list[str]:
    """What is said of a robot that runs this."""
    field.engine("REX")
    with LiveTeam(field.middleware.node("watcher"), field.middleware, field.scheduler, lambda *told: None) as team:
        field.run(1)
        field.deploy("REX", process(text, SIGNALS))
        field.run(1)
        if before:
            field.middleware.node("shop").publisher("/order", STRING).publish(messages.create(STRING, before))
        field.run(6)
        state = team.state.robots["REX"]
        lines = [
            line
            for reason in explain(state, team.models["REX"], element, team.last_time("REX"))
            for line in reason.lines("REX")
        ]
    return lines


def test_a_condition_is_told_with_the_values_that_it_reads(field: Field) -> None:
    lines = why(
        field,
        START.format("Set")
        + """<scriptTask id="Set"><script>battery = 55.5</script></scriptTask>
        <sequenceFlow id="f1" sourceRef="Set" targetRef="Low"/>
        <intermediateCatchEvent id="Low" name="battery low"><conditionalEventDefinition>
        <condition>battery &lt; limit</condition></conditionalEventDefinition></intermediateCatchEvent>""",
    )
    assert lines[0].startswith('REX waits at "battery low" (Low), for ')
    assert lines[1:] == ["  condition battery < limit is not true:", "    battery = 55.5", "    limit is not set"]


CATCH = (
    START.format("Sleep")
    + """
  <intermediateCatchEvent id="Sleep"><timerEventDefinition><timeDuration>PT3S</timeDuration></timerEventDefinition>
  </intermediateCatchEvent><sequenceFlow id="f1" sourceRef="Sleep" targetRef="Order"/>
  <intermediateCatchEvent id="Order" name="order comes"><extensionElements><camunda:properties>
  <camunda:property name="type" value="std_msgs/msg/String"/></camunda:properties></extensionElements>
  <signalEventDefinition signalRef="S"/></intermediateCatchEvent>"""
)


def test_a_topic_that_nobody_publishes_is_told(field: Field) -> None:
    lines = why(field, CATCH, "order comes")
    assert lines[1:] == ["  /order has no publisher", "  no message has come since the token waits"]


def test_a_message_that_came_too_early_is_told_with_its_publisher(field: Field) -> None:
    lines = why(field, CATCH, "Order", before="seven bolts")
    assert lines[1] == "  /order is published by /shop"
    assert "did not count: nothing waited for it then" in lines[2]


def test_a_publisher_that_is_not_connected_is_told_with_the_reason(field: Field) -> None:
    field.middleware.node("shop").publisher("/order", STRING, SENSOR_DATA)
    why_not = "/REX/fame_engine receives nothing from /shop: reliability: offered best_effort, requested reliable"
    lines = why(field, CATCH, "Order")
    assert lines[1:3] == ["  /order is published by /shop", f"  /order: {why_not}"]


@pytest.mark.parametrize(("name", "similar"), [("Ordr", "Order"), ("order come", "order comes")])
def test_an_element_where_no_token_waits_is_refused_with_a_similar_id_or_label(
    field: Field, name: str, similar: str
) -> None:
    with pytest.raises(DeploymentError, match=f"no token waits at '{name}'; did you mean '{similar}'"):
        why(field, CATCH, name)


# ---- servers, on every backend -----------------------------------------------------------------------------------


class Watched:
    """An engine that runs a service task, a driver that may serve it, and a watcher, each with endpoints of its own."""

    def __init__(self, here: World) -> None:
        self.here = here
        watcher = here.node("watcher")
        self.driver = here.node("driver", "REX")
        sender = watcher.publisher("/REX/bpmn_process", STRING)
        here.node("_made")
        made = list(middlewares(here))
        self.engine = EngineNode("REX", scheduler=here.scheduler, middleware=made[-1])
        self.follow = lambda: LiveTeam(watcher, made[0], here.scheduler, lambda *told: None)
        self.team = self.follow()
        here.connect("/REX/bpmn_process")
        self.deploy = lambda text: sender.publish(messages.create(STRING, text))

    def run(self, **said: str) -> None:
        self.deploy(process(f'{START.format("t")}<serviceTask id="t">{properties(**said)}</serviceTask>'))

    def lines(self) -> list[str]:
        """What --why says now, of who has followed it for a while."""
        return lines_of(self.team)

    def lines_at_first(self) -> list[str]:
        """The same, of who has just come."""
        with self.follow() as team:
            self.until(lambda: "REX" in team.state.robots, step=SECOND // 100)
            return lines_of(team)

    def until(self, condition: Callable[[], object], step: int = SECOND // 10) -> None:
        for _ in range(30 * SECOND // step):
            if condition():
                return
            self.here.scheduler.run(self.here.scheduler.now + step)
        raise AssertionError(f"it says {self.lines()}; warnings: {self.here.warnings}")

    def until_told(self, *texts: str) -> None:
        """Wait for lines that begin so, and nothing else."""

        self.until(
            lambda: (
                len(lines := self.lines()) == len(texts)
                and all(line.startswith(f"  {text}") for line, text in zip(lines, texts, strict=True))
            )
        )

    def close(self) -> None:
        self.team.close()
        self.engine.close()


def lines_of(team: LiveTeam) -> list[str]:
    state = team.state.robots.get("REX")
    if state is None or not state.tokens:
        return []
    reasons = explain(state, team.models.get("REX", {}), "", team.last_time("REX"))
    return [line for reason in reasons for line in reason.lines("REX")][1:]


@pytest.fixture(params=[each for each in BACKENDS if each == "local" or "apart" in str(each)])
def watched(request: pytest.FixtureRequest) -> Iterator[Watched]:
    """A type belongs to a topic or service in one process: here each node but those of ``local`` is one of its own."""
    skip_without_drive(request.param)
    made = Watched(world(request.param))
    yield made
    made.close()
    made.here.close()


@pytest.mark.long_but("local")
def test_a_server_that_says_nothing_and_leaves_is_told(watched: Watched) -> None:
    server = Server(watched.driver)
    watched.run(action="drive", type=DRIVE, payload="{distance: 3}")
    watched.until(lambda: server.goals)
    assert watched.lines() == []
    watched.until_told("its server has said nothing for ")
    server.step()
    assert watched.lines_at_first() == []
    server.server.close()
    watched.until_told("it has had no server for ")
    server = Server(watched.driver)
    watched.until(lambda: server.goals)
    watched.until_told()


def test_who_follows_a_robot_is_told_when_its_server_falls_silent_and_speaks_again() -> None:
    here = LocalWorld()
    watched = Watched(here)
    server = Server(watched.driver)
    watched.run(action="drive", type=DRIVE, payload="{distance: 3}")
    told = []
    for _ in range(2):
        here.scheduler.run(here.scheduler.now + 4 * SECOND)
        told.append(bool(watched.lines()))
        server.step()
        here.scheduler.run(here.scheduler.now + SECOND)
        told.append(bool(watched.lines()))
    assert told == [True, False, True, False]
    watched.close()
    here.close()


def test_a_service_of_another_type_is_told(watched: Watched) -> None:
    watched.driver.service("blade", "std_srvs/srv/Trigger", lambda request: None)
    watched.run(service="blade", type="std_srvs/srv/SetBool")
    other = "std_srvs/srv/SetBool: the service /REX/blade is of type std_srvs/srv/Trigger"
    watched.until_told("it has had no server for ", other)


@pytest.mark.long_but("local")
def test_an_action_of_another_type_is_told(watched: Watched) -> None:
    ActionServer(watched.driver, "drive", "nav2_msgs/action/Spin", print, print)
    watched.run(action="drive", type=DRIVE, payload="{distance: 3}")
    if isinstance(watched.here, LocalWorld):  # a topic has one type in one process: it is refused
        watched.here.scheduler.run(10 * SECOND)
        assert watched.engine.running is None
        return
    goal = f"{DRIVE}_SendGoal: the service /REX/drive/_action/send_goal is of type nav2_msgs/action/Spin_SendGoal"
    feedback = (
        "/REX/drive/_action/feedback: /REX/fame_engine receives nothing from /REX/driver: type: offered nav2_msgs"
    )
    watched.until_told("it has had no server for ", goal, feedback)


@pytest.mark.long_but("local")
def test_feedback_of_another_quality_of_service_is_told(watched: Watched) -> None:
    below = "drive/_action"
    feedback = watched.driver.publisher(f"{below}/feedback", f"{DRIVE}_FeedbackMessage", SENSOR_DATA)
    watched.driver.publisher(f"{below}/status", STATUS, LATCHED)
    watched.driver.service(f"{below}/send_goal", f"{DRIVE}_SendGoal", lambda request: {"accepted": True})
    later = DeferredResponse()
    watched.driver.service(f"{below}/get_result", f"{DRIVE}_GetResult", lambda request: later)
    watched.driver.service(f"{below}/cancel_goal", CANCEL, lambda request: None)
    watched.run(action="drive", type=DRIVE, payload="{distance: 3}")
    why = "receives nothing from /REX/driver: reliability: offered best_effort, requested reliable"
    watched.until_told("its server has said nothing for ", f"{feedback.topic}: /REX/fame_engine {why}")


def test_each_of_parallel_repetitions_is_told_with_its_own_values(field: Field) -> None:
    inner = """<startEvent id="In"/><sequenceFlow id="i0" sourceRef="In" targetRef="Full"/>
        <intermediateCatchEvent id="Full"><conditionalEventDefinition>
        <condition>load &gt; 9</condition></conditionalEventDefinition></intermediateCatchEvent>"""
    lines = why(
        field,
        START.format("Set")
        + f"""<scriptTask id="Set"><script>loads = [1, 2]</script></scriptTask>
        <sequenceFlow id="f1" sourceRef="Set" targetRef="Fill"/>
        <subProcess id="Fill"><multiInstanceLoopCharacteristics
        camunda:collection="loads" camunda:elementVariable="load"/>
        {inner}</subProcess>""",
    )
    assert [line.strip() for line in lines if line.startswith("    load")] == ["load = 1", "load = 2"]


def test_the_page_gets_the_sentences_of_commands() -> None:
    mission = mission_json("model", "a mission", Catalogue([]), [])
    token = {"key": "1", "scope": 1, "element": "Ask", "service": "/Door/open", "text": "service"}
    packer = Packer(Catalogue([]), ["REX"])
    packer.put(WAITING, 5, {"robot": "REX", "tokens": [token], "gone": []})
    [(_, _, [shown], _)] = packer.blocks[0].lists["waits"]
    assert shown["text"] == wait_text(token) == "the service /Door/open to answer"
    assert silences({"gone": 1 * SECOND}, 4 * SECOND) == [mission["sentences"]["gone"].format(time="3 s")]
