"""Tasks (standard 13.3.3; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import boundary, element, end, error, extensions, gateway, path, script, start, user

from fame.errors import MissionError, ModelError

RECEIVE = '<receiveTask id="r" messageRef="message_M"/>'


def test_a_plain_task_completes_at_once(play: Play) -> None:
    assert play(start() + "<task id='a'/>" + path("s a")).run().log == "s a =completed"


@pytest.mark.parametrize("tag", ["userTask", "manualTask"])
def test_user_and_manual_tasks_wait_for_somebody(play: Play, tag: str) -> None:
    run = play(start() + f"<{tag} id='u'/>" + end() + path("s u e")).run()
    assert run.waiting == ["u"]
    assert run.complete("u", {"approved": True}).log == "s u e =completed"
    assert run.variables == {"approved": True}


def test_nobody_can_complete_what_does_not_wait(play: Play) -> None:
    run = play(start() + user("u") + path("s u")).run()
    with pytest.raises(MissionError, match="currently waiting: u"):
        run.complete("v")


def test_a_receive_task_waits_for_its_message(play: Play) -> None:
    run = play(start() + RECEIVE + end() + path("s r e")).run()
    assert run.waiting == ["r"]
    assert run.message("M").log == "s r e =completed"


def test_somebody_may_complete_a_receive_task(play: Play) -> None:
    run = play(start() + RECEIVE + path("s r")).run().complete("r", {"x": 1})
    assert (run.status, run.variables) == ("completed", {"x": 1})


def test_a_send_task_publishes_its_message(play: Play) -> None:
    heard: list[object] = []
    run = play(start() + '<sendTask id="t" messageRef="message_M"/>' + path("s t"))
    run.simulation.middleware.node("ear").subscription("/M", "std_msgs/msg/Empty", heard.append)
    assert run.run().log == "s t =completed"
    assert len(heard) == 1


def test_a_service_task_calls_what_it_names(play: Play) -> None:
    task = element(
        "serviceTask", "t", **{"camunda:type": "external", "camunda:topic": "double", "camunda:resultVariable": "y"}
    )
    run = play(start() + task + path("s t"), {"x": 4}, services={"double": lambda variables: variables["x"] * 2}).run()
    assert run.log == "s t =completed"
    assert run.variables["y"] == 8


def test_a_service_that_fails_is_an_error_of_its_task(play: Play) -> None:
    task = element("serviceTask", "t", **{"camunda:type": "external", "camunda:topic": "bad"})
    run = play(start() + task + boundary("b", "t", error("script")) + path("s t"), services={"bad": lambda _: 1 / 0})
    assert run.run().log == "s (t t!script b =completed"


def test_a_service_that_nobody_offers_is_refused(play: Play) -> None:
    task = element("serviceTask", "t", **{"camunda:type": "external", "camunda:topic": "bad"})
    with pytest.raises(ModelError, match="'bad'"):
        play(start() + task + path("s t"))


def test_business_rule_tasks_are_refused(play: Play) -> None:
    with pytest.raises(ModelError, match="business rule"):
        play(start() + "<businessRuleTask id='t'/>" + path("s t"))


def test_a_script_that_waits_holds_its_token_and_no_other(play: Play) -> None:
    content = (
        start() + gateway("parallel", "g") + script("a", "await sleep(2)") + script("b") + path("s g a") + path("g b")
    )
    run = play(content).run(1)
    assert (run.log, run.waiting) == ("s g (a b", ["a"])
    assert run.run().log == "s g (a b a) =completed"


def test_a_task_with_a_mapping_has_variables_of_its_own(play: Play) -> None:
    said = extensions(
        '<camunda:inputOutput><camunda:inputParameter name="n">${x + 1}</camunda:inputParameter>'
        '<camunda:outputParameter name="y">${n * 2}</camunda:outputParameter></camunda:inputOutput>'
    )
    run = play(start() + script("a", "n = n * 10\nx = 5\nlocal = 1", said) + path("s a"), {"x": 1}).run()
    assert run.log == "s a =completed"
    assert run.variables == {"x": 5, "y": 40}


def test_its_errors_are_caught_at_the_task(play: Play) -> None:
    said = extensions(
        '<camunda:inputOutput><camunda:inputParameter name="n">1</camunda:inputParameter></camunda:inputOutput>'
    )
    run = play(start() + script("a", "1 / 0", said) + boundary("b", "a", error()) + path("s a")).run()
    assert run.log.endswith("b -a =completed")
