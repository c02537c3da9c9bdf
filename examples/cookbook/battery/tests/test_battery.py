"""The mule charges when its battery is low, and its trip goes on (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader


def test_a_low_battery_is_charged_and_the_drive_starts_again(mission: MissionLoader) -> None:
    m = mission.load("../mission.bpmn")
    drives = m.stub("GoTo", after=10)
    m.fake_topic(
        "/MULE/battery_state", values=[{"percentage": charge} for charge in (0.9, 0.1, 0.1, 0.5, 1.0)], every=5
    )
    m.expect().completed(within=70)
    m.expect().passed("To the Charger", times=1).before("charged")
    m.expect().passed("To the Barn", times=2)
    goals = [round(call.variables["x_goal"]) for call in drives.calls]
    assert goals == [7, 1, 7, 1, 7, 1]  # the second one is the charger, then the field again
