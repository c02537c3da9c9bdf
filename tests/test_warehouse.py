"""Stations, parcels and doors, the carrier, and the mission of examples/warehouse.yaml."""

from pathlib import Path
from typing import Any

import pytest
from grounds import ground

from fame.errors import ConfigError
from fame.robot import Event
from fame.scenario import Result, Scenario
from sim2d.record import Things, WorldRecorder
from sim2d.warehouse import ParcelConfig, Parcels, StationConfig

EXAMPLE = Path(__file__).parent.parent / "examples" / "warehouse.yaml"
STATIONS = [{"name": "a", "at": [1.3, 2]}, {"name": "b", "at": [5, 2]}]
DOOR = {"name": "door", "from": [3, 0], "to": [3, 4], "time": 1, "open": 3}


class Hall:
    """A hall with a carrier REX at station a, a parcel there, and a door. `ask` calls a service without waiting."""

    def __init__(self, **changes: Any) -> None:
        parcels = [{"name": "p", "at": "a", "to": "b"}]
        things = {"stations": STATIONS, "parcels": parcels, "doors": [DOOR], **changes}
        self.ground = ground(rex={"type": "carrier"}, **things)
        self.world, self.time = self.ground.world, 0.0
        self.node = self.ground.middleware.node("test", "REX")
        self.answers: list[Any] = []
        self.run(0.1)

    def run(self, seconds: float) -> None:
        self.time += seconds
        self.ground.run(self.time)

    def drive(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            self.ground.drive(1.0)
            self.run(0.5)

    def ask(self, service: str) -> None:
        self.node.client(service, "std_srvs/srv/Trigger").call(None, self.answers.append)

    def answer(self, service: str) -> tuple[bool, str]:
        self.ask(service)
        self.run(0.1)
        response = self.answers.pop()
        return response.success, response.message


def test_a_carrier_takes_a_parcel_and_puts_it_down_at_a_station() -> None:
    hall = Hall()
    assert hall.answer("unload") == (False, "carries no parcel")
    assert hall.answer("load") == (True, "p")
    assert hall.answer("load") == (False, "carries p already")
    assert hall.world.summary()["parcels"]["p"]["carrier"] == "REX"
    assert hall.world.summary()["robots"]["REX"]["parcel"] == "p"
    assert hall.world.robots["REX"].appearance.cargo
    assert hall.answer("unload") == (True, "a")
    assert hall.world.summary()["parcels"]["p"]["station"] == "a"


@pytest.mark.parametrize("radius", [0.6, 0.1])
def test_a_parcel_that_a_station_has_taken_lies_at_it(radius: float) -> None:
    hall = Hall(stations=[{"name": "a", "at": [1.3, 2], "radius": radius}], parcels=[{"name": "p", "at": "a"}])
    assert (hall.answer("load"), hall.answer("unload")) == ((True, "p"), (True, "a"))
    assert hall.world.summary()["parcels"]["p"]["station"] == "a"


def test_a_parcel_lies_at_the_nearest_of_two_stations_where_it_was_put_down() -> None:
    stations = [StationConfig("A", (0.0, 0.0), 2.0), StationConfig("B", (1.0, 0.0), 0.6)]
    parcels = Parcels([ParcelConfig("p", (0.0, 0.0))], stations)
    parcel = parcels.take((0.0, 0.0), 1.0, "REX")
    assert parcel is not None
    assert parcels.put(parcel, (1.1, 0.0), 1.0) == parcels.station_of(parcel) == "B"


def test_a_parcel_out_of_reach_stays_where_it_is() -> None:
    hall = Hall(parcels=[{"name": "p", "at": [5, 3]}])
    assert hall.answer("load") == (False, "no parcel within 0.8 m")


def test_a_door_is_solid_until_it_is_open_and_closes_by_itself() -> None:
    hall = Hall()
    hall.drive(3)
    assert [collision.b for collision in hall.world.collisions] == ["door"]
    hall.ask("/door/open")
    hall.run(0.5)
    assert not hall.answers  # it answers when it is open
    hall.run(0.7)
    assert [answer.success for answer in hall.answers] == [True]
    hall.drive(2)
    assert hall.world.robots["REX"].pose.x > 3.5
    hall.run(8)
    assert hall.world.summary()["doors"] == {"door": 0.0}


def test_a_door_waits_for_a_robot_that_stands_in_it() -> None:
    hall = Hall()
    hall.ask("/door/open")
    hall.run(1.5)
    hall.drive(2.5)
    hall.ground.drive(0.0)
    hall.run(1)
    assert hall.world.robots["REX"].pose.x == pytest.approx(3, abs=0.25)
    hall.run(10)
    assert hall.world.summary()["doors"] == {"door": 1.0}


def test_the_map_has_neither_doors_nor_stations() -> None:
    assert not Hall().world.grid.occupied[1:-1, 1:-1].any()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"parcels": [{"at": "c"}]}, r"parcels\[0\]\.at: expected a station, got 'c'"),
        ({"parcels": [{"at": [9, 9]}]}, r"parcels\[0\]\.at: expected a place on the ground"),
        ({"parcels": [{"at": "a", "to": "x"}]}, r"parcels\[0\]\.to: expected a station, got 'x'"),
        ({"doors": [{"from": [1, 1]}]}, r"doors\[0\]: expected the key to"),
        ({"parcels": [{"name": "parcel_2", "at": "a"}, {"at": "b"}]}, "got a second parcel named 'parcel_2'"),
        ({"doors": [{"name": "a b", "from": [1, 1], "to": [1, 2]}]}, r"doors\[0\]: expected a name of ASCII letters"),
        ({"doors": [DOOR, DOOR]}, "got a second door named 'door'"),
        ({"doors": [{"from": [1, 1], "to": [1, 9]}]}, r"doors\[0\]\.to: expected a place on the ground"),
        ({"doors": [{"from": [1, 1], "to": [1.0, 1]}]}, r"doors\[0\]\.to: expected another place than the other end"),
    ],
)
def test_what_is_wrong_in_the_file_is_said_with_its_key(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Hall(**changes)


@pytest.fixture(scope="module")
def run() -> tuple[Result, list[Event]]:
    events: list[Event] = []
    return Scenario.load(EXAMPLE).run(observer=events.append), events


def test_the_warehouse_completes_with_every_parcel_at_a_station(run: tuple[Result, list[Event]]) -> None:
    result, _ = run
    assert (result.status, result.messages) == ("completed", ["parcel parcel_2 is at packing_3, not at packing_2"])
    assert [each.verdict for each in result.judgements] == ["holds"] * 3
    assert result.world is not None
    parcels = result.world["parcels"]
    assert {name: parcel["station"] for name, parcel in parcels.items() if parcel["station"] != parcel["to"]} == {
        "parcel_2": "packing_3"  # there is a pallet on packing_2
    }
    assert sum(robot.instances for robot in result.robots) == 1 + sum(
        1 for event in run[1] if event.element == "Event_Offer" and event.what == "enter"
    )


def test_an_aborted_navigation_is_a_bpmn_error_and_a_low_battery_suspends(run: tuple[Result, list[Event]]) -> None:
    _, events = run
    seen = [(event.robot, event.element) for event in events if event.what == "enter"]
    assert any(element == "Event_Unreachable" for _, element in seen)
    charged = [element for robot, element in seen if robot == "Carrier_2" and element.startswith("Activity_")]
    order = [charged.index(name) for name in ("Activity_Dock", "Activity_Undock", "Activity_Load")]
    assert order == sorted(order)


def test_robots_wait_until_a_door_is_open(run: tuple[Result, list[Event]]) -> None:
    _, events = run
    opening = [event for event in events if event.element == "Activity_OpenEast" and event.what in ("enter", "leave")]
    assert opening[1].time - opening[0].time > 1_000_000_000


def test_no_robot_touches_a_door_or_a_wall(run: tuple[Result, list[Event]]) -> None:
    result, _ = run
    assert result.world is not None
    touched = {collision["b"] for collision in result.world["collisions"]}
    assert touched <= {"Carrier_1", "Carrier_2", "Carrier_3"}


@pytest.mark.long
def test_another_number_of_robots_needs_no_other_model() -> None:
    result = Scenario.load(EXAMPLE, robots={"Carrier": 1}, duration=900).run()
    assert result.status == "completed"


@pytest.mark.long
def test_the_same_seed_gives_the_same_events(run: tuple[Result, list[Event]]) -> None:
    events: list[Event] = []
    Scenario.load(EXAMPLE).run(observer=events.append)
    assert events == run[1]


def test_a_recording_has_doors_parcels_and_what_robots_carry() -> None:
    hall = Hall()
    recorder = WorldRecorder(hall.world)
    hall.run(0.5)
    hall.ask("/door/open")
    hall.answer("load")
    hall.run(2)
    record = recorder.record
    assert record.things[0] == Things((0.0,), ((1.3, 2),))
    assert record.things[-1] == Things((1.0,), (None,))
    assert record.tracks[0].appearances[-1].cargo
