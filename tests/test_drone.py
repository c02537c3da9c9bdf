"""The drone takes off, obeys, hovers and lands as rotors, battery and watchdog let it; its camera finds weeds."""

import math

import pytest
from grounds import Ground

from sim2d.robot import robot_class

ODOMETRY, POSES, BATTERY = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseArray", "sensor_msgs/msg/BatteryState"
SHARP = {"noise": 0, "missed": 0}


def field(drone=None, seed=1, **world):
    """A field of 12 x 8 m with a drone at (2, 4) looking along x."""
    robots = {"Drone": {"type": "drone", "at": [2, 4], **(drone or {})}, **world.pop("robots", {})}
    return Ground({"size": [12, 8], **world, "robots": robots}, seed)


def order(g, word):
    g.say(f"/Drone/{word}", "std_msgs/msg/Empty", {})


def fly(g, ahead=0.0, left=0.0, up=0.0, turn_rate=0.0):
    twist = {"linear": {"x": ahead, "y": left, "z": up}, "angular": {"z": turn_rate}}
    g.say("/Drone/cmd_vel", "geometry_msgs/msg/Twist", twist)


def flying(drone=None, **world):
    """The same field after the take-off, at second 5."""
    g = field({"watchdog": 0, **(drone or {})}, **world)
    g.run(0)
    order(g, "takeoff")
    g.run(5)
    return g


def drone(g):
    return g.world.robots["Drone"]


def test_a_drone_on_the_ground_obeys_no_velocity():
    g = field({"watchdog": 0})
    g.run(0)
    fly(g, ahead=1, up=1)
    g.run(3)
    assert drone(g).pose == (2, 4, 0)
    assert drone(g).status["landed"]
    assert drone(g).appearance.altitude == 0


def test_take_off_starts_the_motors_and_climbs_to_its_height_by_itself():
    g = field({"height": 2.0})
    g.run(0)
    order(g, "takeoff")
    g.run(1)
    fly(g, ahead=1)  # still climbing: not obeyed
    heights = []
    while g.world.now < 6:
        g.run(g.world.now + 0.1)
        heights.append(drone(g).appearance.altitude)
    assert heights == sorted(heights)  # it does not shoot beyond
    assert heights[-1] == pytest.approx(2.0, abs=0.03)
    assert not drone(g).status["landed"]
    assert drone(g).pose[:2] == pytest.approx((2, 4), abs=0.01)


def test_a_second_take_off_changes_nothing():
    g = flying()
    fly(g, up=0.5)
    g.run(7)
    height = drone(g).appearance.altitude
    order(g, "takeoff")
    g.run(8)
    assert drone(g).appearance.altitude > height + 0.3


def test_velocities_are_those_of_its_own_body():
    g = flying({"heading": 90})
    fly(g, ahead=1, left=0.5, up=0.3)
    g.run(7)
    begin, low = drone(g).pose, drone(g).appearance.altitude
    g.run(8)
    end, high = drone(g).pose, drone(g).appearance.altitude
    assert (end.x - begin.x, end.y - begin.y, high - low) == pytest.approx((-0.5, 1.0, 0.3), abs=1e-3)


def test_it_turns_to_the_left_with_a_positive_rate():
    g = flying()
    fly(g, turn_rate=0.5)
    g.run(7)
    assert drone(g).pose.heading == pytest.approx(0.98, abs=0.03)


def test_speed_is_cut_to_its_limit_in_any_direction_and_what_is_no_number_is_a_stop():
    g = flying({"max_speed": 1.0})
    fly(g, ahead=30, left=40)
    g.run(7)
    begin = drone(g).pose
    g.run(8)
    end = drone(g).pose
    assert (end.x - begin.x, end.y - begin.y) == pytest.approx((0.6, 0.8), abs=1e-3)
    fly(g, ahead=math.nan, up=math.inf)
    g.run(10)
    there = drone(g).pose
    g.run(11)
    assert drone(g).pose[:2] == pytest.approx(there[:2], abs=1e-9)


def test_it_takes_its_braking_distance():
    g = flying({"acceleration": 1.5})
    fly(g, ahead=1.2)
    g.run(7)
    begin = drone(g).pose.x
    fly(g)
    g.run(9)
    assert drone(g).pose.x - begin == pytest.approx(1.2**2 / 2 / 1.5, abs=0.01)


@pytest.mark.parametrize(("up", "height"), [(-1, 0.5), (1, 4.0)])
def test_it_stays_between_floor_and_ceiling(up, height):
    g = flying({"ceiling": 4.0})
    fly(g, up=up)
    g.run(12)
    assert drone(g).appearance.altitude == pytest.approx(height, abs=0.02)
    assert not drone(g).status["landed"]


def test_without_commands_it_hovers():
    g = flying({"watchdog": 0.5})
    fly(g, ahead=1, up=0.5)
    g.run(8)
    there, height = drone(g).pose, drone(g).appearance.altitude
    assert 2.4 < there.x < 2.6
    g.run(10)
    assert (*drone(g).pose, drone(g).appearance.altitude) == pytest.approx((*there, height), abs=1e-6)


def test_landing_sinks_and_stops_the_motors():
    g = flying()
    order(g, "land")
    g.run(5.5)
    fly(g, up=1)  # landing: not obeyed
    g.run(9)
    assert drone(g).status["landed"]
    assert drone(g).appearance.altitude == 0
    order(g, "land")
    order(g, "takeoff")
    g.run(14)
    assert drone(g).appearance.altitude == pytest.approx(1.5, abs=0.03)


def test_it_flies_over_obstacles_robots_and_walls_without_touching_them():
    g = flying(
        obstacles=[{"at": [4, 4], "radius": 0.5}],
        robots={"Tractor_1": {"type": "tractor", "at": [6, 4]}},
    )
    fly(g, ahead=2)
    g.run(12)
    assert drone(g).pose.x > 13
    assert g.world.collisions == []


def test_a_sensor_on_the_ground_sees_it_only_when_it_stands():
    g = field({"at": [4, 4]}, robots={"Tractor_1": {"type": "tractor", "at": [2, 4]}})
    heard = g.hear("/Tractor_1/range", "sensor_msgs/msg/Range")
    g.run(0)
    assert heard[-1].range == pytest.approx(4 - 0.2 - 2.3, abs=0.05)
    order(g, "takeoff")
    g.run(4)
    assert heard[-1].range == math.inf


def test_one_that_lands_on_an_obstacle_slides_off_and_has_collided():
    g = flying(obstacles=[{"name": "rock", "at": [4, 4], "radius": 0.3}])
    fly(g, ahead=1)
    g.run(6.6)
    order(g, "land")
    g.run(20)
    assert {(a, b) for _, a, b in g.world.collisions} == {("Drone", "rock")}
    assert 0.45 < math.dist(drone(g).pose[:2], (4, 4)) < 1.5


def test_its_odometry_tells_height_and_all_velocities():
    g = flying()
    heard = g.hear("/Drone/odom", ODOMETRY)
    fly(g, ahead=0.5, left=-0.3, up=0.2)
    g.run(8)
    assert len(heard) == 60
    last, pose = heard[-1], drone(g).pose
    assert (last.header.frame_id, last.child_frame_id) == ("map", "Drone/base_link")
    at, how = last.pose.pose.position, last.twist.twist.linear
    assert (at.x, at.y, at.z) == pytest.approx((pose.x, pose.y, drone(g).appearance.altitude), abs=0.1)
    assert (how.x, how.y, how.z) == pytest.approx((0.5, -0.3, 0.2), abs=0.08)
    assert last.pose.covariance[14] == pytest.approx(0.02**2)
    assert len({message.pose.pose.position.z - 1.5 for message in heard}) == 60  # noisy


def test_a_goal_is_answered_with_the_straight_way():
    g = field(obstacles=[{"at": [6, 4], "radius": 1}])
    heard = g.hear("/Drone/plan", "nav_msgs/msg/Path")
    g.say("/Drone/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 10.0, "y": 4.0}}})
    g.run(0.1)
    (path,) = heard
    places = [(at.pose.position.x, at.pose.position.y) for at in path.poses]
    assert places[0] == pytest.approx((2, 4), abs=0.1)
    assert places[1:] == [(10, 4)]


# ---- the camera ------------------------------------------------------------------------------------------------------


def pictures(g, until):
    heard = g.hear("/Drone/camera/weeds", POSES)
    g.run(until)
    return [[(pose.position.x, pose.position.y, pose.position.z) for pose in message.poses] for message in heard]


def test_the_camera_speaks_five_times_a_second_and_only_in_the_air():
    g = field()
    assert pictures(g, 2) == []
    order(g, "takeoff")
    seen = pictures(g, 4)
    assert len(seen) == pytest.approx(10, abs=1)
    assert all(picture == [] for picture in seen)


def test_it_tells_where_weeds_are_as_seen_from_its_body():
    g = flying({"heading": 90, "camera": SHARP}, weeds=[{"at": [2.5, 4.7]}, {"at": [9, 4]}])
    (weed,) = pictures(g, 5.2)[-1]
    assert weed == pytest.approx((0.7, -0.5, -1.5), abs=0.03)  # ahead, to the right, below


@pytest.mark.parametrize(("height", "seen"), [(1.0, 1), (2.0, 2), (3.0, 3)])
def test_its_footprint_grows_with_its_height(height, seen):
    weeds = [{"at": [2 + distance, 4]} for distance in (0.8, 1.7, 2.6, 3.5)]
    g = flying({"camera": SHARP, "height": height}, weeds=weeds)
    assert len(pictures(g, 5.2)[-1]) == seen
    assert drone(g).appearance.footprint == pytest.approx(height, abs=0.03)


def test_a_narrow_camera_sees_less():
    g = flying({"camera": {**SHARP, "field_of_view": 40}}, weeds=[{"at": [2.4, 4]}, {"at": [2.7, 4]}])
    assert len(pictures(g, 5.2)[-1]) == 1


@pytest.mark.long
def test_it_misses_a_part_of_what_is_in_sight_and_places_the_others_with_the_noise_it_was_given():
    g = flying({"camera": {"noise": 0.1, "missed": 0.25}}, weeds=[{"at": [2.5, 4]}])
    seen = pictures(g, 205)
    assert sum(not picture for picture in seen) / len(seen) == pytest.approx(0.25, abs=0.05)
    errors = [picture[0][0] - 0.5 for picture in seen if picture]
    assert math.sqrt(sum(error**2 for error in errors) / len(errors)) == pytest.approx(0.1, rel=0.15)


def test_two_weeds_that_are_near_are_two_poses_without_names():
    g = flying({"camera": SHARP}, weeds=[{"at": [2.1, 4]}, {"at": [2.2, 4]}])
    heard = g.hear("/Drone/camera/weeds", POSES)
    g.run(5.2)
    assert len(heard[-1].poses) == 2
    assert heard[-1].header.frame_id == "Drone/base_link"


def test_a_camera_at_fault_is_silent_and_other_sensors_are_not():
    g = flying()
    g.world.fault("Drone", "camera")
    odom = g.hear("/Drone/odom", ODOMETRY)
    assert pictures(g, 7) == []
    assert len(odom) == 40
    assert drone(g).appearance.footprint == 0


# ---- battery and safety ----------------------------------------------------------------------------------------------


def test_the_battery_drains_faster_in_the_air():
    g = field()
    heard = g.hear("/Drone/battery_state", BATTERY)
    g.run(10)
    order(g, "takeoff")
    g.run(20)
    assert len(heard) == 21
    standing, flown = heard[0].percentage - heard[10].percentage, heard[10].percentage - heard[20].percentage
    assert standing == pytest.approx(3.0 * 10 / (60 * 3600), rel=0.01)
    assert flown > 30 * standing


def test_one_with_an_empty_battery_lands_and_does_not_start_again():
    g = field({"battery": {"charge": 0.01}})  # 0.6 Wh for 120 W: 18 s
    g.run(0)
    order(g, "takeoff")
    g.run(10)
    assert not drone(g).status["landed"]
    g.run(30)
    assert drone(g).status["landed"]
    assert drone(g).status["battery"] == 0
    order(g, "takeoff")
    g.run(32)
    assert drone(g).status["landed"]


def test_weak_rotors_bring_it_down():
    g = flying()
    g.world.fault("Drone", "rotors")
    order(g, "takeoff")
    g.run(9)
    assert drone(g).status["landed"]


def test_it_hovers_when_its_mission_is_suspended_and_lands_when_it_has_ended():
    g = flying()
    fly(g, ahead=1)
    g.run(6)
    for topic, kind, fields in robot_class("drone").SAFE_SUSPENDED:
        g.say(f"/Drone/{topic}", kind, fields)
    g.run(8)
    there = drone(g).pose
    g.run(10)
    assert (*drone(g).pose, drone(g).appearance.altitude) == pytest.approx((*there, 1.5), abs=0.02)
    fly(g, ahead=1)
    for topic, kind, fields in robot_class("drone").SAFE_STATE:
        g.say(f"/Drone/{topic}", kind, fields)
    g.run(14)
    assert drone(g).status["landed"]
    assert drone(g).pose[:2] == pytest.approx(there[:2], abs=0.05)


def test_one_that_only_climbs_tells_so_and_pays_for_it():
    def flown(up):
        g = flying({"odom": {"speed_noise": 0, "position_noise": 0}, "watchdog": 0})
        g.run(6)
        heard = g.hear("/Drone/odom", "nav_msgs/msg/Odometry")
        charge = g.hear("/Drone/battery_state", "sensor_msgs/msg/BatteryState")
        fly(g, up=up)
        g.run(10)
        return [odom.twist.twist.linear.z for odom in heard[20:]], charge[0].percentage - charge[-1].percentage

    (climbs, climbing), (hovers, hovering) = flown(1.0), flown(0.0)
    assert climbs == pytest.approx([1.0] * len(climbs))
    assert hovers == pytest.approx([0.0] * len(hovers), abs=0.01)
    assert climbing > hovering * 1.05


def test_it_takes_off_to_its_ceiling_at_most():
    g = flying({"ceiling": 1.0, "odom": {"position_noise": 0}})
    heard = g.hear("/Drone/odom", "nav_msgs/msg/Odometry")
    g.run(8)
    assert max(odom.pose.pose.position.z for odom in heard) == pytest.approx(1.0, abs=0.02)
