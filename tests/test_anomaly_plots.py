"""Pictures of what was learned show what was found."""

from pathlib import Path

import numpy as np
import pytest
from arm_data import BENIGN, needs_data, recording
from matplotlib.colors import to_rgb
from PIL import Image

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import ConfusionMatrix
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import of_runs
from fame.monitor.pipeline.configuration import Configuration
from fame.monitor.plots import ANOMALOUS_COLOUR, BENIGN_COLOUR, MISSED_COLOUR, deviations, draw, joint_space, matrices
from robots.arm.sabotage import alter, knots
from robots.arm.task import MH5


def pixels(path: Path, colour: str) -> int:
    """How many pixels of a picture have (nearly) this colour."""
    wanted = 255 * np.array(to_rgb(colour))
    with Image.open(path) as picture:
        return int((np.abs(np.asarray(picture.convert("RGB")) - wanted).max(axis=2) < 12).sum())


POINTS = np.random.default_rng(1).normal(size=(200, 6))


def points() -> object:
    return of_runs([POINTS[:150], POINTS[150:]], 1, tuple("SLURBT"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("found", "colours"),
    [
        (np.ones(200), {BENIGN_COLOUR}),
        (np.where(np.arange(200) < 20, -1, 1), {BENIGN_COLOUR, ANOMALOUS_COLOUR}),
    ],
)
def test_joint_space_shows_what_was_judged_anomalous(tmp_path: Path, found, colours) -> None:
    joint_space(tmp_path / "space.png", points(), found)  # type: ignore[arg-type]
    shown = {c for c in (BENIGN_COLOUR, ANOMALOUS_COLOUR, MISSED_COLOUR) if pixels(tmp_path / "space.png", c) > 50}
    assert shown == colours


@pytest.mark.long
def test_an_anomalous_point_that_was_missed_has_a_colour_of_its_own(tmp_path: Path) -> None:
    missed = of_runs([POINTS], -1, tuple("SLURBT"))
    joint_space(tmp_path / "space.png", missed, np.ones(200))
    assert pixels(tmp_path / "space.png", MISSED_COLOUR) > 50
    assert pixels(tmp_path / "space.png", BENIGN_COLOUR) == 0


def test_an_arm_of_two_joints_can_be_drawn(tmp_path: Path) -> None:
    joint_space(tmp_path / "space.png", of_runs([POINTS[:, :2]], 1, ("S", "L")))
    assert pixels(tmp_path / "space.png", BENIGN_COLOUR) > 50


@pytest.mark.long
@needs_data
def test_an_attack_stands_out_along_the_path(tmp_path: Path) -> None:
    benign = recording(BENIGN).select(range(6))
    detector = PathDetector(MH5).fit(benign)
    one = benign.select([0])
    deviations(tmp_path / "benign.png", detector, [("benign", one)])
    attack = of_runs([alter(one.values, knots("a", 1)).values], -1, one.joints)
    deviations(tmp_path / "attack.png", detector, [("benign", one), ("a, 1 mm", attack)])
    assert pixels(tmp_path / "benign.png", ANOMALOUS_COLOUR) == 0
    assert pixels(tmp_path / "attack.png", ANOMALOUS_COLOUR) > 100


@pytest.mark.long
def test_a_matrix_is_drawn_for_each_classifier(tmp_path: Path) -> None:
    one = ConfusionMatrix(20, 0, 30, 0)
    matrices(tmp_path / "one.png", [("svm", one)])
    matrices(tmp_path / "four.png", [("svm", one)] * 4)
    sizes = []
    for name in ("one.png", "four.png"):
        with Image.open(tmp_path / name) as picture:
            sizes.append(picture.size)
    small, large = sizes
    assert large[0] > 2 * small[0]
    assert large[1] > 1.5 * small[1]


def test_a_plot_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        matrices(tmp_path / "file" / "x.png", [("svm", ConfusionMatrix(1, 0, 1, 0))])
    with pytest.raises(ConfigError, match="cannot be written"):
        draw([Configuration(tmp_path / "c.yaml", "c", (), ())], tmp_path / "file" / "x.svg")
