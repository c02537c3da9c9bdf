"""A run that leaves out, repeats or reorders elements of its mission is told so, whatever its values are."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bpmn_text import process
from monitor_runs import STATE, told

from fame.bpmn import read_text
from fame.bpmn.library import BUILT_IN
from fame.bpmn.model import Definitions
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode
from fame.deploy.options import DeploymentOptions
from fame.middleware.local import LocalMiddleware
from fame.monitor.data_files import LabelledRun
from fame.monitor.judge import judge_trained
from fame.monitor.judge_report import on_page
from fame.monitor.model_card import card_of
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.sequence import FEWEST, OrderWatch, faults, judged, learned, order_of, visits
from fame.monitor.pipeline.threshold import Threshold
from fame.monitor.pipeline.train import Training, fit


def run(names: str, seed: int = 0, seconds: float = 1.0, end: float | None = None) -> Samples:
    """Elements of a letter each, which last about as long."""
    random = np.random.default_rng(seed)
    begins = np.cumsum([0.0, *(seconds * random.uniform(0.9, 1.1, len(names)))])
    stamps = np.arange(0, end or begins[-1], 0.05)
    values = np.sin(stamps)[:, None] + 0.1 * random.standard_normal((len(stamps), 1))
    elements = tuple((float(at), name) for at, name in zip(begins[:-1], names, strict=True))
    return Samples(values, stamps, ("a",), elements)


USUAL = learned([run("ABCD", seed) for seed in range(10)])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("ABCD", []),
        ("A", ["B was left out", "C was left out", "D was left out"]),
        ("BCD", ["A was left out"]),
        ("ABCABCD", [f"{name} came 2 times; in training 1" for name in "ABC"]),
        ("ACBD", ["C came after A", "B came after C", "D came after B"]),
        ("ABXCD", ["X is new: no training run had it"]),
    ],
)
def test_what_is_left_out_repeated_or_in_another_order_is_named(names: str, expected: list[str]):
    assert judged(run(names, 20), USUAL) == expected


def test_an_element_that_lasts_much_too_long_is_named():
    found = run("ABCD", 20, end=8.0)
    late = tuple((at + 3.0 * (name in "CD"), name) for at, name in found.elements)
    (text,) = judged(Samples(found.values, found.stamps, found.names, late), USUAL)
    assert text.startswith("B lasted 3.")


def test_choices_and_loops_of_the_training_are_no_fault():
    usual = learned([run(names, seed) for seed, names in enumerate(["ABD", "ACD", "ABBD", "ACD", "ABD"])])
    assert [judged(run(names, 30), usual) for names in ("ABD", "ACD", "ABBD")] == [[], [], []]
    assert judged(run("AD", 30), usual) == ["D came after A"]


@pytest.mark.parametrize("orders", [["ABCD", "BCDA", "CDAB", "DABC"], ["ABCDE", "BCDEA", "CDEAB", "DEABC", "EABCD"]])
def test_an_order_that_differs_from_run_to_run_is_not_judged(orders: list[str]):
    found = order_of([run(names, seed) for seed, names in enumerate(orders)], 0.05)
    assert found["order"] == {}
    number = len(orders)
    assert found["order_text"] == f"{number} of {number} runs differ from the order of the others: it is not judged"


def test_a_fewest_number_of_runs_that_agree_is_judged_and_no_order_is_learned_of_less():
    alike = [run("ABCD", seed) for seed in range(FEWEST)]
    assert order_of(alike, 0.05)["order_text"] == "0 of 4 runs differ from the order of the others: it is judged"
    assert order_of(alike[1:], 0.05) == {}


def test_as_many_runs_may_differ_as_false_alarms_are_asked_for():
    runs = [run("ABCD", seed) for seed in range(18)] + [run("ACBD", 18)]
    assert [bool(order_of(runs, asked)["order"]) for asked in (0.11, 0.09)] == [True, False], "2 of 20"


def test_what_begins_after_the_last_sample_or_ends_before_the_first_is_no_visit():
    whole = run("ABCD", 20)
    middle = (whole.stamps > 1.5) & (whole.stamps < 2.5)
    assert [name for name, *_ in visits(whole)] == [*"ABCD"]
    seen = visits(whole.replace(whole.values[middle], whole.stamps[middle]))
    assert [name for name, *_ in seen] == [*"BC"]
    assert all(long > 0 for *_, long in seen)
    assert visits(whole.replace(whole.values[:0], whole.stamps[:0])) == []


def test_the_card_says_whether_the_order_is_judged_and_a_table_with_elements_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    config = Training(window=10, detector="pca", false_alarms="0.2 per run")
    model = fit([run("ABCD", seed) for seed in range(8)], config)
    text = "0 of 8 runs differ from the order of the others: it is judged"
    assert card_of(model)["Order of elements"] == [text]
    model.save(tmp_path / "m.skops")
    rows = ["stamp,run,element,a"]
    aborted = run("AB", 40)
    names = [next(name for at, name in reversed(aborted.elements) if at <= stamp) for stamp in aborted.stamps]
    cells = zip(aborted.stamps, names, aborted.values, strict=True)
    rows += [f"{stamp},0,{name},{value}" for stamp, name, (value,) in cells]
    (tmp_path / "new.csv").write_text("\n".join(rows) + "\n")
    code, found = told(capsys, "monitor", "judge", tmp_path / "m.skops", tmp_path / "new.csv")
    (one,) = found["runs"]
    assert (code, one["verdict"], one["order"]) == (1, "anomalous", ["C was left out", "D was left out"])


def told_live(names: str, *, lost: float = -1.0, usual: dict[str, Any] = USUAL) -> list[tuple[float, str]]:
    """What is told of elements that last 1 s each (a dot: none is active), a change at a time, and when (s)."""
    watch, changes = OrderWatch(usual), ((-1.0, ""),)
    found: list[tuple[float, str]] = []
    for at, name in enumerate(names):
        changes = (*changes, (float(at), name.strip(".")))
        found += watch.feed(changes, at + 0.9, lost)
    return found


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("ABCD.", []),
        ("ABCDABCDABCD.", []),
        ("ACD.", [(1.0, "B was left out")]),
        ("AB.", [(2.0, "C was left out"), (2.0, "D was left out")]),
        ("ABCDABDABCD.", [(6.0, "C was left out")]),
        ("ABCABCD.", [(3.0, "D was left out")]),
        ("ABCC", [(3.0, "C came 2 times; in training 1")]),
        ("ABXCD.", [(2.0, "X is new: no training run had it")]),
        ("ABBBBCD", [(2.0, "B came 2 times; in training 1")]),
    ],
)
def test_live_a_fault_of_the_order_is_told_once_and_as_soon_as_it_is_certain(
    names: str, expected: list[tuple[float, str]]
):
    assert told_live(names) == expected


def test_live_an_element_is_too_long_while_it_lasts():
    watch, changes = OrderWatch(USUAL), ((0.0, "A"), (1.0, "B"))
    assert watch.feed(changes, 1.9, -1.0) == []
    ((stamp, text),) = watch.feed(changes, 3.0, -1.0)
    assert (stamp, text.partition(";")[0]) == (3.0, "B lasted 2 s")
    assert watch.feed((*changes, (3.5, "C")), 3.6, -1.0) == []


LOOP = learned([run(f"A{'BC' * loops}D", seed) for seed, loops in enumerate([3, 4, 5, 3])])


def test_live_each_visit_that_is_too_long_is_told_once():
    watch = OrderWatch(LOOP)
    changes = ((0.0, "A"), (1.0, "B"), (9.0, "C"), (10.0, "B"), (18.0, "C"), (19.0, ""))
    found = [
        (stamp, text.partition(";")[0])
        for now in (8.0, 9.0, 18.0)
        for stamp, text in watch.feed(tuple(each for each in changes if each[0] <= now), now, -1.0)
    ]
    assert found == [(8.0, "B lasted 7 s"), (18.0, "B lasted 8 s")]


def test_live_each_visit_in_a_wrong_order_is_told_as_it_is_of_the_recording():
    usual = learned([run(names, seed) for seed, names in enumerate(["ABABC", "AABBC", "ABABC", "AABBC"])])
    usual["pairs"].remove(["A", "A"])
    names, usual["often"]["A"] = "AAABAABC", [2, 9]
    expected = judged(run(names, 30), usual)
    assert expected == ["A came after A"] * 3
    assert [text for _, text in told_live(f"{names}.", usual=usual)] == expected


def test_before_its_first_element_a_run_has_no_fault_and_with_none_it_has():
    assert faults([], USUAL, ended=False) == []
    assert [fault.text for fault in faults([], USUAL)] == [f"{name} was left out" for name in "ABCD"]
    optional = learned([run(names, seed) for seed, names in enumerate("ABAB")])
    assert [fault.text for fault in faults([], optional)] == ["the run had no element"]


def test_live_a_run_whose_begin_was_lost_is_not_judged_and_the_next_one_is():
    assert told_live("CD.ACD.", lost=0.0) == [(4.0, "B was left out")]
    assert told_live("ACD.", lost=0.0) == [(1.0, "B was left out")], "it begins as runs do"
    assert told_live("ABCD.", lost=2.5) == [], "a batch was lost"


def pick(*steps: str) -> Definitions:
    """A mission that waits for a second in each step."""
    timers = (
        f'<intermediateCatchEvent id="{step}"><timerEventDefinition id="{step}_t"><timeDuration>PT1S</timeDuration>'
        f"</timerEventDefinition></intermediateCatchEvent>"
        for step in steps
    )
    flows = (
        f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(["begin", *steps, "over"])
    )
    return read_text(process(f'<startEvent id="begin"/>{"".join(timers)}<endEvent id="over"/>{"".join(flows)}'))


def test_a_robot_that_leaves_out_an_element_raises_the_signal_anomaly_with_the_words(tmp_path: Path):
    steps = {"A": "Approach", "B": "Grip", "C": "Place"}
    runs = [run("ABC", seed) for seed in range(8)]
    runs = [replace(each, elements=tuple((at, steps[name]) for at, name in each.elements)) for each in runs]
    fit(runs, Training(window=10, detector="pca", false_alarms="0.2 per run")).save(tmp_path / "m.skops")
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    engine = EngineNode("p", scheduler=scheduler, middleware=middleware)
    configuration = load(BUILT_IN[1] / "joint_monitor" / "threshold.yaml")
    chain = [Threshold(model=str(tmp_path / "m.skops"))]
    node = ProcessingNode(middleware, scheduler, configuration, processors=chain, namespace="p")
    alarms: list[tuple[float, list[str], list[float]]] = []
    middleware.node("person").subscription(
        "/anomaly", STATE, lambda said: alarms.append((scheduler.now / SECOND, said.name, list(said.position)))
    )

    scheduler.run(SECOND)

    def deploy(number: int, *ids: str) -> None:
        options = DeploymentOptions(only=["p"])
        sent = Deployment(
            pick(*ids), id=f"d{number}", sequence=number, scheduler=scheduler, middleware=middleware,
            ended=lambda deployment: deployment.close(), options=options,
        )  # fmt: skip
        sent.begin()
        scheduler.run(scheduler.now + 8 * SECOND)

    deploy(1, *steps.values())
    assert alarms == []
    deploy(2, "Approach", "Place")
    ((when, words, excess),) = alarms
    assert (words, excess) == (["Grip was left out"], [0.0])
    assert 9.0 < when < 10.5, "when Place begins"
    deploy(3, "Approach", "Grip")
    assert [words for _, words, _ in alarms[1:]] == [["Place was left out"]]
    node.close()
    engine.close()


def test_the_page_of_a_recording_has_an_alarm_with_the_words():
    model = fit([run("ABCD", seed) for seed in range(8)], Training(window=10, detector="pca"))
    aborted = run("ABC", 40)
    given = LabelledRun(aborted, np.ones(len(aborted), dtype=np.int64), "a.mcap")
    assert ["D was left out"] in [alarm["text"] for alarm in on_page(judge_trained(model, [given], "m"))["alarms"]]
