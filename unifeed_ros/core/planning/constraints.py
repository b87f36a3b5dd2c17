"""What every kind of constraint has in common: values that must not fall below bounds, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.planning.kinematics import ArmPose
from unifeed_ros.core.types import Array

NEAR = 0.06
"""Distance over a bound from which on the search may leave a value out [m]."""


class Values(NamedTuple):
    """P values at N postures of n joints."""

    values: Array
    """Shape (N, P); inf where a value is far above its bound."""
    jacobians: Array
    """Derivatives by the posture, shape (N, P, n)."""
    rate_jacobians: Array | None = None
    """Derivatives by the joint velocities, shape (N, P, n) [s]; None: none depends on them."""


@dataclass(frozen=True, kw_only=True)
class Constraint:
    """P values that must reach their bounds at every moment of a motion, all of about a metre's scale."""

    names: tuple[str, ...]
    """What the P values are about."""
    bounds: Array
    """Smallest values, shape (P,)."""
    least: Array | float
    """What the bounds may be lowered to where the start itself is lower, shape (P,); below it no motion may start."""
    margin: float
    """Distance from the bounds that way-points keep, for the spline between them."""
    evaluate: Callable[[ArmPose, Array, float], Values]
    """Values and derivatives from the arm's pose and the joint velocities, shape (N, n) [rad/s]; values that are
    farther over their bounds than the last argument may be left out as inf."""
    say: Callable[[str, float, float], str]
    """Clause about a value of that name that misses its bound."""
    speeds: Array | None = None
    """Speed limits that slowing down cures where values are limits less speeds, shape (P,) [m/s]; or None."""
    at_end: bool = False
    """True: it holds for the last posture only."""


def joined(constraints: tuple[Constraint, ...], pose: ArmPose, velocities: Array, near: float = NEAR) -> Values:
    """Evaluate constraints and subtract their bounds.

    Args:
        constraints: What to evaluate.
        pose: The arm at N postures, of which the last one ends the motion.
        velocities: Joint velocities, shape (N, n) [rad/s].
        near: Distance over a bound from which on a value may be left out as inf [m].

    Returns:
        Values over their bounds, in the constraints' order; feasible where not negative.
    """
    parts = []
    count, n = velocities.shape
    for one in constraints:
        values, jacobians, by_rate = one.evaluate(pose, velocities, near)
        values = values - one.bounds
        if one.at_end:
            values[:-1] = np.inf
        parts.append(Values(values, jacobians, by_rate))
    fast = any(part.rate_jacobians is not None for part in parts)
    rates = [np.zeros(p.jacobians.shape) if p.rate_jacobians is None else p.rate_jacobians for p in parts]
    empty = np.zeros((count, 0, n))
    return Values(np.concatenate([empty[:, :, 0], *(p.values for p in parts)], axis=1),
                  np.concatenate([empty, *(p.jacobians for p in parts)], axis=1),
                  np.concatenate(rates, axis=1) if fast else None)
