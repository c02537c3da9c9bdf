"""Recordings as CSV files, and the runs in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_data import BENIGN, BOTH, needs_data, recording

from fame.errors import ConfigError
from fame.monitor.anomaly.recording import Recording, in_joint_order, merge, of_runs, read_csv, write_csv
from fame.monitor.data_files import read_runs, stamp_text


def made(label: int = 1) -> Recording:
    values = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    return Recording(("s", "l"), values, np.full(3, label), np.array([0, 0, 1]), np.array([1.0, 1.025, 2.0]))


@needs_data
def test_the_benign_recording_holds_thirty_runs():
    found = recording(BENIGN)
    lengths = [rows.stop - rows.start for rows in found.slices()]
    assert (len(found), found.count, min(lengths), max(lengths)) == (15528, 30, 510, 528)


@needs_data
def test_the_mixed_recording_loses_its_separators_and_holds_twenty_loops():
    found = recording(BOTH)
    labels = found.run_labels()
    loops = [rows.stop - rows.start for rows in found.slices()[:20]]
    assert (len(found), labels.count(-1), labels.count(1)) == (20221 - 2, 20, 30)
    assert (min(loops[:10]), max(loops[:10])) == (215, 229)
    assert (min(loops[10:]), max(loops[10:])) == (238, 253)


def test_what_is_written_is_read_again(tmp_path: Path):
    write_csv(tmp_path / "a.csv", made())
    again = read_csv(tmp_path / "a.csv")
    assert (again.joints, again.run_labels()) == (("s", "l"), [1, 1])
    assert np.array_equal(again.values, made().values)
    assert again.stamps is not None
    assert again.stamps.tolist() == [1.0, 1.025, 2.0]


def test_columns_of_a_learning_file_count_joints_in_files_with_a_header_too(tmp_path: Path):
    write_csv(tmp_path / "a.csv", made())
    assert read_csv(tmp_path / "a.csv", [1], 2).values.ravel().tolist() == [0.2, 0.4, 0.6]


def test_a_stamp_since_1970_has_the_digits_that_it_tells() -> None:
    assert [stamp_text(stamp) for stamp in (0.1234567891, 1_700_000_000.01)] == ["0.123456789", "1700000000.010000000"]


@needs_data
def test_separator_rows_are_named(tmp_path: Path):
    assert recording(BOTH).notes == (f"{BOTH}: left out 2 all-zero rows away from home (line 1, 2237)",)


def test_a_row_of_zeros_in_a_file_with_runs_is_left_out_too(tmp_path: Path):
    (tmp_path / "a.csv").write_text("run,s,l,label\n0,1,2,1\n0,0,0,1\n0,1,2,1\n1,1,2,1\n")
    found = read_csv(tmp_path / "a.csv")
    assert (found.runs.tolist(), len(found.notes)) == ([0, 0, 1], 1)


@needs_data
def test_runs_after_an_interruption_are_still_found_by_home(tmp_path: Path):
    lines = BENIGN.read_text().splitlines()[:1560]
    lines[250] = "0,0,0,0,0,0,1"
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found = [len(run) for run in read_csv(tmp_path / "a.csv")]
    whole = [len(run) for run in recording(BENIGN)]
    assert found[0] == 250
    assert found[1:3] == [whole[0] - 251, whole[1]]


def test_merging_keeps_labels_and_numbers_the_runs_on(tmp_path: Path):
    write_csv(tmp_path / "a.csv", made())
    write_csv(tmp_path / "b.csv", made(-1))
    both = merge([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert (both.run_labels(), both.runs.tolist()) == ([1, 1, -1, -1], [0, 0, 1, 2, 2, 3])


def test_a_repeated_header_begins_another_file_and_lines_are_counted_with_it(tmp_path: Path):
    for name, label in (("a", 1), ("b", -1), ("c", 7)):
        write_csv(tmp_path / f"{name}.csv", replace(made(label).select([0]), stamps=np.array([0.0, 1.0])))
    first, second, wrong = ((tmp_path / f"{name}.csv").read_text() for name in "abc")
    (tmp_path / "both.csv").write_text(first + second)
    both = read_csv(tmp_path / "both.csv")
    assert (both.run_labels(), both.runs.tolist()) == ([1, -1], [0, 0, 1, 1])
    assert [len(run) for run in read_runs([tmp_path / "both.csv"])] == [2, 2]
    (tmp_path / "both.csv").write_text(first + wrong)
    with pytest.raises(ConfigError, match=r"both\.csv:5: expected the label"):
        read_csv(tmp_path / "both.csv")
    (tmp_path / "both.csv").write_text(first + second.replace("s,l", "l,s"))
    with pytest.raises(ConfigError, match=r"both\.csv:4: is another header than the first one"):
        read_csv(tmp_path / "both.csv")


def test_joints_come_in_the_order_of_a_model_and_others_are_refused():
    given = of_runs([np.array([[1.0, 2.0], [3.0, 4.0]])], 1, ("turn", "lift"), "a.csv")
    assert in_joint_order(given, ("lift", "turn")).values.tolist() == [[2.0, 1.0], [4.0, 3.0]]
    assert in_joint_order(given, ("joint_1", "joint_2")) is given  # a headerless file names none
    numbered = of_runs([np.array([[1.0, 2.0]])], 1, ("joint_2", "joint_1"))
    assert in_joint_order(numbered, ("joint_1", "joint_2")).values.tolist() == [[2.0, 1.0]]
    for others in (("lift", "gripper"), ("lift", "turn", "tilt"), ("lift",)):
        with pytest.raises(ConfigError, match=r"a\.csv: has 2 joints \(turn, lift\); the model has"):
            in_joint_order(given, others)


def test_files_of_different_joints_are_not_merged(tmp_path: Path):
    write_csv(tmp_path / "a.csv", made())
    write_csv(tmp_path / "b.csv", of_runs([np.ones((2, 2))], 1, ("u", "r")))
    with pytest.raises(ConfigError, match=r"b\.csv: has the 2 joints u, r; expected the 2 of .*a\.csv \(s, l\)"):
        merge([tmp_path / "a.csv", tmp_path / "b.csv"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,1\n1,nan,1\n", r"x\.csv:2: expected a finite number"),
        ("1,2,1\n1,2\n", r"x\.csv:2: expected 3 cells, got 2"),
        ("s,l,label\n1,2,x\n", r"x\.csv:2: expected a number in column 'label', got 'x'"),
        ("1,2,7\n", r"x\.csv:1: expected the label 1 \(benign\) or -1 \(anomalous\) in column 2, got 7"),
        ("", "is empty"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(tmp_path: Path, text: str, message: str):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_csv(tmp_path / "x.csv")


def test_a_column_that_is_not_there_is_named(tmp_path: Path):
    (tmp_path / "x.csv").write_text("1,2,1\n")
    with pytest.raises(ConfigError, match="has 3 columns; column 6"):
        read_csv(tmp_path / "x.csv", [0, 1], 6)


def test_a_byte_order_mark_makes_no_header_of_the_first_row(tmp_path: Path):
    (tmp_path / "a.csv").write_text("\ufeff0.1,0.2,1\n0.11,0.2,1\n\n")
    found = read_csv(tmp_path / "a.csv")
    assert (len(found), found.joints) == (2, ("joint_1", "joint_2"))
    (tmp_path / "a.csv").write_text("\ufeffstamp,run,s,label\n0,0,1,1\n1,0,2,1\n")
    assert read_csv(tmp_path / "a.csv").joints == ("s",)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("stamp,run,s,label\nnan,0,1,1\n", ":2: expected a finite number"),
        ("stamp,run,s,label\n0,nan,1,1\n", ":2: expected a finite number"),
        ("s,s,label\n0,1,1\n", "several columns 's'"),
        ("s,label\n" + "1" * 200_000 + ",1\n", ":2: expected a finite number"),
    ],
)
def test_what_would_be_guessed_from_a_table_is_refused_with_its_line(text: str, why: str, tmp_path: Path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ConfigError, match=why):
        read_csv(tmp_path / "a.csv")


def steady(rows: int, *, head: str = "", label: str = "") -> str:
    """A table of a time and two joints that move to and fro; stamps with jitter."""
    jitter = 0.002 * np.random.default_rng(1).standard_normal(rows)
    lines = [f"{0.025 * n + jitter[n]:.6f},{np.sin(n):.6f},{np.cos(n):.6f}{label}" for n in range(rows)]
    return "\n".join([head, *lines] if head else lines) + "\n"


@pytest.mark.parametrize(
    ("text", "inputs", "why"),
    [
        (
            steady(40),
            [0, 1, 2],
            r"column 0 \(counted from 0\) grows steadily from row to row, as times do, not a joint",
        ),
        (steady(40, label=",1"), None, "column 0 .* grows steadily"),
        (
            steady(40, head="Time,a,b"),
            None,
            r"'Time', holds times, not a joint: call it 'stamp' \(s\), or leave it out",
        ),
        (
            steady(40, head="stamp,a,b"),
            [0, 1],
            r"column 0 .* is 'stamp', not a joint; the joints are the columns \[1, 2\]",
        ),
        ("stamp,run,a\n0,0,1\n1,0,2\n", [1, 2], r"column 1 .* is 'run', not a joint; the joints are the columns \[2\]"),
    ],
)
def test_a_column_of_times_is_not_a_joint(tmp_path: Path, text: str, inputs: list[int] | None, why: str):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ConfigError, match=why):
        read_csv(tmp_path / "a.csv", inputs)


def test_stamps_are_recognised_without_labels_and_a_named_axis_may_turn_steadily(tmp_path: Path):
    (tmp_path / "a.csv").write_text(steady(40, head="stamp,a,b"))
    found = read_csv(tmp_path / "a.csv")
    assert (found.joints, found.stamps is not None, set(found.labels.tolist())) == (("a", "b"), True, {1})
    (tmp_path / "a.csv").write_text(steady(40, head="turntable,a,b"))
    assert read_csv(tmp_path / "a.csv").joints == ("turntable", "a", "b")
    assert read_csv(tmp_path / "a.csv", [1, 2]).joints == ("a", "b")


def test_a_joint_named_t_is_one_beside_stamps(tmp_path: Path) -> None:
    path = tmp_path / "arm.csv"
    path.write_text("stamp,run,b,t,label\n0,0,0,1,1\n1,0,1,2,1\n")
    assert read_csv(path, [0, 1], 2).joints == ("b", "t")
    path.write_text("b,t,label\n0,1,1\n1,2,1\n")
    with pytest.raises(ConfigError, match="holds times, not a joint"):
        read_csv(path, [0, 1], 2)
