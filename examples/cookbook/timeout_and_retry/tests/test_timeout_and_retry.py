"""REX docks within three attempts of 10 s, or says that it cannot (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_the_second_attempt_comes_after_a_pause(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect().completed(within=15).has(tries=2)
    m.expect().passed("docked")
    assert m.now == 15  # 10 s, the pause of 2 s, 3 s


def test_after_three_attempts_it_says_that_it_cannot(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.set(slow_tries=9)
    m.expect().completed(within=34).has(tries=3).never_entered("docked")
    assert [message.value for message in m.published("/dock_failed")] == ["REX"]
