"""Which message an event threw: known if events threw all messages of an instant, or if it makes no difference."""

from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.cli import main
from fame.log.judge import judge_log
from fame.properties import Judge, compile, parse
from fame.properties.vocabulary import RobotTerms, Vocabulary
from fame.scenario import Scenario

THROWN = properties(type="std_msgs/msg/Float64", payload="{data: ${v}}")


def team(script: str, *, throws: int = 1) -> str:
    """A runs a script, then throws `v` on /level; B catches it."""
    definition = '<signalEventDefinition id="{}" signalRef="S"/>'
    tags = ["intermediateThrowEvent"] * (throws - 1) + ["endEvent"]
    nodes = ["Start", "X", *(f"E{n}" for n in range(throws))]
    inner = f'<startEvent id="Start"/><scriptTask id="X"><script>{script}</script></scriptTask>'
    for n, tag in enumerate(tags):
        inner += f'<{tag} id="E{n}">{THROWN.replace("${v}", f"${{v[{n}]}}")}{definition.format(f"d{n}")}</{tag}>'
    for n, (source, target) in enumerate(pairwise(nodes)):
        inner += f'<sequenceFlow id="f{n}" sourceRef="{source}" targetRef="{target}"/>'
    other = '<startEvent id="BS"/><sequenceFlow id="g" sourceRef="BS" targetRef="BC"/>'
    other += f'<intermediateCatchEvent id="BC">{definition.format("c")}</intermediateCatchEvent>'
    pools = "".join(f'<participant id="p{n}" name="{n}" processRef="P{n}"/>' for n in "AB")
    processes = f'<process id="PA" isExecutable="true">{inner}</process><process id="PB" isExecutable="true">{other}'
    signal = '<signal id="S" name="level"/>'
    return document(f'{signal}<collaboration id="C">{pools}</collaboration>{processes}</process>')


@pytest.mark.parametrize(
    ("script", "throws", "verdict"),
    [
        ("v = [9.0]", 1, "violated"),
        ("v = [0.0]", 1, "holds"),
        ('v = [9.0]\nsignal("level", {"data": 0.0})', 1, "not known"),
        ('v = [0.0]\nsignal("level", {"data": 9.0})', 1, "not known"),
        ('v = [0.0]\nsignal("level", {"data": 3.0})', 1, "holds"),
        ('v = [7.0]\nsignal("level", {"data": 9.0})', 1, "violated"),
        ("v = [0.0, 9.0]", 2, "violated"),
        ("v = [0.0, 3.0]", 2, "holds"),
    ],
)
def test_a_message_that_a_script_published_is_not_taken_for_that_of_an_event(
    tmp_path: Path, script: str, throws: int, verdict: str
) -> None:
    model, log = tmp_path / "m.bpmn", tmp_path / "run.mcap"
    model.write_text(team(script, throws=throws))
    model.with_name("m.properties.yaml").write_text("properties: {low: never A throws /level where data > 5}\n")
    (found,) = Scenario.load(model).run().judgements
    assert found.verdict == verdict
    if verdict == "not known":
        assert found.text == "not all messages of an instant were thrown by events: which, is not known"
    main(["run", str(model), "--quiet", "--log", str(log)])
    assert judge_log(log, Scenario.load(model).properties) == [found]


E_TERMS = RobotTerms("P", {"e": "", "f": "", "g": ""}, {}, {"/a": ("e", "f"), "/b": ("e",)}, {})


def judged(sentence: str, *what: tuple[str, float] | str) -> str:
    """The verdict if this happens in one instant: messages (topic, value), and events that are left."""
    judge = Judge([compile(parse(sentence), Vocabulary({"R": E_TERMS}))])
    for each in what:
        if isinstance(each, str):
            judge.event(0, "R", each, "leave")
        else:
            judge.message(0, "R", each[0], {"data": each[1]})
    return judge.finish(1, complete=True)[0].verdict


@pytest.mark.parametrize(
    ("sentence", "what", "verdict"),
    [
        ("R throws /a where data > 5", (("/a", 0), ("/a", 9), "e", "f"), "holds"),
        ("R throws /a where data > 5", (("/a", 0), "e", ("/a", 9), "f"), "holds"),
        ("R throws /a where data > 5", (("/a", 0), ("/a", 9), "e"), "not known"),
        ("R throws /a where data > 5", (("/a", 0), ("/a", 9), "e", "f", "f"), "not known"),
        ('never R completes "g" before R throws /a where data > 5', (("/a", 0), ("/a", 9), "e", "f", "g"), "holds"),
        ('never R completes "g" before R throws /a where data > 5', (("/a", 0), ("/a", 9), "e", "g", "f"), "violated"),
        ("R throws /b where data > 5", (("/a", 0), ("/b", 9), "e"), "holds"),
    ],
)
def test_messages_and_events_of_an_instant_are_in_one_order(
    sentence: str, what: tuple[tuple[str, float] | str, ...], verdict: str
) -> None:
    assert judged(sentence, *what) == verdict


def test_two_properties_about_two_topics_of_one_event_each_get_their_message() -> None:
    sentences = ("never R throws /a where data > 5", "never R throws /b where data < 5")
    judge = Judge([compile(parse(one), Vocabulary({"R": E_TERMS})) for one in sentences])
    judge.message(0, "R", "/a", {"data": 0})
    judge.message(0, "R", "/b", {"data": 9})
    judge.event(0, "R", "e", "leave")
    assert [one.verdict for one in judge.finish(1, complete=True)] == ["holds", "holds"]
