"""Where verifiers of BPMN collaborations differ from FAME: each difference is an option, off and on."""

from __future__ import annotations

import re

import pytest
from collaborations import Steps, team

from fame.bpmn.model import Definitions
from fame.check.explore import Finding
from fame.errors import ConfigError
from fame.scenario.exploration import explore


def found(model: Definitions, kind: str, **options: str) -> list[Finding]:
    result = explore(model, **options)  # type: ignore[arg-type]
    assert result.exhaustive
    return [one for one in result.findings if one.kind == kind]


def test_messages_are_lost_or_kept() -> None:
    """A message that comes before its receiver listens: lost as a signal, kept as a message of a collaboration."""
    model = team({"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]})
    assert found(model, "lost")
    assert not explore(model, network="bag").failed


def test_messages_of_one_sender_arrive_in_order_or_overtake() -> None:
    model = team({"A": ["throw x", "throw x", "throw y"], "B": [("race", ["catch x", "catch y"], ["catch y"])]})
    first = found(model, "unneeded", delivery="any")
    assert first  # the second x comes while B waits for y, and is lost
    assert not explore(model, network="bag", delivery="any").failed


def test_two_tokens_at_one_end_event() -> None:
    both: dict[str, Steps] = {"A": [("and", ["work"], ["work"])]}
    model = team(both)
    assert not found(model, "unsafe", ends="once")  # a parallel gateway joins them
    unsafe = without_join(model)
    assert not found(unsafe, "unsafe")
    (finding,) = found(unsafe, "unsafe", ends="once")
    assert re.fullmatch(r"A: a second token comes to the end event A_join_\d+", finding.text)
    assert [step.text for step in finding.run][-1].startswith('A\'s "work" ends')


def without_join(model: Definitions) -> Definitions:
    """Let the branches end in the end event, each by itself."""
    import fame

    source = model.source.decode()
    _, _, rest = source.partition('<parallelGateway id="A_join')
    number = rest[: rest.index('"')].lstrip("_")
    old = f'<parallelGateway id="A_join_{number}" ></parallelGateway>'
    assert old in source
    flow = source[source.index("<sequenceFlow", source.index(f'sourceRef="A_join_{number}"') - 60) :]
    flow = flow[: flow.index("</sequenceFlow>") + len("</sequenceFlow>")]
    return fame.read(source.replace(old, f'<endEvent id="A_join_{number}"/>').replace(flow, "").encode())


def test_a_loop_that_may_be_left() -> None:
    model = team({"A": [("loop", ["work"]), "throw done"], "B": ["catch done"]})
    assert not explore(model).failed
    assert not found(model, "endless")
    (finding,) = found(model, "endless", fairness="weak")
    assert finding.text.endswith("can loop forever, though it could leave the loop")
    assert not found(team({"A": ["work", "throw done"], "B": ["catch done"]}), "endless", fairness="weak")


def test_plain_tasks_take_no_time_or_some() -> None:
    """B's answer to A comes at once, or after another task of A."""
    model = team({"A": ["throw ask", ("if", "1 == 1", ["catch answer"], [])], "B": ["catch ask", "throw answer"]})
    assert not explore(model, delivery="run").failed  # the task between them completes at once
    assert found(model, "lost", delivery="run", tasks="timed")


@pytest.mark.parametrize("option", ["network", "tasks", "ends", "fairness"])
def test_unknown_values(option: str) -> None:
    with pytest.raises(ConfigError, match=f"{option}: expected"):
        explore(team({"A": ["work"]}), **{option: "x"})  # type: ignore[arg-type]
