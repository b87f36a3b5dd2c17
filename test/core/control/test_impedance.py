"""The impedance law: a spring and damper that vanish with the robot's share, gravity fed forward."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from unifeed_ros.core.control.impedance import ImpedanceLaw, ToolImpedanceLaw, make_law
from unifeed_ros.core.control.sampled_motion import Setpoint
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel, load_robot

CONFIG = load_robot(Path(__file__).parents[3] / "config" / "robots" / "panda.yaml")
ROBOT = RobotModel(replace(CONFIG, compensates_gravity=False))
REST, ZERO = np.array(CONFIG.seed), np.zeros(ROBOT.n)


def resting(positions=REST):
    return Setpoint(positions, ZERO, ZERO)


def test_at_the_reference_only_weight_remains():
    law = ImpedanceLaw(ROBOT)
    np.testing.assert_allclose(law.torque(REST, ZERO, resting(), 1.0, 0.1), ROBOT.gravity(REST), atol=1e-9)
    np.testing.assert_allclose(law.weight(REST), ROBOT.gravity(REST), atol=1e-9)


def test_where_the_driver_adds_gravity_none_is_sent():
    law = ImpedanceLaw(RobotModel(replace(CONFIG, compensates_gravity=True)))
    np.testing.assert_allclose(law.torque(REST, ZERO, resting(), 1.0, 0.1), ZERO, atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_spring_scales_with_the_share(share):
    law = ImpedanceLaw(ROBOT)
    spring = law.torque(REST, ZERO, resting(REST + 0.01), share, 0.1) - ROBOT.gravity(REST)
    np.testing.assert_allclose(spring, share * 0.01 * np.array(CONFIG.stiffness), atol=1e-9)


@pytest.mark.parametrize(("share", "part"), [(0.0, 0.1), (0.5, 0.55), (1.0, 1.0)])
def test_damper_keeps_a_part_when_the_share_is_gone(share, part):
    law, velocities = ImpedanceLaw(ROBOT), np.full(ROBOT.n, 0.2)
    damper = law.torque(REST, velocities, resting(), share, 0.1) - ROBOT.gravity(REST)
    np.testing.assert_allclose(damper, -part * 0.2 * np.array(CONFIG.damping), atol=1e-9)


def test_feed_forward_is_the_inverse_dynamics_of_the_reference():
    law, rng = ImpedanceLaw(ROBOT), np.random.default_rng(0)
    v, a = 0.3 * rng.normal(size=ROBOT.n), rng.normal(size=ROBOT.n)
    wanted = pin.rnea(ROBOT.pin_model, ROBOT.pin_model.createData(), REST, v, a)
    np.testing.assert_allclose(law.torque(REST, v, Setpoint(REST, v, a), 1.0, 0.1), wanted, atol=1e-9)


def test_beyond_the_limits_the_arm_is_braked_and_pushed_back():
    law = ImpedanceLaw(ROBOT)
    fast = ROBOT.velocity_limits + 0.5
    ordinary = -0.1 * fast * np.array(CONFIG.damping)
    braking = law.torque(REST, fast, resting(), 0.0, 0.1) - ROBOT.gravity(REST) - ordinary
    np.testing.assert_allclose(braking, -0.5 * np.array(CONFIG.damping), atol=1e-9)
    outside = ROBOT.upper + 0.02
    back = law.torque(outside, ZERO, resting(outside), 0.0, 0.1) - ROBOT.gravity(outside)
    np.testing.assert_allclose(back, -0.02 * np.array(CONFIG.stiffness), atol=1e-9)


@pytest.mark.parametrize(("inertia", "coriolis"), [(True, False), (False, True), (False, False)])
def test_compensation_of_inertia_and_coriolis_can_be_left_out(inertia, coriolis):
    law = ImpedanceLaw(ROBOT, ControlConfig(inertia_compensation=inertia, coriolis_compensation=coriolis))
    rng = np.random.default_rng(1)
    v, a = 0.3 * rng.normal(size=ROBOT.n), rng.normal(size=ROBOT.n)
    wanted = pin.rnea(ROBOT.pin_model, ROBOT.pin_model.createData(), REST, v * coriolis, a * inertia)
    np.testing.assert_allclose(law.torque(REST, v, Setpoint(REST, v, a), 1.0, 0.1), wanted, atol=1e-9)


def test_the_settings_choose_the_law():
    assert type(make_law(ROBOT, ControlConfig(impedance="tool"))) is ToolImpedanceLaw
    assert type(make_law(ROBOT, ControlConfig())) is ImpedanceLaw


def pull(target, positions=REST):
    law = ToolImpedanceLaw(ROBOT)
    return law.torque(positions, ZERO, resting(target), 1.0, 0.1) - law.weight(positions)


def test_the_spring_at_the_tool_has_its_stiffness_in_every_direction():
    """J q' moves the tool by e: the force that balances the torques is K e, to first order."""
    jacobian = ROBOT.tool_jacobian(REST)
    stiffness = np.array(CONFIG.tool_stiffness)
    for axis in range(6):
        error = np.eye(6)[axis] * 1e-4
        step = np.linalg.pinv(jacobian) @ error
        force = np.linalg.lstsq(jacobian.T, pull(REST + step), rcond=None)[0]
        np.testing.assert_allclose(force, stiffness * error, atol=0.03 * stiffness[axis] * 1e-4 + 2e-5)


def test_what_the_tool_leaves_free_is_held_by_the_joints_and_gives_the_tool_no_force():
    jacobian = ROBOT.tool_jacobian(REST)
    free = np.linalg.svd(jacobian)[2][-1]
    torque = pull(REST + 1e-4 * free)
    assert np.linalg.norm(jacobian @ torque) < 0.05 * np.linalg.norm(torque)
    assert free @ torque > 0.5 * 1e-4 * free @ (np.array(CONFIG.stiffness) * free) * 0.5


def test_the_law_at_the_tool_vanishes_with_the_share_as_the_other_does():
    for law in (ImpedanceLaw(ROBOT), ToolImpedanceLaw(ROBOT)):
        torque = law.torque(REST, ZERO, resting(REST + 0.3), 0.0, 0.1)
        np.testing.assert_allclose(torque, ROBOT.gravity(REST), atol=1e-9)
