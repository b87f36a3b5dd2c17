"""The simulated arm: the same mechanics as pinocchio's, honest sensors, the same bytes for the same seed."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.simulation.arm import ArmConfig, SimulatedArm

CONFIGS = Path(__file__).parents[2] / "config" / "robots"
ROBOTS = {name: RobotModel(load_robot(CONFIGS / f"{name}.yaml")) for name in ("panda", "ur10")}
NOISELESS = ArmConfig(position_noise=0.0, velocity_noise=0.0, torque_noise=0.0, torque_bias=0.0, friction_error=0.0)


@pytest.fixture(params=sorted(ROBOTS))
def robot(request):
    return ROBOTS[request.param]


def gravity_command(arm):
    gravity = arm.robot.gravity(arm.true_positions)
    return np.zeros(arm.robot.n) if arm.robot.config.compensates_gravity else gravity


def frictionless(robot, **settings):
    """Make an arm without friction of any kind."""
    arm = SimulatedArm(robot, seed=0, table_height=None, config=ArmConfig(damping=(0.0,), hold_damping=0.0, **settings))
    arm.model.dof_frictionloss[:] = 0.0
    return arm


@settings(max_examples=20, deadline=None)
@given(name=st.sampled_from(sorted(ROBOTS)), seed=st.integers(0, 2**32 - 1))
def test_mechanics_agree_with_pinocchio(name, seed):
    robot = ROBOTS[name]
    arm = SimulatedArm(robot, seed=0, table_height=None)
    rng = np.random.default_rng(seed)
    q, v, acceleration = rng.uniform(robot.lower, robot.upper), rng.normal(size=robot.n), rng.normal(size=robot.n)
    data = robot.pin_model.createData()
    arm.data.qpos[:], arm.data.qvel[:] = q, v
    mujoco.mj_forward(arm.model, arm.data)
    mass = np.zeros((robot.n, robot.n))
    for column, unit in enumerate(np.eye(robot.n)):
        mujoco.mj_mulM(arm.model, arm.data, mass[column], unit)
    armature = arm.model.dof_armature
    wanted = pin.rnea(robot.pin_model, data, q, v, acceleration)
    np.testing.assert_allclose(mass @ acceleration + arm.data.qfrc_bias - armature * acceleration, wanted, atol=1e-9)
    upper = np.triu(pin.crba(robot.pin_model, data, q))
    np.testing.assert_allclose(mass - np.diag(armature), upper + np.triu(upper, 1).T, atol=1e-9)
    position, rotation = robot.tool_pose(q)
    np.testing.assert_allclose(arm.tool_position, position, atol=1e-9)
    np.testing.assert_allclose(arm.data.site("tool").xmat.reshape(3, 3), rotation, atol=1e-9)


def test_rests_where_it_is_put_without_commands(robot):
    arm = SimulatedArm(robot, seed=0)
    before = arm.tool_position
    for _ in range(1000):
        arm.step()
    assert np.linalg.norm(arm.tool_position - before) < 1e-6
    assert arm.time == pytest.approx(1.0)


def test_energy_is_kept_in_free_fall_and_does_not_grow_in_gravity_compensation(robot):
    """Without friction, falling keeps the sum of both energies; weightless, the kinetic energy stays."""
    arm = frictionless(robot)
    start = arm.energy
    for _ in range(300):
        gravity = robot.gravity(arm.true_positions)
        arm.command(-gravity if robot.config.compensates_gravity else np.zeros(robot.n))
        arm.step()
    fallen = start - arm.energy
    kinetic = 0.5 * arm.true_velocities @ _mass(arm) @ arm.true_velocities
    assert kinetic > 1.0
    assert abs(fallen) < 0.02 * kinetic
    arm.reset(robot.config.seed)
    arm.data.qvel[:] = 0.3
    mujoco.mj_step1(arm.model, arm.data)
    kinetic = []
    for _ in range(1000):
        arm.command(gravity_command(arm))
        kinetic.append(0.5 * arm.true_velocities @ _mass(arm) @ arm.true_velocities)
        arm.step()
    assert max(kinetic) < 1.02 * kinetic[0]


def _mass(arm):
    mass = np.zeros((arm.robot.n, arm.robot.n))
    for row, unit in zip(mass, np.eye(arm.robot.n), strict=True):
        mujoco.mj_mulM(arm.model, arm.data, row, unit)
    return mass


def test_external_torque_is_the_hand_s_wrench_through_the_jacobian(robot):
    arm = SimulatedArm(robot, seed=0, config=NOISELESS)
    wrench = np.array([1.0, -0.5, 0.3, 0.05, 0.02, -0.04])
    arm.push(wrench)
    for _ in range(50):  # too weak to overcome dry friction
        arm.step()
    wanted = robot.tool_jacobian(arm.true_positions).T @ wrench
    np.testing.assert_allclose(arm.external_torque(), wanted, atol=1e-3)


def test_sensors_are_noisy_and_biased_as_configured(robot):
    arm = SimulatedArm(robot, seed=3)
    samples = []
    for _ in range(1000):
        arm.step()
        samples.append(np.concatenate([arm.state().positions - arm.true_positions, arm.external_torque()]))
    spread = np.std(samples, axis=0)
    thresholds = np.array(robot.config.contact_thresholds)
    np.testing.assert_allclose(spread[:robot.n], arm.config.position_noise, rtol=0.2)
    np.testing.assert_allclose(spread[robot.n:], arm.config.torque_noise * thresholds, rtol=0.2)
    assert (np.abs(np.mean(samples, axis=0)[robot.n:]) > 3 * spread[robot.n:] / np.sqrt(1000)).any()


def test_same_seed_same_bytes_and_another_seed_other_bytes(robot):
    def run(seed):
        arm, record = SimulatedArm(robot, seed=seed), []
        for k in range(300):
            arm.push([0.0, 10.0 * (k > 100), 0.0, 0.0, 0.0, 0.0])
            arm.step()
            record.append(np.concatenate([arm.state().positions, arm.state().velocities, arm.external_torque()]))
        return np.array(record).tobytes()

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_the_table_stops_the_tool_and_is_felt(robot):
    arm = SimulatedArm(robot, seed=0, table_height=0.0, config=NOISELESS)
    arm.reset(robot.inverse_kinematics([0.5, 0.0, 0.05]))
    for _ in range(2500):
        arm.push([0.0, 0.0, -15.0, 0.0, 0.0, 0.0])
        arm.step()
    assert -0.01 < arm.tool_position[2] < 0.02
    assert np.abs(arm.contact_torque()).max() > 1.0
    above = SimulatedArm(robot, seed=0, table_height=None, config=NOISELESS)
    assert not above.contact_torque().any()


def test_joint_limits_stop_the_arm(robot):
    arm = SimulatedArm(robot, seed=0, table_height=None)
    for _ in range(1500):
        push = np.zeros(robot.n)
        push[0] = 20.0
        arm.command(push + gravity_command(arm))
        arm.step()
    assert arm.true_positions[0] < robot.upper[0] + robot.config.position_margin + 0.05


def test_torques_are_limited():
    robot = ROBOTS["ur10"]
    arm = SimulatedArm(robot, seed=0)
    arm.command(np.full(robot.n, 1e4))
    arm.step()
    np.testing.assert_allclose(arm.data.qfrc_applied, robot.torque_limits)


def test_bad_input_is_refused(robot):
    arm = SimulatedArm(robot, seed=0)
    with pytest.raises(ShapeError):
        arm.command(np.zeros(robot.n + 1))
    with pytest.raises(InputError):
        arm.command(np.full(robot.n, np.nan))
    with pytest.raises(ShapeError):
        arm.push(np.zeros(3))
    with pytest.raises(InputError):
        arm.reset(np.full(robot.n, 100.0))
    with pytest.raises(ConfigError):
        SimulatedArm(robot, seed=0, config=ArmConfig(damping=(1.0, 1.0)))
    with pytest.raises(ConfigError):
        ArmConfig(torque_noise=-1.0)
