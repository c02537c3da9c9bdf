"""A run that leaves out, repeats or reorders elements of its mission is told so, whatever its values are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from monitor_runs import told

from fame.monitor.model_card import card_of
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.sequence import FEWEST, judged, learned, order_of, visits
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
