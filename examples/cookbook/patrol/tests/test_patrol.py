"""The guard patrols until it is called, then drives to where the call says (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_it_goes_round_until_it_is_called(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(9.5)
    m.expect("GUARD").passed("To Next Place", times=2).never_entered("To the Caller")
    m.expect("GUARD").completed(within=6).has(x_call=2.0, y_call=1.5)
    m.expect("DESK").completed(within=1).passed("arrived")


def test_a_call_from_elsewhere_counts_too(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(1).signal("called", x=7.0)
    m.advance(1).expect("GUARD").waits_at("To the Caller").has(x_call=7.0)
