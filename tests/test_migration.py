"""What runs goes over to a changed model: tokens, subscriptions, variables, timers; all robots or none."""

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "conformance"))

from deployment_field import Field, definitions, made, process as bpmn_process
from engine_models import (
    Run,
    boundary,
    call,
    catch,
    element,
    end,
    gateway,
    handler,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

import fame
from fame.clock import SECOND
from fame.deploy.migration import plan_of, read_plan
from fame.errors import ConfigError, MissionError, ModelError
from fame.middleware import messages
from fame.robot.events import Event
from fame.robot.state_transfer import go_on_after, timers_of, transfer_state, what_becomes
from fame.scenario import Scenario
from fame.scenario.migrating import migrate_run
from fame.scenario.run import Run as ScenarioRun


class Migrated:
    """A run of a changed model that has taken over the state of another one, at the same time."""

    def __init__(self, old: Run, content: str, plan: Mapping[str, Any] | None = None) -> None:
        changed = model(*content.replace("</process><process", "</process>\0<process").split("\0"))
        self.events: list[Event] = []
        self.simulation = fame.Simulation(changed, "P", observer=self.events.append)
        self.simulation.scheduler.now = old.simulation.scheduler.now
        self.simulation._begun = True
        self.node = self.simulation.node
        old.node.hold()
        timers = timers_of(old.node)
        self.tokens = transfer_state(self.node, old.node, plan_of(plan or {}))
        go_on_after(self.node, timers)
        self.simulation.run(old.simulation.now)

    @property
    def instance(self) -> Any:
        return self.simulation.instances[-1]

    @property
    def waiting(self) -> list[str]:
        return list(self.instance.waiting)


TWO = start() + user("a") + user("b") + end() + path("s a b e")


def test_a_token_stays_at_the_element_of_its_id_and_goes_the_new_way() -> None:
    old = Run(TWO, {"x": 1}).run()
    new = Migrated(old, start() + user("a") + script("k", "y = x + 1") + user("c") + end() + path("s a k c e"))
    assert (new.waiting, [str(token) for token in new.tokens]) == (["a"], ["a: keep"])
    new.simulation.complete("a")
    assert (new.waiting, new.instance.variables["y"]) == (["c"], 2)
    assert new.instance.visits == {"s": 1, "a": 1, "k": 1}


def test_what_is_gone_blocks_unless_the_plan_says_what_becomes_of_it() -> None:
    old = Run(TWO).run()
    content = start() + user("z") + user("b") + end() + path("s z b e")
    with pytest.raises(MissionError, match="a: the new model has no element a"):
        Migrated(old, content)
    assert old.waiting == ["a"]
    assert Migrated(old, content, {"elements": {"a": {"to": "z"}}}).waiting == ["z"]
    assert Migrated(Run(TWO).run(), content, {"elements": {"a": "abandon"}}).instance.status == "completed"


def test_an_element_of_another_kind_begins_there_if_the_plan_says_so() -> None:
    content = start() + script("a", "x = 7") + user("b") + end() + path("s a b e")
    with pytest.raises(MissionError, match="a: a is a script task, not a user task"):
        Migrated(Run(TWO).run(), content)
    new = Migrated(Run(TWO).run(), content, {"elements": {"a": {"to": "a"}}})
    assert (new.waiting, new.instance.variables["x"]) == (["b"], 7)


def test_a_plan_that_puts_a_token_at_a_boundary_event_is_refused() -> None:
    content = TWO + boundary("x", "b", signal("A"), interrupting=False)
    with pytest.raises(MissionError, match="a: x is a boundary event signal, not a user task"):
        Migrated(Run(content).run(), content, {"elements": {"a": {"to": "x"}}})


def test_a_catching_event_keeps_its_place_and_listens_on_its_new_topic() -> None:
    old = Run(start() + catch("c", signal("A")) + end() + path("s c e")).run()
    new = Migrated(old, start() + catch("c", signal("B")) + end() + path("s c e"))
    new.simulation.signal("B")
    assert new.instance.status == "completed"


def test_a_timer_keeps_the_time_that_it_was_set_for() -> None:
    old = Run(start() + catch("c", timer("PT10S")) + end() + path("s c e")).run(4)
    new = Migrated(old, start() + catch("c", timer("PT60S")) + user("u") + end() + path("s c u e"))
    assert new.simulation.run(9.9).instances[0].waiting == ["c"]
    assert new.simulation.run(10.1).instances[0].waiting == ["u"]


def test_boundary_events_and_event_sub_processes_are_closed_and_opened() -> None:
    old = Run(TWO + boundary("x", "a", signal("A")) + end("xe") + path("x xe")).run()
    more = boundary("y", "a", signal("B"), interrupting=False) + script("k", "n = 1") + path("y k")
    event = handler("h", start("hs", signal("C"), interrupting=False) + script("m", "m = 1") + path("hs m"))
    new = Migrated(old, TWO + more + event)
    new.simulation.signal("B")
    new.simulation.signal("C")
    assert (new.waiting, new.instance.variables["n"], new.instance.variables["m"]) == (["a"], 1, 1)
    assert set(new.node.engine.listeners) == {"/B", "/C"}


def test_an_activity_that_repeats_now_is_of_another_kind() -> None:
    inner = start("t") + user("a") + path("t a")
    loop = "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    with pytest.raises(MissionError, match="p: p is a repeated embedded sub-process, not a embedded sub-process"):
        Migrated(Run(start() + sub("p", inner) + path("s p")).run(), start() + sub("p", loop, inner) + path("s p"))


def test_a_sub_process_gets_the_boundary_events_that_are_new() -> None:
    content = start() + sub("p", start("t"), user("a"), path("t a")) + path("s p")
    new = Migrated(Run(content).run(), content + boundary("y", "p", signal("B")) + user("b") + path("y b"))
    new.simulation.signal("B")
    assert new.waiting == ["b"]


def test_sub_processes_calls_and_loops_go_over_with_what_is_in_them() -> None:
    several = (
        "<multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality></multiInstanceLoopCharacteristics>"
    )
    inner = process(start("qs") + user("u") + end("qe") + path("qs u qe"), id="Q")
    content = (
        start() + call("c", "Q") + sub("p", start("ps") + element("userTask", "v", several) + path("ps v")) + end()
    )
    old = Run(model(process(content + path("s c p e")), inner)).run()
    renamed = content.replace('id="c"', 'id="d"') + user("w") + path("s d p w e")
    new = Migrated(old, process(renamed) + inner, {"elements": {"c": {"to": "d"}}})
    assert new.waiting == ["u"]
    new.simulation.complete("u")
    new.simulation.complete("v")
    assert new.waiting == ["v", "v"]
    for _ in range(2):
        new.simulation.complete("v")
    assert new.waiting == ["w"]


def test_each_token_of_a_repeated_activity_is_listed_once() -> None:
    several = (
        "<multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality></multiInstanceLoopCharacteristics>"
    )
    task = start() + element("userTask", "w", several) + path("s w")
    assert [str(token) for token in Migrated(Run(task).run(), task).tokens] == ["w: keep"] * 3
    inside = start() + sub("q", several, start("t"), user("w"), path("t w")) + path("s q")
    said = [str(token) for token in Migrated(Run(inside).run().complete("w"), inside).tokens]
    assert sorted(said) == ["q: keep", "q: keep", "w: keep", "w: keep"]
    mapped = task.replace(
        several,
        properties(x="1")
        .replace("properties>", "inputOutput>")
        .replace(
            '<camunda:property name="x" value="1"/>', '<camunda:inputParameter name="x">1</camunda:inputParameter>'
        ),
    )
    assert [str(token) for token in Migrated(Run(mapped).run(), mapped).tokens] == ["w: keep"]
    plan = {"elements": {"w": "restart"}}
    assert [str(token) for token in Migrated(Run(task).run(), task, plan).tokens] == ["w: restart"]


def test_arrivals_at_a_join_go_over_and_a_join_with_other_flows_blocks() -> None:
    fork = start() + gateway("parallel", "g") + user("a") + user("b") + gateway("parallel", "j") + end()
    old = Run(fork + path("s g a j e") + path("g b j")).run().complete("a")
    new = Migrated(old, fork + user("w") + path("s g a j w e") + path("g b j"))
    new.simulation.complete("b")
    assert new.waiting == ["w"]
    old = Run(fork + path("s g a j e") + path("g b j")).run().complete("a")
    with pytest.raises(MissionError, match="j: j is a parallel gateway with 3 incoming flows"):
        Migrated(old, fork + user("c") + path("s g a j e") + path("g b j") + path("g c j"))


@pytest.mark.parametrize("kind", ["parallel", "inclusive"])
def test_a_plan_moves_no_token_past_the_others_at_a_join(kind: str) -> None:
    content = start() + gateway(kind, "g") + user("a") + user("b") + gateway(kind, "j") + user("c") + end()
    content += path("s g a j c e") + path("g b j")
    old = Run(content).run()
    with pytest.raises(MissionError, match="j joins flows, and no token comes by one so"):
        Migrated(old, content, {"elements": {"a": {"to": "j"}}})
    assert old.waiting == ["a", "b"]


def test_an_event_based_gateway_waits_for_the_events_that_it_has_now() -> None:
    choice = start() + gateway("eventBased", "g") + catch("x", signal("A")) + end("xe") + path("s g x xe")
    old = Run(choice).run()
    new = Migrated(old, choice + catch("y", signal("B")) + user("u") + path("g y u"))
    new.simulation.signal("B")
    assert new.waiting == ["u"]


def test_queued_messages_go_over() -> None:
    typed = properties(queue="5", type="std_msgs/msg/Int32")
    content = start() + user("u") + catch("c", signal("A"), typed) + end() + path("s u c e")
    old = Run(content).run().signal("A", 7)
    new = Migrated(old, content.replace("<endEvent", user("w") + "<endEvent").replace('targetRef="e"', 'targetRef="w"'))
    new.simulation.complete("u")
    assert (new.waiting, new.instance.variables["A"]) == (["w"], 7)


def test_a_script_that_waits_starts_again_in_its_new_form_and_an_activity_can_begin_anew() -> None:
    old = Run(start() + script("a", "await sleep(60)\nx = 1") + end() + path("s a e")).run(5)
    new = Migrated(old, start() + script("a", "await sleep(2)\nx = 2") + end() + path("s a e"))
    assert new.simulation.run(8).instances[0].variables["x"] == 2
    inside = sub("p", start("ps") + user("u") + path("ps u")) + end() + path("s p e")
    old = Run(start() + inside).run()
    new = Migrated(
        old, start() + inside.replace('id="u"', 'id="w"').replace('Ref="u"', 'Ref="w"'), {"elements": {"p": "restart"}}
    )
    assert new.waiting == ["w"]


def test_variables_are_renamed_and_have_defaults_and_functions_stay() -> None:
    old = Run(start() + script("k", "def f(): return 3\nx = 1") + user("a") + end() + path("s k a e")).run()
    content = start() + script("k", "pass") + user("a") + script("z", "y = v + w + f()") + end() + path("s k a z e")
    plan = {"variables": {"x": {"rename": "v"}, "w": {"default": 10}}}
    new = Migrated(old, content, plan)
    new.simulation.complete("a")
    assert new.instance.variables["y"] == 14


def test_a_renamed_variable_replaces_one_that_has_its_new_name() -> None:
    for names in ("x = 1\nv = 2", "v = 2\nx = 1"):
        old = Run(start() + script("k", names) + user("a") + path("s k a")).run()
        new = Migrated(old, start() + user("a") + path("s a"), {"variables": {"x": {"rename": "v"}}})
        assert new.instance.variables == {"v": 1}


COMPENSATED = "<compensateEventDefinition/>"


def undone(handler: str, *, at: str = "w", tasks: str = "a") -> str:
    """Activities with handlers (if there is one), a user task, and a compensation event."""
    text = start() + user("w") + throw("t", COMPENSATED) + user("z") + end()
    for task in tasks.split():
        text += script(task) + (boundary(f"b{task}", task, COMPENSATED) if handler else "")
        text += element("userTask", f"{handler}{task}", isForCompensation="true") if handler else ""
        text += (
            element("association", f"x{task}", sourceRef=f"b{task}", targetRef=f"{handler}{task}") if handler else ""
        )
    return text + path(f"s {tasks} {'w t' if at == 'w' else 't'} z e")


def test_a_compensation_that_is_under_way_goes_over() -> None:
    for plan, undoing in (({}, "u"), ({"elements": {"ua": {"to": "va"}}}, "v"), ({"elements": {"ua": "restart"}}, "u")):
        old = Run(undone("u", at="t")).run()
        assert old.waiting == ["ua"]
        new = Migrated(old, undone(undoing, at="t").replace('id="z"', 'id="z" name="Z"'), plan)
        new.simulation.complete(f"{undoing}a")
        assert new.waiting == ["z"]
    with pytest.raises(MissionError, match="ua: the new model has no element ua"):
        Migrated(Run(undone("u", at="t")).run(), undone("v", at="t"))


def test_what_is_completed_is_undone_or_is_said_not_to_be() -> None:
    new = Migrated(Run(undone("u")).run(), undone("v"))
    new.simulation.complete("w")
    assert new.waiting == ["va"]
    for changed, why in (
        (undone(""), "a has no compensation handler in the new model"),
        (undone("u", tasks="b"), "the new model has no element a"),
    ):
        with pytest.raises(MissionError, match=f"a: is completed, and would never be undone: {why}"):
            Migrated(Run(undone("u")).run(), changed)
        new = Migrated(Run(undone("u")).run(), changed, {"elements": {"a": "abandon"}})
        assert sorted(token.fate for token in new.tokens) == ["abandon", "keep"]
        new.simulation.complete("w")
        assert new.waiting == ["z"]


def test_what_is_still_to_be_undone_while_another_compensation_runs_is_not_forgotten() -> None:
    old = Run(undone("u", at="t", tasks="a b")).run()
    assert old.waiting == ["ub"]
    with pytest.raises(MissionError, match="a: is completed, and would never be undone"):
        Migrated(old, undone("u", at="t", tasks="b"))
    new = Migrated(old, undone("u", at="t", tasks="b a"))
    new.simulation.complete("ub")
    assert new.waiting == ["ua"]


def test_what_is_completed_in_a_sub_process_is_undone_by_the_handler_that_there_is() -> None:
    def inner(own: bool) -> str:
        body = start("qs") + script("a") + boundary("ba", "a", COMPENSATED) + path("qs a")
        body += element("userTask", "ua", isForCompensation="true")
        body += element("association", "xa", sourceRef="ba", targetRef="ua")
        text = start() + sub("q", body) + user("w") + throw("t", COMPENSATED) + end() + path("s q w t e")
        outer = boundary("bq", "q", COMPENSATED) + element("userTask", "uq", isForCompensation="true")
        return text + (outer + element("association", "xq", sourceRef="bq", targetRef="uq") if own else "")

    for before, after, undoing in ((False, True, "uq"), (True, False, "ua")):
        new = Migrated(Run(inner(before)).run(), inner(after))
        new.simulation.complete("w")
        assert new.waiting == [undoing]


def test_a_preview_changes_nothing() -> None:
    old = Run(TWO).run()
    changed = fame.Simulation(model(start() + user("b") + path("s b")), "P", observer=lambda event: None)
    (token,), state = what_becomes(changed.node, old.node, plan_of({}))
    assert state is None
    assert str(token) == "a: the new model has no element a"
    assert old.complete("a").waiting == ["b"]


@pytest.mark.parametrize(("fate", "done"), [("restart", "abc"), ("abandon", "bc")])
def test_the_next_activity_of_a_sequential_ad_hoc_sub_process_starts_after_one_that_a_plan_ends(
    fate: str, done: str
) -> None:
    tasks = "".join(map(user, "abc"))
    content = start() + element("adHocSubProcess", "q", tasks, ordering="Sequential") + end() + path("s q e")
    new = Migrated(Run(content).run(), content, {"elements": {"a": fate}})
    for task in done:
        assert new.waiting == [task]
        new.simulation.complete(task)
    assert new.instance.status == "completed"


def test_what_is_new_is_armed_when_a_mission_that_was_suspended_continues() -> None:
    more = boundary("x", "a", signal("B"), interrupting=False) + script("k", "n = 1") + path("x k")
    timed = boundary("c", "a", timer("PT5S"), interrupting=False) + script("l", "l = 1") + path("c l")
    event = handler("h", start("hs", signal("C"), interrupting=False) + script("m", "m = 1") + path("hs m"))
    old = Run(TWO).run()
    old.node.suspension.suspend("somebody")
    new = Migrated(old, TWO + more + timed + event)
    for name in "BC":
        new.simulation.signal(name)
    new.simulation.run(4)
    assert "n" not in new.instance.variables
    new.node.suspension.go_on("somebody")
    for name in "BC":
        new.simulation.signal(name)
    new.simulation.run(5)
    assert [new.instance.variables.get(name) for name in "nlm"] == [1, 1, 1]
    assert new.waiting == ["a"]


def test_what_is_new_in_a_suspended_scope_is_armed_when_that_continues() -> None:
    event = handler("h", start("hs", signal("A")) + user("v") + path("hs v"), resume=True)
    inside = start("t") + user("a") + path("t a")
    content = start() + event + sub("p", inside) + path("s p")
    more = boundary("x", "p", signal("B"), interrupting=False) + boundary("c", "p", timer("PT5S"), interrupting=False)
    within = boundary("y", "a", signal("B"), interrupting=False)
    new = Migrated(Run(content).run(0).signal("A"), start() + event + sub("p", inside + within) + path("s p") + more)
    new.simulation.signal("B")
    new.simulation.run(6)
    assert sum(new.instance.visits[each] for each in "xyc") == 0
    new.simulation.complete("v")
    assert [new.instance.visits[each] for each in "xyc"] == [0, 0, 1]
    new.simulation.signal("B")
    assert [new.instance.visits[each] for each in "xyc"] == [1, 1, 1]


# ---- plans -----------------------------------------------------------------------------------------------------------


def test_a_plan_is_read_from_yaml(tmp_path: Path) -> None:
    text = "elements:\n  a: {to: b}\n  c: restart\n  d: abandon\nvariables:\n  x: {rename: y}\n  z: {default: [1]}\n"
    (tmp_path / "plan.yaml").write_text(text)
    plan = plan_of(read_plan(tmp_path / "plan.yaml"))
    assert (plan.to, plan.restart, plan.abandon) == ({"a": "b"}, {"c"}, {"d"})
    assert (plan.rename, plan.default) == ({"x": "y"}, {"z": [1]})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("elements: {a: fly}", r"plan\.yaml:1: elements\.a: expected a fate or {to: ID}, got 'fly'"),
        ("elements:\n  a: {too: b}", r"plan\.yaml:2: elements\.a\.too: unknown key; did you mean 'to'"),
        ("element: {}", r"plan\.yaml:1: element: unknown key; did you mean 'elements'"),
        ("elements: [a]", r"plan\.yaml:1: elements: expected a mapping"),
    ],
)
def test_a_plan_that_is_wrong_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "plan.yaml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_plan(tmp_path / "plan.yaml")


# ---- deployment ------------------------------------------------------------------------------------------------------


def team(a: str, b: str = "ub") -> str:
    """Two robots, each at a task; another version has another task after that."""
    pools = "".join(f'<participant id="{r}" name="{r}" processRef="p{r.lower()}"/>' for r in "AB")

    def pool(robot: str, first: str) -> str:
        content = f'<startEvent id="s{robot}"/><scriptTask id="k{robot}"><script>n = 1</script></scriptTask>'
        content += f'<userTask id="{first}"/><userTask id="{first}2"/>'
        flows = [(f"s{robot}", f"k{robot}"), (f"k{robot}", first), (first, f"{first}2")]
        return bpmn_process(f"p{robot}", content, *flows)

    return definitions(f'<collaboration id="C">{pools}</collaboration>', pool("a", a), pool("b", b))


def test_all_robots_go_over_and_nothing_starts_again() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = field.deploy(
        team("ux"), "d2", 2, migrate=True, plan={"elements": {"ua": {"to": "ux"}, "ua2": {"to": "ux2"}}}
    )
    assert {robot: each.state for robot, each in sent.robots.items()} == {"A": "started", "B": "started"}
    assert [field.engines[robot].deployed for robot in "AB"] == ["d2", "d2"]
    assert [field.engines[robot].running.instances[0].waiting for robot in "AB"] == [["ux"], ["ub"]]
    assert [field.engines[robot].running.instances[0].visits[f"k{robot.lower()}"] for robot in "AB"] == [1, 1]
    field.engines["A"].running.complete("ux")
    assert field.engines["A"].running.instances[0].waiting == ["ux2"]


def test_a_message_is_taken_once_though_both_processes_receive_it() -> None:
    """The new process listens from the moment it is loaded; what comes until it takes over, the old one has had."""
    uri = "http://camunda.org/schema/1.0/bpmn"
    queue = f'<c:properties xmlns:c="{uri}"><c:property name="queue" value="9"/></c:properties>'
    catch = f"<extensionElements>{queue}</extensionElements><signalEventDefinition signalRef='g'/>"
    text = team("ua").replace(
        '<userTask id="ua"/>', f'<intermediateCatchEvent id="ua">{catch}</intermediateCatchEvent>'
    )
    text = text.replace('<userTask id="ua2"/>', '<scriptTask id="ua2"><script>n = n + 1</script></scriptTask>')
    text = text.replace("</process>", '<sequenceFlow id="again" sourceRef="ua2" targetRef="ua"/></process>', 1)
    text = text.replace("<collaboration", '<signal id="g" name="/go"/><collaboration')
    field = Field("A", "B")
    field.deploy(text)
    go = field.middleware.node("world").publisher("/go", "std_msgs/msg/Empty")
    go.publish(messages.create("std_msgs/msg/Empty", None))
    field.pass_time(1)
    assert field.variables("A")["n"] == 2
    sent = made(field, text, "d2", 2, migrate=True)
    for robot, envelope in sent.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(1)
    assert field.engines["A"].candidate is not None
    go.publish(messages.create("std_msgs/msg/Empty", None))
    field.pass_time(1)
    for robot in "AB":
        field.send(robot, sent._envelope(robot, "start").to_json())
    field.pass_time(1)
    assert (field.engines["A"].deployed, field.variables("A")["n"]) == ("d2", 3)


def test_if_one_robot_cannot_go_over_none_does_and_all_go_on() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = field.deploy(team("ux"), "d2", 2, migrate=True)
    assert "ua: the new model has no element ua" in str(sent.robots["A"])
    assert [field.engines[robot].deployed for robot in "AB"] == ["d1", "d1"]
    assert [field.engines[robot].state for robot in "AB"] == ["running", "running"]
    field.engines["B"].running.complete("ub")
    assert field.engines["B"].running.instances[0].waiting == ["ub2"]


def test_a_state_that_fits_no_more_at_the_start_is_said_to_start_from_the_beginning() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = made(field, team("ua").replace("ua2", "uz2"), "d2", 2, migrate=True)
    for robot, envelope in sent.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(1)
    field.engines["A"].running.complete("ua")  # nothing but a bug could do so: requests are refused now
    field.engines["A"].running.engine.release()
    for robot in "AB":
        field.send(robot, sent._envelope(robot, "start").to_json())
    field.pass_time(1)
    said = {report.robot: report.reason for report in field.said if report.answer == "started"}
    assert said["A"].startswith("starts from the beginning: pa: the state does not fit the new model: ua2")
    assert said["B"] == ""


def test_without_migrate_a_new_model_starts_from_the_beginning() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    field.engines["A"].running.complete("ua")
    field.deploy(team("ua"), "d2", 2)
    assert field.engines["A"].running.instances[0].waiting == ["ua"]


def test_a_robot_that_runs_nothing_starts_the_model() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"), migrate=True)
    assert [field.engines[robot].running.instances[0].waiting for robot in "AB"] == [["ua"], ["ub"]]


# ---- a run in one process --------------------------------------------------------------------------------------------

CUTS = """<startEvent id="s"/><scriptTask id="t"><script>robot.publish("blade_force", "geometry_msgs/msg/Wrench",
torque={"z": 1.0})</script></scriptTask>
<intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT4S</timeDuration></timerEventDefinition>
</intermediateCatchEvent><userTask id="u"/>"""
WAYS = ("s", "t"), ("t", "c"), ("c", "u")
TWO_TRACTORS = """model: m.bpmn
world: {bounds: [0, 0, 9, 4], robots: {A: {type: tractor, at: [1, 1]}, B: {type: tractor, at: [1, 3]}}}
"""


@contextmanager
def two_tractors(folder: Path) -> Iterator[ScenarioRun]:
    """A run with two tractors whose blades turn, after two seconds."""
    (folder / "day.yaml").write_text(TWO_TRACTORS)
    (folder / "m.bpmn").write_text(tractors(CUTS, *WAYS))
    run = ScenarioRun(Scenario.load(folder / "day.yaml"), False, None, None)
    run.begin()
    run.scheduler.run(2 * SECOND)
    try:
        yield run
    finally:
        run.stop()


def tractors(content: str, *flows: tuple[str, str]) -> str:
    pools = "".join(f'<participant id="{name}" name="{name}" processRef="p{name}"/>' for name in "AB")
    two = [bpmn_process(f"p{name}", re.sub(r'id="', f'id="{name}', content), *flows) for name in "AB"]
    named = [re.sub(r'(sourceRef|targetRef)="', rf"\g<0>{name}", one) for name, one in zip("AB", two, strict=True)]
    return definitions(f'<collaboration id="x">{pools}</collaboration>', *named)


def test_a_run_goes_over_as_a_whole_and_its_robots_go_on_with_what_they_did(tmp_path: Path) -> None:
    with two_tractors(tmp_path) as run:
        changed = tractors(CUTS.replace("PT4S", "PT8S") + '<userTask id="v"/>', *WAYS[:2], ("c", "v"))
        (tmp_path / "m.bpmn").write_text(changed)
        found = migrate_run(run, Scenario.load(tmp_path / "day.yaml"))
        assert [[str(token) for token in one.tokens] for one in found.values()] == [["Ac: keep"], ["Bc: keep"]]
        assert run.scheduler.now == 2 * SECOND
        run.scheduler.run(5 * SECOND)
        assert [list(node.engine.instances[1].waiting) for node in run.nodes] == [["Av"], ["Bv"]]
        assert run.world is not None
        assert [one.appearance.blade > 0 for one in run.world.robots.values()] == [True, True]  # no safe state


def test_a_run_stays_as_it_was_if_one_token_cannot_go_over(tmp_path: Path) -> None:
    with two_tractors(tmp_path) as run:
        nodes, ends = list(run.nodes), len(run.middleware.nodes)
        path = tmp_path / "m.bpmn"
        path.write_text(path.read_text().replace('"Bc"', '"Bz"'))
        found = migrate_run(run, Scenario.load(tmp_path / "day.yaml"))
        assert [one.blocked for one in found.values()] == [
            "", "the state does not fit the new model: Bc: the new model has no element Bc"
        ]  # fmt: skip
        path.write_text(path.read_text().replace("robot.publish(", "robot.publish(("))
        with pytest.raises(ModelError, match="not valid Python"):
            migrate_run(run, Scenario.load(tmp_path / "day.yaml"))
        assert (run.nodes, len(run.middleware.nodes)) == (nodes, ends)
        run.scheduler.run(5 * SECOND)
        assert [list(node.engine.instances[1].waiting) for node in run.nodes] == [["Au"], ["Bu"]]


def test_a_run_goes_on_as_it_was_if_a_state_cannot_be_transferred(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(new: Any, old: Any, *rest: Any) -> Any:
        raise MissionError("cannot be transferred")

    with two_tractors(tmp_path) as run:
        monkeypatch.setattr("fame.scenario.migrating.migrate_robot", refused)
        nodes, ends = list(run.nodes), len(run.middleware.nodes)
        with pytest.raises(MissionError, match="cannot be transferred"):
            migrate_run(run, Scenario.load(tmp_path / "day.yaml"))
        assert (run.nodes, len(run.middleware.nodes)) == (nodes, ends)
        run.scheduler.run(5 * SECOND)
        assert [list(node.engine.instances[1].waiting) for node in run.nodes] == [["Au"], ["Bu"]]
