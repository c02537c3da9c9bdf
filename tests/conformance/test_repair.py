"""Incidents: a failed activity keeps its token until somebody retries it, sets variables or moves the token."""

import json
import re
from collections.abc import Callable

import pytest
from deployment_field import Field
from engine_models import (
    Run,
    boundary,
    call,
    catch,
    dump,
    element,
    end,
    error,
    escalation,
    extensions,
    flow,
    gateway,
    handler,
    load,
    message,
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

from fame.deploy import EngineNode
from fame.deploy.options import EngineOptions
from fame.engine import BpmnError, restore, snapshot
from fame.errors import MissionError
from fame.robot.waiting_tokens import WaitingTokens

Play = Callable[..., Run]
FAILING = start() + script("a", "y = 10 / x") + user("u") + end() + path("s a u e")


def kept(content: str, **variables: object) -> Run:
    """A run whose engine keeps incidents."""
    run = Run(content, variables)
    run.node.engine.on_incident = lambda wait: None
    return run.run()


def incidents(run: Run) -> dict[str, tuple[str, str]]:
    return {wait.node.id: found for wait, found in run.node.engine.incidents.items()}


def test_without_incidents_an_uncaught_error_fails_the_instance() -> None:
    assert Run(FAILING, {"x": 0}).run().status == "failed"


def test_a_failed_activity_keeps_its_token() -> None:
    run = kept(FAILING, x=0)
    assert (run.status, run.waiting) == ("running", ["a"])
    assert incidents(run) == {"a": ("script", "ZeroDivisionError: division by zero")}


def test_retry_executes_it_again_with_other_variables() -> None:
    run = kept(FAILING, x=0)
    run.node.engine.retry("a", {"x": 5})
    assert (run.waiting, run.variables["y"], incidents(run)) == (["u"], 2, {})
    assert run.complete("u").status == "completed"
    assert run.visits == {"s": 1, "a": 1, "u": 1, "e": 1}


def test_of_several_incidents_at_an_element_a_retry_takes_the_first() -> None:
    run = kept(FAILING + script("m") + path("s m a"), x=0)
    assert run.node.engine.others_at("a", "retry") == 1
    run.node.engine.retry("a", {"x": 5})
    assert (run.waiting, run.node.engine.others_at("a", "retry")) == (["a", "u"], 0)


def test_a_retry_that_fails_is_an_incident_again() -> None:
    run = kept(FAILING, x=0)
    run.node.engine.retry("a")
    assert (run.waiting, list(incidents(run))) == (["a"], ["a"])


def test_a_caught_error_is_no_incident() -> None:
    content = start() + script("a", "1 / 0") + boundary("b", "a", error()) + user("u") + path("s a") + path("b u")
    assert kept(content).waiting == ["u"]


def test_an_error_end_event_in_a_sub_process_waits_for_the_way_that_people_choose() -> None:
    content = start() + sub("p", start("ps") + end("pe", error("lost")) + path("ps pe")) + user("u") + path("s p u")
    run = kept(content)
    assert incidents(run)["pe"][0] == "lost"
    run.node.engine.move("p", "u")
    assert (run.waiting, incidents(run)) == (["u"], {})
    assert run.complete("u").status == "completed"


def test_a_script_that_waits_and_then_fails_is_one_too() -> None:
    content = start() + script("a", "await sleep(1)\nif x: raise ValueError('no')") + end() + path("s a e")
    run = kept(content, x=1)
    assert incidents(run)["a"][1] == "ValueError: no"
    run.node.engine.retry("a", {"x": 0})
    assert run.run().status == "completed"


def test_one_in_compensation_names_no_call() -> None:
    undo = script("undo", "1 / 0").replace("<scriptTask", '<scriptTask isForCompensation="true"')
    undo += boundary("c", "a", "<compensateEventDefinition/>") + '<association id="l" sourceRef="c" targetRef="undo"/>'
    run = kept(start() + script("a") + undo + throw("t", "<compensateEventDefinition/>") + end() + path("s a t e"))
    assert incidents(run)["undo"] == ("script", "ZeroDivisionError: division by zero")


def test_other_tokens_are_not_touched() -> None:
    fork = start() + gateway("parallel", "g") + script("a", "y = 10 / x") + user("u") + gateway("parallel", "j") + end()
    run = kept(fork + path("s g a j e") + path("g u j"), x=0)
    assert sorted(run.waiting) == ["a", "u"]
    run.complete("u").node.engine.retry("a", {"x": 1})
    assert run.status == "completed"


def test_a_sub_process_that_is_made_to_fail_is_not_cancelled_too() -> None:
    run = kept(start() + sub("p", user("a")) + boundary("x", "p", error()) + user("v") + path("s p") + path("x v"))
    run.node.hold()
    run.node.engine.fail("p", BpmnError("stop"))
    assert (run.waiting, "p!stop" in run.log, "-p" in run.log) == (["v"], True, False)


def test_a_skipped_element_is_left_without_results() -> None:
    run = kept(FAILING, x=0)
    assert run.node.engine.skip("a") == "a_u"  # the flow, as the run is observed
    assert (run.waiting, incidents(run)) == (["u"], {})
    assert run.complete("u").status == "completed"
    assert "y" not in run.variables


def test_a_sub_process_and_its_boundary_events_are_skipped_as_a_whole() -> None:
    inside = sub("p", start("ps") + script("a", "1 / 0") + path("ps a"))
    run = kept(start() + inside + boundary("b", "p", signal("stop")) + user("u") + path("s p u"))
    run.node.engine.skip("p")
    assert (run.waiting, incidents(run)) == (["u"], {})


def test_a_split_is_skipped_by_its_default_flow() -> None:
    gate = start() + gateway("exclusive", "g", default="g_v") + user("u") + user("v")
    flows = path("s g") + flow("g", "u", "1 / 0") + flow("g", "v")
    run = kept(gate + flows)
    assert list(incidents(run)) == ["g"]
    run.node.engine.skip("g")
    assert (run.waiting, incidents(run)) == (["v"], {})


def test_a_split_without_a_default_flow_is_not_skipped() -> None:
    run = kept(start() + gateway("exclusive", "g") + user("u") + path("s g") + flow("g", "u", "1 / 0"))
    with pytest.raises(MissionError, match="it has no default flow; move its token"):
        run.node.engine.skip("g")
    assert list(incidents(run)) == ["g"]


def test_variables_are_set_while_it_runs() -> None:
    run = Run(start() + user("u") + script("k", "y = x") + end() + path("s u k e"), {"x": 1}).run()
    run.node.engine.set_variables({"x": 7})
    assert run.complete("u").variables["y"] == 7


def test_a_token_is_moved_within_its_scope_and_what_it_did_is_cancelled() -> None:
    content = (
        start() + script("a", "try:\n    await sleep(9)\nfinally:\n    out = 1") + user("u") + end() + path("s a u e")
    )
    run = Run(content).run(1)
    run.node.engine.move("a", "u")
    assert (run.run(2).waiting, run.variables["out"]) == (["u"], 1)
    run.node.engine.move("u", "a")
    assert run.run(3).waiting == ["a"]


@pytest.mark.parametrize("kind", ["parallel", "inclusive"])
@pytest.mark.parametrize("moved", ["u", "w"])
def test_a_token_that_is_moved_to_a_join_waits_there_for_the_others(kind: str, moved: str) -> None:
    content = (
        start() + gateway(kind, "g") + user("u") + script("k") + user("w") + gateway(kind, "j") + script("a") + end()
    )
    run = Run(content + path("s g u k j a e") + path("g w j")).run()
    run.node.engine.move(moved, "j")
    other = "w" if moved == "u" else "u"
    assert (sorted(run.waiting), "a" in run.visits) == (["j", other], False)
    assert run.complete(other).status == "completed"
    assert run.visits["a"] == 1


def test_one_from_elsewhere_arrives_by_a_flow_that_is_still_open() -> None:
    content = start() + gateway("parallel", "f") + user("x") + gateway("parallel", "g") + user("u") + user("w")
    run = Run(content + gateway("parallel", "j") + end() + path("s f x") + path("f g u j e") + path("g w j")).run()
    run.complete("u").node.engine.move("x", "j")
    assert run.waiting == ["w"]
    assert run.complete("w").waiting == ["j"]


def test_a_restarted_gateway_takes_its_token_again_and_no_other() -> None:
    joins = gateway("complex", "j", "<activationCondition>activationCount &gt;= n</activationCondition>")
    run = kept(start() + gateway("parallel", "g") + joins + user("u") + path("s g j u") + path("g w j") + user("w"))
    assert list(incidents(run)) == ["j"]
    run.node.engine.set_variables({"n": 2})
    run.node.engine.move("j", "j")
    assert sorted(run.waiting) == ["j", "w"]
    assert run.complete("w").waiting == ["u"]


def test_what_is_not_there_is_said() -> None:
    run = kept(start() + sub("p", start("ps") + user("u") + path("ps u")) + user("v") + path("s p v"))
    engine = run.node.engine
    with pytest.raises(MissionError, match="has no incident; incidents are at: none"):
        engine.retry("u")
    with pytest.raises(MissionError, match="has no token; tokens are at: p, u"):
        engine.move("v", "u")
    with pytest.raises(MissionError, match="v: is not in the scope of u; elements there are: ps, u"):
        engine.move("u", "v")
    run.complete("u").complete("v")
    with pytest.raises(MissionError, match="no instance is running"):
        engine.set_variables({"x": 1})


def test_an_incident_survives_a_snapshot_and_a_hold() -> None:
    run = kept(FAILING, x=0)
    engine = run.node.engine
    engine.hold()
    data = json.loads(json.dumps(snapshot(engine, dump=dump)))
    again = restore(engine.program, data, run.node.host, engine.new_variables, load=load)
    assert json.loads(json.dumps(snapshot(again, dump=dump))) == data
    run.node.attach(again)
    again.retry("a", {"x": 5})
    assert run.visits == {"s": 1}
    again.release()
    assert run.waiting == ["u"]


LATE = timer("${late}")
AROUND = start() + user("a") + boundary("b", "a", LATE) + user("u") + end() + path("s a e") + path("b u")


def test_a_boundary_timer_that_has_no_time_is_an_incident_and_its_activity_goes_on() -> None:
    run = kept(AROUND, late="soon")
    assert (run.status, run.waiting, list(incidents(run))) == ("running", ["a"], ["b"])
    run.node.engine.retry("b", {"late": "PT2S"})
    assert (run.waiting, incidents(run)) == (["a"], {})
    assert run.run(3).waiting == ["u"]


def test_an_armed_incident_ends_with_its_activity() -> None:
    run = kept(AROUND, late="soon")
    assert run.complete("a").status == "completed"
    assert incidents(run) == {}


def test_an_armed_incident_survives_a_snapshot_and_is_armed_when_its_hold_ends() -> None:
    run = kept(AROUND, late="soon")
    engine = run.node.engine
    engine.hold()
    data = json.loads(json.dumps(snapshot(engine, dump=dump)))
    again = restore(engine.program, data, run.node.host, engine.new_variables, load=load)
    assert json.loads(json.dumps(snapshot(again, dump=dump))) == data
    run.node.attach(again)
    again.retry("b", {"late": "PT2S"})
    again.release()
    assert run.run(3).waiting == ["u"]


def test_the_start_of_an_event_sub_process_is_armed_again() -> None:
    content = start() + user("a") + handler("h", start("hs", LATE) + user("u") + path("hs u")) + path("s a")
    run = kept(content, late="soon")
    assert (run.waiting, list(incidents(run))) == (["a"], ["hs"])
    run.node.engine.retry("hs", {"late": "PT2S"})
    assert run.run(3).waiting == ["u"]


def test_a_boundary_event_whose_message_does_not_fit_takes_the_next_one() -> None:
    take = extensions(
        '<camunda:properties><camunda:property name="type" value="geometry_msgs/msg/Vector3"/></camunda:properties>'
        '<camunda:inputOutput><camunda:outputParameter name="y">${1 / msg.x}</camunda:outputParameter>'
        "</camunda:inputOutput>"
    )
    content = start() + user("a") + boundary("b", "a", take, signal("g")) + user("u") + path("s a") + path("b u")
    run = kept(content).signal("g", {"x": 0.0})
    assert (run.run().waiting, list(incidents(run))) == (["a"], ["b"])
    run.node.engine.retry("b")
    assert (run.signal("g", {"x": 2.0}).waiting, run.variables["y"]) == (["u"], 0.5)


def test_an_event_based_gateway_waits_again() -> None:
    content = start() + gateway("eventBased", "g") + catch("t", LATE) + catch("c", signal("n")) + user("u") + user("v")
    run = kept(content + path("s g t u") + path("g c v"), late="soon")
    assert (run.waiting, list(incidents(run))) == (["g"], ["g"])
    run.node.engine.retry("g", {"late": "PT2S"})
    assert run.run(3).waiting == ["u"]


@pytest.mark.parametrize("before", ["false", "true"])
def test_the_condition_of_a_loop_is_evaluated_again_and_no_instance_twice(before: str) -> None:
    loop = WHILE.format("2 / x > n").replace(">", f" testBefore='{before}'>", 1)
    run = kept(start() + script("a", "n = n + 1", loop) + user("u") + path("s a u"), x=0, n=0)
    assert (list(incidents(run)), run.variables["n"]) == (["a"], 1 if before == "false" else 0)
    run.node.engine.retry("a", {"x": 1})
    assert (run.waiting, run.variables["n"]) == (["u"], 2)


@pytest.mark.parametrize("how", ["", " isSequential='true'"])
def test_a_completion_condition_is_evaluated_again_and_no_instance_counts_twice(how: str) -> None:
    loop = TWICE.format("1 / x > numberOfCompletedInstances").replace(">", f"{how}>", 1)
    run = kept(start() + script("a", "n = n + 1", loop) + user("u") + path("s a u"), x=0, n=0)
    while incidents(run):
        run.node.engine.retry("a", {"x": 1})
    assert (run.waiting, run.variables["n"]) == (["u"], 2)


def test_a_complex_gateway_decides_again_with_the_same_tokens() -> None:
    join = gateway("complex", "j", "<activationCondition>activationCount / x >= 2</activationCondition>")
    content = start() + gateway("parallel", "g") + user("a") + user("b") + join + user("u")
    run = kept(content + path("s g a j u") + path("g b j"), x=0).complete("a")
    assert list(incidents(run)) == ["j"]
    run.node.engine.retry("j", {"x": 1})
    assert incidents(run) == {}
    assert run.complete("b").waiting == ["u"]


# ---- at every kind of node that can hold one -------------------------------------------------------------------------

TYPED = properties(type="std_msgs/msg/Float64", payload="${1 / 0}")
LOOP = "<multiInstanceLoopCharacteristics><loopCardinality>1 / 0</loopCardinality></multiInstanceLoopCharacteristics>"

WHILE = "<standardLoopCharacteristics><loopCondition>{}</loopCondition></standardLoopCharacteristics>"
TWICE = (
    "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality>"
    "<completionCondition>{}</completionCondition></multiInstanceLoopCharacteristics>"
)

INSIDE = start("is") + end("ie") + path("is ie")
TO = properties(type="std_msgs/msg/Float64", payload="1.0", to="nobody")
DUE = timer("${1 / 0}")
NODES = {
    "script task": script("x", "1 / 0"),
    "script task that waits": script("x", "await sleep(0.1)\n1 / 0"),
    "multi-instance task": script("x", "pass", LOOP),
    "multi-instance sub-process": sub("x", INSIDE, LOOP),
    "call of a process that fails": call("x", "Q"),
    "user task of many": element("userTask", "x", LOOP),
    "manual task": element("manualTask", "x", LOOP),
    "receive task": element("receiveTask", "x", properties(type="std_msgs/msg/Float64"), LOOP, messageRef="message_m"),
    "send task": element("sendTask", "x", TYPED, messageRef="message_m"),
    "send task to nobody": element("sendTask", "x", TO, messageRef="message_m"),
    "throw signal": throw("x", TYPED, signal("g")),
    "throw message": throw("x", TYPED, message("m")),
    "throw message to nobody": throw("x", TO, message("m")),
    "end signal": end("x", TYPED, signal("g")),
    "end message": end("x", TYPED, message("m")),
    "end error": end("x", error("lost")),
    "end error in a sub-process": sub("p", start("ps") + end("x", error("lost")) + path("ps x")),
    "catch timer": catch("x", DUE),
    "exclusive gateway": gateway("exclusive", "x") + user("y") + flow("x", "y", "1 / 0"),
    "exclusive gateway without a way": gateway("exclusive", "x") + user("y") + flow("x", "y", "False"),
    "inclusive gateway": gateway("inclusive", "x") + user("y") + flow("x", "y", "1 / 0"),
    "complex gateway": gateway("complex", "x") + user("y") + flow("x", "y", "1 / 0"),
    "task with conditional flows": user("u") + script("x") + user("y") + flow("x", "y", "1 / 0"),
    "multiple throw": throw("x", TYPED, signal("g"), escalation("c")),
    "boundary timer": user("x") + boundary("b", "x", DUE),
    "boundary timer that does not interrupt": user("x") + boundary("b", "x", DUE, interrupting=False),
    "boundary timer of a sub-process": sub("x", start("xs") + user("u") + path("xs u")) + boundary("b", "x", DUE),
    "boundary timer of a loop": script("x", "await sleep(9)", WHILE.format("True")) + boundary("b", "x", DUE),
    "one trigger of a boundary event": user("x") + boundary("b", "x", signal("g"), DUE),
    "timer behind an event-based gateway": gateway("eventBased", "x")
    + catch("y", DUE)
    + catch("z", signal("g"))
    + path("x y")
    + path("x z"),
    "timer of a multiple event": catch("x", signal("g"), DUE),
    "timer of a parallel multiple event": catch("x", signal("g"), DUE, parallelMultiple="true"),
    "timer of a parallel multiple boundary event": user("x")
    + boundary("b", "x", signal("g"), DUE, parallelMultiple="true"),
    "timer of an event sub-process": user("x") + handler("h", start("hs", DUE) + user("u") + path("hs u")),
    "condition of a loop": script("x", "pass", WHILE.format("1 / 0")),
    "condition of a loop, tested before": script(
        "x", "pass", WHILE.format("1 / 0").replace(">", " testBefore='true'>", 1)
    ),
    "completion condition": script("x", "pass", TWICE.format("1 / 0")),
    "completion condition, one by one": script(
        "x", "pass", TWICE.format("1 / 0").replace(">", " isSequential='true'>", 1)
    ),
    "condition of an ad-hoc sub-process": element(
        "adHocSubProcess", "x", script("a"), "<completionCondition>1 / 0</completionCondition>"
    ),
}


WITHOUT_TOKEN = re.compile("boundary|event sub-process")
"""What fails is armed beside a token that waits for something else."""


@pytest.mark.parametrize("kind", NODES)
def test_no_engine_ends_when_it_describes_or_reports_an_incident(kind: str) -> None:
    field, told = Field(), list[str]()
    field.engines["A"] = engine = EngineNode(
        "A",
        scheduler=field.scheduler,
        middleware=field.middleware,
        options=EngineOptions(hold_errors=True, on_report=lambda event: told.append(str(event.detail))),
    )
    field.listen("A")
    batches = list[str]()
    field.person.subscription("/A/bpmn_events", "std_msgs/msg/String", lambda message: batches.append(message.data))
    content = process(start(), NODES[kind], path("s p" if 'id="p"' in NODES[kind] else "s x"))
    called = process(start("qs"), end("qe", error("lost")), path("qs qe"), id="Q")
    text = model(content, called).source.decode()
    field.send("A", text)
    field.pass_time(3)
    assert engine.state == "incident", (told, field.said[-1])
    assert field.said[-1].incidents
    if not WITHOUT_TOKEN.search(kind):
        assert "a person to repair it" in [wait["for"] for wait in field.said[-1].waits]
    assert "incident" in batches[-1]
    assert not [line for line in told if "could not" in line]
    at = field.said[-1].incidents[0]["element"]
    engine.running.retry(at)
    field.pass_time(1)
    assert engine.state == "incident"
    field.send("A", text)  # what runs is described once more, and replaced
    field.pass_time(1)
    assert field.answers()[-1] == "started"
    engine.close()


def test_an_error_in_a_description_is_reported_and_the_mission_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    field, told = Field(), list[str]()
    field.engines["A"] = EngineNode(
        "A",
        scheduler=field.scheduler,
        middleware=field.middleware,
        options=EngineOptions(on_report=lambda event: told.append(str(event.detail))),
    )
    field.listen("A")
    field.person.subscription("/A/bpmn_events", "std_msgs/msg/String", lambda message: None)
    monkeypatch.setattr(WaitingTokens, "list", lambda self, engine, most=None: 1 / 0)
    monkeypatch.setattr(WaitingTokens, "details", lambda self, wait: 1 / 0)
    field.send("A", model(start() + user("x") + end() + path("s x e")).source.decode())
    field.pass_time(2)
    assert field.said[-1].error == "its state cannot be described: ZeroDivisionError: division by zero"
    assert "changes cannot be published: ZeroDivisionError: division by zero" in told
    field.engines["A"].running.complete("x")
    field.pass_time(2)
    assert field.said[-1].state == "idle"


def test_a_token_moved_inside_a_sequential_ad_hoc_sub_process_starts_at_once_and_the_next_ones_follow() -> None:
    tasks = "".join(map(user, "abc"))
    run = Run(start() + element("adHocSubProcess", "q", tasks, ordering="Sequential") + end() + path("s q e")).run()
    assert run.waiting == ["a"]
    run.node.engine.move("a", "c")
    assert run.waiting == ["c"]
    for task in "cbc":
        run.complete(task)
    assert run.instance.status == "completed"
