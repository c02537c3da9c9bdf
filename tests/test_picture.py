"""Pictures and animations of a run show what was recorded."""

import math
import shutil
import subprocess

import numpy as np
import pytest
from grounds import Ground, ground
from PIL import Image, ImageColor, ImageSequence

from fame.errors import ConfigError, UnavailableError
from sim2d import style
from sim2d.animation import animate, picture
from sim2d.record import WorldRecorder


@pytest.fixture(scope="module")
def record():
    g = ground(
        obstacles=[{"name": "rock", "at": [3, 1], "radius": 0.3}, {"at": [2, 3.5], "size": [1, 0.2], "angle": 20}],
        targets=[{"name": "target", "at": [5, 3], "radius": 0.1}],
        rex={"watchdog": 0},
        robots={"DINGO": {"type": "car", "at": [1, 3]}},
    )
    recorder = WorldRecorder(g.world)
    g.run(0)
    g.drive(0.5, 0.3)
    g.say("/REX/led", "std_msgs/msg/ColorRGBA", {"r": 1.0})
    g.run(4)
    return recorder.record


def share(image, colour, within=10):
    """What part of an image's pixels has a colour."""
    pixels = np.asarray(image.convert("RGB"), dtype=np.int16)
    return float((abs(pixels - np.array(ImageColor.getrgb(colour)[:3])) <= within).all(axis=2).mean())


def test_a_recorder_keeps_ten_samples_a_second_of_every_robot(record):
    assert record.times == pytest.approx([number / 10 for number in range(41)])
    rex, dingo = record.tracks
    assert (rex.name, dingo.name) == ("REX", "DINGO")
    assert len(rex.poses) == len(rex.appearances) == 41
    assert rex.appearances[0].led == "off"
    assert rex.appearances[-1].led == "red"
    assert math.dist(rex.poses[0][:2], rex.poses[-1][:2]) > 1.5
    assert dingo.poses[0] == dingo.poses[-1]


@pytest.mark.long
def test_a_picture_shows_ground_obstacles_targets_ways_and_leds(record, tmp_path):
    file = tmp_path / "out" / "world.png"
    picture(record, file, title="A mission")
    with Image.open(file) as image:
        assert image.width > 900
        assert share(image, style.GROUND) > 0.4
        for colour in (style.OBSTACLE, style.TARGET, style.LEDS["red"], style.ROBOTS[0], style.ROBOTS[1]):
            assert share(image, colour) > 1e-4


@pytest.mark.long
def test_a_picture_of_a_world_that_has_just_begun_shows_the_world(tmp_path):
    g = ground(walls=False)
    recorder = WorldRecorder(g.world)
    g.run(0.2)
    picture(recorder.record, tmp_path / "world.png")
    with Image.open(tmp_path / "world.png") as image:
        assert share(image, style.GROUND) > 0.4


@pytest.mark.long
def test_an_animation_moves_and_ends_with_what_was_recorded_last(record, tmp_path):
    file = tmp_path / "world.gif"
    animate(record, file, fps=10, speed=2)
    with Image.open(file) as film:
        assert film.n_frames == 21
        assert film.info["duration"] == 100
        first = film.convert("RGB")
        film.seek(20)
        last = film.convert("RGB")
    assert share(first, style.LEDS["red"]) == 0
    assert share(last, style.LEDS["red"]) > 1e-4
    way = [share(image, style.ROBOTS[0], within=60) for image in (first, last)]
    assert way[1] > way[0] + 3e-4


@pytest.mark.long
def test_captions_change_when_the_process_moves_on(record, tmp_path):
    labels = [(0.0, "REX", "Explore"), (2.0, "REX", "Wait for done")]
    animate(record, tmp_path / "with.gif", labels=labels, fps=10, speed=10)
    animate(record, tmp_path / "without.gif", fps=10, speed=10)
    differing = []
    with Image.open(tmp_path / "with.gif") as film, Image.open(tmp_path / "without.gif") as bare:
        for number in range(5):
            film.seek(number)
            bare.seek(number)
            a, b = (np.asarray(image.convert("RGB"), dtype=np.int16) for image in (film, bare))
            rows, columns = np.nonzero((a != b).any(axis=2))
            differing.append((rows.min(), columns.max()))
    assert min(row for row, _ in differing) > 480  # below the ground
    assert differing[0] == differing[1]
    assert differing[2] == differing[3] == differing[4]
    assert differing[2][1] > differing[1][1] + 20  # the longer text


def test_a_caption_that_takes_no_time_is_not_shown(record, tmp_path):
    calm = [(0.0, "REX", "Take Off")]
    hectic = [*calm, *((time / 20, "REX", text) for time in range(1, 60) for text in ("Read Height", "Take Off"))]
    animate(record, tmp_path / "calm.gif", labels=calm, speed=10)
    animate(record, tmp_path / "hectic.gif", labels=hectic, speed=10)
    assert (tmp_path / "calm.gif").read_bytes() == (tmp_path / "hectic.gif").read_bytes()


def test_computers_have_captions_too(record, tmp_path):
    animate(record, tmp_path / "robots.gif", speed=10)
    animate(record, tmp_path / "team.gif", labels=[(0.0, "Monitor", "Learn")], speed=10)
    with Image.open(tmp_path / "robots.gif") as robots, Image.open(tmp_path / "team.gif") as team:
        assert team.height > robots.height
        assert share(team, style.ROBOTS[2]) > share(robots, style.ROBOTS[2])


def test_the_progress_of_a_film_is_told_frame_by_frame(record, tmp_path):
    told = []
    animate(record, tmp_path / "world.gif", fps=10, speed=10, progress=lambda *frames: told.append(frames))
    assert told == [(number, 5) for number in range(1, 6)]


# ---- arms ------------------------------------------------------------------------------------------------------------


def arm(kind, step):
    """An arm in its world."""
    return Ground({"size": [2, 2], "step": step, "robots": {"Arm": {"type": kind, "at": [1, 1]}}})


def pieces(look, kind):
    """The corners of what an arm works on."""
    return [list(piece.corners) for piece in look.workpieces if piece.kind == kind]


def frames(recorder, path):
    """The frames of a film of a run, as fast as it was, in colour."""
    animate(recorder.record, path, speed=1)
    with Image.open(path) as film:
        return [np.asarray(frame.convert("RGB"), dtype=np.int16) for frame in ImageSequence.Iterator(film)]


@pytest.mark.long
def test_an_arm_that_cuts_moves_and_its_part_comes_about(tmp_path):
    g = arm("mh5", 0.025)
    recorder = WorldRecorder(g.world)
    g.say("/Arm/cut", "std_msgs/msg/Empty", {})
    g.run(12.5)
    looks = recorder.record.tracks[0].appearances
    assert math.dist(looks[1].limb[-1], looks[10].limb[-1]) > 0.02
    lengths = [len(cut) for look in looks for cut in pieces(look, "cut")]
    assert lengths == sorted(lengths)
    assert lengths[-1] > lengths[0] + 100
    assert not pieces(looks[0], "part")
    assert pieces(looks[-1], "part")
    assert [look.note for look in (looks[4], looks[-1])] == ["cuts part 1", "stands"]
    shown = frames(recorder, tmp_path / "cut.gif")
    assert (shown[0] != shown[len(shown) // 2]).any(axis=2).mean() > 1e-3


def test_an_arm_that_is_held_in_its_work_shows_a_red_light():
    g = arm("mh5", 0.025)
    g.say("/Arm/hold", "std_msgs/msg/Empty", {})
    g.run(1)
    assert g.world.robots["Arm"].appearance.led == "off"
    g.say("/Arm/cut", "std_msgs/msg/Empty", {})
    g.run(3)
    g.say("/Arm/hold", "std_msgs/msg/Empty", {})
    g.run(4)
    look = g.world.robots["Arm"].appearance
    assert (look.led, look.note) == ("red", "held in part 1")


@pytest.mark.long
def test_an_arm_carries_the_lid_in_jaws_that_close(tmp_path):
    g = arm("ur5e", 0.002)
    recorder, robot = WorldRecorder(g.world), g.world.robots["Arm"]

    def go(x, y, z, until):
        g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": x, "y": y, "z": z}}})
        g.run(until)

    g.run(0.1)
    go(0.5, 0.0, 0.3, 2.5)
    go(0.5, 0.0, 0.18, 5)
    before = robot.appearance
    robot.machine.grip(True)
    held = robot.appearance
    go(0.5, 0.0, 0.3, 7)
    go(0.4, -0.2, 0.3, 10)
    after = robot.appearance
    assert before.jaws > held.jaws > 0
    assert "holds the lid, 0.18 m up" in held.note
    assert "holds the lid, 0.30 m up" in after.note
    (lay,), (gripped,), (carried,) = (np.array(pieces(look, "part")) for look in (before, held, after))
    assert lay == pytest.approx(gripped, abs=1e-3)
    assert lay - carried == pytest.approx(np.full_like(lay, (0.1, 0.2)), abs=1e-2)
    assert pieces(before, "fixture") == pieces(after, "fixture")
    shown = frames(recorder, tmp_path / "lid.gif")
    assert (shown[0] != shown[-1]).any(axis=2).mean() > 1e-3


def test_an_arm_that_is_stopped_on_its_way_shows_a_red_light_until_it_goes_on():
    g = arm("ur5e", 0.002)
    robot, empty = g.world.robots["Arm"], ("trajectory_msgs/msg/JointTrajectory", {})
    g.run(0.1)
    g.say("/Arm/joint_trajectory", *empty)
    g.run(0.5)
    assert robot.appearance.led == "off"
    g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.3}}})
    g.run(1)
    g.say("/Arm/joint_trajectory", *empty)
    g.run(2)
    assert robot.appearance.led == "red"
    assert robot.appearance.note.startswith("stopped on its way")
    g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.3}}})
    g.run(2.1)
    assert robot.appearance.led == "off"


# ---- batteries -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("kind", ["tractor", "drone"])
def test_an_empty_battery_is_seen_and_told(kind, tmp_path):
    shares = []
    for charge in (1.0, 0.1, 0.0):
        g = ground(rex={"type": kind, "battery": {"charge": charge}})
        recorder = WorldRecorder(g.world)
        g.run(1)
        animate(recorder.record, tmp_path / "film.gif", speed=1)
        picture(recorder.record, tmp_path / "world.png")
        with Image.open(tmp_path / "film.gif") as film:
            film.seek(film.n_frames - 1)
            shares.append(share(film, style.LEDS["red"], within=40))
    assert shares[0] == 0
    assert shares[1] > 0
    assert shares[2] > 0


def test_what_is_told_of_a_robot_is_what_it_does_then_what_its_process_waits_for():
    text = style.activity_text("waits for part_cut", "cuts part 2", 1.0)
    assert text == "cuts part 2 \N{MIDDLE DOT} waits for part_cut"
    assert style.activity_text("Go To", "", 0.0) == "battery empty \N{MIDDLE DOT} Go To"
    assert style.activity_text("", "", 0.5) == ""


@pytest.fixture(scope="module")
def farm():
    """A drone that flies and a tractor that cuts one of two weeds after two seconds."""
    g = ground(
        size=[20, 15],
        rex={"type": "tractor"},
        robots={"Drone": {"type": "drone", "at": [10, 8]}},
        weeds=[{"name": "thistle", "at": [1.1, 2], "radius": 0.3}, {"name": "dock", "at": [12, 3], "radius": 0.3}],
    )
    recorder = WorldRecorder(g.world)
    g.run(1.5)
    g.say("/Drone/takeoff", "std_msgs/msg/Empty", {})
    g.say("/REX/blade_force", "geometry_msgs/msg/Wrench", {"torque": {"z": 1.0}})
    g.run(2.5)
    g.drive(1.0)
    g.run(4)
    return recorder.record


def test_a_recorder_keeps_height_footprint_and_blade(farm):
    rex, drone = farm.tracks
    early = max(sample for sample, time in enumerate(farm.times) if time <= 1)
    assert (rex.appearances[early].blade, rex.appearances[-1].blade) == (0, 0.3)
    assert (drone.appearances[early].altitude, drone.appearances[early].footprint) == (0, 0)
    assert drone.appearances[-1].altitude == pytest.approx(1.5, abs=0.1)
    assert drone.appearances[-1].footprint == pytest.approx(drone.appearances[-1].altitude, abs=1e-3)


@pytest.mark.long
def test_a_picture_shows_weeds_that_grow_and_weeds_that_were_cut(farm, tmp_path):
    picture(farm, tmp_path / "farm.png")
    with Image.open(tmp_path / "farm.png") as image:
        for colour in (style.WEED, style.STUBBLE, style.ROBOTS[1]):
            assert share(image, colour) > 1e-4


@pytest.mark.long
def test_a_film_shows_a_weed_before_and_after_and_what_the_drone_sees(farm, tmp_path):
    animate(farm, tmp_path / "farm.gif", speed=4)
    with Image.open(tmp_path / "farm.gif") as film:
        first = film.convert("RGB")
        film.seek(film.n_frames - 1)
        last = film.convert("RGB")
    assert share(first, style.STUBBLE) == 0
    assert share(last, style.STUBBLE) > 5e-5
    assert share(last, style.WEED) > 0
    bluish = [share(image, faint_on_ground(style.ROBOTS[1])) for image in (first, last)]
    assert bluish[1] > bluish[0] + 5e-3


def faint_on_ground(colour):
    """A robot's colour as it is where a sensor covers the ground."""
    part = style.CONE / 255
    pairs = zip(ImageColor.getrgb(colour), ImageColor.getrgb(style.GROUND), strict=True)
    return "#" + "".join(f"{round(a * part + b * (1 - part)):02x}" for a, b in pairs)


@pytest.mark.long
def test_a_hundred_robots_can_still_be_drawn(tmp_path):
    robots = {f"Tractor_{n}": {"type": "tractor", "at": [2 + n % 10, 2 + n // 10]} for n in range(100)}
    g = ground(size=[20, 15], robots=robots)
    recorder = WorldRecorder(g.world)
    g.run(0.2)
    picture(recorder.record, tmp_path / "many.png")
    animate(recorder.record, tmp_path / "many.gif")
    with Image.open(tmp_path / "many.gif") as film:
        assert share(film, style.ROBOTS[3]) > 1e-3


def test_the_same_record_gives_the_same_file(record, tmp_path):
    animate(record, tmp_path / "a.gif", speed=20)
    animate(record, tmp_path / "b.gif", speed=20)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_a_film_needs_a_known_ending_and_something_recorded(record, tmp_path):
    with pytest.raises(ConfigError, match=r"expected a file .gif or .mp4 or .webp, got '.avi'"):
        animate(record, tmp_path / "world.avi")
    with pytest.raises(ConfigError, match="got nothing recorded"):
        animate(WorldRecorder(ground().world).record, tmp_path / "world.gif")


def test_an_mp4_is_made_by_ffmpeg_or_the_error_says_how_to_get_it(record, tmp_path, monkeypatch):
    file = tmp_path / "world.mp4"
    if shutil.which("ffmpeg"):
        animate(record, file, fps=10, speed=2)
        probe = ["ffmpeg", "-hide_banner", "-i", str(file)]
        assert "Video: h264" in subprocess.run(probe, capture_output=True, text=True, check=False).stderr
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UnavailableError, match="apt install ffmpeg"):
        animate(record, file)


def test_names_are_drawn_as_they_are_written(tmp_path):
    weeds, targets = [{"name": "農 $\\frac$", "at": [2, 2]}], [{"name": "$\\bad$", "at": [3, 3], "radius": 0.1}]
    g = ground(weeds=weeds, targets=targets, chargers=[{"name": "$^^$", "at": [4, 1]}])
    recorder = WorldRecorder(g.world)
    g.run(0.1)
    picture(recorder.record, tmp_path / "x.png", title="$\\alpha 農")
    animate(recorder.record, tmp_path / "x.gif", title="$\\alpha 農")
    assert (tmp_path / "x.png").stat().st_size > 0
    assert (tmp_path / "x.gif").stat().st_size > 0


@pytest.mark.long_but("*png")
@pytest.mark.parametrize(("draw", "ending"), [(picture, "png"), (animate, "gif")])
def test_what_cannot_be_written_is_named(record, tmp_path, draw, ending):
    full, folder = tmp_path / f"full.{ending}", tmp_path / f"folder.{ending}"
    full.symlink_to("/dev/full")
    folder.mkdir()
    for path, why in ((full, "No space left"), (folder, "Is a directory"), (full / f"x.{ending}", "File exists|Not a")):
        with pytest.raises(ConfigError, match=f"{path.name}: cannot be written: ({why})"):
            draw(record, path)
