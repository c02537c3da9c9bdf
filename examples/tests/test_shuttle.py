"""A mule carries four loads and charges whenever its battery is low (models/shuttle.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader, MissionUnderTest

MODEL = "models/shuttle.bpmn"


def mule(mission: MissionLoader, *charges: float) -> MissionUnderTest:
    """The mule, whose battery tells these charges, one every ten seconds; each way takes ten seconds."""
    m = mission.load(MODEL)
    m.stub("GoTo", after=10)
    m.fake_topic("/MULE/battery_state", values=[{"percentage": charge} for charge in charges], every=10)
    return m


def test_four_loads_are_four_trips(mission: MissionLoader) -> None:
    m = mule(mission, *[0.9] * 10)
    m.expect().completed(within=100).has(trips=4)
    m.expect().passed("To the Barn", times=4)
    m.expect().never_entered("To the Charger")
    m.expect().passed("noted", times=8)


def test_a_low_battery_is_charged_and_the_trip_goes_on_from_where_it_was(mission: MissionLoader) -> None:
    m = mule(mission, 0.9, 0.9, 0.1, 0.1, 0.5, 1.0, *[1.0] * 10)
    m.run_until(at="charged")
    m.expect().passed("To the Charger", times=1)
    m.expect().completed(within=200).has(trips=4)
    m.expect().passed("goes on", times=1)
