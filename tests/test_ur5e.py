"""The UR5e: its dynamics against energy, its motion, contacts, and the robot in the world beside the recorded run."""

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from grounds import Ground

from fame.errors import ConfigError, MissionError
from robots.arm.bench import LID, MOTOR
from robots.arm.dynamics import GRAVITY, HOME, UR5E, friction, inertia_matrices, inverse_dynamics
from robots.arm.kinematics import forward, sampled, straight
from robots.arm.machine import TYPICAL, ControlledArm, RunVariation
from robots.arm.reassembly import PROGRAM, RATE, SCENARIOS, generators, plans, recorded

one_run = cache(recorded)
"""A run by its seed and what else matters, computed once for all tests."""
POSTURES = np.random.default_rng(3).uniform(-2, 2, (20, 6))


def energies(angles: np.ndarray, velocities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic and potential energy, J, from the places of small parts of each body: nothing of Newton and Euler."""
    chain, kinetic, potential = UR5E.chain, 0.0, 0.0
    for number, body in enumerate(UR5E.bodies):
        values, axes = np.linalg.eigh(body.inertia)
        spread = np.sqrt(np.maximum((values.sum() / 2 - values) / body.mass, 0))  # a body as six points on its axes
        signs = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
        for axis, sign in signs:
            part = body.centre + sign * np.sqrt(3) * spread[axis] * axes[:, axis]
            cut = type(chain)(
                chain.joints[: number + 1], chain.origins[: number + 1], chain.axes[: number + 1], (), tuple(part)
            )
            place, _, jacobian = forward(cut, angles[:, : number + 1])
            speed = (jacobian[:, :3] @ velocities[:, : number + 1, None])[:, :, 0]
            kinetic = kinetic + body.mass / 12 * (speed**2).sum(axis=1)
            potential = potential + body.mass / 6 * GRAVITY * place[:, 2]
    return np.asarray(kinetic + 0.5 * (UR5E.armature * velocities**2).sum(axis=1)), np.asarray(potential)


def test_what_the_motors_put_in_is_what_the_energy_grows_by():
    times = np.linspace(0, 2, 2001)[:, None]
    phases = np.arange(6)
    motion = np.sin(times * 2 + phases), 2 * np.cos(times * 2 + phases), -4 * np.sin(times * 2 + phases)
    power = (inverse_dynamics(UR5E, *motion) * motion[1]).sum(axis=1)
    energy = sum(energies(motion[0], motion[1]))
    assert np.gradient(energy, times[:, 0])[1:-1] == pytest.approx(power[1:-1], abs=2e-3)


def test_efforts_at_rest_are_the_slope_of_the_potential_energy():
    still = np.zeros_like(POSTURES)
    efforts = inverse_dynamics(UR5E, POSTURES, still, still)
    for joint in range(6):
        step = np.zeros(6)
        step[joint] = 1e-5
        slope = (energies(POSTURES + step, still)[1] - energies(POSTURES - step, still)[1]) / 2e-5
        assert efforts[:, joint] == pytest.approx(slope, abs=1e-6)


def test_the_inertia_matrix_is_that_of_the_kinetic_energy():
    velocities = np.random.default_rng(4).uniform(-1, 1, POSTURES.shape)
    matrices = inertia_matrices(UR5E, POSTURES)
    found = 0.5 * np.einsum("ni,nij,nj->n", velocities, matrices, velocities)
    assert found == pytest.approx(energies(POSTURES, velocities)[0], rel=1e-9)
    assert np.allclose(matrices, matrices.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(matrices).min() > 0


def test_an_upright_arm_needs_nothing_at_the_base_and_a_stretched_one_its_weight_times_its_reach():
    stretched = np.zeros((1, 6))
    efforts = inverse_dynamics(UR5E, stretched, stretched, stretched)[0]
    reach = sum(
        body.mass * (body.centre[0] + offset)
        for body, offset in zip(UR5E.bodies, np.cumsum([origin[0] for origin in UR5E.chain.origins]), strict=True)
    )
    assert efforts[0] == pytest.approx(0, abs=1e-12)
    assert efforts[1] == pytest.approx(GRAVITY * reach)  # the axis points to -y, the arm to -x


def test_a_load_adds_its_weight_along_the_jacobian():
    still = np.zeros_like(POSTURES)
    more = inverse_dynamics(UR5E.carrying(LID), POSTURES, still, still) - inverse_dynamics(UR5E, POSTURES, still, still)
    jacobian = forward(UR5E.chain, POSTURES)[2]
    assert more == pytest.approx(LID * GRAVITY * jacobian[:, 2], abs=1e-9)


def test_the_flange_is_where_the_parameters_of_denavit_and_hartenberg_put_it():
    a, d = (0, -0.425, -0.3922, 0, 0, 0), (0.1625, 0, 0, 0.1333, 0.0997, 0.0996)
    alpha = (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0)
    for posture in POSTURES:
        frame = np.eye(4)
        for theta, length, offset, twist in zip(posture, a, d, alpha, strict=True):
            c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(twist), np.sin(twist)
            frame = frame @ [
                [c, -s * ca, s * sa, length * c], [s, c * ca, -c * sa, length * s], [0, sa, ca, offset], [0, 0, 0, 1],
            ]  # fmt: skip
        tip = frame @ [0, 0.06, 0.15, 1]
        assert UR5E.chain.place(posture.tolist()) == pytest.approx(tip[:3], abs=1e-12)


def test_a_trajectory_passes_its_points_without_jumps_of_velocity_or_acceleration():
    times, points = np.array([0.0, 1.0, 1.5, 3.0]), np.array([[0.0], [1.0], [0.5], [2.0]])
    motion = sampled(times, points, np.zeros(1), 0.002)
    assert motion.positions[[499, 749, 1499], 0] == pytest.approx([1.0, 0.5, 2.0], abs=1e-9)
    assert motion.velocities[-1, 0] == pytest.approx(0, abs=1e-9)
    assert np.gradient(motion.positions[:, 0], 0.002)[1:-1] == pytest.approx(motion.velocities[1:-1, 0], abs=1e-3)
    assert np.abs(np.diff(motion.accelerations[:, 0])).max() < 0.3


def test_the_twin_goes_straight_and_keeps_the_tool_upright():
    way = straight(UR5E.chain, HOME, MOTOR)
    places, begin = UR5E.chain.places(way.positions), UR5E.chain.places(HOME[None])[0]
    ahead = (MOTOR - begin) / np.linalg.norm(MOTOR - begin)
    assert np.abs(np.cross(places - begin, ahead)).max() < 1e-5
    assert np.allclose(UR5E.chain.orientations(way.positions), UR5E.chain.orientations(HOME[None])[0], atol=1e-5)


# ---- contacts --------------------------------------------------------------------------------------------------------


def clean(seed: int, scenario: Any) -> np.ndarray:
    """Efforts without what the reference and the noise make of them: what contacts and people add."""
    found, free = one_run(seed, scenario), one_run(seed)
    count = min(len(found.stamps), len(free.stamps))
    return found.efforts[:count] - free.efforts[:count]


@pytest.mark.long
def test_an_obstructed_run_is_the_free_one_until_somebody_is_in_the_way():
    touched = np.flatnonzero(clean(5, "blocked_lid").any(axis=1))[0]
    assert one_run(5).stamps[touched] > 3.7  # when the lid is gripped
    assert np.abs(clean(5, "blocked_lid")).max(axis=0)[4] > 1


@pytest.mark.long
def test_somebody_at_joint_0_is_felt_there_and_hardly_in_the_wrist():
    run, free = one_run(5, "blocked_shoulder"), one_run(5)
    added = np.abs(run.efforts).max(axis=0) - np.abs(free.efforts).max(axis=0)
    assert 10 < added[0] < 40
    assert np.abs(added[3:]).max() < 0.5


def pushed(rate: float, seconds: float = 3.0) -> np.ndarray:
    """The positions (cycles, joints) of an arm at rest that somebody pushes at joint 0."""
    arm = ControlledArm(UR5E, HOME, 1 / rate, generators(5), replace(TYPICAL, encoders=False))
    arm.obstruct_shoulder()
    return np.array([arm.step().positions for _ in range(round(seconds * rate))])


def test_a_push_deflects_the_arm_alike_at_every_rate():
    fine, coarse = pushed(500.0), pushed(20.0)
    deflected = np.abs(fine - HOME).max(axis=0)
    assert 0.001 < deflected[0] < 0.1
    assert np.allclose(fine[::25], coarse, rtol=0, atol=1e-9)


def test_an_arm_that_leaves_its_reference_is_no_longer_simulated():
    arm = ControlledArm(UR5E, HOME, 0.002, generators(5))
    arm.obstruct_shoulder()
    arm._rate[0] = np.nan
    with pytest.raises(MissionError, match="the simulation of the arm has failed"):
        arm.step()


@pytest.mark.long
def test_pressed_on_lightly_the_lid_lies_on_the_motor_again():
    machine = ControlledArm(UR5E, HOME, 1 / RATE, generators(7))
    assert performed(machine)[1] == [False, True, False, True, False]
    assert (machine.bench.lid, machine.bench.jaws) == ("motor", "open")


@pytest.mark.long
def test_a_lid_that_is_held_stays_and_the_gripper_goes_on_empty():
    machine = ControlledArm(UR5E, HOME, 1 / RATE, generators(7))
    machine.hold_lid()
    assert performed(machine)[1] == [False, True, False, False, False]
    assert (machine.bench.lid, machine.bench.held_down) == ("motor", False)


def performed(machine: ControlledArm, steps: int = len(PROGRAM)) -> tuple[np.ndarray, list[bool]]:
    """The efforts in the first steps of the program, and what each command to the gripper found."""
    efforts, held = list[list[float]](), list[bool]()
    for step, (_, plan) in zip(PROGRAM[:steps], plans(), strict=False):
        machine.start(plan)
        efforts += [machine.step().efforts for _ in range(len(plan.places) + 200)]
        if step.shut is not None:
            held.append(machine.grip(step.shut))
    return np.array(efforts), held


@pytest.mark.long
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_run_repeats_with_its_seed(scenario: Any):
    assert np.array_equal(recorded(5, scenario).efforts, one_run(5, scenario).efforts)
    assert not np.array_equal(one_run(5, scenario).efforts, one_run(2, scenario).efforts)


# ---- variation ------------------------------------------------------------------------------------------------------


NONE = replace(RunVariation(**dict.fromkeys((field.name for field in fields(RunVariation)), 0)), correlation=0.02)


def varied(seed: int, **values: Any) -> np.ndarray:
    """Efforts of the first movements, until the lid is lifted, with one source of variation alone."""
    return performed(ControlledArm(UR5E, HOME, 1 / RATE, generators(seed), replace(NONE, **values)), steps=3)[0]


def test_without_variation_only_the_bench_and_white_noise_differ():
    reference, other = varied(1), varied(2)
    assert np.abs(reference - other)[:1000].std(axis=0) == pytest.approx(UR5E.noise * 0.85, rel=0.1)


@pytest.mark.long_but("*0-1", "*1-1", "values0*")
@pytest.mark.parametrize(
    ("values", "joint"), [({"friction": 0.2}, 1), ({"temperature": 20.0}, 1), ({"bias": 4.0}, 3), ({"payload": 0.5}, 2)]
)
def test_each_source_moves_the_efforts_and_repeats_with_its_seed(values: dict[str, float], joint: int):
    apart = varied(3, **values) - varied(3)
    assert np.abs(apart[:, joint]).max() > 0.1
    assert np.array_equal(varied(3, **values), varied(3, **values))


def test_coloured_noise_keeps_the_deviation_and_is_correlated():
    still = 400  # between the first two movements
    white, coloured = ((varied(4, coloured=share)[750:940, 5]) for share in (0.0, 1.0))
    assert len(white) < still
    lag = [np.corrcoef(noise[:-1], noise[1:])[0, 1] for noise in (white, coloured)]
    assert abs(lag[0]) < 0.2
    assert lag[1] > 0.7


@pytest.mark.long
def test_positions_are_those_of_encoders():
    steps = one_run(5).positions * 131072 / (2 * np.pi)
    assert np.abs(steps - np.round(steps)).max() < 1e-6


@pytest.mark.long
def test_runs_differ_in_length_by_the_time_of_planning():
    assert len(one_run(2).stamps) != len(one_run(5).stamps)
    assert len({len(recorded(seed, variation=replace(TYPICAL, jitter=0.0)).stamps) for seed in (2, 5)}) == 1


# ---- in the world ----------------------------------------------------------------------------------------------------


def world(seed: int = 1) -> Ground:
    return Ground({"size": [2, 2], "step": 0.002, "robots": {"Arm": {"type": "ur5e", "at": [1, 1]}}}, seed)


def test_without_a_bench_there_is_an_arm_alone():
    robot = {"type": "ur5e", "at": [1, 1], "bench": False}
    arm = Ground({"size": [2, 2], "step": 0.002, "robots": {"Arm": robot}}, 1).world.robots["Arm"]
    assert arm.appearance.workpieces == []
    with pytest.raises(ConfigError, match="unknown fault 'blocked_lid' of Arm"):
        arm.fault("blocked_lid")
    assert not arm.machine.grip(shut=True)  # type: ignore[attr-defined]


def test_joint_states_come_at_the_rate_of_the_arm_with_its_names():
    g = world(7)
    heard = g.hear("/Arm/joint_states", "sensor_msgs/msg/JointState")
    g.run(0.1)
    assert len(heard) == 50
    assert heard[0].name == list(UR5E.chain.joints)


def test_a_goal_is_reached_and_an_empty_trajectory_holds():
    g = world()
    g.run(0.1)
    g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.3}}})
    g.run(0.6)
    g.say("/Arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", {})
    g.run(1.0)
    machine = g.world.robots["Arm"].machine  # type: ignore[attr-defined]
    here = machine.state.positions
    assert not machine.moving
    g.run(2.0)
    assert machine.state.positions == here
    g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.3}}})
    g.run(5.0)
    assert UR5E.chain.place(machine.state.positions) == pytest.approx((0.5, 0.0, 0.3), abs=1e-5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"joint_names": ["elbow"]}, "expected the joints shoulder_pan_joint"),
        ({"points": [{"positions": [0.0], "time_from_start": {"sec": 1}}]}, "expected 6 positions in point 0, got 1"),
        ({"points": [{"positions": [float("nan")] * 6, "time_from_start": {"sec": 1}}]}, "finite positions"),
        ({"points": [{"positions": [0.0] * 6}]}, "expected positive, increasing times"),
        ({"points": [{"positions": [9.0] * 6, "time_from_start": {"sec": 1}}]}, "rad/s for "),
    ],
)
def test_a_wrong_trajectory_is_refused_with_the_reason_and_the_arm_stays(change: dict[str, Any], reason: str):
    g = world()
    refusals = g.hear("/Arm/trajectory_refused", "std_msgs/msg/String")
    g.run(0.1)
    right = {"joint_names": UR5E.chain.joints, "points": [{"positions": HOME.tolist(), "time_from_start": {"sec": 1}}]}
    g.say("/Arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", {**right, **change})
    g.run(0.2)
    assert reason in refusals[0].data
    assert not g.world.robots["Arm"].machine.moving  # type: ignore[attr-defined]


def test_a_goal_out_of_reach_is_answered_with_an_empty_trajectory():
    g = world()
    heard = g.hear("/Arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
    g.run(0.1)
    g.say("/Arm/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 3.0, "y": 0.0, "z": 0.3}}})
    g.run(0.2)
    assert [len(message.points) for message in heard] == [0]


def test_friction_is_against_the_motion_and_grows_with_it():
    slow, fast = friction(UR5E, np.full(6, 0.1)), friction(UR5E, np.full(6, 1.0))
    assert (fast > slow).all()
    assert (slow > UR5E.coulomb * 0.99).all()
    assert friction(UR5E, np.zeros(6)) == pytest.approx(0)
