"""Service tasks call ROS services and actions, on every backend: request, result, feedback, errors, cancellation."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from action_server import DRIVE, Server, skip_without_drive
from bpmn_text import process, properties, refused
from middleware_contract import BACKENDS, World, middlewares, world

import fame
from fame.bpmn.reader import read_text
from fame.errors import ModelError
from fame.middleware.actions import CANCEL, ActionServer
from fame.middleware.interface import DeferredResponse
from fame.robot import RobotNode, make_mission
from fame.robot.options import RobotOptions

SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture(params=[backend for backend in BACKENDS if "apart" not in str(backend)])
def here(request: pytest.FixtureRequest) -> Iterator[World]:
    skip_without_drive(request.param)
    made = world(request.param)
    yield made
    made.close()


def model(task: str, more: str = "", attributes: str = "") -> str:
    """A process of one service task ``t``, and what else belongs to it."""
    outer = '<startEvent id="s"/><endEvent id="e"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
    flow = '<sequenceFlow id="g" sourceRef="t" targetRef="e"/>'
    return process(f'{outer}{flow}<serviceTask id="t" {attributes}>{task}</serviceTask>{more}', root=SIGNAL)


SIGNAL = '<signal id="S" name="stop"/><error id="E" errorCode="aborted"/><error id="R" errorCode="rejected"/>'


class Place:
    """A driver, whose action is ``drive`` and whose service is ``blade``, and an engine that runs a model."""

    def __init__(self, here: World) -> None:
        self.here, node = here, here.node("driver", "REX")
        self.server, self.blade = Server(node), list[bool]()
        self.blades = node.service("blade", SET_BOOL, self._switch)
        self.stop = node.publisher("/stop", "std_msgs/msg/Empty")
        self.robots: list[RobotNode] = []
        self.reports: list[Any] = []

    def _switch(self, request: Any) -> Any:
        self.blade.append(request.data)
        return {"success": request.data, "message": f"blade {request.data}"}

    def run(self, text: str, hold_errors: bool = False, **variables: Any) -> Any:
        """Start a model; returns its instance."""
        definitions = read_text(text, file="mission.bpmn")
        robot = RobotNode(
            "REX",
            make_mission(definitions, definitions.processes[0]),
            scheduler=self.here.scheduler,
            middleware=next(iter(middlewares(self.here))),
            options=RobotOptions(
                hold_errors=hold_errors, on_report=lambda event: self.reports.append(str(event.detail))
            ),
        )
        self.robots.append(robot)
        robot.load()
        robot.start(variables)
        return robot.instances[-1]

    def end(self, instance: Any) -> Any:
        """Run until it is over."""
        self.here.until(lambda: instance.status != "running")
        return instance


@pytest.fixture
def place(here: World) -> Iterator[Place]:
    made = Place(here)
    yield made
    for robot in made.robots:
        robot.close()


# ---- services --------------------------------------------------------------------------------------------------------


def test_a_service_is_asked_and_its_response_is_the_result(place: Place) -> None:
    task = properties(service="blade", type=SET_BOOL, payload="{data: ${on}}")
    instance = place.end(place.run(model(task, attributes='camunda:resultVariable="answer"'), on=True))
    assert (instance.status, place.blade) == ("completed", [True])
    assert (instance.variables["answer"].success, instance.variables["answer"].message) == (True, "blade True")


def test_without_payload_the_request_is_one_of_defaults_and_outputs_take_what_they_want(place: Place) -> None:
    output = '<camunda:inputOutput><camunda:outputParameter name="said">${msg.message}</camunda:outputParameter>'
    task = properties(service="blade", type=SET_BOOL).replace(
        "</extensionElements>", f"{output}</camunda:inputOutput></extensionElements>"
    )
    instance = place.end(place.run(model(task)))
    assert (instance.variables["said"], "msg" in instance.variables, place.blade) == ("blade False", False, [False])


def test_the_web_modelers_form_calls_too(place: Place) -> None:
    task = f'<extensionElements><ros:service name="blade" type="{SET_BOOL}"/><ros:payload data="true"/>'
    instance = place.end(place.run(model(f"{task}</extensionElements>")))
    assert (instance.status, place.blade) == ("completed", [True])


def test_a_service_that_comes_late_is_waited_for(here: World, place: Place) -> None:
    instance = place.run(model(properties(service="/late", type="std_srvs/srv/Trigger")))
    here.scheduler.after(200_000_000, lambda: here.node("late").service("/late", "std_srvs/Trigger", lambda r: None))
    assert place.end(instance).status == "completed"


def test_a_request_that_does_not_fit_is_an_error_of_the_task(place: Place) -> None:
    instance = place.end(place.run(model(properties(service="blade", type=SET_BOOL, payload="{data: often}"))))
    assert (instance.status, instance.error.element, instance.error.code) == ("failed", "t", "service")
    assert "data: expected true or false, got 'often'" in str(instance.error)


# ---- actions ---------------------------------------------------------------------------------------------------------


def drive(distance: str = "3", more: str = "", attributes: str = "", **said: str) -> str:
    return model(properties(action="drive", type=DRIVE, payload=f"{{distance: {distance}}}", **said), more, attributes)


def test_an_action_gets_its_goal_and_gives_its_result(here: World, place: Place) -> None:
    instance = place.run(drive("${x + 1}", attributes='camunda:resultVariable="result"'), x=1)
    here.until(lambda: place.server.goals)
    assert [wanted for wanted, _ in place.server.goals.values()] == [2.0]
    place.server.step()
    here.settle()
    assert instance.status == "running"
    place.server.step()
    assert (place.end(instance).status, instance.variables["result"].driven) == ("completed", 2.0)


def test_feedback_goes_to_a_variable_and_conditional_events_see_it(here: World, place: Place) -> None:
    boundary = (
        '<boundaryEvent id="near" attachedToRef="t" cancelActivity="false"><conditionalEventDefinition>'
        "<condition>state is not None and state.remaining &lt; 2</condition></conditionalEventDefinition>"
        '</boundaryEvent><scriptTask id="slow"><script>slow = state.remaining</script></scriptTask>'
        '<sequenceFlow id="h" sourceRef="near" targetRef="slow"/>'
    )
    instance = place.run(drive(more=boundary, feedback="state"), state=None)
    for remaining in (2.0, 1.0):
        here.until(lambda: place.server.goals)
        place.server.step()
        here.until(lambda r=remaining: instance.variables["state"] and instance.variables["state"].remaining == r)
        assert instance.variables.get("slow") == (1.0 if remaining == 1 else None)
    place.server.step()
    assert place.end(instance).status == "completed"


def test_feedback_may_be_taken_field_by_field(here: World, place: Place) -> None:
    instance = place.run(drive(feedback="remaining, state"), state=None)
    here.until(lambda: place.server.goals)
    place.server.step()
    here.until(lambda: instance.variables["state"] is not None)
    assert instance.variables["remaining"] == instance.variables["state"].remaining == 2.0


@pytest.mark.parametrize("errors", ["{rejected: wrong_way}", "{0: aborted_without_number, rejected: wrong_way}"])
def test_errors_gives_the_outcome_another_code(errors: str, here: World, place: Place) -> None:
    instance = place.run(drive("-1", errors=errors))
    end = place.end(instance)
    assert (end.status, end.error.code) == ("failed", "wrong_way")


@pytest.mark.long_but("local*")
@pytest.mark.parametrize("errors", ["[1]", "{a: 1}", "{", "text"])
def test_errors_that_are_no_mapping_are_refused(errors: str, here: World, place: Place) -> None:
    with pytest.raises(ModelError, match="property errors: expected a mapping such as"):
        place.run(drive(errors=errors))


ON_STOP = (
    '<boundaryEvent id="b" attachedToRef="t"><signalEventDefinition signalRef="S"/></boundaryEvent>'
    '<sequenceFlow id="h" sourceRef="b" targetRef="e"/>'
)


def test_a_task_that_is_cancelled_cancels_its_goal(here: World, place: Place) -> None:
    instance = place.run(drive("9", ON_STOP))
    here.until(lambda: place.server.goals)
    here.connect("/stop")
    here.settle()
    place.stop.publish(fame.middleware.messages.create("std_msgs/msg/Empty"))
    assert place.end(instance).status == "completed"
    here.until(lambda: len(place.server.cancelled) == 1)
    assert (place.server.goals, instance.visits["t"]) == ({}, 0)


def test_an_engine_that_stops_cancels_its_goal(here: World, place: Place) -> None:
    place.run(drive("9"))
    here.until(lambda: place.server.goals)
    here.settle()
    place.robots[-1].stop()
    here.until(lambda: len(place.server.cancelled) == 1)


@pytest.mark.parametrize(("reference", "distance", "code"), [("E", "9", "aborted"), ("R", "-1", "rejected")])
def test_a_goal_that_does_not_succeed_is_an_error_of_its_outcome(
    here: World, place: Place, reference: str, distance: str, code: str
) -> None:
    caught = (
        f'<boundaryEvent id="b" attachedToRef="t"><errorEventDefinition errorRef="{reference}"/></boundaryEvent>'
        '<scriptTask id="note"><script>caught = True</script></scriptTask>'
        '<sequenceFlow id="h" sourceRef="b" targetRef="note"/>'
    )
    for text in (drive(distance), drive(distance, caught)):
        instance = place.run(text)
        if code == "aborted":
            here.until(lambda: place.server.goals)
            here.settle()
            place.server.end(next(iter(place.server.goals)), 6)
        place.end(instance)
    failed, handled = (robot.instances[-1] for robot in place.robots)
    assert (failed.status, failed.error.code, failed.error.element) == ("failed", code, "t")
    assert (handled.status, handled.variables["caught"]) == ("completed", True)


def test_scripts_act_too(here: World, place: Place) -> None:
    script = (
        "seen = []\n"
        f"result = await robot.act('drive', '{DRIVE}', lambda told: seen.append(told.remaining), distance=2)\n"
        "driven = result.driven\n"
        f"try: await robot.act('drive', '{DRIVE}', distance=-1)\n"
        "except BpmnError as error: code = error.code"
    )
    task = f'<scriptTask id="t"><script>{script}</script></scriptTask>'
    text = model("").replace('<serviceTask id="t" ></serviceTask>', task)
    instance = place.run(text)
    here.until(lambda: place.server.goals)
    for remaining in (1.0, 0.0):
        place.server.step()
        here.until(lambda r=remaining: not instance.variables["seen"] or r in instance.variables["seen"])
    place.end(instance)
    assert (instance.variables["driven"], instance.variables["code"]) == (2.0, "rejected")


# ---- servers that do not cancel --------------------------------------------------------------------------------------

REFUSED = "/REX/drive: a cancelled goal still runs: its server refuses to cancel it"


def twice(more: str = "", **said: str) -> str:
    """Drive 9 m, but once the signal comes 1 m instead; `said` are properties of that."""
    task = properties(action="drive", type=DRIVE, payload="{distance: 1}", **said)
    return drive("9", ON_STOP.replace('targetRef="e"', 'targetRef="u"') + f"""<serviceTask id="u">{task}</serviceTask>
      <sequenceFlow id="i" sourceRef="u" targetRef="e"/>{more}""")  # fmt: skip


def stopped(here: World, place: Place, text: str) -> Any:
    """The instance of a model that is told to stop while it drives, by a server that does not obey."""
    place.server.obeys = False
    instance = place.run(text)
    here.connect("/stop")
    until(here, lambda: place.server.goals)
    soon(here)
    place.stop.publish(fame.middleware.messages.create("std_msgs/msg/Empty"))
    return instance


def test_a_refused_cancel_is_reported_until_the_goal_ends_and_the_next_goal_is_sent_beside_it(
    here: World, place: Place
) -> None:
    instance, cancelled = stopped(here, place, twice()), place.robots[-1].runner.cancelled
    until(here, lambda: len(place.server.goals) == 2 and cancelled.texts())
    assert (cancelled.texts(), cancelled.actions(), place.reports) == ([REFUSED], ["/REX/drive"], [REFUSED])
    place.server.end(place.server.cancelled[0], 4)
    until(here, lambda: not cancelled.actions())
    assert (cancelled.texts(), place.reports) == ([], [REFUSED, "/REX/drive: the cancelled goal has ended"])
    soon(here)
    place.server.step()
    assert place.end(instance).status == "completed"


def scripted(wait: float, more: str = "") -> str:
    """As `twice`, with a script for the second drive."""
    task = f"await robot.act('drive', '{DRIVE}', wait_cancelled={wait}, distance=1)"
    second = twice(more).rpartition('<serviceTask id="u">')
    rest = second[2].partition("</serviceTask>")[2]
    return f'{second[0]}<scriptTask id="u"><script>{task}</script></scriptTask>{rest}'


@pytest.mark.parametrize("text", [twice(wait_cancelled="60"), scripted(60)])
def test_a_goal_may_wait_until_cancelled_ones_have_ended(here: World, place: Place, text: str) -> None:
    instance = stopped(here, place, text)
    until(here, lambda: place.reports)
    soon(here)
    assert len(place.server.goals) == 1
    place.server.end(place.server.cancelled[0], 4)
    until(here, lambda: place.server.goals)
    soon(here)
    place.server.step()
    assert place.end(instance).status == "completed"


@pytest.mark.parametrize("by_script", [False, True])
def test_a_goal_that_waits_in_vain_fails_and_a_model_hears_of_it(here: World, place: Place, by_script: bool) -> None:
    heard = """<subProcess id="k" triggeredByEvent="true"><startEvent id="ks" isInterrupting="false">
      <signalEventDefinition signalRef="T"/></startEvent></subProcess>"""
    second = scripted(0.3, heard) if by_script else twice(heard, wait_cancelled="0.3")
    text = second.replace("<error ", '<signal id="T" name="~/still_running"/><error ', 1)
    instance = place.end(stopped(here, place, text))
    assert (instance.error.code, instance.variables["still_running"]) == ("still_running", "/REX/drive")
    assert len(place.server.goals) == 1


@pytest.mark.parametrize("here", ["local"], indirect=True)
def test_a_cancel_without_an_end_is_reported_after_five_seconds(here: World, place: Place) -> None:
    stopped(here, place, twice())
    place.server.obeys, begun = None, here.scheduler.now
    until(here, lambda: place.reports)
    assert place.reports == ["/REX/drive: a cancelled goal still runs: it has not ended within 5 s"]
    assert 5 <= (here.scheduler.now - begun) / 1e9 < 6
    place.server.server.close()
    soon(here)
    assert place.robots[-1].runner.cancelled.texts() == [
        "/REX/drive: a cancelled goal may still run: its server has left"
    ]
    restart(here, place)
    until(here, lambda: not place.robots[-1].runner.cancelled.actions())


def test_how_long_a_goal_waits_is_a_number_of_seconds(here: World, place: Place) -> None:
    with pytest.raises(ModelError, match="property wait_cancelled: expected a number of seconds, got 'soon'"):
        place.run(drive(wait_cancelled="soon"))


# ---- servers that leave ----------------------------------------------------------------------------------------------


def soon(here: World) -> None:
    """A moment, which is long enough for all that is on its way."""
    here.scheduler.run(here.scheduler.now + 200_000_000)


def until(here: World, condition: Callable[[], object]) -> None:
    """Not longer, in simulated time, too."""
    for _ in range(150):
        if not condition():
            soon(here)
    assert condition()


def restart(here: World, place: Place) -> None:
    """The driver ends, and another one comes that knows nothing of its goals."""
    place.server.server.close()
    soon(here)
    place.server = Server(here.node("driver", "REX"))


@pytest.mark.long_but("local*")
def test_a_goal_that_the_next_server_does_not_know_is_sent_again(here: World, place: Place) -> None:
    instance = place.run(drive("1"))
    until(here, lambda: place.server.goals)
    soon(here)
    restart(here, place)
    until(here, lambda: place.server.goals)
    place.server.step()
    assert place.end(instance).status == "completed"


@pytest.mark.long_but("local*")
@pytest.mark.parametrize("retry", ["never", "ask"])
def test_a_goal_may_be_lost_instead(here: World, place: Place, retry: str) -> None:
    instance = place.run(drive("1", retry=retry))
    until(here, lambda: place.server.goals)
    soon(here)
    restart(here, place)
    end = place.end(instance)
    assert (end.status, end.error.code, place.server.goals) == ("failed", "lost", {})
    assert "act('drive'): its server does not know the goal, and its fate is unknown" in str(end.error)


@pytest.mark.long_but("local*")
def test_ask_waits_for_a_person_where_errors_are_held(here: World, place: Place) -> None:
    place.run(drive("1", retry="ask"), hold_errors=True)
    until(here, lambda: place.server.goals)
    soon(here)
    restart(here, place)
    until(here, lambda: place.robots[-1].incidents)
    assert place.robots[-1].incidents[0][:2] == ("t", "lost")


def back(here: World, place: Place) -> None:
    """The driver that was closed is back, with its goals."""
    old = place.server.server
    place.server.server = new = ActionServer(here.node("driver", "REX"), "drive", DRIVE, print, place.server._cancel)
    new.goals, new._results = old.goals, old._results
    for goal in new.goals.values():
        goal._server = new


def test_a_goal_goes_on_when_its_server_is_back(here: World, place: Place) -> None:
    instance = place.run(drive("2"))
    until(here, lambda: place.server.goals)
    place.server.step()
    soon(here)
    place.server.server.close()
    soon(here)
    back(here, place)
    soon(here)
    place.server.step()
    assert place.end(instance).status == "completed"


LIMIT = """<boundaryEvent id="late" attachedToRef="t"><timerEventDefinition><timeDuration>PT1S</timeDuration>
  </timerEventDefinition></boundaryEvent>"""
STOPPING = """<subProcess id="h" triggeredByEvent="true"><startEvent id="hs"><signalEventDefinition signalRef="S"/>
  </startEvent></subProcess>"""


@pytest.mark.long_but("local*")
@pytest.mark.parametrize("ending", [LIMIT, STOPPING], ids=["boundary timer", "event sub-process"])
def test_a_goal_that_was_cancelled_while_its_server_was_away_is_cancelled_when_that_is_back(
    here: World, place: Place, ending: str
) -> None:
    instance = place.run(drive("9", ending))
    here.connect(*["/stop"] * (ending is STOPPING))
    until(here, lambda: place.server.goals)
    soon(here)
    place.server.server.close()
    soon(here)
    place.stop.publish(fame.middleware.messages.create("std_msgs/msg/Empty"))
    assert place.end(instance).status == "completed"
    assert len(place.server.goals) == 1
    back(here, place)
    until(here, lambda: place.server.cancelled)
    assert place.server.goals == {}


@pytest.mark.long_but("local*")
def test_a_goal_that_was_cancelled_before_its_server_left_is_cancelled_when_that_is_back(
    here: World, place: Place
) -> None:
    """The request to cancel it gets no response: the server left with it."""
    instance = place.run(drive("9", ON_STOP))
    here.connect("/stop")
    until(here, lambda: place.server.goals)
    soon(here)
    place.server.server._ends[2].close()
    soon(here)  # until the graph of ROS lacks it
    later = DeferredResponse()
    deaf = here.node("driver", "REX").service("drive/_action/cancel_goal", CANCEL, lambda request: later)
    soon(here)
    place.stop.publish(fame.middleware.messages.create("std_msgs/msg/Empty"))
    assert place.end(instance).status == "completed"
    soon(here)
    deaf.close()
    place.server.server.close()
    soon(here)
    assert not place.server.cancelled
    back(here, place)
    until(here, lambda: place.server.cancelled)


@pytest.mark.long_but("local*")
def test_an_engine_that_ends_while_a_server_is_away_says_that_a_goal_may_still_run(here: World, place: Place) -> None:
    instance = place.run(drive("9", LIMIT))
    until(here, lambda: place.server.goals)
    soon(here)
    place.server.server.close()
    soon(here)
    place.end(instance)
    place.robots.pop().close()
    soon(here)
    name, why = (
        "/REX/drive/_action/cancel_goal",
        "closed while the server was away: what was to be cancelled may still run",
    )
    assert [text for text in here.warnings if text.startswith(name) and text.endswith(why)]


@pytest.mark.long_but("local*")
def test_a_server_that_leaves_before_it_accepts_a_goal_is_as_any(here: World, place: Place) -> None:
    place.server.server.close()
    soon(here)
    node, below, asked = here.node("driver", "REX"), "drive/_action", list[Any]()
    ends = [
        node.service(
            f"{below}/send_goal", f"{DRIVE}_SendGoal", lambda request: asked.append(DeferredResponse()) or asked[-1]
        ),
        node.service(f"{below}/get_result", f"{DRIVE}_GetResult", lambda request: DeferredResponse()),
        node.service(f"{below}/cancel_goal", "action_msgs/srv/CancelGoal", lambda request: None),
    ]
    instance = place.run(drive("1"))
    until(here, lambda: asked)
    for end in ends:
        end.close()
    restart(here, place)
    until(here, lambda: place.server.goals)
    place.server.step()
    assert place.end(instance).status == "completed"


@pytest.mark.long_but("local*")
@pytest.mark.parametrize(
    ("retry", "errors", "code"), [("safe", "", None), ("never", "", "lost"), ("never", "{lost: gone}", "gone")]
)
def test_a_request_whose_server_leaves_is_made_again_or_lost(
    here: World, place: Place, retry: str, errors: str, code: str | None
) -> None:
    node, asked = here.node("press", "REX"), list[Any]()
    silent = node.service("press", SET_BOOL, lambda request: asked.append(DeferredResponse()) or asked[-1])
    instance = place.run(model(properties(service="press", type=SET_BOOL, retry=retry, errors=errors)))
    until(here, lambda: asked)
    silent.close()
    soon(here)
    node.service("press", SET_BOOL, lambda request: asked.append(None))
    end = place.end(instance)
    assert (end.status, end.error and end.error.code) == ("failed" if code else "completed", code)
    assert len(asked) == (2 if retry == "safe" else 1)


@pytest.mark.long_but("local*")
@pytest.mark.parametrize(
    "said", [{"action": "drive", "type": DRIVE, "payload": "{distance: 1}"}, {"service": "blade", "type": SET_BOOL}]
)
def test_without_a_server_for_five_seconds_the_task_fails(here: World, place: Place, said: dict[str, str]) -> None:
    task, left = model(properties(**said)), list[Any]()
    node = here.node("driver2", "REX")
    soon(here)  # what leaves while a session of Zenoh begins to follow may stay known to it (`ZenohMiddleware.follow`)
    place.blades.close()
    soon(here)
    node.service("blade", SET_BOOL, lambda request: left.append(node.close()) or DeferredResponse())
    place.server.on_goal = lambda: left.append(place.server.server.close())
    instance = place.run(task)
    begun = here.scheduler.now
    until(here, lambda: "(it has had no server for " in place.robots[-1].waiting_tokens()[0].text)
    end = place.end(instance)
    assert (end.status, end.error.code, len(left)) == ("failed", "service", 1)
    assert here.scheduler.now - begun >= 5_000_000_000
    assert "no node offers the service" in str(end.error)


# ---- what is said before anything moves ------------------------------------------------------------------------------


def test_a_service_that_nobody_offers_fails_its_task_after_a_while() -> None:
    sim = fame.Simulation(read_text(model(properties(service="/gone", type="std_srvs/Empty")), file="m.bpmn"))
    sim.run()
    (instance,) = sim.instances
    assert (instance.status, sim.now) == ("failed", 5.0)
    assert "no node offers the service /gone" in str(instance.error)


def test_a_function_of_that_name_takes_the_place_of_a_ros_service() -> None:
    definitions = read_text(model(properties(service="blade", type=SET_BOOL)), file="m.bpmn")
    seen: list[Any] = []
    sim = fame.Simulation(definitions, services={"blade": lambda variables: seen.append(1)})
    sim.run()
    assert (sim.instances[0].status, seen) == ("completed", [1])


def test_an_unknown_type_is_refused_at_load() -> None:
    definitions = read_text(model(properties(action="drive", type="farm_msg/Drive")), file="m.bpmn")
    with pytest.raises(ModelError, match=r"m\.bpmn:\d+.*did you mean farm_msgs/action/Drive"):
        fame.Simulation(definitions)


def test_a_task_calls_either_a_service_or_an_action() -> None:
    assert "service and action" in refused(model(properties(service="a", action="b", type=DRIVE))).text


def test_the_check_looks_at_goals() -> None:
    from fame.check import check

    definitions = read_text(drive("far").replace("distance", "length"), file="m.bpmn")
    assert any("length" in str(finding) and "Drive_Goal" in str(finding) for finding in check(definitions))


@pytest.mark.parametrize("mapping", ["", '<camunda:outputParameter name="y">${message}</camunda:outputParameter>'])
def test_the_result_of_a_service_in_a_multi_instance_is_set_where_the_variable_is(mapping: str) -> None:
    """The fields of the response are for a mapping alone."""
    task = properties(service="/ask", type="std_srvs/srv/Trigger")
    if mapping:
        mapping = f"<camunda:inputOutput>{mapping}</camunda:inputOutput></extensionElements>"
        task = task.replace("</extensionElements>", mapping)
    task += "<multiInstanceLoopCharacteristics><loopCardinality>1</loopCardinality></multiInstanceLoopCharacteristics>"
    definitions = read_text(model(task, attributes='camunda:resultVariable="answer"'), file="m.bpmn")
    sim = fame.Simulation(definitions, variables={"answer": "before", "message": "before", "y": "before"})
    node = sim.middleware.node("server")
    node.service("/ask", "std_srvs/srv/Trigger", lambda request: {"success": True, "message": "asked"})
    sim.run()
    found = sim.instances[0].variables
    assert (found["answer"].message, found["message"]) == ("asked", "before")
    assert found["y"] == ("asked" if mapping else "before")
