"""Sensors of torque that are stuck."""

from __future__ import annotations

import numpy as np
import pytest

from unifeed_ros.core.capture.stuck import STUCK_S, StuckTorque
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.resources import config_path


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


def feed(watch, rows, begin=100.0, rate=1000.0):
    """Feed rows; give the index of the first that is refused, None if none is."""
    for k, row in enumerate(rows):
        try:
            watch.check(begin + k / rate, row)
        except InputError:
            return k
    return None


def pushes(level, seconds, rate=1000.0):
    """A sensor with noise that somebody pushes at joint 2."""
    rows = np.random.default_rng(0).normal(0.0, 0.05, (round(seconds * rate), 7))
    rows[:, 1] += level
    return rows


def test_a_sensor_at_the_end_of_its_range_is_noticed_and_named(robot):
    rows = pushes(15.0, 0.5)
    rows[200:, 1] = 20.0
    refused = feed(watch := StuckTorque(robot), rows)
    assert refused == pytest.approx(200 + 1000 * STUCK_S, abs=2)
    with pytest.raises(InputError, match="20 Nm at panda_joint2") as caught:
        watch.check(100.5, rows[-1])
    assert "panda_joint3" not in str(caught.value)


def test_what_moves_again_is_taken_again_and_clocks_that_went_back_do_no_harm(robot):
    watch = StuckTorque(robot)
    assert feed(watch, np.tile([0.0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0], (200, 1))) is not None
    assert feed(watch, pushes(20.0, 0.3), begin=101.0) is None
    assert feed(watch, pushes(20.0, 0.3), begin=50.0) is None
    assert feed(watch, np.tile([0.0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0], (200, 1)), begin=51.0) is not None


@pytest.mark.parametrize("rows", [np.zeros((500, 7)), np.full((500, 7), 0.3), pushes(30.0, 0.5),
                                  np.repeat(pushes(30.0, 0.5, 25.0), 40, axis=0)],
                         ids=["nothing", "a bias", "a push", "a driver with 25 new values a second"])
def test_neither_rest_nor_pushes_nor_slow_drivers_count(robot, rows):
    assert feed(StuckTorque(robot), rows) is None
