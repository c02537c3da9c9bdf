"""`fame.monitor.Detector`: an estimator of scikit-learn like any other."""

import numpy as np
import pytest
from sklearn.ensemble import IsolationForest
from sklearn.model_selection import cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

from fame.monitor import Detector


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
def test_scikit_learn_finds_nothing_wrong_with_it():
    check_estimator(Detector())


def test_it_stands_beside_other_detectors_in_a_pipeline():
    random = np.random.default_rng(0)
    usual = random.standard_normal((300, 3)) @ np.array([[1, 1, 0], [0, 1, 1], [0, 0, 0.1]])
    odd = usual[:20] * [1, -1, 1]
    for detector in (Detector(), IsolationForest(random_state=0)):
        made = make_pipeline(StandardScaler(), detector).fit(usual)
        assert made.score_samples(odd).mean() < made.score_samples(usual).mean()
    assert (cross_val_predict(Detector(), usual) == -1).mean() < 0.1


@pytest.mark.parametrize("name", ["phase", "any of phase, mahalanobis"])
def test_runs_are_judged_as_runs(name: str):
    random, time = np.random.default_rng(1), np.arange(100) / 100
    course = np.stack([np.sin(6.28 * time), time**2], axis=1)
    rows = np.concatenate([course + 0.02 * random.standard_normal(course.shape) for _ in range(30)])
    made = Detector(name, window=10, false_alarms=0.1).fit(rows[:2000], runs=np.repeat(np.arange(20), 100))
    assert made.calibration_.runs == 20
    judged = made.predict(rows[2000:], runs=np.repeat(np.arange(10), 100)).reshape(10, 100)
    assert (judged == -1).any(axis=1).sum() <= 3
    late = np.roll(rows[2000:2100], 10, axis=0)
    found = made.predict(late)
    assert (found[20:60] == -1).any()
    with pytest.raises(ValueError, match="expected at least 10 rows of a run, a whole window, got 5"):
        made.predict(late[:5])


@pytest.mark.parametrize(
    ("runs", "rows", "why"),
    [
        (np.tile(np.arange(5), 20), np.arange(100), "got run 0 again after another one"),
        (np.repeat(np.arange(5), 20), np.tile(np.arange(50), 2), "has the same rows as that of 0"),
    ],
    ids=["in turn", "copied"],
)
def test_rows_in_turn_and_copies_make_no_runs(runs: np.ndarray, rows: np.ndarray, why: str):
    values = np.random.default_rng(3).standard_normal((100, 2))[rows]
    runs = np.repeat(np.arange(2), 50) if "same" in why else runs
    with pytest.raises(ValueError, match=why):
        Detector().fit(values, runs=runs)


def test_a_data_frame_of_pandas_is_judged_as_its_rows():
    pd = pytest.importorskip("pandas")
    rows, runs = np.random.default_rng(2).standard_normal((300, 2)), np.repeat(np.arange(30), 10)
    frame = pd.DataFrame(rows, columns=["left", "right"]).assign(run=runs)
    framed = Detector(false_alarms=0.1).fit(frame[["left", "right"]], runs=frame["run"])
    plain = Detector(false_alarms=0.1).fit(rows, runs=runs)
    assert list(framed.predict(frame[["left", "right"]], runs=frame["run"])) == list(plain.predict(rows, runs=runs))
