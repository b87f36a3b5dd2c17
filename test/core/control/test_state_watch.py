"""Joint states that no arm gives: jumps, and repetition to the last bit while it is driven."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from control_loop import ROBOTS, Loop

from unifeed_ros.core.control.state_watch import StateWatch
from unifeed_ros.core.types import RobotState

ROBOT = ROBOTS["panda"]
REST, ZERO = np.array(ROBOT.config.seed), np.zeros(ROBOT.n)


def state(time, positions=REST, velocities=ZERO):
    return RobotState(time=time, positions=positions, velocities=velocities)


def test_a_jump_names_the_joint_and_permuted_values_are_one():
    watch = StateWatch(ROBOT)
    assert watch.fault_of(state(0.0), 0.0) is None
    jumped = REST.copy()
    jumped[1] += 0.2
    assert "panda_joint2 jumped by 0.20 rad in 2 ms" in watch.fault_of(state(0.002, jumped), 0.0)
    assert "jumped" in watch.fault_of(state(0.004, np.roll(REST, 1)), 0.0)


def test_after_a_jump_only_states_near_the_last_good_one_are_trusted_or_one_that_is_accepted():
    watch, permuted = StateWatch(ROBOT), np.roll(REST, 1)
    watch.fault_of(state(0.0), 0.0)
    for time in (0.002, 0.5, 2.0):
        assert "jumped" in watch.fault_of(state(time, permuted), 0.0) and watch.doubted
    assert watch.fault_of(state(2.002, REST + 0.1), 0.0) is None and not watch.doubted
    assert watch.fault_of(state(2.004, permuted), 0.0) is not None
    watch.accept(state(2.006, permuted))
    assert watch.fault_of(state(2.008, permuted), 0.0) is None and not watch.doubted


def test_a_pause_of_the_messages_is_no_jump():
    watch = StateWatch(ROBOT)
    watch.fault_of(state(0.0), 0.0)
    assert watch.fault_of(state(0.3, REST + 0.3), 0.0) is None


@pytest.mark.parametrize(("speed", "frozen"), [(0.0, False), (0.5, True)])
def test_frozen_states_are_a_fault_only_while_the_arm_is_driven(speed, frozen):
    watch = StateWatch(ROBOT)
    faults = [watch.fault_of(state(0.002 * k), speed) for k in range(60)]
    assert (faults[-1] is not None) == frozen
    assert faults[:15] == [None] * 15


def test_an_arm_that_moves_and_yields_is_never_taken_for_one():
    loop = Loop(ROBOT)
    loop.start_tracking()
    loop.run(1.0).run(0.5, (0.0, 25.0, 0.0)).run(1.0)
    assert {c.message for c in loop.commands if "stopped" in c.message} == set()
