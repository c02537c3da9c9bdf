"""The MH5 in the world: it cuts when told, tells its joints, and can be led astray."""

import sys
from typing import Any

import numpy as np
import pytest
from grounds import Ground

from fame.errors import UnavailableError
from robots.arm.mh5 import programmed
from robots.arm.task import MH5, TRIANGLE, find_cut

JOINTS, EMPTY, TEXT, NUMBER = (
    "sensor_msgs/msg/JointState", "std_msgs/msg/Empty", "std_msgs/msg/String", "std_msgs/msg/UInt32",
)  # fmt: skip


class Cell(Ground):
    """A ground with an arm."""

    def __init__(self, seed: int = 1) -> None:
        robots = {"Arm": {"type": "mh5", "at": [0.6, 1.0]}}
        super().__init__({"size": [2, 2], "step": 0.025, "robots": robots}, seed)
        self.states, self.parts = self.hear("/Arm/joint_states", JOINTS), self.hear("/Arm/part_cut", NUMBER)

    def tell(self, topic: str, text: str | None = None) -> None:
        self.say(f"/Arm/{topic}", EMPTY if text is None else TEXT, {} if text is None else text)

    @property
    def angles(self) -> np.ndarray:
        return np.array([state.position for state in self.states])

    @property
    def status(self) -> dict[str, Any]:
        return self.world.summary()["robots"]["Arm"]


def test_told_to_cut_it_cuts_one_part_and_comes_home() -> None:
    cell = Cell()
    cell.run(1)
    cell.tell("cut")
    cell.run(20)
    assert [message.data for message in cell.parts] == [1]
    assert np.abs(cell.angles[-1]).max() < 1e-4
    places = MH5.places(cell.angles)
    cut = find_cut(places, TRIANGLE)
    assert sorted(set(cut.sides.tolist())) == [0, 1, 2]
    for corner in TRIANGLE.corners:
        assert np.linalg.norm(places[cut.first : cut.last + 1, :2] - corner, axis=1).min() < 1e-3
    assert (cell.status["parts"], cell.status["spoiled"]) == (1, 0)


def test_joint_states_come_at_their_rate_also_at_rest() -> None:
    cell = Cell()
    cell.run(2)
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec / 1e9 for state in cell.states]
    assert np.allclose(np.diff(stamps), 0.025)
    assert tuple(cell.states[0].name) == MH5.joints


def test_no_two_runs_are_the_same_but_the_same_seed_gives_the_same() -> None:
    def two(seed: int) -> np.ndarray:
        cell = Cell(seed)
        for end in (14, 28):
            cell.tell("cut")
            cell.run(end)
        return cell.angles

    first = two(1)
    assert np.array_equal(first, two(1))
    assert not np.array_equal(first, two(2))
    assert not np.array_equal(first[:500], first[560:1060])


def test_an_arm_that_is_held_stays_and_goes_home_before_it_cuts_again() -> None:
    cell = Cell()
    cell.tell("cut")
    cell.run(5)
    cell.tell("hold")
    cell.run(8)
    assert np.array_equal(cell.angles[-1], cell.angles[-100])
    assert not cell.status["cutting"]
    cell.tell("cut")
    cell.run(30)
    assert cell.status["parts"] == 1
    assert np.abs(np.diff(cell.angles, axis=0)).max() < 0.04  # rad: it never jumps


@pytest.mark.long
def test_another_program_spoils_the_parts_that_follow() -> None:
    cell = Cell()
    cell.tell("program", "b 0.5")
    cell.tell("cut")
    cell.run(15)
    assert (cell.status["spoiled"], cell.status["program"]) == (1, "b 0.5")
    nominal, altered = (MH5.places(programmed(program, 40.0)) for program in ("nominal", "b 0.5"))
    near = np.array([np.linalg.norm(nominal - place, axis=1).min() for place in altered])
    assert 4e-4 < near.max() < 3e-3  # m: 0.5 mm across a side, more at a corner and along the path
    assert near[:50].max() == 0.0


@pytest.mark.long_but("b -1")
@pytest.mark.parametrize("text", ["", "b", "x 1", "b one", "b -1", "b 100", "nominal 3"])
def test_a_program_that_there_is_not_changes_nothing(text: str) -> None:
    cell = Cell()
    cell.tell("program", text)
    cell.run(1)
    assert cell.status["program"] == "nominal"


def test_broken_encoders_say_nothing() -> None:
    cell = Cell()
    cell.run(1)
    count = len(cell.states)
    cell.world.fault("Arm", "encoders")
    cell.run(2)
    assert len(cell.states) == count


def test_without_scipy_the_world_says_so_before_anything_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(UnavailableError, match=r"scipy.*pip install 'fame-robots\[sim\]'"):
        Cell()
