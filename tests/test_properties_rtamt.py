"""Monitors of bounds and values agree with rtamt, which evaluates signal temporal logic (Nickovic, Yamaguchi 2020)."""

from __future__ import annotations

import warnings
from random import Random

import pytest
from compare_properties import Item, S, judged

from fame.properties import parse
from fame.properties.conditions import ValueSource

END = 40
"""Seconds of a trace. Events stop long enough before, so that all bounds are over."""


def robustness(formula: str, **signals: list[float]) -> float:
    """The robustness of a formula at time 0, for samples at each second."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "typing.io is deprecated", DeprecationWarning)  # of its parser, antlr 4.7
        rtamt = pytest.importorskip("rtamt")
    specification = rtamt.StlDiscreteTimeSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = formula
    specification.parse()
    result = specification.evaluate({"time": list(range(END)), **signals})
    return float(result[0][1])


@pytest.mark.parametrize("seed", range(40))
def test_a_bounded_response(seed: int) -> None:
    random = Random(seed)
    bound = random.choice((1, 2, 4))
    asked, answered = ([float(t < END - 10 and random.random() < share) for t in range(END)] for share in (0.1, 0.5))
    items = []
    for t in range(END):
        items += [Item(t * S, ("A", "x", "enter", None))] * int(asked[t])
        items += [Item(t * S, ("B", "y", "leave", None))] * int(answered[t])  # an answer of this instant counts
    verdict, _, _ = judged(parse(f"after A starts x, B completes y within {bound} s"), items, END * S, True)
    right = robustness(f"always((a > 0.5) implies (eventually[0:{bound}](b > 0.5)))", a=asked, b=answered)
    assert (verdict == "violated") == (right < 0)


@pytest.mark.parametrize("seed", range(40))
def test_the_slack_of_a_condition_is_its_robustness(seed: int) -> None:
    random = Random(seed)
    values = [random.choice((2.0, 2.5, 3.0, 4.0)) - (random.random() < 0.02) * 2 for _ in range(END)]
    items = [Item(t * S, source=ValueSource("variable", "A", "v"), value=value) for t, value in enumerate(values)]
    verdict, slack, time = judged(parse("always A.v > 1"), items, END * S, True)
    if verdict == "violated":  # what comes after a violation is not judged
        assert time is not None
        values = values[: time // S + 1] + [9.0] * (END - 1 - time // S)
    assert slack == pytest.approx(robustness("always(v > 1)", v=values))
    assert (verdict == "violated") == (slack <= 0)
