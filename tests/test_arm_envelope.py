"""``fame monitor adm envelope``: training data just outside a tolerance, made from benign runs."""

import json
from pathlib import Path

import numpy as np
import pytest
from arm_data import BENIGN, needs_data, recording

from fame.cli import main
from fame.monitor.anomaly.recording import read_csv, write_csv
from robots.arm.task import MH5, TRIANGLE, find_cut

TASK = "corners: [[0.5669, 0], [0.4169, 0.07505], [0.4169, -0.07505]]\nheight: 0.0882\n"


@pytest.fixture
def benign(tmp_path: Path) -> str:
    path = tmp_path / "benign.csv"
    write_csv(path, recording(BENIGN).select([3, 9]))
    return str(path)


@needs_data
def test_each_run_gives_a_larger_and_a_smaller_part_by_the_tolerance(benign: str, tmp_path: Path, capsys) -> None:
    out = tmp_path / "outside.csv"
    assert main(["monitor", "adm", "envelope", benign, "--tolerance", "2", "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["anomalous_runs"] == 4
    found = read_csv(out)
    assert set(found.labels.tolist()) == {-1}
    for number, sign in enumerate((-1, -1, 1, 1)):
        places = MH5.places(found.select([number]).values)
        wanted = TRIANGLE.offset(np.full(3, sign * 0.002))
        nearest = min(np.linalg.norm(places[:, :2] - corner, axis=1).min() for corner in wanted)
        assert nearest < 0.0015
        cut = find_cut(places, TRIANGLE)
        assert cut.last - cut.first > 100


@needs_data
def test_a_task_file_says_another_part(benign: str, tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    out, same = tmp_path / "a.csv", tmp_path / "b.csv"
    assert main(["monitor", "adm", "envelope", benign, "--tolerance", "2", "-o", str(out)]) == 0
    task = str(tmp_path / "task.yaml")
    assert main(["monitor", "adm", "envelope", benign, "--tolerance", "2", "--task", task, "-o", str(same)]) == 0
    assert out.read_bytes() == same.read_bytes()


BAD = {
    "no polygon": ("corners: [[0, 0], [1, 1]]\nheight: 0\n", "1", ("task.yaml:1", "polygon")),
    "no area": ("corners: [[0, 0], [1, 1], [2, 2]]\nheight: 0\n", "1", ("task.yaml:1", "no area")),
    "a corner twice": ("corners: [[0, 0], [0, 0], [1, 1], [1, 2]]\nheight: 0\n", "1", ("task.yaml:1", "at an angle")),
    "a corner on a side": (
        "corners: [[0, 0], [1, 0], [2, 0], [1, 1]]\nheight: 0\n",
        "1",
        ("corners[1]", "at an angle"),
    ),
    "no height": ("corners: [[0, 0], [1, 1], [1, 2]]\n", "1", ("task.yaml", "height")),
    "a corner that is none": ("corners: [[0], [1, 1], [1, 2]]\nheight: 0\n", "1", ("task.yaml:1", "[x, y]")),
    "a part that is elsewhere": (TASK.replace("0.0882", "3"), "1", ("never cuts",)),
    "a tolerance that leaves nothing": (TASK, "200", ("200 mm", "leaves something of the part")),
    "a tolerance that is none": (TASK, "0", ("--tolerance", "above 0")),
}


@needs_data
@pytest.mark.parametrize(("task", "tolerance", "said"), BAD.values(), ids=BAD)
def test_bad_input_is_refused(task: str, tolerance: str, said, benign: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "task.yaml").write_text(task)
    out = tmp_path / "outside.csv"
    options = ["--tolerance", tolerance, "--task", str(tmp_path / "task.yaml"), "-o", str(out)]
    assert main(["monitor", "adm", "envelope", benign, *options]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert all(text in err for text in said)
    assert not out.exists()
