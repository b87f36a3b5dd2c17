"""Tasks with a true reward, which simulated people know and the learner does not; regret."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, PlanningError, ShapeError
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import plan_motion
from unifeed_ros.core.reward.terms import Values, distance, height, shortfall, tilt, weighted
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory

LAPTOP_RADIUS = 1.0
"""Distance over the table within which the laptop counts [m]."""
PERSON_RADIUS = 0.4
"""Distance over the table within which the person feels crowded [m]."""


def _table(scene: Scene, states: Array) -> Values:
    return weighted((-2.0, distance(states, scene.goal)), (-1.2, height(states, scene.table_height)))


def _laptop(scene: Scene, states: Array) -> Values:
    near = shortfall(distance(states, scene.objects["laptop"], dimensions=2), LAPTOP_RADIUS)
    return weighted((-1.0, distance(states, scene.goal)), (-1.0, near))


def _cup(scene: Scene, states: Array) -> Values:
    return weighted((-1.0, distance(states, scene.goal)), (-0.75, tilt(states, scene.axis)))


def _proximity(scene: Scene, states: Array) -> Values:
    near = shortfall(distance(states, scene.objects["person"], dimensions=2), PERSON_RADIUS)
    return weighted((-1.0, distance(states, scene.goal)), (-3.0, near))


_REWARDS: Mapping[str, Callable[[Scene, Array], Values]] = {
    "table": _table, "laptop": _laptop, "cup": _cup, "proximity": _proximity,
}
_TILTING = ("cup",)
_OBJECTS: Mapping[str, str] = {"laptop": "laptop", "proximity": "person"}

TASKS = tuple(_REWARDS)
"""Names of the tasks that have a true reward."""


@dataclass(frozen=True, kw_only=True)
class TrueTask:
    """What a simulated person wants; satisfies the planner's StateReward.

    For a tool at x with axis a, goal g, all distances in metres:
    table: -2 ||x - g|| - 1.2 |z - table|;
    laptop: -||x - g|| - max(0, 1.0 - ||x_xy - laptop_xy||);
    cup: -||x - g|| - 0.75 angle(a, upright);
    proximity: -||x - g|| - 3 max(0, 0.4 - ||x_xy - person_xy||).
    """

    scene: Scene
    """Goal, table and objects."""
    name: str = ""
    """One of TASKS; empty: the scene's own task."""

    def __post_init__(self) -> None:
        """Refuse tasks without a true reward, and scenes without the object that the task is about."""
        object.__setattr__(self, "name", self.name or self.scene.task)
        if self.name not in _REWARDS:
            raise ConfigError("unknown task", expected=", ".join(TASKS), got=self.name)
        needed = _OBJECTS.get(self.name)
        if needed and needed not in self.scene.objects:
            raise ConfigError(f"objects in the scene of task {self.name}", expected=needed,
                              got=", ".join(self.scene.objects) or "none")

    @property
    def minds_tilt(self) -> bool:
        """True if the reward depends on the tool's direction."""
        return self.name in _TILTING

    def value_and_gradient(self, tool_states: ArrayLike) -> Values:
        """Evaluate the true reward.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,) [reward], and their gradients by the tool state, shape (N, 6) [reward/m, reward].

        Raises:
            ShapeError: Not six columns.
        """
        states = np.asarray(tool_states, dtype=np.float64)
        if states.ndim != 2 or states.shape[1] != 6:
            raise ShapeError("shape of tool states", expected="(any, 6)", got=states.shape)
        return _REWARDS[self.name](self.scene, states)

    def rewards(self, tool_states: ArrayLike) -> Array:
        """Evaluate the true reward without its gradient.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,) [reward].
        """
        return self.value_and_gradient(tool_states)[0]

    def returns(self, robot: RobotModel, motion: Trajectory | ArrayLike, waypoints: int) -> float:
        """Add up the true reward over states evenly spaced in time (paper eq. P3).

        Args:
            robot: The arm that moves.
            motion: Motion, or evenly timed postures of shape (K, n) [rad].
            waypoints: Number H of states, both ends included.

        Returns:
            Return [reward].
        """
        if not isinstance(motion, Trajectory):
            path = np.asarray(motion, dtype=np.float64)
            motion = Trajectory(joint_names=robot.joint_names, times=np.arange(float(len(path))), positions=path)
        return float(self.rewards(robot.tool_states(motion.resampled(waypoints))).sum())


def endpoints(robot: RobotModel, scene: Scene) -> tuple[Array, Array]:
    """Find the postures at the start and at the goal of a scene.

    Args:
        robot: The arm.
        scene: Start, goal and direction of the tool.

    Returns:
        Start and goal posture, shape (n,) each [rad].

    Raises:
        UnreachableError: The arm cannot take one of them.
    """
    start = robot.inverse_kinematics(scene.start, scene.axis)
    return start, robot.inverse_kinematics(scene.goal, scene.axis, seed=start)


def straight_line(robot: RobotModel, scene: Scene, waypoints: int) -> Trajectory:
    """Move from start to goal on a straight line in joint space at constant speed: what not learning gives.

    Args:
        robot: The arm.
        scene: Start, goal and duration.
        waypoints: Number of points.

    Returns:
        The motion.
    """
    start, goal = endpoints(robot, scene)
    share = np.linspace(0.0, 1.0, waypoints)[:, None]
    return Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, scene.duration, waypoints),
                      positions=start + share * (goal - start))


@dataclass(frozen=True, kw_only=True)
class Yardstick:
    """The best and the unlearned motion of a task on one arm, which regret is measured between."""

    robot: RobotModel
    """The arm."""
    task: TrueTask
    """True reward and scene."""
    waypoints: int
    """Number H of states that a return adds up."""
    optimum: Trajectory
    """The best motion that the planner finds for the true reward, under the arm's limits."""
    optimal_return: float
    """Return of the optimum [reward]."""
    straight_return: float
    """Return of the straight line [reward]."""

    def regret(self, motion: Trajectory | ArrayLike) -> float:
        """Compute how much a motion falls short of the optimum (paper eq. s1).

        Args:
            motion: Motion, or evenly timed postures of shape (K, n) [rad].

        Returns:
            Regret [reward]; slightly negative where the planner's optimum was beaten.
        """
        return self.optimal_return - self.task.returns(self.robot, motion, self.waypoints)

    def normalised_regret(self, motion: Trajectory | ArrayLike) -> float:
        """Compute regret as a share of the straight line's regret.

        Args:
            motion: Motion, or evenly timed postures of shape (K, n) [rad].

        Returns:
            0 for the optimum, 1 for a motion no better than the straight line [1].
        """
        return self.regret(motion) / (self.optimal_return - self.straight_return)


def measure(robot: RobotModel, task: TrueTask, config: PlannerConfig | None = None, *, starts: int = 8) -> Yardstick:
    """Find the optimum of a task by planning from many starts on the true reward.

    The smoothness term is made small, so that the arm's limits and not taste decide how fast the optimum is.

    Args:
        robot: The arm.
        task: True reward and scene.
        config: Settings of the planner; those that the learner uses.
        starts: Number of starts, the straight line among them.

    Returns:
        The optimum and both returns.

    Raises:
        PlanningError: No motion satisfies the constraints.
        UnreachableError: The arm cannot take the start or the goal.
    """
    config = config or PlannerConfig()
    scene = task.scene
    start, goal = endpoints(robot, scene)
    many = replace(config, starts=starts, halving=0, smoothness=config.smoothness * 0.1, time_budget=60.0)
    plan = plan_motion(robot, task, start, goal, duration=scene.duration, scene=scene, config=many)
    if not plan.success:
        raise PlanningError(f"no motion for task {task.name} on {robot.config.name}", got=plan.message)
    line = straight_line(robot, scene, config.waypoints)
    return Yardstick(robot=robot, task=task, waypoints=config.waypoints, optimum=plan.trajectory,
                     optimal_return=task.returns(robot, plan.trajectory, config.waypoints),
                     straight_return=task.returns(robot, line, config.waypoints))
