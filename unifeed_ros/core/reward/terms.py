"""Terms that rewards are made of, known or learned: values and exact gradients over tool states."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.types import Array

Values = tuple[Array, Array]
"""Values, shape (N,), and their gradients by the tool state, shape (N, 6)."""


def distance(states: Array, point: ArrayLike, dimensions: int = 3) -> Values:
    """Compute how far the tool is from a point.

    ||x - p|| over the first dimensions of the position. At the point itself, where no gradient exists, it is zero.

    Args:
        states: Tool states, shape (N, 6) [m, 1].
        point: Point in the base frame, shape (3,) [m].
        dimensions: 3 for space, 2 for the distance over the table (x and y only).

    Returns:
        Distances [m] and gradients [1].
    """
    offset = states[:, :dimensions] - np.asarray(point, dtype=np.float64)[:dimensions]
    length = np.linalg.norm(offset, axis=1)
    gradient = np.zeros_like(states)
    gradient[:, :dimensions] = offset / np.where(length > 0.0, length, 1.0)[:, None]
    return length, gradient


def box_distance(states: Array, centre: ArrayLike, half_sizes: ArrayLike) -> Values:
    """Compute how far the tool is from a box whose sides are parallel to the base frame's axes.

    ||x - clip(x)||, zero inside.

    Args:
        states: Tool states, shape (N, 6) [m, 1].
        centre: Centre of the box in the base frame, shape (3,) [m].
        half_sizes: Half of each side's length, shape (3,) [m].

    Returns:
        Distances [m] and gradients [1].
    """
    middle, half = np.asarray(centre, dtype=np.float64), np.asarray(half_sizes, dtype=np.float64)
    position = states[:, :3]
    offset = position - np.clip(position, middle - half, middle + half)
    length = np.linalg.norm(offset, axis=1)
    gradient = np.zeros_like(states)
    gradient[:, :3] = offset / np.where(length > 0.0, length, 1.0)[:, None]
    return length, gradient


def height(states: Array, level: float) -> Values:
    """Compute how far the tool is above or below a level, |z - level|.

    Args:
        states: Tool states, shape (N, 6) [m, 1].
        level: Height of the level in the base frame [m].

    Returns:
        Distances [m] and gradients [1].
    """
    offset = states[:, 2] - level
    gradient = np.zeros_like(states)
    gradient[:, 2] = np.sign(offset)
    return np.abs(offset), gradient


def tilt(states: Array, upright: ArrayLike) -> Values:
    """Compute the angle between the tool's axis and a direction.

    atan2(|a x u|, a . u), which unlike the arc cosine has a gradient near zero. At zero itself it is taken as zero.

    Args:
        states: Tool states, shape (N, 6) [m, 1].
        upright: Unit vector u in the base frame, shape (3,).

    Returns:
        Angles [rad] and gradients [rad].
    """
    direction = np.asarray(upright, dtype=np.float64)
    axis = states[:, 3:]
    across = np.cross(axis, direction)
    sine, cosine = np.linalg.norm(across, axis=1), axis @ direction
    by_sine = np.cross(direction, across) / np.where(sine > 0.0, sine, 1.0)[:, None]
    gradient = np.zeros_like(states)
    gradient[:, 3:] = (cosine[:, None] * by_sine - sine[:, None] * direction) / (sine**2 + cosine**2)[:, None]
    gradient[sine == 0.0] = 0.0
    return np.arctan2(sine, cosine), gradient


def shortfall(values: Values, limit: float) -> Values:
    """Compute by how much values fall short of a limit, max(0, limit - value).

    Args:
        values: Values and gradients.
        limit: Limit, in the values' unit.

    Returns:
        Shortfalls and their gradients; zero where the limit is met.
    """
    value, gradient = values
    short = limit - value
    return np.maximum(short, 0.0), np.where(short > 0.0, -1.0, 0.0)[:, None] * gradient


def weighted(*terms: tuple[float, Values]) -> Values:
    """Add up weighted terms.

    Args:
        *terms: Pairs of a weight and a term.

    Returns:
        Weighted sums and their gradients.
    """
    value = sum((w * v for w, (v, _) in terms), np.zeros(len(terms[0][1][0])))
    gradient = sum((w * g for w, (_, g) in terms), np.zeros_like(terms[0][1][1]))
    return value, gradient
