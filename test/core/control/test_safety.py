"""The safety filter: bounded torques and torque rates for any request, and faults named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unifeed_ros.core.control.safety import LONGEST_TICK, TARGET_SPEED, SafetyFilter
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import RobotState

ROBOT = RobotModel(load_robot(Path(__file__).parents[3] / "config" / "robots" / "panda.yaml"))
CONFIG = ControlConfig()
REST = np.array(ROBOT.config.seed)


@given(st.lists(arrays(float, ROBOT.n, elements=st.floats()), min_size=1, max_size=10), st.floats(-1.0, 1.0))
def test_torque_and_its_rate_are_limited_for_any_request(requests, dt):
    safety = SafetyFilter(ROBOT, CONFIG)
    last = np.zeros(ROBOT.n)
    for request in requests:
        torque = safety.limited(request, dt)
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= ROBOT.torque_limits).all()
        assert np.abs(torque - last).max() <= CONFIG.torque_rate * min(max(dt, 0.0), LONGEST_TICK) + 1e-9
        last = torque


def state(**changes):
    return RobotState(**({"time": 1.0, "positions": REST, "velocities": np.zeros(ROBOT.n)} | changes))


def test_faults_are_named():
    safety = SafetyFilter(ROBOT, CONFIG)
    assert safety.fault_of(state()) is None
    assert "finite" in safety.fault_of(state(positions=np.full(ROBOT.n, np.nan)))
    assert "finite" in safety.fault_of(state(time=float("inf")))
    assert "positions" in safety.fault_of(state(positions=np.zeros(3)))
    fast = np.zeros(ROBOT.n)
    fast[4] = -9.0
    assert "panda_joint5 moves at 9.00 rad/s" in safety.fault_of(state(velocities=fast))


def moving(velocity, positions=REST):
    """Make a state whose tool moves with a velocity [m/s]."""
    return state(positions=positions, velocities=np.linalg.pinv(ROBOT.tool_jacobian(positions)[:3]) @ velocity)


def test_a_tool_that_is_too_fast_is_a_fault():
    safety = SafetyFilter(ROBOT, ControlConfig(tool_speed=0.5))
    assert safety.fault_of(moving(np.array([0.0, 0.49, 0.0]))) is None
    assert "0.52 m/s, above the limit of 0.50" in safety.fault_of(moving(np.array([0.0, 0.52, 0.0])))


def test_a_tool_that_leaves_the_workspace_is_a_fault_and_may_come_back():
    place = ROBOT.tool_pose(REST)[0]
    box = [*(place - 0.2), *(place + np.array([0.2, 0.2, -0.03]))]  # 3 cm above the box
    safety = SafetyFilter(ROBOT, ControlConfig(workspace=box))
    assert "0.03 m outside the workspace" in safety.fault_of(moving(np.array([0.0, 0.0, 0.1])))
    assert safety.fault_of(moving(np.array([0.0, 0.0, -0.1]))) is None
    assert safety.fault_of(state()) is None
    roomy = SafetyFilter(ROBOT, ControlConfig(workspace=[*(place - 0.2), *(place + 0.2)]))
    assert roomy.fault_of(moving(np.array([0.0, 0.0, 0.1]))) is None


def test_a_joint_that_goes_beyond_its_limit_is_a_fault_and_may_come_back():
    safety = SafetyFilter(ROBOT, CONFIG)
    margin = ROBOT.config.position_margin
    for limit, sign in ((ROBOT.upper + margin, 1.0), (ROBOT.lower - margin, -1.0)):
        out = REST.copy()
        out[3] = limit[3] + 0.1 * sign
        away = np.zeros(ROBOT.n)
        away[3] = 0.1 * sign
        assert "panda_joint4 is 0.10 rad beyond" in safety.fault_of(state(positions=out, velocities=away))
        assert safety.fault_of(state(positions=out, velocities=-away)) is None


def test_too_large_a_force_is_a_fault():
    safety = SafetyFilter(ROBOT, ControlConfig(tool_force=50.0))
    assert safety.force_fault(49.0) is None
    assert "51 N, above the limit of 50" in safety.force_fault(51.0)


@given(st.lists(arrays(float, ROBOT.n, elements=st.floats()), min_size=1, max_size=10), st.floats(-1.0, 1.0))
def test_set_points_stay_within_limits_and_speeds_for_any_request(requests, dt):
    safety, last = SafetyFilter(ROBOT, CONFIG), REST
    margin = ROBOT.config.position_margin
    for request in requests:
        target = safety.limited_target(request, REST, dt)
        assert np.isfinite(target).all()
        assert (target >= ROBOT.lower - margin).all() and (target <= ROBOT.upper + margin).all()
        step = TARGET_SPEED * ROBOT.velocity_limits * min(max(dt, 0.0), LONGEST_TICK)
        assert (np.abs(target - last) <= step + 1e-12).all()
        last = target


@pytest.mark.parametrize("bad", [{"workspace": [0.0] * 6}, {"workspace": [1.0, 2.0]}, {"stop_category": "fall"},
                                 {"output": "steam"}, {"tool_speed": 0.0}, {"impedance": ""}])
def test_limits_that_cannot_be_meant_are_refused(bad):
    with pytest.raises(ConfigError):
        ControlConfig(**bad)
