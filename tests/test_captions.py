"""Captions tell what a robot does now, and if it waits, for what."""

from itertools import pairwise

import pytest
from bpmn_text import process

import fame
from fame.bpmn import read_text
from fame.scenario.film_captions import Captions

SIGNALS = '<signal id="S_go" name="go"/><message id="M" name="answer"/>'
SIGNAL, TIMER = (
    '<signalEventDefinition signalRef="S_{}"/>',
    "<timerEventDefinition><timeDuration>PT{}S</timeDuration></timerEventDefinition>",
)


def told(content: str, until: float = 10.0, beside: str = "") -> list[str]:
    """The captions of a run of a process, one after the other; others stand `beside` it."""
    definitions = read_text(process(content, SIGNALS + beside), file="caption.bpmn")
    captions = Captions([definitions], {"REX": definitions.processes[0]})
    fame.Simulation(definitions, "P", observer=captions.add, robot="REX").run(until)
    return [text for _, robot, text in captions.labels if robot == "REX"]


def chain(*ids: str) -> str:
    """Sequence flows from one to the next."""
    return "".join(f'<sequenceFlow id="{a}-{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


def catch(id: str, name: str, definition: str) -> str:
    return f'<intermediateCatchEvent id="{id}" name="{name}">{definition}</intermediateCatchEvent>'


START = '<startEvent id="s"/>'


def test_a_robot_that_has_not_begun_says_what_it_waits_for() -> None:
    start = f'<startEvent id="s" name="go">{SIGNAL.format("go")}</startEvent>'
    assert told(f'{start}<task id="t"/>{chain("s", "t")}') == ["waits for go"]


def test_an_event_without_a_name_is_told_by_its_topic() -> None:
    start = f'<startEvent id="s">{SIGNAL.format("go")}</startEvent><endEvent id="e"/>'
    assert told(start + chain("s", "e")) == ["waits for /go"]


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (catch("c", "go", SIGNAL.format("go")), "waits for go"),
        (catch("c", "a few parts later", TIMER.format(50)), "waits: a few parts later"),
        ('<receiveTask id="c" name="an answer" messageRef="M"/>', "waits for an answer"),
        ('<userTask id="c" name="Sign"/>', "Sign, waits for a person"),
    ],
)
def test_a_robot_that_waits_says_for_what(event: str, text: str) -> None:
    content = f'{START}<scriptTask id="t" name="Look"><script>pass</script></scriptTask>{event}{chain("s", "t", "c")}'
    assert told(content) == ["Look", text]


def test_a_choice_between_events_names_them() -> None:
    events = catch("a", "go", SIGNAL.format("go")) + catch("b", "60 s", TIMER.format(60))
    assert told(f'{START}<eventBasedGateway id="g"/>{events}{chain("s", "g", "a")}{chain("g", "b")}') == [
        "waits for go or 60 s"
    ]


def test_what_a_robot_does_counts_more_than_what_it_waits_for_beside_it() -> None:
    task = '<scriptTask id="t" name="Drive"><script>await sleep(3)</script></scriptTask>'
    event = catch("c", "go", SIGNAL.format("go"))
    content = f'{START}<parallelGateway id="p"/>{task}{event}{chain("s", "p", "t")}{chain("p", "c")}'
    assert told(content) == ["Drive", "waits for go"]


def test_what_goes_on_in_an_activity_stands_after_its_name() -> None:
    inside = f'<startEvent id="i"/>{catch("c", "odom", SIGNAL.format("go"))}{chain("i", "c")}'
    assert told(f'{START}<subProcess id="p" name="Explore">{inside}</subProcess>{chain("s", "p")}') == [
        "Explore",
        "Explore: waits for odom",
    ]


def test_what_a_called_process_waits_for_is_not_told_but_what_it_does() -> None:
    task = '<scriptTask id="u" name="Steer"><script>await sleep(1)</script></scriptTask>'
    inside = f'<startEvent id="i"/>{task}{catch("c", "odom", SIGNAL.format("go"))}{chain("i", "u", "c")}'
    called = f'<process id="GoTo">{inside}</process>'
    call = '<callActivity id="t" name="Go To" calledElement="GoTo"/>'
    assert told(f"{START}{call}{chain('s', 't')}", beside=called) == ["Go To", "Go To: Steer", "Go To"]


def test_at_the_end_it_says_how_it_ended() -> None:
    assert told(f'{START}<task id="t" name="Look"/>{chain("s", "t")}') == ["Look", "(completed)"]


def test_a_process_that_can_start_again_says_at_the_end_what_it_waits_for() -> None:
    start = f'<startEvent id="s" name="0.5 s">{TIMER.format(0.5)}</startEvent>'
    assert told(f'{start}<task id="t" name="Look"/>{chain("s", "t")}')[-1] == "(completed), waits: 0.5 s"
