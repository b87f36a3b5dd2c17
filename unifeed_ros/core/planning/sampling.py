"""Motions from way-points: the clamped cubic spline, its derivatives at the knots, and time profiles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from unifeed_ros.core.types import Array, Trajectory

_NEGLIGIBLE = 1e-6
"""Share of the largest entry below which an entry of a knot map is dropped: they decay by 0.27 a knot."""


def sample_spline(waypoints: Array, duration: float, joint_names: Sequence[str], rate: float) -> Trajectory:
    """Lay a spline with continuous acceleration and zero end velocities through way-points.

    Args:
        waypoints: Joint positions, evenly spaced in time, shape (H, n) [rad].
        duration: Time from the first to the last [s].
        joint_names: Names of the n joints.
        rate: Smallest number of points in a second [Hz].

    Returns:
        Positions, velocities and accelerations from 0 to the duration.
    """
    spline = CubicSpline(np.linspace(0.0, duration, len(waypoints)), waypoints, bc_type="clamped")
    times = np.linspace(0.0, duration, int(np.ceil(duration * rate - 1e-9)) + 1)
    return Trajectory(joint_names=tuple(joint_names), times=times, positions=spline(times), velocities=spline(times, 1),
                      accelerations=spline(times, 2))


def knot_maps(count: int, duration: float) -> tuple[Array, Array]:
    """Compute the spline's derivatives at its knots as linear maps of the way-points.

    Args:
        count: Number of way-points H.
        duration: Time from the first to the last [s].

    Returns:
        Maps to velocities [1/s] and accelerations [1/s^2] at the knots, shape (H, H) each, nearly banded.
    """
    times = np.linspace(0.0, duration, count)
    basis = CubicSpline(times, np.eye(count), bc_type="clamped")
    maps = [basis(times, order) for order in (1, 2)]
    for values in maps:
        values[np.abs(values) < _NEGLIGIBLE * np.abs(values).max()] = 0.0
    return maps[0], maps[1]


def spline_basis(count: int, *, ends_free: bool) -> Array:
    """Compute the way-points that the coefficients of the clamped cubic spline stand for.

    Way-point k is (c_{k-1} + 4 c_k + c_{k+1}) / 6, where c_0 and the one before it let the spline start at rest from 0;
    a fixed last way-point does the same at the end, a free one only stays at rest. All derivatives at a knot depend on
    its three nearest coefficients alone.

    Args:
        count: Number of way-points H.
        ends_free: True if the last way-point is free.

    Returns:
        Map from the m coefficients to the m free way-points, tridiagonal, shape (m, m), m = H - 1 or H - 2.
    """
    m = count - 1 if ends_free else count - 2
    basis = (4.0 * np.eye(m) + np.eye(m, k=1) + np.eye(m, k=-1)) / 6.0
    basis[0, 0] -= 0.5 / 6.0
    if ends_free:
        basis[-1, -2] += 1.0 / 6.0
    else:
        basis[-1, -1] -= 0.5 / 6.0
    return basis


def shortest_duration(distance: Array, velocity: Array, acceleration: Array) -> float:
    """Compute the time of the fastest rest-to-rest motion over joint distances.

    Args:
        distance: Distance of each joint, shape (n,) [rad].
        velocity: Velocity limits, shape (n,) [rad/s].
        acceleration: Acceleration limits, shape (n,) [rad/s^2].

    Returns:
        Time of the slowest joint [s].
    """
    distance = np.abs(distance)
    cruising = distance / velocity + velocity / acceleration
    peaked = 2.0 * np.sqrt(distance / acceleration)
    return float(np.where(distance > velocity**2 / acceleration, cruising, peaked).max())


def rest_to_rest(count: int) -> Array:
    """Compute the share of the way covered at evenly spaced times, with zero velocity at both ends.

    A third of the time to speed up, a third to slow down.

    Args:
        count: Number of times H.

    Returns:
        Shares from 0 to 1, shape (H,) [1].
    """
    t = np.linspace(0.0, 1.0, count)
    share = np.where(t < 1 / 3, 2.25 * t**2, 1.5 * t - 0.25)
    return np.where(t > 2 / 3, 1.0 - 2.25 * (1.0 - t) ** 2, share)
