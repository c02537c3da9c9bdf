"""The shares of workers that are lost or late are done by others (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"
TEAM = ["Worker_1", "Worker_2", "Worker_3"]


def test_a_whole_team_needs_no_helper(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect("BASE").completed(within=9).never_entered("30 s")
    m.expect("Worker_2").completed(within=1).passed("Work", times=1)


def test_the_share_of_a_lost_worker_is_done_by_another_one(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Worker": 3}, variables={"": {"team": TEAM}})
    m.advance(3).fault("Worker_2", "engine")
    m.expect("BASE").completed(within=40).passed("30 s", times=1)
    (request,) = m.published("/take_over")
    assert (request.message.key, request.message.value) == ("Worker_1", "Worker_2")
    m.expect("Worker_1").completed(within=1).passed("Work", times=2)
    m.expect("Worker_3").completed(within=1).passed("Work", times=1)


def test_a_helper_that_is_lost_too_is_not_the_last(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Worker": 3}, variables={"": {"team": TEAM}})
    m.advance(3).fault("Worker_2", "engine")
    m.advance(10).fault("Worker_1", "engine")
    m.expect("BASE").completed(within=70).passed("30 s", times=2)
    m.expect("Worker_3").completed(within=1).passed("Work", times=2)


def test_without_any_report_the_base_waits(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    for worker in ("Worker_1", "Worker_2"):
        m.advance(1).fault(worker, "engine")
    m.advance(70).expect("BASE").passed("30 s", times=2)
    m.expect("BASE").never_entered("Choose Helper").waits_at("Gateway_Done")
