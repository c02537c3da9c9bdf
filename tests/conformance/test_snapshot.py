"""State is data: an engine and its snapshot (docs/semantics.md). Every other test here also runs through snapshots."""

import json
from typing import Any

import pytest
from engine_models import (
    Run,
    boundary,
    call,
    catch,
    dump,
    end,
    gateway,
    handler,
    load,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    timer,
    user,
)

from fame.engine import BpmnError, restore, snapshot
from fame.engine.encoding import decode, encode
from fame.errors import MissionError
from fame.middleware import messages


def snap(run: Run) -> Any:
    return json.loads(json.dumps(snapshot(run.node.engine, dump=dump)))


def carry_on(run: Run, data: Any) -> None:
    """Let the run go on from a snapshot, as after a crash: scripts are gone, timers are still set."""
    engine = run.node.engine
    run.node.attach(restore(engine.program, data, run.node.host, engine.new_variables, load=load))


def test_a_snapshot_of_a_restored_engine_is_the_same() -> None:
    content = (
        start() + sub("p", user("u") + handler("h", start("t", signal("A")), resume=True)) + catch("c", timer("PT5S"))
    )
    run = Run(content + path("s p") + path("s c"), {"x": 1.5}).run(1).signal("A")
    data = snap(run)
    engine = restore(run.node.engine.program, data, run.node.host, load=load)
    assert json.loads(json.dumps(snapshot(engine, dump=dump))) == data


def test_one_snapshot_restores_any_number_of_engines() -> None:
    content = start() + gateway("parallel", "g") + user("a") + user("b") + gateway("parallel", "j") + end()
    run = Run(content + path("s g a j e") + path("g b j")).run()
    data = snapshot(run.node.engine)
    for _ in range(3):
        carry_on(run, data)
        assert run.complete("a").instance.waiting == ["b", "j"]
        assert run.instance.visits == {"s": 1, "g": 1, "a": 1}


def test_a_suspended_script_starts_again() -> None:
    text = "n = n + 1\nawait sleep(10)\ndone = True"
    run = Run(start() + script("a", text) + end() + path("s a e"), {"n": 0}).run(4)
    data = snap(run)
    run.node.runner.close()
    carry_on(run, data)
    run.node.engine.restart()
    assert run.variables["n"] == 2
    assert run.run(13).status == "running"
    assert run.run(15).log == "s a e =completed"
    assert not run.left_behind()


def test_one_that_a_suspension_holds_starts_when_that_ends() -> None:
    pause = handler("h", start("t", signal("A")) + user("w") + path("t w"), resume=True)
    run = Run(start() + script("a", "n = n + 1\nawait sleep(10)") + path("s a") + pause, {"n": 0}).run(4).signal("A")
    carry_on(run, snap(run))
    run.node.engine.restart()
    assert run.variables["n"] == 1
    assert run.complete("w").variables["n"] == 2


def test_what_waited_for_scripts_to_leave_goes_on() -> None:
    text = "try:\n    await sleep(9)\nfinally:\n    await sleep(1)"
    content = start() + sub("p", script("a", text)) + boundary("b", "p", signal("A")) + script("x") + path("s p")
    run = Run(content + path("b x")).run(1).signal("A")
    carry_on(run, snap(run))
    run.node.engine.restart()
    assert run.log == "s (p (a b -p -a x =completed"


def test_messages_in_queues_and_variables_are_kept() -> None:
    said = properties(queue=3, type="geometry_msgs/msg/Vector3")
    run = Run(start() + user("u") + catch("c", said, signal("A")) + path("s u c")).run().signal("A", {"x": 2.0})
    carry_on(run, snap(run))
    assert run.complete("u").variables["A"].x == 2.0


def test_chained_variables_stay_chained() -> None:
    multi = "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    inner = user("u") + script("k", "x = x + loopCounter") + path("u k")
    run = Run(start() + sub("p", multi, inner) + path("s p"), {"x": 0}).run()
    carry_on(run, snap(run))
    assert run.complete("u").complete("u").variables == {"x": 3}


def test_the_state_of_another_program_is_refused() -> None:
    one, other = Run(start() + user("u") + path("s u")).run(), Run(start() + user("v") + path("s v")).run()
    hashes = [run.node.engine.program.hash[:12] for run in (one, other)]
    with pytest.raises(
        MissionError, match="the state is one of another model: .* hash {}, expected {};".format(*hashes)
    ):
        restore(other.node.engine.program, snap(one), other.node.host)


def test_called_processes_are_part_of_the_program() -> None:
    caller = start() + call("c", "Q") + path("s c")
    hashes = {Run(model(caller, process(script("k", text), id="Q"))).node.engine.program.hash for text in ("1", "2")}
    assert len(hashes) == 2


def test_a_value_that_is_no_data_is_named() -> None:
    run = Run(start() + user("u") + path("s u"), {"x": BpmnError("E")}).run()
    with pytest.raises(MissionError, match="a BpmnError cannot be kept"):
        snapshot(run.node.engine)


@pytest.mark.parametrize("depth", [600, 5000])
def test_a_value_that_is_nested_too_deep_is_named(depth: int) -> None:
    deep: Any = 1
    for _ in range(depth):
        deep = [deep]
    repeated = '<multiInstanceLoopCharacteristics camunda:collection="x" camunda:elementVariable="y"/>'
    run = Run(start() + user("u", repeated) + path("s u"), {"x": [deep, 2]}).run()
    with pytest.raises(MissionError, match="a value cannot be kept in a snapshot: it is nested too deep"):
        snapshot(run.node.engine)


def test_functions_classes_and_modules_stay_behind() -> None:
    run = Run(start() + script("a", "import json\ndef f(): pass\nx = 1") + user("u") + path("s a u")).run()
    assert snap(run)["variables"][0]["own"] == {"x": 1}


@pytest.mark.parametrize(
    "value",
    [None, True, 3, 2.5, "text", [1, [2]], {"a": {"b": 1}}, (1, 2), {1, 2}, frozenset("ab"), b"\x00\xff",
     {1: "a", "$x": 2}, {"$tuple": [1]}, float("inf"), {(1, 2): [(3,)]}],
)  # fmt: skip
def test_values_come_back_as_they_were(value: Any) -> None:
    again = decode(json.loads(json.dumps(encode(value), allow_nan=False)))
    assert again == value
    assert type(again) is type(value)


def test_messages_come_back_as_they_were() -> None:
    twist = messages.create("geometry_msgs/msg/Twist", {"linear": {"x": 1.0}})
    assert decode(encode(twist, dump), load) == twist


def test_the_names_of_nodes_differ() -> None:
    content = (
        start()
        + gateway("parallel", "g")
        + gateway("parallel", "j")
        + call("c", "Q")
        + call("d", "Q")
        + path("s g c j")
    )
    program = Run(model(content + path("g d j"), process(start("t") + script("k"), id="Q"))).node.engine.program
    keys = [node.key for node in program.nodes]
    assert len(keys) == len(set(keys))


def test_a_scope_that_was_cancelled_at_an_inclusive_join_is_in_no_snapshot() -> None:
    inner = (
        gateway("inclusive", "g") + user("a") + user("b") + gateway("inclusive", "j") + path("g a j") + path("g b j")
    )
    content = start() + sub("p", start("t"), inner, path("t g")) + boundary("x", "p", signal("A")) + user("u")
    run = Run(content + path("s p") + path("x u")).run()
    run.complete("a")
    assert len(snap(run)["inclusive"]) == 1
    run.signal("A")
    assert (run.waiting, snap(run)["inclusive"]) == (["u"], [])
