"""Constraints on the tool alone: workspace, cones, speed, slow zones, and where a motion ends."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from unifeed_ros.core.planning.constraints import Constraint, Values
from unifeed_ros.core.planning.kinematics import ArmPose, cross_products
from unifeed_ros.core.types import Array
from unifeed_ros.core.zones import Cone, Zone

_CONE_SCALE = 0.3
"""Metres that a change of a cosine by one counts as."""
_STANDSTILL = 1e-9
_MARGIN = 1e-3
_SPEED_MARGIN = 0.01
"""Share of a speed limit that way-points leave unused [1]."""


def workspace_constraint(box: tuple[float, ...]) -> Constraint:
    """Keep the tool in a box: its distances to the six faces.

    Args:
        box: Smallest x, y, z, then largest [m].
    """
    low, high = np.array(box[:3]), np.array(box[3:])

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del velocities, near
        return Values(np.concatenate([pose.tool - low, high - pose.tool], axis=1),
                      np.concatenate([pose.tool_jacobian, -pose.tool_jacobian], axis=1))

    return Constraint(
        names=tuple(f"{side} {axis}" for side in ("smallest", "largest") for axis in "xyz"), bounds=np.zeros(6),
        least=-1e-6, margin=_MARGIN, evaluate=evaluate,
        say=lambda name, value, bound: f"the tool leaves the workspace at its {name} by {bound - value:.4f} m")


def cone_constraint(cones: Mapping[str, Cone]) -> Constraint:
    """Keep the tool's z axis in cones: cos(angle to the direction) - cos(largest angle), scaled to metres."""
    directions = np.stack([cone.direction for cone in cones.values()])
    limits = {name: cone.angle for name, cone in cones.items()}
    cosines = np.cos(list(limits.values()))

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del velocities, near
        return Values(_CONE_SCALE * (pose.tool_axis @ directions.T - cosines),
                      _CONE_SCALE * np.einsum("ci,kij->kcj", directions, pose.axis_jacobian))

    def say(name: str, value: float, bound: float) -> str:
        del bound
        tilt = np.arccos(np.clip(value / _CONE_SCALE + np.cos(limits[name]), -1.0, 1.0))
        return f"the tool tilts {tilt:.4f} rad from cone {name}, at most {limits[name]:.4f} rad"

    return Constraint(names=tuple(cones), bounds=np.zeros(len(cones)), least=-1e-6, margin=_MARGIN, evaluate=evaluate,
                      say=say)


def speed_constraint(limit: float) -> Constraint:
    """Limit the tool's speed: limit - |J q'|."""

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del near
        speed, by_posture, by_rate = tool_speed(pose, velocities)
        return Values(limit - speed[:, None], -by_posture[:, None], -by_rate[:, None])

    return Constraint(
        names=("tool speed",), bounds=np.zeros(1), least=0.0, margin=_SPEED_MARGIN * limit, evaluate=evaluate,
        say=lambda name, value, bound: f"the tool reaches {limit + bound - value:.4f} m/s of {limit:.4f}",
        speeds=np.array([limit]))


def slow_zone_constraint(zones: Mapping[str, Zone]) -> Constraint:
    """Limit the tool's speed inside zones: the larger one of the distance to the zone and what is left of its speed."""
    limits = np.array([zone.speed for zone in zones.values()])

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del near
        speed, by_posture, by_rate = tool_speed(pose, velocities)
        values, jacobians, rates = [], [], []
        for zone in zones.values():
            distance, normal = zone.distance(pose.tool)
            left = zone.speed - speed
            outside = distance > left
            values.append(np.where(outside, distance, left))
            away = np.einsum("ki,kij->kj", normal, pose.tool_jacobian)
            jacobians.append(np.where(outside[:, None], away, -by_posture))
            rates.append(np.where(outside[:, None], 0.0, -by_rate))
        return Values(np.stack(values, axis=1), np.stack(jacobians, axis=1), np.stack(rates, axis=1))

    def say(name: str, value: float, bound: float) -> str:
        limit = zones[name].speed
        return f"the tool reaches {limit + bound - value:.4f} m/s of {limit:.4f} in slow zone {name}"

    return Constraint(names=tuple(zones), bounds=np.zeros(len(zones)), least=0.0, margin=_SPEED_MARGIN * limits.min(),
                      evaluate=evaluate, say=say, speeds=limits)


def end_constraint(position: Array, axis: Array | None, tolerance: float) -> Constraint:
    """Bring the tool to a position, and its z axis to a direction, at the end.

    Args:
        position: Where the tool ends, shape (3,) [m].
        axis: Direction of its z axis, shape (3,), or None: any.
        tolerance: Largest distance of each coordinate [m, 1].
    """
    target = position if axis is None else np.concatenate([position, axis])
    names = ("x", "y", "z", "axis_x", "axis_y", "axis_z")[: len(target)]

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del velocities, near
        away, slope = pose.states[:, : len(target)] - target, pose.state_jacobians[:, : len(target)]
        return Values(tolerance - np.concatenate([away, -away], axis=1), np.concatenate([-slope, slope], axis=1))

    return Constraint(
        names=names + names, bounds=np.zeros(2 * len(target)), least=-np.inf, margin=0.5 * tolerance,
        evaluate=evaluate, at_end=True,
        say=lambda name, value, bound: f"the tool ends {tolerance + bound - value:.4f} from the goal's {name}, at most "
                                       f"{tolerance:.4f}")


def tool_speed(pose: ArmPose, velocities: Array) -> tuple[Array, Array, Array]:
    """Compute the tool's speed and its derivatives.

    With J_i = a_i x (p - o_i), the derivative of the tool's velocity sum_i J_i q'_i by joint j is
    (sum_{i<=j} a_i q'_i) x J_j + a_j x sum_{i>j} J_i q'_i.

    Args:
        pose: The arm at N postures.
        velocities: Joint velocities, shape (N, n) [rad/s].

    Returns:
        Speeds, shape (N,) [m/s], derivatives by the posture, shape (N, n) [m/s/rad], and by the velocities [m/rad].
    """
    columns = pose.tool_jacobian.transpose(0, 2, 1)  # (N, n, 3)
    moved = columns * velocities[:, :, None]
    velocity = moved.sum(axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    direction = velocity / np.maximum(speed, _STANDSTILL)[:, None]
    turned = np.cumsum(pose.axes * velocities[:, :, None], axis=1)
    behind = velocity[:, None] - np.cumsum(moved, axis=1)
    bent = cross_products(turned, columns) + cross_products(pose.axes, behind)
    return speed, (bent @ direction[:, :, None])[:, :, 0], (columns @ direction[:, :, None])[:, :, 0]
