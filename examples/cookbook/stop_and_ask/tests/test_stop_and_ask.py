"""A force above the limit suspends the arm until a person has decided (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_a_person_lets_it_go_on(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(6).signal("ARM", "~/force", data=12.0)
    m.advance(1).signal("ARM", "~/force", data=31.0)
    m.advance(100).expect().waits_at("Look")
    m.expect().passed("Press", times=1)
    m.signal("ARM", "~/force", data=3.0).complete("Look", go_on=True)
    m.expect().completed(within=40).passed("all pressed")


def test_a_person_stops_it(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(6).signal("ARM", "~/force", data=31.0)
    m.advance(1).complete("Look", go_on=False)
    m.expect().completed(within=3).passed("Release Part")
    m.expect().never_entered("all pressed")
