"""A check of planned motions at 1 kHz that shares neither constraints nor kinematics with the planner."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array
from unifeed_ros.core.zones import Zone

RATE = 1000.0
"""Samples of a motion in a second [Hz]."""


def dense_excess(robot: RobotModel, scene: Scene, waypoints: Array, duration: float) -> dict[str, float]:
    """Measure by how much a motion exceeds each limit, 0 where it keeps it; table and zones with the tool alone.

    The motion is laid through the way-points anew. What the start or the goal has is allowed in between, as far as
    joints' positions and heights are concerned. In a slow zone counts the smaller one of how deep and how much too fast
    the tool is, so that a motion that is slow from a hair's breadth inside the border on exceeds by that.

    Args:
        robot: The arm, with its limits.
        scene: Table, zones, cones, workspace and speed of the tool.
        waypoints: Joint positions, shape (H, n) [rad].
        duration: Time from the first to the last [s].

    Returns:
        Largest excess by limit: position [rad], velocity and acceleration over their limits [1], height, workspace and
        slow_zone [m, m/s], tool_speed [m/s], and cone [rad]; what the scene does not ask for is left out.
    """
    spline = CubicSpline(np.linspace(0.0, duration, len(waypoints)), waypoints, bc_type="clamped")
    times = np.linspace(0.0, duration, int(np.ceil(RATE * duration)) + 1)
    q, v = spline(times), spline(times, 1)
    states, jacobians = robot.tool_states_and_jacobians(q)
    tool, ends = states[:, :3], waypoints[[0, -1]]
    speeds = np.linalg.norm(np.einsum("kij,kj->ki", jacobians[:, :3], v), axis=1)
    lower, upper = np.minimum(robot.lower, ends.min(axis=0)), np.maximum(robot.upper, ends.max(axis=0))
    excess = {"position": np.maximum(lower - q, q - upper),
              "velocity": np.abs(v) / robot.velocity_limits - 1.0,
              "acceleration": np.abs(spline(times, 2)) / robot.acceleration_limits - 1.0,
              "height": min(scene.floor, float(tool[[0, -1], 2].min())) - tool[:, 2]}
    if scene.workspace:
        box = np.asarray(scene.workspace)
        excess["workspace"] = np.maximum(box[:3] - tool, tool - box[3:])
    if scene.tool_speed:
        excess["tool_speed"] = speeds - scene.tool_speed
    if scene.cones:
        axes = states[:, 3:] / np.linalg.norm(states[:, 3:], axis=1, keepdims=True)
        excess["cone"] = np.stack([np.arccos(np.clip(axes @ cone.direction, -1.0, 1.0)) - cone.angle
                                   for cone in scene.cones.values()])
    slow = [zone for zone in scene.zones.values() if zone.speed > 0]
    if slow:
        excess["slow_zone"] = np.stack([np.minimum(_depth(zone, tool), speeds - zone.speed) for zone in slow])
    return {name: max(0.0, float(values.max())) for name, values in excess.items()}


def _depth(zone: Zone, points: Array) -> Array:
    """Measure how deep points are inside a zone, negative outside, shape (N,) [m]."""
    away = np.abs(points - zone.position)
    if zone.shape == "box":
        return np.asarray((0.5 * zone.size - away).min(axis=1))
    beyond = np.maximum(away[:, 2] - (0.5 * zone.size[-1] - zone.size[0] if zone.shape == "capsule" else 0.0), 0.0)
    return np.asarray(zone.size[0] - np.sqrt((away[:, :2] ** 2).sum(axis=1) + beyond**2))
