"""The tractor cuts what its blade turns above, drains its battery, and breaks as it is told."""

import math

import pytest
from grounds import ground

from fame.errors import ConfigError
from sim2d.robot import robot_class

BATTERY = "sensor_msgs/msg/BatteryState"


def field(seed=1, **changes):
    """A ground of 6 x 4 m with the tractor REX at (1, 2) looking along x."""
    tractor = {"type": "tractor", "watchdog": 0, **changes.pop("rex", {})}
    return ground(seed, rex=tractor, **changes)


def blade(g, torque):
    g.say("/REX/blade_force", "geometry_msgs/msg/Wrench", {"torque": {"z": torque}})


def cut(g):
    return {name: (weed["cut"], weed["by"]) for name, weed in g.world.summary()["weeds"].items()}


def test_a_blade_cuts_the_weed_above_which_it_has_turned_for_half_a_second():
    g = field(weeds=[{"name": "thistle", "at": [1.2, 2.1]}])
    g.run(1)
    blade(g, 1.0)
    g.run(1.4)
    assert cut(g) == {"thistle": (None, None)}
    g.run(2)
    assert cut(g) == {"thistle": (pytest.approx(1.5, abs=0.03), "REX")}


def test_commands_that_repeat_themselves_do_not_begin_anew():
    g = field(weeds=[{"at": [1, 2]}])
    for tenth in range(10):
        g.run(tenth / 10)
        blade(g, 1.0)
    assert cut(g)["weed_1"][0] == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("torque", [0.0, -1.0, math.nan])
def test_a_blade_that_does_not_turn_cuts_nothing(torque):
    g = field(weeds=[{"at": [1, 2]}])
    g.run(0)
    blade(g, torque)
    g.run(3)
    assert cut(g) == {"weed_1": (None, None)}
    assert g.world.robots["REX"].appearance.blade == 0


def test_it_cuts_only_what_is_under_its_disc():
    g = field(weeds=[{"name": "under", "at": [1.29, 2]}, {"name": "beside", "at": [1, 2.31]}])
    g.run(0)
    blade(g, 1.0)
    g.run(2)
    assert cut(g)["under"][1] == "REX"
    assert cut(g)["beside"] == (None, None)
    assert g.world.robots["REX"].appearance.blade == 0.3


def test_one_that_only_passes_by_quickly_cuts_nothing():
    weeds = [{"name": "passed", "at": [3, 2]}]
    g = field(weeds=weeds, rex={"max_speed": 1.5})
    g.run(0)
    blade(g, 1.0)
    g.drive(1.5)  # above it for 0.4 s
    g.run(3)
    assert g.world.robots["REX"].pose.x > 4
    assert cut(g) == {"passed": (None, None)}
    g = field(weeds=weeds)
    g.run(0)
    blade(g, 1.0)
    g.drive(0.5)  # for 1.2 s
    g.run(6)
    assert cut(g)["passed"][1] == "REX"


def test_it_collides_with_obstacles_and_not_with_weeds():
    g = field(obstacles=[{"name": "rock", "at": [4, 2], "radius": 0.3}], weeds=[{"at": [2, 2]}])
    g.run(0)
    g.drive(0.8)
    g.run(6)
    assert [(a, b) for _, a, b in g.world.collisions] == [("REX", "rock")]
    assert g.world.robots["REX"].pose.x == pytest.approx(4 - 0.3 - 0.3, abs=0.02)


def test_weeds_are_not_in_the_map_and_not_seen_by_its_range_sensor():
    g = field(weeds=[{"at": [2, 2]}])
    heard = g.hear("/REX/range", "sensor_msgs/msg/Range")
    chart = g.hear("/REX/map", "nav_msgs/msg/OccupancyGrid", latched=True)
    g.run(0.1)
    assert heard[-1].range == math.inf
    assert (chart[0].data == ground().world.map.data).all()


def test_it_brakes_as_tyres_on_grass_do():
    g = field()
    g.run(0)
    g.drive(1.0)
    g.run(2)
    begin = g.world.robots["REX"].pose.x
    g.drive(0)
    g.run(4)
    assert g.world.robots["REX"].pose.x - begin == pytest.approx(1 / 2 / (0.35 * 9.81), abs=0.012)


def test_the_battery_drains_with_motion_and_blade():
    def used(speed, torque):
        g = field(walls=False)
        heard = g.hear("/REX/battery_state", BATTERY)
        g.run(0)
        g.drive(speed)
        blade(g, torque)
        g.run(10)
        assert len(heard) == 11
        return (heard[0].percentage - heard[10].percentage) * 100 * 3600 / 10  # W

    assert used(0, 0) == pytest.approx(5, rel=0.01)
    assert used(0.5, 0) == pytest.approx(35, rel=0.05)
    assert used(0.5, 1) == pytest.approx(185, rel=0.05)


def test_a_charger_fills_the_battery_of_who_stands_on_it_and_no_more():
    def charged(at, seconds=20):
        g = field(rex={"battery": {"charge": 0.5, "capacity": 2}}, chargers=[{"at": at, "power": 365}])
        heard = g.hear("/REX/battery_state", BATTERY)
        g.run(seconds)
        return heard[-1]

    here = field().world.robots["REX"].pose
    state = charged([here.x, here.y + 0.4], 5)
    assert state.percentage == pytest.approx(0.5 + 360 * 5 / 7200, abs=1e-3)
    assert (state.current > 0, state.power_supply_status) == (True, state.POWER_SUPPLY_STATUS_CHARGING)
    full = charged([here.x, here.y])
    assert (full.percentage, full.power_supply_status) == (1.0, full.POWER_SUPPLY_STATUS_FULL)
    assert charged([here.x, here.y + 0.6]).percentage < 0.5


def test_battery_state_is_told_as_the_type_says():
    g = field(rex={"battery": {"charge": 0.5}})
    heard = g.hear("/REX/battery_state", BATTERY)
    g.run(1)
    state = heard[-1]
    assert (state.percentage, state.present) == (pytest.approx(0.5, abs=1e-3), True)
    assert state.voltage == pytest.approx(24 * 0.95, rel=1e-3)
    assert state.current == pytest.approx(-5 / state.voltage, rel=1e-3)
    assert state.charge == pytest.approx(state.capacity / 2, rel=1e-3)
    assert math.isnan(state.temperature)
    assert state.power_supply_status == state.POWER_SUPPLY_STATUS_DISCHARGING


def test_one_with_an_empty_battery_stands_still_and_its_blade_too():
    g = field(rex={"battery": {"capacity": 0.1}}, weeds=[{"at": [1, 2]}])
    heard = g.hear("/REX/battery_state", BATTERY)
    g.run(0)
    g.drive(0.3)
    g.run(30)
    stood = g.world.robots["REX"].pose
    g.drive(0.3)
    blade(g, 1)
    g.run(35)
    assert g.world.robots["REX"].pose == stood
    assert g.world.robots["REX"].status == {"battery": 0.0, "blade": False}
    assert (heard[-1].percentage, heard[-1].current) == (0, 0)


def test_a_range_sensor_at_fault_is_silent():
    g = field()
    heard, odom = g.hear("/REX/range", "sensor_msgs/msg/Range"), g.hear("/REX/odom", "nav_msgs/msg/Odometry")
    g.run(1)
    g.world.fault("REX", "range")
    g.run(2)
    assert len(heard) == 21
    assert len(odom) == 41
    assert g.world.robots["REX"].appearance.cone is None


def test_blocked_wheels_brake_and_obey_no_more():
    g = field()
    g.run(0)
    g.drive(0.8)
    g.run(2)
    begin = g.world.robots["REX"].pose.x
    g.world.fault("REX", "wheels")
    g.drive(0.8, 1.0)
    g.run(4)
    stood = g.world.robots["REX"].pose
    assert stood.x - begin == pytest.approx(0.8**2 / 2 / (0.35 * 9.81), abs=0.012)
    assert stood.heading == pytest.approx(0, abs=1e-9)


def test_its_safe_state_stops_it_and_its_blade():
    for state in (robot_class("tractor").SAFE_STATE, robot_class("tractor").SAFE_SUSPENDED):
        g = field()
        g.run(0)
        g.drive(0.5)
        blade(g, 1)
        g.run(1)
        for topic, kind, fields in state:
            g.say(f"/REX/{topic}", kind, fields)
        g.run(2)
        stood = g.world.robots["REX"].pose
        g.run(3)
        assert g.world.robots["REX"].pose == stood
        assert not g.world.robots["REX"].status["blade"]


def test_its_parameters_can_be_changed_one_by_one():
    g = field(rex={"range": {"noise": 0}, "blade": {"ahead": 0.2}}, weeds=[{"at": [1.45, 2]}])
    heard = g.hear("/REX/range", "sensor_msgs/msg/Range")
    g.run(0)
    blade(g, 1)
    g.run(1)
    assert heard[-1].max_range == 3  # the tractor's own default, beside a noise that was given
    assert cut(g)["weed_1"][1] == "REX"
    with pytest.raises(ConfigError, match=r"robots.REX.blade.radios: unknown key; did you mean 'radius'"):
        field(rex={"blade": {"radios": 1}})


def test_no_current_flows_into_a_full_battery():
    g = field(chargers=[{"at": [1, 2]}])
    heard = g.hear("/REX/battery_state", BATTERY)
    g.run(3)
    assert [state.current for state in heard] == [0.0] * 4


def test_the_battery_drains_however_seldom_the_odometry_speaks():
    def left(rate):
        g = field(rex={"odom": {"rate": rate}})
        heard = g.hear("/REX/battery_state", BATTERY)
        g.run(4)
        return heard[-1].percentage

    assert left(0.01) == left(20)
