"""Motions as the page draws them: tool paths, the reward along them, and what a lesson changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory

POINTS = 60
"""Points that a motion is drawn with."""


@dataclass(frozen=True, kw_only=True)
class DrawnMotion:
    """A motion, sampled evenly in time."""

    positions: Array
    """Joint positions, shape (POINTS, n) [rad]."""
    states: Array
    """Tool states, shape (POINTS, 6) [m, 1]."""
    duration: float
    """Duration [s]."""

    @property
    def path(self) -> Array:
        """Tool positions, shape (POINTS, 3) [m]."""
        return self.states[:, :3]


def drawn(robot: RobotModel, motion: Trajectory) -> DrawnMotion:
    """Sample a motion for drawing.

    Args:
        robot: The arm.
        motion: The motion.

    Returns:
        What is drawn of it.
    """
    positions = motion.resampled(POINTS)
    return DrawnMotion(positions=positions, states=robot.tool_states(positions), duration=motion.duration)


def rewards_along(model: RewardEnsemble | None, motion: DrawnMotion, context: Context) -> tuple[Array, Array]:
    """Evaluate the learned reward along a motion.

    Args:
        model: Learned reward; None before the first.
        motion: The motion.
        context: Goal and objects.

    Returns:
        Mean reward and disagreement at each point, shape (POINTS,) each [1]; zeros without a model.
    """
    if model is None:
        return np.zeros(len(motion.states)), np.zeros(len(motion.states))
    return (model.member_rewards(motion.states, context).mean(axis=0), model.disagreement(motion.states, context))


def is_task_motion(motion: DrawnMotion, start: Array, tolerance: float = 0.03) -> bool:
    """Tell a motion of the task from one that only moves back to the start.

    Args:
        motion: The motion.
        start: Where the tool starts, shape (3,) [m].
        tolerance: Distance that counts as being there [m].

    Returns:
        True if it begins at the start and ends elsewhere.
    """
    begins, ends = np.linalg.norm(motion.path[[0, -1]] - start, axis=1)
    return bool(begins < tolerance < ends)


def describe_change(before: DrawnMotion | None, after: DrawnMotion) -> str:
    """Say how a plan changed, in centimetres at the tool.

    Args:
        before: The plan before; None for the first plan.
        after: The plan after.

    Returns:
        A sentence.
    """
    if before is None:
        return "the first motion that was learned"
    apart = after.path - before.path
    most = int(np.argmax(np.linalg.norm(apart, axis=1)))
    distance = float(np.linalg.norm(apart[most]))
    if distance < 0.01:
        return "the motion stayed as it was (less than 1 cm)"
    share = 100 * most / (len(apart) - 1)
    up = float(apart[most, 2])
    where = f", {100 * abs(up):.0f} cm {'higher' if up > 0 else 'lower'}" if abs(up) > 0.01 else ""
    return f"moved the motion by up to {100 * distance:.0f} cm{where}, most after {share:.0f} % of the way"
