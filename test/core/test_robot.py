"""The arm's kinematics and gravity as laws, and settings that cannot be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError, UnifeedError, UnreachableError
from unifeed_ros.core.robot import RobotModel, find_urdf, load_robot

ROBOTS = Path(__file__).parents[2] / "config/robots"


@pytest.fixture(scope="module", params=sorted(path.stem for path in ROBOTS.glob("*.yaml")))
def robot(request) -> RobotModel:
    return RobotModel(load_robot(ROBOTS / f"{request.param}.yaml"))


def _posture(robot: RobotModel, seed: int, spread: float = 0.7) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(np.array(robot.config.seed) + rng.uniform(-spread, spread, robot.n), robot.lower, robot.upper)


def _differences(function, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    return np.stack([(np.asarray(function(q + step * e)) - np.asarray(function(q - step * e))) / (2 * step)
                     for e in np.eye(len(q))], axis=-1)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_tool_state_jacobian_matches_differences(robot, seed):
    q = _posture(robot, seed)
    states, jacobians = robot.tool_states_and_jacobians(q[None])
    np.testing.assert_allclose(jacobians[0], _differences(lambda p: robot.tool_states(p[None])[0], q), atol=1e-7)
    np.testing.assert_array_equal(states, robot.tool_states(q[None]))
    np.testing.assert_allclose(robot.tool_jacobian(q)[:3], jacobians[0, :3], atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_angular_jacobian_turns_the_tool(robot, seed):
    q, step = _posture(robot, seed), 1e-6
    turned = robot.tool_pose(q + step)[1] @ robot.tool_pose(q)[1].T
    np.testing.assert_allclose(pin.log3(turned) / step, robot.tool_jacobian(q)[3:] @ np.ones(robot.n), atol=1e-5)


def test_tool_pose_is_the_tool_state(robot):
    q = _posture(robot, 0)
    position, rotation = robot.tool_pose(q)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.concatenate([position, rotation[:, 2]]), robot.tool_states(q[None])[0], atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_gravity_is_the_gradient_of_potential_energy(robot, seed):
    q, data = _posture(robot, seed), robot.pin_model.createData()
    energy = _differences(lambda p: pin.computePotentialEnergy(robot.pin_model, data, p), q, step=1e-5)
    np.testing.assert_allclose(robot.gravity(q), energy, atol=1e-4)
    assert (np.abs(robot.gravity(q)) < robot.torque_limits).all()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_inverse_kinematics_finds_back_to_where_the_tool_was(robot, seed):
    state = robot.tool_states(_posture(robot, seed, spread=0.4)[None])[0]
    found = robot.inverse_kinematics(state[:3], state[3:])
    np.testing.assert_allclose(robot.tool_states(found[None])[0], state, atol=2e-3)
    assert (found >= robot.lower).all() and (found <= robot.upper).all()


def test_inverse_kinematics_is_repeatable_and_stays_near_its_seed(robot):
    first = robot.inverse_kinematics((0.4, 0.1, 0.4))
    np.testing.assert_array_equal(first, robot.inverse_kinematics((0.4, 0.1, 0.4)))
    near = robot.inverse_kinematics((0.41, 0.1, 0.4), seed=first)
    assert np.abs(near - first).max() < 0.2


def test_out_of_reach_says_how_far(robot):
    with pytest.raises(UnreachableError, match=r"out of reach.*m short"):
        robot.inverse_kinematics((3.0, 0.0, 0.5))


def test_limits_are_the_urdfs_less_the_margin(robot):
    margin = robot.config.position_margin
    np.testing.assert_allclose(robot.lower, robot.pin_model.lowerPositionLimit + margin)
    np.testing.assert_allclose(robot.upper, robot.pin_model.upperPositionLimit - margin)
    assert (robot.velocity_limits <= robot.pin_model.velocityLimit).all()
    np.testing.assert_allclose(robot.torque_limits, robot.pin_model.effortLimit)
    plain = RobotModel(replace(robot.config, velocity_limits=(), torque_limits=()))
    np.testing.assert_allclose(plain.velocity_limits, robot.pin_model.velocityLimit)


def test_states_are_checked(robot):
    inside = robot.require_state(robot.config.seed)
    assert not inside.flags.writeable
    outside = np.array(inside)
    outside[1] = robot.upper[1] + robot.config.position_margin + 0.1
    with pytest.raises(InputError, match=f"{robot.joint_names[1]} is outside its limits"):
        robot.require_state(outside)
    robot.require_state(np.minimum(outside, robot.upper + robot.config.position_margin))  # the margin is no limit
    with pytest.raises(InputError, match="not finite"):
        robot.require_state(np.full(robot.n, np.nan))
    for call in (robot.require_state, robot.tool_states, robot.tool_states_and_jacobians):
        with pytest.raises(ShapeError):
            call(np.zeros(robot.n + 1))


def test_settings_in_the_files_have_one_number_a_joint(robot):
    for name in ("seed", "velocity_limits", "acceleration_limits", "torque_limits", "stiffness", "damping",
                 "contact_thresholds", "friction"):
        assert len(getattr(robot.config, name)) == robot.n
    np.testing.assert_allclose(robot.tool_states(np.array(robot.config.seed)[None])[0, 5], -1.0, atol=0.05)


def test_a_robot_that_cannot_be_built_says_why(robot, tmp_path):
    config = robot.config
    with pytest.raises(ConfigError, match="missing"):
        find_urdf("no_such_robot/arm.urdf")
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot name='x'><link")
    with pytest.raises(ConfigError, match=r"broken\.urdf"):
        RobotModel(replace(config, urdf=str(broken)))
    with pytest.raises(ConfigError, match="no_such_frame"):
        RobotModel(replace(config, tool_frame="no_such_frame"))
    with pytest.raises(ConfigError, match="no_such_joint"):
        RobotModel(replace(config, joints=(*config.joints[:-1], "no_such_joint")))
    with pytest.raises(ConfigError, match="order of joints"):
        RobotModel(replace(config, joints=config.joints[::-1]))


@pytest.mark.parametrize(("changes", "text"), [
    ({"joints": ()}, "joints"), ({"stiffness": (1.0,)}, "stiffness"),
    ({"velocity_limits": (-1.0,) * 6}, "velocity_limits"),
    ({"damping": (float("nan"),) * 6}, "damping"), ({"friction": ("much",) * 6}, "much"),
])
def test_settings_that_cannot_work_are_refused(changes, text):
    config = load_robot(ROBOTS / "ur10.yaml")
    with pytest.raises((UnifeedError, ValueError), match=text):
        replace(config, **changes)


@pytest.mark.parametrize(("content", "text"), [
    (None, "No such file"), ("a: [", "not YAML"), ("a: 1", "ros__parameters"), ("[1, 2]", "ros__parameters"),
    ("/**: {ros__parameters: {arm: {}}}", "a group named robot.*arm"),
    ("/**: {ros__parameters: {robot: {name: x}}}", "lacks settings"),
    ("/**: {ros__parameters: {robot: {colour: red}}}", "unknown settings.*colour"),
    ("/**: {ros__parameters: {robot: {name: x, urdf: y, base_frame: b, tool_frame: t, joints: [j], seed: [0.0, 1.0]}}}",
     "seed"),
    ("/**: {ros__parameters: {robot: {name: x, urdf: y, base_frame: b, tool_frame: t, joints: [j], seed: [far]}}}",
     "far"),
])
def test_files_that_cannot_be_used_are_named(tmp_path, content, text):
    path = tmp_path / "robot.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=text) as caught:
        load_robot(path)
    assert "robot.yaml" in str(caught.value)
