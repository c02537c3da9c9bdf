"""A message that is thrown `to` one robot follows the rules of `test_deliveries` at every place, and only there."""

import re
from pathlib import Path

import pytest
from engine_models import (
    HEAD,
    catch,
    flow,
    message,
    path,
    process,
    properties,
    script,
    signal,
    start,
    throw,
    user,
)
from test_deliveries import PLACES, ROOT, TYPE, content, expected

from fame.scenario import Completion, Result, Scenario

ORDERS, INNER = ("mam", "mmam", "ammm"), ("abm", "mab", "ammbm")
KEYED, KEYED_INNER = "mxam", "amxbm"
POOLS = (
    '<collaboration id="C"><participant id="B" name="Boss" processRef="boss"/>'
    '<participant id="W" name="Worker" processRef="P"><participantMultiplicity minimum="2"/></participant>'
    "</collaboration>"
)
SECOND = "<timerEventDefinition><timeDuration>PT1S</timeDuration></timerEventDefinition>"


def boss(order: str) -> str:
    """A process that throws the messages of an order to the first worker, one step a second."""
    text, last, number = '<startEvent id="boss_s"/>', "boss_s", 0
    for at, step in enumerate(order):
        text += catch(f"step{at}", SECOND) + flow(last, f"step{at}")
        last = f"step{at}"
        if step in "mx":
            number += 1
            payload = f"{{'x': {number}.0, 'y': {7.0 if step == 'm' else 8.0}}}"
            said = properties(type=TYPE, payload=payload, to="Worker_1")
            text += throw(f"throw{at}", said, message("M")) + flow(last, f"throw{at}")
            last = f"throw{at}"
        elif step == "a":
            text += throw("pause", signal("S")) + flow(last, "pause")
            last = "pause"
    return f'<process id="boss" isExecutable="true">{text}</process>'


def run(folder: Path, kind: str, queue: int, place: str, order: str, *, keyed: bool) -> Result:
    """A run of the boss and two workers, who log what they take."""
    inside, others = content(kind, queue, place)
    begin = start() + script("init", "found = []; key = 7.0") + user("u") + path("s init u")
    texts = process(begin + inside) + (others and process(others) if not others.startswith("<process") else others)
    whole = texts.replace("[M.x]", "[M.x]; log(M.x)") + boss(order)
    root = ROOT if keyed else ""
    for name in dict.fromkeys(re.findall(r'messageRef="message_(\w+)"', root + whole)):
        root += f'<message id="message_{name}" name="{name}"/>'
    for name in dict.fromkeys(re.findall(r'signalRef="signal_(\w+)"', whole)):
        root += f'<signal id="signal_{name}" name="{name}"/>'
    file = folder / "team.bpmn"
    file.write_text(f"{HEAD}{root}{POOLS}{whole}</definitions>")
    done = [
        Completion(worker, at + 0.5, "u" if step == "a" else "v")
        for at, step in enumerate(order)
        if step in "ab"
        for worker in ("Worker_1", "Worker_2")
    ]
    return Scenario.load(file, completions=done, duration=len(order) + 2.0).run()


CASES = [(kind, place) for kind in ("message", "receive") for place in PLACES
         if place != "repeated task"
         and not (kind == "receive" and ("boundary" in place or "handler" in place))]  # fmt: skip


@pytest.mark.parametrize(("kind", "place"), CASES)
def test_a_message_for_one_robot_comes_once_and_to_that_robot_alone(tmp_path: Path, kind: str, place: str) -> None:
    inner = PLACES[place].armed_at == "b"
    for queue in (0, 2):
        cases = [(order, False) for order in (INNER if inner else ORDERS)]
        for order, keyed in [*cases, (KEYED_INNER if inner else KEYED, True)]:
            result = run(tmp_path, kind, queue, place, order, keyed=keyed)
            taken = [(event.robot, float(event.detail)) for event in result.reports if event.what == "log"]
            right = [("Worker_1", number) for number in expected(kind, queue, place, order)]
            assert taken == right, f"queue={queue} {order}"
