"""What a motion must keep to, and the check that holds at every sample of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.clearance import clearance_constraint
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.constraints import NEAR, Constraint
from unifeed_ros.core.planning.heights import height_constraint
from unifeed_ros.core.planning.kinematics import Kinematics
from unifeed_ros.core.planning.tool_limits import (
    cone_constraint,
    slow_zone_constraint,
    speed_constraint,
    workspace_constraint,
)
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory

TOLERANCE = 1e-6
"""Largest excess of a motion that passes: positions [rad], rates over their limits [1], constraints [m]."""
_GOAL_TOLERANCE = 1e-3
"""Largest distance of a given goal below a bound, which inverse kinematics may leave [m]."""
_SPARE = 1e-3
"""Share by which slowing down goes beyond what cures the excess, since other moments are sampled then [1]."""


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
    jerk: Array
    """Largest joint jerks, shape (n,) [rad/s^3]; inf: any."""
    constraints: tuple[Constraint, ...]
    """What depends on where the arm is and how fast the tool moves."""
    kinematics: Kinematics
    """The arm that they are about."""


class MotionCheck(NamedTuple):
    """How far a motion keeps to its bounds; the worst sample of each kind."""

    position_excess: Array
    """Largest distance of each joint outside its limits, negative inside, shape (n,) [rad]."""
    velocity_ratio: float
    """Largest joint speed over its limit [1]."""
    acceleration_ratio: float
    """Largest joint acceleration over its limit [1]."""
    jerk_ratio: float
    """Largest joint jerk over its limit [1]."""
    speed_ratio: float
    """Largest speed of the tool over its limit [1]."""
    shortfalls: Array
    """Distance of each constraint's value below its bound at each of the K samples, not negative, shape (K, P)."""
    problems: tuple[str, ...]
    """What is wrong, one clause each with its numbers and its time; empty: nothing."""

    @property
    def ok(self) -> bool:
        """True if the motion keeps to all bounds."""
        return not self.problems

    @property
    def shortfall(self) -> float:
        """Largest distance of a constraint's value below its bound [m]."""
        return float(self.shortfalls.max(initial=0.0))

    @property
    def slowdown(self) -> float:
        """Factor of the duration that would cure speeds, accelerations and jerks, at least 1 [1]."""
        factor = max(self.velocity_ratio, float(np.sqrt(self.acceleration_ratio)), float(np.cbrt(self.jerk_ratio)),
                     self.speed_ratio)
        return factor * (1.0 + _SPARE) if factor > 1.0 + TOLERANCE else 1.0


def motion_bounds(robot: RobotModel, scene: Scene, start: Array, goal: Array | None, config: PlannerConfig,
                  extra: tuple[Constraint, ...] = ()) -> MotionBounds:
    """Collect the limits of a motion and check that its ends are inside.

    A start that is already closer to a joint limit, the table or a zone than the margin may stay as close, not closer.

    Args:
        robot: The arm.
        scene: Table, zones, cones, workspace and speed of the tool.
        start: Joint positions at the start, shape (n,) [rad].
        goal: Joint positions at the end, shape (n,) [rad], or None.
        config: Margins and jerk limit.
        extra: Further constraints.

    Raises:
        PlanningError: The start is below the table or inside a zone, or the goal outside the limits.
        InputError: An end is outside the URDF's limits or not finite.
        ShapeError: Another number of joints.
    """
    start = robot.require_state(start, "start of the motion")
    ends = [start] if goal is None else [start, robot.require_state(goal, "goal of the motion")]
    kinematics = Kinematics(robot)
    constraints = tuple(_allowing(one, kinematics, np.stack(ends)) for one in scene_constraints(robot, scene, config))
    bounds = MotionBounds(
        lower=np.minimum(robot.lower, start), upper=np.maximum(robot.upper, start), velocity=robot.velocity_limits,
        acceleration=robot.acceleration_limits, jerk=np.full(robot.n, config.jerk_limit or np.inf),
        constraints=(*constraints, *extra), kinematics=kinematics)
    if goal is not None:
        outside = np.maximum(bounds.lower - goal, goal - bounds.upper)
        worst = int(np.argmax(outside))
        if outside[worst] > TOLERANCE:
            raise PlanningError(f"goal of the motion: joint {robot.joint_names[worst]} is too close to its limit",
                                expected=f"{bounds.lower[worst]:.3f} to {bounds.upper[worst]:.3f} rad",
                                got=f"{goal[worst]:.3f} rad", mend="choose another goal")
    return bounds


def scene_constraints(robot: RobotModel, scene: Scene, config: PlannerConfig) -> tuple[Constraint, ...]:
    """List what a scene asks of a motion.

    Args:
        robot: The arm.
        scene: The task.
        config: Distances to keep.

    Raises:
        ConfigError: The arm's collision geometry cannot be read.
    """
    found = [height_constraint(robot, scene, config.arm_radius)]
    slow = {name: zone for name, zone in scene.zones.items() if zone.speed > 0}
    closed = {name: zone for name, zone in scene.zones.items() if zone.speed == 0}
    if config.whole_arm:
        found.append(clearance_constraint(robot, closed, scene.table_height, config.body_clearance))
    elif closed:
        raise PlanningError("keep-out zones need the whole arm's geometry", got="planner.whole_arm false")
    if scene.workspace:
        found.append(workspace_constraint(tuple(scene.workspace)))
    if scene.cones:
        found.append(cone_constraint(scene.cones))
    if scene.tool_speed:
        found.append(speed_constraint(scene.tool_speed))
    if slow:
        found.append(slow_zone_constraint(slow))
    return tuple(found)


def check_motion(trajectory: Trajectory, bounds: MotionBounds) -> MotionCheck:
    """Check every sample of a motion against every limit and constraint.

    Args:
        trajectory: Motion with velocities and accelerations.
        bounds: What it must keep to.
    """
    q, v, a, times = (trajectory.positions, trajectory.velocities, trajectory.accelerations, trajectory.times)
    assert v is not None and a is not None
    names = trajectory.joint_names
    excess = np.maximum(bounds.lower - q, q - bounds.upper)
    jerk = np.diff(a, axis=0, prepend=a[:1]) / np.diff(times, prepend=times[0] - 1.0)[:, None]
    rates = [(np.abs(values), limit, unit) for values, limit, unit in (
        (v, bounds.velocity, "rad/s"), (a, bounds.acceleration, "rad/s^2"), (jerk, bounds.jerk, "rad/s^3"))]
    problems = [f"{names[j]} leaves its limits by {excess[k, j]:.4f} rad at {times[k]:.2f} s"
                for j, k in enumerate(np.argmax(excess, axis=0).tolist()) if excess[k, j] > TOLERANCE]
    problems += [f"{names[j]} reaches {values[k, j]:.3f} {unit} of {limit[j]:.3f} at {times[k]:.2f} s"
                 for values, limit, unit in rates for j, k in enumerate(np.argmax(values, axis=0).tolist())
                 if values[k, j] > limit[j] * (1.0 + TOLERANCE)]
    pose, v = bounds.kinematics.evaluate(np.ascontiguousarray(q)), np.ascontiguousarray(v)
    speed_ratio, shortfalls = 0.0, []
    for one in bounds.constraints:
        values = one.evaluate(pose, v, 0.0).values - one.bounds
        if one.at_end:
            values[:-1] = np.inf
        shortfalls.append(np.maximum(-values, 0.0))
        if one.speeds is not None:
            speed_ratio = max(speed_ratio, float((1.0 - values / one.speeds).max()))
        problems += [f"{one.say(name, values[k, p] + one.bounds[p], one.bounds[p])} at {times[k]:.2f} s"
                     for p, (name, k) in enumerate(zip(one.names, np.argmin(values, axis=0).tolist(), strict=True))
                     if values[k, p] < -TOLERANCE]
    velocity, acceleration, jerk_ratio = (float((values / limit).max()) for values, limit, _ in rates)
    return MotionCheck(
        position_excess=excess.max(axis=0), velocity_ratio=velocity, acceleration_ratio=acceleration,
        jerk_ratio=jerk_ratio, speed_ratio=speed_ratio, shortfalls=np.concatenate(shortfalls, axis=1),
        problems=tuple(problems))


def _allowing(one: Constraint, kinematics: Kinematics, ends: Array) -> Constraint:
    """Lower bounds to what the ends of a motion have, down to the least that is allowed."""
    values = one.evaluate(kinematics.evaluate(ends), np.zeros(ends.shape), NEAR).values
    least = np.broadcast_to(one.least, one.bounds.shape)
    for worst in np.flatnonzero(values[0] < least).tolist():
        raise PlanningError("start of the motion: " + one.say(one.names[worst], values[0, worst], least[worst]),
                            mend="move the arm by hand")
    bounds = np.minimum(one.bounds, values[0])
    low = int(np.argmin(values[-1] - bounds))
    if values[-1, low] < max(bounds[low] - _GOAL_TOLERANCE, least[low]):
        raise PlanningError("goal of the motion: " + one.say(one.names[low], values[-1, low], bounds[low]),
                            mend="choose another goal, or mend the scene")
    return replace(one, bounds=np.minimum(bounds, values[-1]))
