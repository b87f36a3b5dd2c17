"""What a motion must keep to, and the check that holds at every sample of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.arm_points import ArmPoints
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory

_POSITION_TOLERANCE = 1e-3
_HEIGHT_TOLERANCE = 2e-3
_RATE_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True)
class MotionBounds:
    """Limits of one motion."""

    lower: Array
    """Smallest joint positions, shape (n,) [rad]."""
    upper: Array
    """Largest joint positions, shape (n,) [rad]."""
    velocity: Array
    """Largest joint speeds, shape (n,) [rad/s]."""
    acceleration: Array
    """Largest joint accelerations, shape (n,) [rad/s^2]."""
    floors: Array
    """Smallest heights of the arm's points, shape (P,) [m]."""


class MotionCheck(NamedTuple):
    """How far a motion keeps to its bounds; the worst sample of each kind."""

    position_excess: float
    """Largest distance outside the position limits [rad]."""
    velocity_ratio: float
    """Largest speed over its limit [1]."""
    acceleration_ratio: float
    """Largest acceleration over its limit [1]."""
    height_shortfall: float
    """Largest distance below the floor [m]."""
    problems: tuple[str, ...]
    """What is wrong, one clause each; empty: nothing."""

    @property
    def ok(self) -> bool:
        """True if the motion keeps to all bounds."""
        return not self.problems

    @property
    def slowdown(self) -> float:
        """Factor of the duration that would cure speeds and accelerations, at least 1 [1]."""
        return max(1.0, self.velocity_ratio, float(np.sqrt(self.acceleration_ratio)))


def motion_bounds(robot: RobotModel, scene: Scene, start: Array, goal: Array | None, arm_radius: float) -> MotionBounds:
    """Collect the limits of a motion and check that its ends are inside.

    A start that is already closer to a joint limit or to the table than the margin may stay as close, not closer.

    Args:
        robot: The arm.
        scene: Table and clearance.
        start: Joint positions at the start, shape (n,) [rad].
        goal: Joint positions at the end, shape (n,) [rad], or None.
        arm_radius: Distance from the joints' centres to the arm's surface [m].

    Raises:
        PlanningError: The start is below the table, or the goal outside the limits.
        InputError: An end is outside the URDF's limits or not finite.
        ShapeError: Another number of joints.
    """
    start = robot.require_state(start, "start of the motion")
    points = ArmPoints(robot)
    radius = np.array([arm_radius] * (len(points.names) - 1) + [0.0])
    floors = scene.floor + radius
    heights = points.evaluate(start[None]).heights[0]
    if (heights < scene.table_height).any():
        raise PlanningError(f"start of the motion puts {points.names[int(np.argmin(heights))]} below the table",
                            expected=f"above {scene.table_height:.3f} m", got=f"{heights.min():.3f} m",
                            mend="move the arm up by hand")
    lower, upper = np.minimum(robot.lower, start), np.maximum(robot.upper, start)
    bounds = MotionBounds(lower=lower, upper=upper, velocity=robot.velocity_limits,
                          acceleration=robot.acceleration_limits, floors=np.minimum(floors, heights))
    if goal is not None:
        goal = robot.require_state(goal, "goal of the motion")
        _require_goal(robot, bounds, points, goal)
    return bounds


def check_motion(trajectory: Trajectory, bounds: MotionBounds, points: ArmPoints) -> MotionCheck:
    """Check every sample of a motion: positions, speeds, accelerations, heights of the tool and the arm.

    Args:
        trajectory: Motion with velocities and accelerations.
        bounds: What it must keep to.
        points: The arm's points, in the order of the floors.
    """
    q = trajectory.positions
    assert trajectory.velocities is not None and trajectory.accelerations is not None
    names = trajectory.joint_names
    excess = np.maximum(bounds.lower - q, q - bounds.upper).max(axis=0)
    speed = np.abs(trajectory.velocities).max(axis=0)
    acceleration = np.abs(trajectory.accelerations).max(axis=0)
    heights = points.evaluate(np.ascontiguousarray(q)).heights.min(axis=0)
    shortfall = bounds.floors - heights
    problems = [f"{names[j]} leaves its limits by {excess[j]:.3f} rad"
                for j in np.flatnonzero(excess > _POSITION_TOLERANCE)]
    problems += [f"{names[j]} reaches {speed[j]:.2f} rad/s of {bounds.velocity[j]:.2f}"
                 for j in np.flatnonzero(speed > bounds.velocity * (1 + _RATE_TOLERANCE))]
    problems += [f"{names[j]} reaches {acceleration[j]:.2f} rad/s^2 of {bounds.acceleration[j]:.2f}"
                 for j in np.flatnonzero(acceleration > bounds.acceleration * (1 + _RATE_TOLERANCE))]
    problems += [f"{points.names[p]} comes down to {heights[p]:.3f} m, floor {bounds.floors[p]:.3f} m"
                 for p in np.flatnonzero(shortfall > _HEIGHT_TOLERANCE)]
    return MotionCheck(
        position_excess=max(float(excess.max()), 0.0), velocity_ratio=float((speed / bounds.velocity).max()),
        acceleration_ratio=float((acceleration / bounds.acceleration).max()),
        height_shortfall=max(float(shortfall.max()), 0.0), problems=tuple(problems))


def _require_goal(robot: RobotModel, bounds: MotionBounds, points: ArmPoints, goal: Array) -> None:
    outside = np.maximum(bounds.lower - goal, goal - bounds.upper)
    worst = int(np.argmax(outside))
    if outside[worst] > 1e-6:
        raise PlanningError(f"goal of the motion: joint {robot.joint_names[worst]} is too close to its limit",
                            expected=f"{bounds.lower[worst]:.3f} to {bounds.upper[worst]:.3f} rad",
                            got=f"{goal[worst]:.3f} rad", mend="choose another goal")
    heights = points.evaluate(goal[None]).heights[0]
    low = int(np.argmin(heights - bounds.floors))
    if heights[low] < bounds.floors[low] - 1e-3:
        raise PlanningError(f"goal of the motion puts {points.names[low]} too close to the table",
                            expected=f"{bounds.floors[low]:.3f} m or higher", got=f"{heights[low]:.3f} m",
                            mend="raise the goal, or lower the scene's clearance")
