"""Topics that scripts name literally are known before the script runs."""

from fame.bpmn.model import Expression
from fame.scripting import ScriptTopic, effects_of


def test_literal_topics_are_found_in_the_order_of_the_text() -> None:
    text = """
robot.publish("cmd_vel", "geometry_msgs/msg/Twist", linear={"x": 1.0})
m = await receive("odom", timeout=1)
n = await receive("/clock", type="rosgraph_msgs/msg/Clock")
async for scan in robot.subscribe("scan", "sensor_msgs/msg/LaserScan", queue=3):
    if robot.latest("range").range < 0.5: signal("target_found", {"x": 1})
    await robot.call("arm", "std_srvs/srv/SetBool", data=True)
    signal("~/alarm")
"""
    assert effects_of(Expression(text, line=10), script=True).topics == (
        ScriptTopic("cmd_vel", "publish", "geometry_msgs/msg/Twist", 11),
        ScriptTopic("odom", "subscribe", None, 12),
        ScriptTopic("/clock", "subscribe", "rosgraph_msgs/msg/Clock", 13),
        ScriptTopic("scan", "subscribe", "sensor_msgs/msg/LaserScan", 14),
        ScriptTopic("range", "subscribe", None, 15),
        ScriptTopic("/target_found", "publish", None, 15),
        ScriptTopic("arm", "call", "std_srvs/srv/SetBool", 16),
        ScriptTopic("~/alarm", "publish", None, 17),
    )


def test_a_topic_is_told_once_and_computed_names_not_at_all() -> None:
    text = "robot.latest('a')\nrobot.latest('a')\nrobot.latest(name)\nother.publish('b', 'c')\npublish('d')\nreceive()"
    assert effects_of(Expression(text), script=True).topics == (ScriptTopic("a", "subscribe", None, 1),)


def test_of_computed_names_it_is_known_how_they_begin() -> None:
    text = "signal(f'{x}'); signal('goal_' + x); robot.publish(f'led_{x}'); robot.latest(f'/a/b{x}'); receive('%d' % x)"
    computed = {("publish", ""), ("publish", "/goal_"), ("publish", "~/led_"), ("subscribe", "/a/b"), ("subscribe", "")}
    assert effects_of(Expression(text), script=True).computed == computed
    assert effects_of(Expression("signal('a'); robot.now; receive(topic='b')"), script=True).computed == frozenset()
    javascript = "node.createPublisher('std_msgs/msg/Bool', 'led_' + n); node.createSubscription(T, 'b', f)"
    effects = effects_of(Expression(javascript, "javascript"), script=True)
    assert (effects.topics, effects.computed) == ((), {("publish", ""), ("subscribe", "")})


def test_other_languages_and_wrong_python_name_none() -> None:
    assert effects_of(Expression("${x}", "juel")).topics == ()
    assert effects_of(Expression("receive = = 1"), script=True).topics == ()
