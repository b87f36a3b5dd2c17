"""The spline through way-points, its derivatives, and the fastest motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.planning.sampling import knot_maps, rest_to_rest, sample_spline, shortest_duration


def _waypoints(seed: int, count: int = 12, joints: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, joints)).cumsum(axis=0) * 0.2


@given(seed=st.integers(0, 1000), duration=st.floats(0.5, 10.0))
def test_spline_goes_through_the_waypoints_and_rests_at_both_ends(seed, duration):
    waypoints = _waypoints(seed)
    motion = sample_spline(waypoints, duration, ("a", "b", "c"), 100.0)
    assert motion.duration == pytest.approx(duration)
    assert np.diff(motion.times).max() <= 0.01 + 1e-9
    np.testing.assert_allclose(motion.positions[[0, -1]], waypoints[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=1e-9)
    resampled = sample_spline(waypoints, duration, ("a", "b", "c"), 11 / duration)  # samples at the knots
    np.testing.assert_allclose(resampled.positions, waypoints, atol=1e-9)


def test_velocities_and_accelerations_are_the_derivatives():
    motion = sample_spline(_waypoints(0), 3.0, ("a", "b", "c"), 2000.0)
    step = motion.times[1]
    speeds, rises = (np.gradient(values, step, axis=0)[1:-1] for values in (motion.positions, motion.velocities))
    np.testing.assert_allclose(speeds, motion.velocities[1:-1], atol=1e-3)
    np.testing.assert_allclose(rises, motion.accelerations[1:-1], atol=0.02)
    assert np.abs(np.diff(motion.accelerations, axis=0)).max() < 0.2  # continuous


@given(seed=st.integers(0, 1000), count=st.integers(5, 40), duration=st.floats(0.5, 10.0))
def test_knot_maps_give_the_splines_derivatives(seed, count, duration):
    waypoints = _waypoints(seed, count)
    motion = sample_spline(waypoints, duration, ("a", "b", "c"), (count - 1) / duration)
    velocity, acceleration = knot_maps(count, duration)
    np.testing.assert_allclose(velocity @ waypoints, motion.velocities, atol=2e-4 * np.abs(motion.velocities).max())
    np.testing.assert_allclose(acceleration @ waypoints, motion.accelerations,
                               atol=2e-4 * np.abs(motion.accelerations).max())


@given(distance=st.floats(1e-3, 3.0), velocity=st.floats(0.1, 2.0), acceleration=st.floats(0.5, 10.0))
def test_shortest_duration_covers_exactly_the_distance(distance, velocity, acceleration):
    time = shortest_duration(np.array([-distance]), np.array([velocity]), np.array([acceleration]))
    peak = min(velocity, acceleration * time / 2)
    assert peak * time - peak**2 / acceleration == pytest.approx(distance)


def test_slowest_joint_decides_the_duration():
    one = np.ones(2)
    assert shortest_duration(np.array([0.1, 2.0]), one, one) == shortest_duration(np.array([0.0, 2.0]), one, one)


def test_rest_to_rest_is_smooth_and_symmetric():
    share = rest_to_rest(301)
    assert share[0] == 0.0 and share[-1] == 1.0
    assert (np.diff(share) > 0).all()
    np.testing.assert_allclose(share + share[::-1], 1.0, atol=1e-12)
    assert np.diff(share).max() * 300 == pytest.approx(1.5, abs=0.01)
