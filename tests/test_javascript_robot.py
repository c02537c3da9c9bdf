"""What scripts in JavaScript do with their robot: topics, timers, services; callbacks and how long they live."""

from typing import Any

import pytest
from javascript_models import Peer, definitions, error_of, flows, run, simulate, task

import fame
from fame.bpmn.model import Expression
from fame.clock import SECOND
from fame.middleware.interface import DeferredResponse
from fame.scripting import effects_of
from fame.scripting.javascript import values

NODE = "const node = this.environment.variables.ros_node; "
VECTOR = "geometry_msgs/msg/Vector3"
ODOMETRY = "nav_msgs/msg/Odometry"


def odometry(*places: float) -> list[dict[str, Any]]:
    """Messages of a car on its way along x (m)."""
    return [{"pose": {"pose": {"position": {"x": x, "y": 2 * x, "z": 0.5}}}} for x in places]


# ---- the four patterns of the papers ---------------------------------------------------------------------------------


def test_pattern_1_a_script_publishes_once_and_finishes() -> None:
    simulation = simulate("""
        const robot = this.environment.variables.ros_node;
        robot.createPublisher("std_msgs/msg/ColorRGBA", "led").publish({r: 1.0, g: 0.0, b: 0.0, a: 0.0});
        next();""")
    peer = Peer(simulation).hear("/REX/led", "std_msgs/msg/ColorRGBA")
    assert simulation.run().instances[0].status == "completed"
    ((_, color),) = peer.heard
    assert (color.r, color.g, color.b, color.a) == (1.0, 0.0, 0.0, 0.0)


CLOSEST = """
    const v = this.environment.variables;
    const away = (x, y) => Math.hypot(x - v.x_target, y - v.y_target);
    if (v.closest == null || away(v.x_tractor, v.y_tractor) < away(v.x_closest, v.y_closest)) {
        v.closest = v.tractor_name;
        v.x_closest = v.x_tractor;
        v.y_closest = v.y_tractor;
    }
    next();"""


@pytest.mark.parametrize("order", [("far", "near", "middle"), ("near", "far", "middle"), ("middle", "far", "near")])
def test_pattern_2_a_script_keeps_the_closest_of_several_answers(order: tuple[str, ...]) -> None:
    places = {"far": 9.0, "middle": 5.0, "near": 1.0}
    answer = "const v = this.environment.variables; v.tractor_name = '{}'; v.x_tractor = {}; v.y_tractor = 0; next();"
    texts = [text for name in order for text in (answer.format(name, places[name]), CLOSEST)]
    assert run(*texts, x_target=0.5, y_target=0.0)["closest"] == "near"


POSITION = """
    const robot = this.environment.variables.ros_node;
    const subscription = robot.createSubscription("nav_msgs/msg/Odometry", "odom", (msg) => {
        this.environment.variables.my_x = msg.pose.pose.position.x;
        this.environment.variables.my_y = msg.pose.pose.position.y;
        this.environment.variables.my_z = msg.pose.pose.position.z;
        robot.destroySubscription(subscription);
    });
    next();"""


def test_pattern_3_a_callback_sets_variables_after_its_script_has_finished_and_destroys_its_subscription() -> None:
    look = "const v = this.environment.variables; v.early = 'my_x' in v; next()"
    simulation = simulate(POSITION, "setTimeout(next, 500)", look, "setTimeout(next, 5000)")
    Peer(simulation).say("odom", ODOMETRY, *odometry(1.5, 2.5, 3.5))
    variables = simulation.run().instances[0].variables
    assert (variables["my_x"], variables["my_y"], variables["my_z"]) == (1.5, 3, 0.5)
    assert variables["early"] is False


def test_pattern_4_a_script_publishes_a_nested_message_once_and_finishes() -> None:
    simulation = simulate("""
        const robot = this.environment.variables.ros_node;
        const publisher = robot.createPublisher("geometry_msgs/msg/Wrench", "blade_force");
        publisher.publish({force: {x: 0.0, y: 0.0, z: 0.0}, torque: {x: 0.0, y: 0.0, z: 1.0}});
        next();""")
    peer = Peer(simulation).hear("/REX/blade_force", "geometry_msgs/msg/Wrench")
    simulation.run()
    assert [message.torque.z for _, message in peer.heard] == [1.0]


# ---- topics ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("topic", "full"), [("led", "/REX/led"), ("/led", "/led"), ("~/led", "/REX/led"), ("arm/led", "/REX/arm/led")]
)
def test_topics_are_relative_to_the_namespace_of_the_robot(topic: str, full: str) -> None:
    simulation = simulate(f"{NODE}node.createPublisher('std_msgs/msg/Bool', '{topic}').publish({{data: true}}); next()")
    peer = Peer(simulation).hear(full, "std_msgs/msg/Bool")
    simulation.run()
    assert [message.data for _, message in peer.heard] == [True]


def test_the_namespace_is_that_of_ros() -> None:
    text = "this.environment.variables.y = [node.namespace(), node.name()]; next()"
    assert run(NODE + text)["y"] == ["/REX", "REX"]


@pytest.mark.parametrize(
    ("type", "given", "field", "value"),
    [
        ("std_msgs/msg/String", "'bare'", "data", "bare"),
        ("std_msgs/msg/Float64", "{data: NaN}", "data", pytest.approx(float("nan"), nan_ok=True)),
        ("sensor_msgs/msg/Range", "{range: Infinity}", "range", float("inf")),
        ("std_msgs/msg/String", "", "data", ""),
        ("std_msgs/msg/String", "{data: undefined}", "data", ""),
        ("std_msgs/msg/String", "{data: 'na\\u00efve \\u{1f69c}'}", "data", "naïve 🚜"),
        (VECTOR, "{x: 1, y: undefined}", "x", 1.0),
    ],
)
def test_objects_become_messages_of_the_type(type: str, given: str, field: str, value: Any) -> None:
    simulation = simulate(f"this.environment.variables.node.createPublisher('{type}', 'out').publish({given}); next()")
    peer = Peer(simulation).hear("out", type)
    simulation.run()
    assert getattr(peer.heard[0][1], field) == value


def test_messages_are_plain_objects_with_plain_arrays() -> None:
    simulation = simulate("""
        this.environment.variables.node.createSubscription("sensor_msgs/msg/LaserScan", "scan", {depth: 5}, (msg) => {
            const {ranges, header} = msg;
            this.environment.variables.y = [Array.isArray(ranges), ranges.map((r) => r * 2), header.frame_id,
                                            msg.constructor === Object];
            next();
        });""")
    Peer(simulation).say(
        "scan", "sensor_msgs/msg/LaserScan", {"ranges": [0.5, float("inf")], "header": {"frame_id": "f"}}
    )
    assert simulation.run().instances[0].variables["y"] == [True, [1, float("inf")], "f", True]


def test_what_a_script_publishes_reaches_events_and_subscriptions_of_its_own_robot() -> None:
    hear = "node.createSubscription('std_msgs/msg/String', '/found', (m) => { node.heard = m.data; }); next()"
    content = (
        '<intermediateCatchEvent id="c"><extensionElements><camunda:properties>'
        '<camunda:property name="type" value="std_msgs/msg/String"/></camunda:properties></extensionElements>'
        '<signalEventDefinition signalRef="S"/></intermediateCatchEvent>'
        '<parallelGateway id="g"/><parallelGateway id="j"/><startEvent id="s"/><endEvent id="e"/>'
        + task("hear", NODE + hear)
        + task("say", f"{NODE}node.createPublisher('std_msgs/msg/String', '/found').publish('weed'); next()")
        + task("tell", f"{NODE}setTimeout(() => {{ this.environment.variables.y = node.heard; next() }}, 5)")
        + flows("s", "hear", "g", "c", "j", "tell", "e") + flows("g", "say", "j")
    )  # fmt: skip
    simulation = fame.Simulation(definitions(content, '<signal id="S" name="found"/>'), robot="REX").run()
    assert simulation.instances[0].status == "completed"
    assert simulation.instances[0].variables["y"] == "weed"


def test_topics_and_services_that_scripts_name_are_known_before_they_run() -> None:
    text = """// two of them
        const led = node.createPublisher( "std_msgs/msg/ColorRGBA", 'led');
        node.createSubscription(`nav_msgs/msg/Odometry`, "~/odom", (msg) => {});
        node.createClient("std_srvs/srv/Trigger", "/stop");
        node.createPublisher(type, "unknown")"""
    assert [
        (use.name, use.direction, use.type, use.line)
        for use in effects_of(Expression(text, "javascript", 7), script=True).topics
    ] == [
        ("led", "publish", "std_msgs/msg/ColorRGBA", 8),
        ("~/odom", "subscribe", "nav_msgs/msg/Odometry", 9),
        ("/stop", "call", "std_srvs/srv/Trigger", 10),
    ]
    simulation = simulate(
        "setTimeout(next, 1)", "node.createPublisher('std_msgs/msg/Bool', 'led').publish(true); next()"
    )
    assert "/REX/led" in [info.name for info in simulation.middleware.graph()]


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("\nnode.createPublisher('std_msgs/msg/ColorRGBA', 'led').publish({red: 1});", 5, "red: there is no such"),
        ("node.createPublisher('std_msgs/msg/Bool', 'led')\n.publish({data: [1]});", 5, "std_msgs/msg/Bool: data"),
        ("\n\nnode.createPublisher('std_msgs/msg/Colour', 'led');", 6, "std_msgs/msg/Colour"),
        ("\n node.createSubscription('no/msg/Thing', 'odom', () => {});", 5, "no/msg/Thing"),
        ("\nnode.createClient('no/srv/Thing', 'odom');", 5, "no/srv/Thing"),
        ("node.createPublisher('std_msgs/msg/Bool', 'a');\nnode.createPublisher('std_msgs/msg/Char', 'a').publish(1);",
         5, "std_msgs/msg/Char"),
    ],
)  # fmt: skip
def test_a_wrong_type_or_field_is_an_error_of_the_script_at_its_line(text: str, line: int, complaint: str) -> None:
    error = error_of(f"{NODE}{text} next()")
    assert error.line == line
    assert complaint in error.text


# ---- timers and polling ----------------------------------------------------------------------------------------------


def test_timers_run_on_the_clock_of_the_engine() -> None:
    simulation = simulate("""
        const v = this.environment.variables;
        v.rang = [];
        setTimeout((a, b) => v.rang.push([Date.now(), a + b]), 20, 1, 2);
        clearTimeout(setTimeout(() => v.rang.push('never'), 10));
        setTimeout(() => v.rang.push(Date.now()), 0);
        setTimeout(next, 1500.5);""").run()
    assert simulation.instances[0].variables["rang"] == [1, [20, 3]]
    assert simulation.now == 1.5005


def test_a_polling_loop_waits_without_blocking_until_a_variable_is_set() -> None:
    poll = """
        const v = this.environment.variables;
        v.looks = 0;
        const look = () => { v.looks += 1; if (v.my_x > 2) next(); else setTimeout(look, 2000); };
        look();"""
    follow = """
        this.environment.variables.ros_node.createSubscription("nav_msgs/msg/Odometry", "odom", (msg) => {
            this.environment.variables.my_x = msg.pose.pose.position.x;
        });
        next();"""
    simulation = simulate(follow, poll)
    Peer(simulation).say("odom", ODOMETRY, *odometry(0.5, 1.0, 1.5, 2.0, 2.5, 3.0))
    (instance,) = simulation.run(until=30).instances
    assert (instance.status, instance.variables["looks"], instance.variables["my_x"]) == ("completed", 4, 2.5)


def test_a_script_that_waits_says_for_what() -> None:
    simulation = simulate("this.environment.variables.node.createSubscription('std_msgs/msg/Bool', 'go', () => next())")
    assert simulation.run().instances[0].waiting == ["t1"]
    assert [wait.text for wait in simulation.node.waiting_tokens()] == ["a callback to call next()"]


def test_a_conditional_event_sees_what_a_callback_sets() -> None:
    content = (
        task("t", POSITION)
        + '<startEvent id="s"/><endEvent id="e"/><intermediateCatchEvent id="c"><conditionalEventDefinition>'
        "<condition>my_x > 1</condition></conditionalEventDefinition></intermediateCatchEvent>"
        + flows("s", "t", "c", "e")
    )
    simulation = fame.Simulation(definitions(content), robot="REX")
    Peer(simulation).say("odom", ODOMETRY, *odometry(1.5))
    assert simulation.run().instances[0].status == "completed"


# ---- services --------------------------------------------------------------------------------------------------------

ASK = """
    const v = this.environment.variables, client = v.ros_node.createClient("std_srvs/srv/SetBool", "arm");
    client.waitForService(3000).then((there) => {
        v.there = there;
        v.at = Date.now();
        if (there) client.sendRequest({data: true}, (response) => { v.response = response; next(); });
        else next();
    });"""


def offer(simulation: fame.Simulation, after: float) -> None:
    """Offer the service after so many seconds."""
    node = simulation.middleware.node("gripper", "REX")

    def answer(request: Any) -> dict[str, Any]:
        return {"success": request.data, "message": "armed"}

    simulation.scheduler.at(round(after * 1e9), lambda: node.service("arm", "std_srvs/srv/SetBool", answer))


@pytest.mark.parametrize("after", [0.0, 1.23])
def test_a_service_is_waited_for_and_asked(after: float) -> None:
    simulation = simulate(ASK)
    offer(simulation, after)
    variables = simulation.run().instances[0].variables
    assert (variables["there"], variables["response"]) == (True, {"success": True, "message": "armed"})
    assert after * 1000 <= variables["at"] < after * 1000 + 100


def test_a_service_that_does_not_come_is_waited_for_no_longer_than_said() -> None:
    simulation = simulate(ASK).run()
    assert simulation.instances[0].variables == {"there": False, "at": 3000}


def test_a_service_is_waited_for_in_an_async_function_too() -> None:
    simulation = simulate("""
        async function ask() {
            const client = this.environment.variables.node.createClient("std_srvs/srv/SetBool", "arm");
            await client.waitForService(1000);
            client.sendRequest({data: false}, ({success}) => { this.environment.variables.y = success; next(); });
        }
        ask();""")
    offer(simulation, 0.5)
    assert simulation.run().instances[0].variables["y"] is False


# ---- servers that leave ----------------------------------------------------------------------------------------------

SWITCH = """
    const v = this.environment.variables;
    const client = v.node.createClient("std_srvs/srv/SetBool", "arm");
    client.sendRequest({data: true}, (response) => { v.y = response; next(); });"""


class Arm:
    """A server that answers nothing, or at once."""

    def __init__(self, simulation: fame.Simulation) -> None:
        self.node, self.heard = simulation.middleware.node("gripper", "REX"), list[Any]()
        self.service: Any = None

    def come(self, silent: bool = False) -> None:
        def answer(request: Any) -> Any:
            self.heard.append(request.data)
            return DeferredResponse() if silent else {"success": True, "message": "armed"}

        self.service = self.node.service("arm", "std_srvs/srv/SetBool", answer)

    def leave(self) -> None:
        self.service.close()


def test_a_request_without_a_server_is_the_error_service_after_a_while() -> None:
    simulation = simulate(SWITCH).run()
    error = simulation.instances[0].error
    assert (simulation.instances[0].status, error.code) == ("failed", "service")
    assert "no node offers the service /REX/arm" in error.text
    assert simulation.now == 5


def test_a_request_waits_for_a_server_that_comes_later() -> None:
    simulation = simulate(SWITCH)
    arm = Arm(simulation)
    simulation.scheduler.at(3 * SECOND, arm.come)
    assert simulation.run().instances[0].variables["y"]["message"] == "armed"


@pytest.mark.parametrize("back", [2, 9])
def test_a_request_is_made_again_when_its_server_left_and_fails_if_none_comes(back: int) -> None:
    simulation = simulate(SWITCH)
    arm = Arm(simulation)
    arm.come(silent=True)
    simulation.scheduler.at(1 * SECOND, arm.leave)
    simulation.scheduler.at(back * SECOND, arm.come)
    (instance,) = simulation.run().instances
    assert arm.heard == ([True, True] if back == 2 else [True])
    assert (instance.status, instance.error and instance.error.code) == (
        ("completed", None) if back == 2 else ("failed", "service")
    )


@pytest.mark.parametrize("retry", ["never", "ask"])
def test_the_property_retry_of_its_task_decides_on_a_lost_request(retry: str) -> None:
    kept = '<extensionElements><c:properties xmlns:c="http://camunda.org/schema/1.0/bpmn"><c:property name="retry" '
    kept += f'value="{retry}"/></c:properties></extensionElements>'
    text = task("t1", SWITCH).replace("<script>", f"{kept}<script>")
    content = f'{text}<startEvent id="s"/><endEvent id="e"/>{flows("s", "t1", "e")}'
    simulation = fame.Simulation(definitions(content), robot="REX")
    arm = Arm(simulation)
    arm.come(silent=True)
    simulation.scheduler.at(1 * SECOND, arm.leave)
    simulation.scheduler.at(2 * SECOND, arm.come)
    error = simulation.run().instances[0].error
    assert (error.code, arm.heard) == ("lost", [True])
    assert "call('arm'): its server left before it answered, and its fate is unknown" in error.text


# ---- how long callbacks live -----------------------------------------------------------------------------------------

COUNT = """
    const v = this.environment.variables;
    v.count = 0;
    v.subscription = v.node.createSubscription("nav_msgs/msg/Odometry", "odom", () => { v.count += 1; });
    next();"""


def test_a_callback_runs_until_another_script_destroys_its_subscription() -> None:
    destroy = "const v = this.environment.variables; v.node.destroySubscription(v.subscription); next()"
    simulation = simulate(COUNT, "setTimeout(next, 3500)", destroy, "setTimeout(next, 3000)")
    Peer(simulation).say("odom", ODOMETRY, *odometry(*range(8)))
    assert simulation.run().instances[0].variables == {"count": 3}


def test_a_message_is_put_into_text_once_for_all_subscriptions(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    monkeypatch.setattr(values, "encode", lambda value, encode=values.encode: told.append(value) or encode(value))
    simulation = simulate("this.environment.variables.count = 0; next()", *[COUNT.replace("v.count = 0;", "")] * 5,
                          "setTimeout(next, 3500)")  # fmt: skip
    Peer(simulation).say("odom", ODOMETRY, *odometry(*range(8)))
    assert simulation.run().instances[0].variables == {"count": 15}
    assert len([value for value in told if hasattr(value, "__msgtype__")]) == 3


def test_callbacks_and_timers_end_with_their_process() -> None:
    forever = "const tick = () => { this.environment.variables.node.name(); setTimeout(tick, 1000) }; tick(); next()"
    simulation = simulate(COUNT, forever, "setTimeout(next, 2500)")
    Peer(simulation).say("odom", ODOMETRY, *odometry(*range(8)))
    (instance,) = simulation.run().instances
    assert instance.variables == {"count": 2}
    assert simulation.node.host.scripts.javascript.realms == []
    assert simulation.now == 8.0


def test_each_process_instance_has_a_context_of_its_own() -> None:
    text = "globalThis.seen = (globalThis.seen ?? 0) + 1; this.environment.variables.y = globalThis.seen; next()"
    simulation = simulate(text).run()
    simulation.start()
    assert [instance.variables["y"] for instance in simulation.run().instances] == [1, 1]


def test_a_called_process_with_variables_of_its_own_takes_its_callbacks_with_it() -> None:
    called = f'<process id="Called" isExecutable="false"><startEvent id="cs"/>{task("ct", COUNT)}<endEvent id="ce"/>' \
        f'{flows("cs", "ct", "wait", "ce")}{task("wait", "setTimeout(next, 1500)")}</process>'  # fmt: skip
    content = (
        '<startEvent id="s"/><endEvent id="e"/><callActivity id="c" calledElement="Called"><extensionElements>'
        '<camunda:in source="nothing" target="unused"/><camunda:out source="count" target="counted"/>'
        f"</extensionElements></callActivity>{flows('s', 'c', 'last', 'e')}{task('last', 'setTimeout(next, 3000)')}"
    )
    simulation = fame.Simulation(definitions(content, called), "P", robot="REX", variables={"nothing": 0})
    Peer(simulation).say("odom", ODOMETRY, *odometry(*range(8)))
    assert simulation.run().instances[0].variables["counted"] == 1


def timed_out(text: str) -> fame.Simulation:
    """A script with a boundary timer of 3 s, then another script that waits until second 10."""
    content = (
        f"{task('t', text)}{task('later', 'setTimeout(next, 7000)')}"
        '<startEvent id="s"/><endEvent id="e"/><endEvent id="late"/>'
        f'{flows("s", "t", "e")}{flows("b", "later", "late")}<boundaryEvent id="b" attachedToRef="t">'
        "<timerEventDefinition><timeDuration>PT3S</timeDuration></timerEventDefinition></boundaryEvent>"
    )
    return fame.Simulation(definitions(content), robot="REX")


def test_a_cancelled_script_loses_its_timers_and_subscriptions() -> None:
    simulation = timed_out("""
        const v = this.environment.variables;
        v.ticks = v.count = 0;
        v.node.createSubscription("nav_msgs/msg/Odometry", "odom", () => { v.count += 1; });
        const tick = () => { v.ticks += 1; if (v.ticks > 100) next(); else setTimeout(tick, 1000); };
        setTimeout(tick, 1000);""")
    Peer(simulation).say("odom", ODOMETRY, *odometry(*range(9)))
    (instance,) = simulation.run().instances
    assert instance.visits["late"] == 1
    assert instance.variables["ticks"] in (2, 3)
    assert instance.variables["count"] == 3
    assert simulation.now == 10.0


def test_a_script_that_an_original_handler_suspends_starts_again_afterwards() -> None:
    content = (
        task("t", "const v = this.environment.variables; v.starts = (v.starts ?? 0) + 1; setTimeout(next, 4000)")
        + f'<startEvent id="s"/><endEvent id="e"/>{flows("s", "t", "e")}'
        + '<subProcess id="h" triggeredByEvent="true"><extensionElements><camunda:properties>'
        '<camunda:property name="resume" value="true"/></camunda:properties></extensionElements>'
        '<startEvent id="hs"><signalEventDefinition signalRef="S"/></startEvent><endEvent id="he"/>'
        + task("ht", "setTimeout(next, 1000)") + flows("hs", "ht", "he") + "</subProcess>"
    )  # fmt: skip
    simulation = fame.Simulation(definitions(content, '<signal id="S" name="weed"/>'), robot="REX").run(until=2)
    simulation.signal("weed")
    (instance,) = simulation.run().instances
    assert (instance.status, instance.variables["starts"], simulation.now) == ("completed", 2, 7.0)


def test_a_script_may_hand_its_next_to_another() -> None:
    content = (
        task("waits", "const v = this.environment.variables; v.go = (n) => { v.y = n; next(); };")
        + task("frees", "setTimeout(() => { this.environment.variables.go(7); next() }, 1000)")
        + '<startEvent id="s"/><endEvent id="e"/><parallelGateway id="g"/><parallelGateway id="j"/>'
        + flows("s", "g", "waits", "j", "e") + flows("g", "frees", "j")
    )  # fmt: skip
    (instance,) = fame.Simulation(definitions(content), robot="REX").run().instances
    assert (instance.status, instance.variables) == ("completed", {"y": 7})


def test_a_script_whose_last_callback_another_one_destroys_fails() -> None:
    content = (
        task("waits", f"{NODE}node.sub = node.createSubscription('std_msgs/msg/Bool', 'go', () => next());")
        + task("kills", f"{NODE}setTimeout(() => {{ node.destroySubscription(node.sub); next() }}, 1000)")
        + '<startEvent id="s"/><endEvent id="e"/><parallelGateway id="g"/><parallelGateway id="j"/>'
        + flows("s", "g", "waits", "j", "e") + flows("g", "kills", "j")
    )  # fmt: skip
    (instance,) = fame.Simulation(definitions(content), robot="REX").run().instances
    assert instance.error is not None
    assert instance.error.element == "waits"
    assert "lost the last callback that could have called next()" in instance.error.text


# ---- errors in callbacks ---------------------------------------------------------------------------------------------

LATE = """
    const node = this.environment.variables.node;
    node.createSubscription("nav_msgs/msg/Odometry", "odom", (msg) => {
        msg.missing.x;
    });
    next();"""


def test_an_error_in_a_callback_of_a_finished_script_fails_the_process_with_its_line() -> None:
    simulation = simulate(LATE, "setTimeout(next, 5000)")
    Peer(simulation).say("odom", ODOMETRY, *odometry(1.0, 2.0))
    (instance,) = simulation.run().instances
    assert instance.status == "failed"
    assert instance.error is not None
    assert (instance.error.element, instance.error.line, simulation.now) == ("t1", 7, 2.0)


def handled(inner: str) -> fame.Simulation:
    """A sub-process with that script and a boundary event for its errors; and one around it."""
    content = (
        '<subProcess id="sub"><startEvent id="i"/><endEvent id="o"/>'
        + task("t", inner) + task("w", "setTimeout(next, 5000)") + flows("i", "t", "w", "o")
        + '</subProcess><boundaryEvent id="b" attachedToRef="sub"><errorEventDefinition/></boundaryEvent>'
        '<startEvent id="s"/><endEvent id="e"/><endEvent id="caught"/>' + flows("s", "sub", "e") + flows("b", "caught")
    )  # fmt: skip
    simulation = fame.Simulation(definitions(content), robot="REX")
    Peer(simulation).say("odom", ODOMETRY, *odometry(1.0, 2.0))
    return simulation.run()


def test_an_error_in_a_callback_of_a_finished_script_is_caught_around_its_scope() -> None:
    (instance,) = handled(LATE).instances
    assert (instance.status, instance.visits["caught"], instance.visits["e"]) == ("completed", 1, 0)


def test_a_wrong_publish_in_a_callback_is_such_an_error() -> None:
    text = LATE.replace("msg.missing.x", "node.createPublisher('std_msgs/msg/Bool', 'out').publish({on: 1})")
    assert handled(text).instances[0].visits["caught"] == 1


def test_an_error_of_a_callback_whose_scope_has_ended_is_reported() -> None:
    """Nobody serves the request of a called process, which is over when that is known."""
    ask = (
        "this.environment.variables.node.createClient('std_srvs/srv/SetBool', 'arm').sendRequest({}, () => {}); next()"
    )
    called = f'<process id="Called" isExecutable="false"><startEvent id="cs"/>{task("ct", ask)}<endEvent id="ce"/>' \
        f'{flows("cs", "ct", "ce")}</process>'  # fmt: skip
    content = (
        '<startEvent id="s"/><endEvent id="e"/><callActivity id="c" calledElement="Called"><extensionElements>'
        '<camunda:in source="nothing" target="unused"/></extensionElements></callActivity>'
        f"{flows('s', 'c', 'last', 'e')}{task('last', 'setTimeout(next, 9000)')}"
    )
    simulation = fame.Simulation(definitions(content, called), "P", robot="REX", variables={"nothing": 0})
    assert simulation.run().instances[0].status == "completed"
    (told,) = [event.detail for event in simulation.reports]
    assert told.startswith("a callback failed after its scope had ended: error service was not caught: ")
    assert "no node offers the service /REX/arm" in told


def test_callbacks_without_end_at_one_instant_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.scripting.javascript.source.AT_ONE_INSTANT", 1000)
    text = """
        const node = this.environment.variables.node;
        const echo = node.createPublisher("std_msgs/msg/Bool", "echo");
        node.createSubscription("std_msgs/msg/Bool", "echo", (msg) => echo.publish(msg));
        echo.publish(true);
        next();"""
    (instance,) = simulate(text, "setTimeout(next, 1000)").run().instances
    assert instance.error is not None
    assert "1000 callbacks at one moment" in instance.error.text
