"""The safety filter: bounded torques and torque rates for any request, and faults named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unifeed_ros.core.control.safety import LONGEST_TICK, SafetyFilter
from unifeed_ros.core.control.settings import ControlConfig
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
