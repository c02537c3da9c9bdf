"""The small examples: cars that set off together, a car that delivers, a tractor that charges in between."""

import re
from pathlib import Path

import pytest

from fame.clock import SECOND
from fame.robot import Event
from fame.scenario import Fault, Result, Scenario

CONVOY = Path("examples/convoy.yaml")
DELIVERY = Path("examples/delivery.yaml")
SHUTTLE = Path("examples/shuttle.yaml")


def played(path: Path, *faults: Fault) -> tuple[Result, list[Event]]:
    """How it went, and each element that was entered."""
    events: list[Event] = []
    result = Scenario.load(path, faults=list(faults)).run(observer=events.append)
    return result, [event for event in events if event.what == "enter"]


def times(events: list[Event], element: str) -> dict[str, float]:
    """When each robot came to an element, s."""
    return {event.robot: event.time / SECOND for event in events if event.element == element}


def without_crate(tmp_path: Path) -> Path:
    text = re.sub(r"  obstacles:\n.*\n", "", DELIVERY.read_text()).replace("../models", str(Path("models").resolve()))
    path = tmp_path / "delivery.yaml"
    path.write_text(text)
    return path


def test_the_cars_set_off_together_when_the_last_one_is_there() -> None:
    result, events = played(CONVOY)
    there, off = times(events, "Activity_Barrier"), times(events, "Activity_Go")
    assert [result.status, *(each.verdict for each in result.judgements)] == ["completed", *["holds"] * 3]
    assert len(off) == 5
    assert set(off.values()) == {max(there.values())}
    assert sorted(there.values())[-1] > sorted(there.values())[-2] + 0.05  # the last one comes alone


@pytest.mark.long
def test_who_is_missing_is_not_waited_for_without_end() -> None:
    _, events = played(CONVOY, Fault("Car_3", 1.0, "engine"))
    there, off = times(events, "Activity_Barrier"), times(events, "Activity_Go")
    assert sorted(off) == ["Car_1", "Car_2", "Car_4", "Car_5"]
    assert all(off[car] == there[car] + 30 for car in off)


def test_what_cannot_be_delivered_is_tried_three_times_and_unloaded_at_home() -> None:
    result, events = played(DELIVERY)
    ways = [event.element for event in events]
    assert [result.status, *(each.verdict for each in result.judgements)] == ["completed", *["holds"] * 3]
    assert (ways.count("Activity_Drive"), ways.count("Activity_CountAttempts")) == (5, 2)
    assert ways[-1] == "Event_GivenUp"
    assert [event.detail for event in result.reports] == ["unloaded again"]
    porter = result.world["robots"]["PORTER"]
    assert abs(porter["x"] - 0.6) < 0.2
    assert abs(porter["y"] - 2.0) < 0.2


def test_with_free_doors_everything_is_delivered(tmp_path: Path) -> None:
    result, events = played(without_crate(tmp_path))
    assert events[-1].element == "Event_Delivered"
    assert [event.detail for event in result.reports] == ["delivered; attempts: 1 1 1"]


def test_the_tractor_charges_in_between_and_goes_on_where_it_was() -> None:
    result, events = played(SHUTTLE)
    ways = [event.element for event in events]
    trips = [way for way in ways if way in ("Activity_ToField", "Activity_ToBarn", "Event_Low", "Event_GoesOn")]
    assert [result.status, *(each.verdict for each in result.judgements)] == ["completed", *["holds"] * 3]
    assert trips.count("Activity_ToField") == trips.count("Activity_ToBarn") == 4  # none is begun anew
    low = trips.index("Event_Low")
    assert trips[low : low + 2] == ["Event_Low", "Event_GoesOn"]
    assert 0 < low < len(trips) - 2
    assert result.world["robots"]["MULE"]["battery"] > 0.2
