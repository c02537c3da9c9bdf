"""Incidents: a failed activity keeps its token until somebody retries it, sets variables or moves the token."""

from __future__ import annotations

import json
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
    flow,
    gateway,
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
from fame.engine import restore, snapshot
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


def test_other_tokens_are_not_touched() -> None:
    fork = start() + gateway("parallel", "g") + script("a", "y = 10 / x") + user("u") + gateway("parallel", "j") + end()
    run = kept(fork + path("s g a j e") + path("g u j"), x=0)
    assert sorted(run.waiting) == ["a", "u"]
    run.complete("u").node.engine.retry("a", {"x": 1})
    assert run.status == "completed"


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


# ---- at every kind of node that can hold one -------------------------------------------------------------------------

TYPED = properties(type="std_msgs/msg/Float64", payload="${1 / 0}")
LOOP = "<multiInstanceLoopCharacteristics><loopCardinality>1 / 0</loopCardinality></multiInstanceLoopCharacteristics>"

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
}


@pytest.mark.parametrize("kind", NODES)
def test_no_engine_ends_when_it_describes_or_reports_an_incident(kind: str) -> None:
    field, told = Field(), list[str]()
    field.engines["A"] = engine = EngineNode(
        "A",
        scheduler=field.scheduler,
        middleware=field.middleware,
        hold_errors=True,
        on_report=lambda event: told.append(str(event.detail)),
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
    (wait,) = field.said[-1].waits
    assert wait["for"] == "a person to repair it"
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
        on_report=lambda event: told.append(str(event.detail)),
    )
    field.listen("A")
    field.person.subscription("/A/bpmn_events", "std_msgs/msg/String", lambda message: None)
    monkeypatch.setattr(WaitingTokens, "list", lambda self, engine: 1 / 0)
    monkeypatch.setattr(WaitingTokens, "details", lambda self, wait: 1 / 0)
    field.send("A", model(start() + user("x") + end() + path("s x e")).source.decode())
    field.pass_time(2)
    assert field.said[-1].error == "its state cannot be described: ZeroDivisionError: division by zero"
    assert "changes cannot be published: ZeroDivisionError: division by zero" in told
    field.engines["A"].running.complete("x")
    field.pass_time(2)
    assert field.said[-1].state == "idle"
