"""The arm: its kinematics, its task, and modifications put into recorded runs."""

import numpy as np
import pytest
from arm_data import BENIGN, needs_data, recording

from fame.errors import ConfigError, MissionError
from fame.monitor.anomaly.recording import of_runs
from robots.arm.kinematics import inverse
from robots.arm.sabotage import KINDS, alter, envelope, knots, knots_of_slope
from robots.arm.task import MH5, TRIANGLE, find_cut, simulated_runs


def step(values: np.ndarray) -> float:
    """The largest step of the tool, m."""
    return float(np.linalg.norm(np.diff(MH5.places(values), axis=0), axis=1).max())


def test_the_flange_at_home_is_where_the_origins_add_up():
    assert MH5.place([0.0] * 6) == pytest.approx((0.088 + 0.305 + 0.080, 0.0, 0.330 + 0.310 + 0.040))


def test_one_point_and_many_points_are_the_same():
    values = np.random.default_rng(1).uniform(-1, 1, (5, 6))
    assert np.allclose(MH5.places(values), [MH5.place(row) for row in values.tolist()], atol=1e-12)


def test_inverse_kinematics_undo_forward_kinematics():
    values = np.array([[0.1, 1.1, 0.1, 0.05, -0.4, 0.1], [-0.2, 1.2, -0.2, 0.1, -0.3, 0.2]])
    found = inverse(MH5, MH5.places(values), MH5.orientations(values), values + 0.02)
    assert np.allclose(MH5.places(found), MH5.places(values), atol=1e-6)
    assert np.allclose(MH5.orientations(found), MH5.orientations(values), atol=1e-6)


def test_a_place_out_of_reach_is_named():
    values = np.zeros((1, 6)) + 0.1
    with pytest.raises(MissionError, match=r"cannot reach x 9\.0000"):
        inverse(MH5, np.array([[9.0, 0.0, 0.0]]), MH5.orientations(values), values)


def test_moving_the_sides_of_the_triangle_changes_its_area_by_perimeter_times_distance():
    perimeter = np.linalg.norm(np.roll(TRIANGLE.corners, -1, axis=0) - TRIANGLE.corners, axis=1).sum()
    larger = TRIANGLE.offset(np.full(3, 1e-6))
    x, y = larger.T
    area = 0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    assert area - TRIANGLE.area == pytest.approx(perimeter * 1e-6, rel=1e-3)


@needs_data
def test_benign_runs_cut_the_triangle_side_by_side():
    run = recording(BENIGN).select([3]).values
    cut = find_cut(MH5.places(run), TRIANGLE)
    assert np.bincount(cut.sides).min() > 50
    assert (np.diff(cut.sides) >= 0).all()


@needs_data
def test_recorded_angles_are_whole_steps_of_the_encoders():
    values = recording(BENIGN).values
    assert np.abs(MH5.quantised(values) - values).max() < 1e-7


@needs_data
def test_a_run_without_a_modification_comes_out_as_it_went_in():
    run = recording(BENIGN).select([3]).values
    assert np.array_equal(alter(run, knots("none", 1.0)).values, run)


@needs_data
@pytest.mark.parametrize("kind", [*KINDS, "rotated"])
def test_a_modification_has_no_seam(kind: str):
    benign = recording(BENIGN)
    largest = max(step(run.values) for run in benign)
    altered = alter(benign.select([3]).values, knots(kind, 3.0)).values
    assert step(altered) <= largest
    assert np.abs(np.diff(altered, axis=0)).max() <= np.abs(np.diff(benign.values, axis=0)).max()
    assert np.abs(MH5.quantised(altered) - altered).max() < 1e-7


@needs_data
@pytest.mark.parametrize(("kind", "sign"), [("a", -1), ("b", 1), ("e", 1), ("g", -1)])
def test_sides_are_moved_across_by_the_magnitude(kind: str, sign: int):
    run = recording(BENIGN).select([3]).values
    altered = alter(run, knots(kind, 2.0)).values
    cut = find_cut(MH5.places(altered), TRIANGLE)
    places = MH5.places(altered)[cut.first : cut.last + 1, :2]
    middle = int(np.abs(np.where(cut.sides == 0, cut.fractions, 9) - 0.5).argmin())
    ahead = TRIANGLE.corners[1] - TRIANGLE.corners[0]
    outwards = np.array([ahead[1], -ahead[0]]) / np.linalg.norm(ahead) * np.sign(TRIANGLE.area)
    assert outwards @ (places[middle] - TRIANGLE.corners[0]) == pytest.approx(sign * 2e-3, abs=1e-4)


@needs_data
def test_the_feed_stays_where_the_path_gets_longer():
    run = recording(BENIGN).select([3]).values
    altered = alter(run, knots_of_slope(1.0)).values
    assert len(altered) > len(run)
    assert step(altered) <= step(run)


@needs_data
def test_the_envelope_lies_outside_by_the_tolerance():
    made = envelope(recording(BENIGN).select([3]), TRIANGLE, 0.002, MH5)
    assert made.run_labels() == [-1, -1]
    width = [np.ptp(MH5.places(run.values)[:, 1]) for run in made]
    assert width[0] < np.ptp(TRIANGLE.corners[:, 1]) - 0.004 < width[1]


def test_a_tolerance_larger_than_the_part_is_refused():
    run = of_runs([np.zeros((5, 6))], 1, MH5.joints)
    with pytest.raises(ConfigError, match="leaves something of the part, got 100 mm"):
        envelope(run, TRIANGLE, 0.1, MH5)


@needs_data
def test_simulated_runs_repeat_with_their_seed():
    few = recording(BENIGN).select([3, 4])
    first, second = (simulated_runs(few, 2, 7, MH5) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_a_run_that_never_cuts_is_refused():
    with pytest.raises(ConfigError, match="never cuts"):
        alter(np.zeros((20, 6)), knots("a", 1.0))
