"""The bench of the page: which state a drawn pose belongs to, and what is printed."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from unifeed_ros.cli.bench_console import describe, lags

STATES = [(0.01 * k, np.array([0.1 * k, 0.0, 0.5])) for k in range(100)]


def test_a_pose_is_as_late_as_it_came_after_its_own_state():
    late = np.random.default_rng(0).uniform(0.0, 0.3, 20)
    drawn = [(time + delay, place) for (time, place), delay in zip(STATES[::5], late, strict=True)]
    np.testing.assert_allclose(lags(drawn, STATES), late)


def test_poses_that_no_state_has_or_that_came_before_it_do_not_count():
    unknown = (0.5, np.array([0.123, 0.0, 0.5]))
    early = (STATES[50][0] - 0.001, STATES[50][1])
    assert lags([unknown, early], STATES).size == 0


def test_an_arm_that_stood_there_before_counts_from_the_last_time():
    twice = [*STATES, (1.0, STATES[10][1])]
    np.testing.assert_allclose(lags([(1.02, STATES[10][1])], twice), [0.02])


def test_figures_are_printed_by_name():
    text = describe({"machine": {"cpus": 2, "load_before": 1.0, "load_after": 2.0},
                     **{part: {"figure": 0.25} for part in ("without_page", "with_page", "pose", "click_ms")}})
    assert "before 1.0, after 2.0, 2 cpus" in text
    assert [line.split() for line in text.splitlines()[3:]] == [["pose.figure", "0.250"], ["click_ms.figure", "0.250"]]
