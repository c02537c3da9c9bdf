"""An arm takes the lid off a motor and puts it back; its monitor stops it at an anomaly (models/reassembly.bpmn)."""

from __future__ import annotations

from typing import Any

from fame.testing import FakeService, MissionLoader, MissionUnderTest

MODEL = "models/reassembly.bpmn"
WAY = {"points": [{"time_from_start": {"sec": 2}}]}
NO_WAY: dict[str, Any] = {"points": []}


def cell(mission: MissionLoader, *, watching: float = 600) -> tuple[MissionUnderTest, FakeService]:
    """The arm and its gripper, and a monitor that watches for so many seconds."""
    m = mission.load(MODEL)
    m.stub("joint_monitor", after=watching)
    return m, m.fake_service("/Arm/gripper", "std_srvs/srv/SetBool", response={"success": True})


def find_ways(m: MissionUnderTest, *ways: dict[str, Any]) -> None:
    """The digital twin answers so many goals of the arm, each with a trajectory."""
    for way in ways:
        m.run_until("Arm", at="Gateway_Re_Answer")
        m.signal("Arm", "~/joint_trajectory", way)


def test_the_lid_comes_off_goes_to_the_table_and_back_on_the_motor(mission: MissionLoader) -> None:
    m, gripper = cell(mission)
    find_ways(m, *[WAY] * 12)
    m.expect("Arm").completed(within=10).passed("Look at the Way", times=12)
    assert [request.data for request in gripper.requests] == [False, True, False, True, False]
    goals = [goal.message.pose.position for goal in m.published("/Arm/goal_pose")]
    used_at = [(goals[step].x, goals[step].y) for step in (1, 4, 6, 9)]
    assert used_at == [(0.5, 0.0), (0.32, -0.38), (0.32, -0.38), (0.5, 0.0)]
    assert [over.value for over in m.published("/reassembly_over")] == ["done"]
    m.expect("Monitor").completed().passed("over")


def test_the_jaws_move_only_when_the_arm_is_there(mission: MissionLoader) -> None:
    m, gripper = cell(mission)
    find_ways(m, WAY)
    m.advance(2.3).expect("Arm").waits_at("there").never_entered("Gripper")
    m.advance(0.2).expect("Arm").passed("Gripper").before("jaws at rest")
    assert len(gripper.requests) == 1


def test_a_goal_that_gets_no_answer_is_sent_again(mission: MissionLoader) -> None:
    m, _ = cell(mission)
    m.run_until("Arm", at="Gateway_Re_Answer")
    m.advance(6)
    assert len(m.published("/Arm/goal_pose")) == 2
    find_ways(m, *[WAY] * 12)
    m.expect("Arm").completed(within=10).passed("Look at the Way", times=12)


def test_without_a_way_it_fails_and_the_monitor_knows(mission: MissionLoader) -> None:
    m, _ = cell(mission)
    find_ways(m, WAY, *[NO_WAY] * 3)
    m.expect("Arm").failed("unreachable", at="unreachable", within=1)
    assert [over.value for over in m.published("/reassembly_over")] == ["there is no way"]
    m.expect("Monitor").completed(within=1).passed("over")


def test_an_anomaly_stops_the_arm_where_it_is_and_names_the_joint(mission: MissionLoader) -> None:
    m, _ = cell(mission)
    find_ways(m, WAY)
    m.advance(1).signal("anomaly", name=["joint_0"], position=[2.5])
    m.expect("Arm").completed(within=1).passed("Event_Re_Hold").before("Tell")
    m.expect("Arm").never_entered("Use the jaws?")
    assert m.published("/Arm/joint_trajectory")[-1].message.points == []
    assert [over.value for over in m.published("/reassembly_over")] == [
        "stopped: joint_0, a loss 2.5 times its threshold"
    ]


def test_the_arm_goes_on_if_its_monitor_ends(mission: MissionLoader) -> None:
    m, _ = cell(mission, watching=3)
    find_ways(m, WAY, WAY)
    m.expect("Monitor").completed(within=5).passed("ended")
    m.expect("Arm").waits_at("there")
