"""Eq. M10 over joint way-points: variables, cost, constraints, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.check import MotionBounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.constraints import NEAR, joined
from unifeed_ros.core.planning.qp import QPConstants
from unifeed_ros.core.planning.sampling import knot_maps, spline_basis
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

_SMALLEST_SCALE = 1e-9
_RAISE, _LEAST_RAISE = 1.2, 5e-4
"""Factor, and least distance, by which a margin grows where a motion missed its bound; more than what still counts as
feasible at a way-point, or nothing would move [1, m]."""
_SMALL_MARGIN = 0.01
"""Margin up to which values that are far enough to be left out need not be known [m]."""
_REACH = 0.2
"""Largest value over a bound that a way-point beside a missed one counts with [m]."""


class StateReward(Protocol):
    """A reward of single tool states with its gradient: learned, true, or made up for a test."""

    def value_and_gradient(self, tool_states: Array) -> tuple[Array, Array]:
        """Compute rewards and gradients.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,), and their gradients, shape (N, 6).
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Everything that one iteration needs to know at way-points Q."""

    waypoints: Array
    """Joint positions, shape (H, n) [rad]."""
    cost: float
    """Negated objective over the scale: reward and roughness [1]."""
    reward_gradients: Array
    """Gradient of the reward's part of the cost at the m free way-points, shape (m, n) [1/rad]."""
    roughness_gradient: Array
    """Gradient of the roughness, shape (m, n) [1/rad]."""
    clearances: Array
    """Values of the constraints over bounds and margins at the free way-points, shape (m, P) [m]; inf: far."""
    clearance_jacobians: Array
    """Their derivatives by the posture, shape (m, P, n) [m/rad]."""
    rate_jacobians: Array | None
    """Their derivatives by the joint velocities, shape (m, P, n) [m s/rad]; None: none depends on them."""

    @cached_property
    def shortfalls(self) -> Array:
        """Largest distance below a bound at each free way-point, shape (m,) [m]."""
        return np.maximum(-self.clearances.min(axis=1), 0.0)

    @cached_property
    def violation(self) -> float:
        """Largest distance below a bound [m]."""
        return float(self.shortfalls.max())


class PlanningProblem:
    """Maximise the reward over way-points (paper eq. M10), less the cost of roughness.

    minimise -1/scale sum_k r(x(q_k)) + smoothness sum_k mean_j (a_kj / a_max_j)^2, with q_0 the start and q_{H-1} the
    goal, where accelerations a and velocities are those of the clamped cubic spline through the way-points. Between
    knots its acceleration is linear and its velocity a parabola inside its Bezier control points. A velocity at a knot
    is the mean of the control points on both sides, so that limits of accelerations at the knots and of the middle
    control points hold everywhere; its jerk is constant between knots. Constraints on the arm's pose and the tool's
    speed are not linear; they keep margins at the way-points, which grow where the spline between them needs it.

    Attributes:
        count: Number of way-points H.
        aim: Where the straight line ends: the goal, or a guess, shape (n,) [rad]; None: unknown.
        lower, upper: Joint positions that free way-points keep to, shape (n,) [rad].
        velocity: Linear map from changes of free way-points to joint velocities at them, shape (m, m) [1/s].
        free: Indices of the way-points that may move, m of them.
        scale: Reward's spread that the cost is divided by [reward].
        rates: Linear map from way-points to what is limited, shape (R, H): accelerations, the velocities' middle
            control points, and jerks where they are limited.
        rate_limits: Their limits less the margin, shape (R, n).
        roughness_hessian: Hessian of the roughness over free way-points for a joint of unit weight, shape (m, m).
        roughness_weights: Weight of each joint in it, shape (n,).
        qp_solver: Name of the solver of its quadratic models.
        joint_names: Names of the n joints.
    """

    def __init__(self, robot: RobotModel, reward: StateReward | None, start: Array, goal: Array | None, duration: float,
                 bounds: MotionBounds, config: PlannerConfig, *, guess: Array | None = None,
                 margins: Array | None = None, inset: Array | None = None) -> None:
        """Set up the linear maps and measure the reward's spread.

        Args:
            robot: The arm.
            reward: Reward of single states; None for the smoothest motion.
            start: Joint positions at the start, shape (n,) [rad].
            goal: Joint positions at the end, shape (n,) [rad]; None: any.
            duration: Time from start to end [s].
            bounds: Limits of the motion.
            config: Settings.
            guess: Where a motion without a fixed goal may end, shape (n,) [rad]; None: unknown.
            margins: Distance kept from the constraints' bounds at each way-point, shape (H, P) [m]; by default the
                constraints' own.
            inset: Distance kept from the position limits at free way-points, shape (n,) [rad]; by default none.

        Raises:
            PlanningError: The reward is not finite.
        """
        self._arguments = (robot, reward, start, goal, duration, bounds, config)
        self.reward, self.start, self.goal, self.bounds, self.duration = reward, start, goal, bounds, duration
        self.count, self.joints = config.waypoints, robot.n
        self.free = np.arange(1, self.count - (goal is not None))
        self.aim = guess if goal is None else goal
        self._kinematics = bounds.kinematics
        own = np.concatenate([np.full(len(one.names), one.margin) for one in bounds.constraints])
        self._margins = np.tile(own, (self.count, 1)) if margins is None else margins
        self._near = NEAR + max(0.0, float(self._margins.max(initial=0.0)) - _SMALL_MARGIN)
        self._inset = np.zeros(robot.n) if inset is None else inset
        self.lower, self.upper = bounds.lower + self._inset, bounds.upper - self._inset
        velocity, acceleration = knot_maps(self.count, duration)
        self._velocity, self.velocity = velocity, velocity[np.ix_(self.free, self.free)]
        half = 0.5 * duration / (self.count - 1)
        between = velocity[:-1] + half * acceleration[:-1]  # middle control points of the velocity's parabolas
        self.rates = np.vstack([acceleration, between])
        limits = [bounds.acceleration] * self.count + [bounds.velocity] * (self.count - 1)
        if np.isfinite(bounds.jerk).all():
            self.rates = np.vstack([self.rates, np.diff(acceleration, axis=0) / (2.0 * half)])
            limits += [bounds.jerk] * (self.count - 1)
        self.rate_limits = np.array(limits) * (1.0 - config.margin)
        self._acceleration = acceleration
        self.smoothness = config.smoothness if reward is not None else 1.0
        self.roughness_weights = self.smoothness / (self.joints * bounds.acceleration**2)
        self.roughness_hessian = 2.0 * acceleration[:, self.free].T @ acceleration[:, self.free]
        self.qp_solver, self.joint_names = config.qp_solver, robot.joint_names
        self.scale = self._spread()

    def raised(self, waypoints: Array, shortfalls: Array, excess: Array) -> PlanningProblem:
        """Return the problem with larger margins where a motion between its way-points missed bounds.

        Way-points beside a miss have to come farther from the bound than they are: those of a tool that hurries past a
        corner are all well away from it.

        Args:
            waypoints: The motion's, shape (H, n) [rad].
            shortfalls: Distances below the bounds at K evenly spaced moments, shape (K, P) [m].
            excess: Distances outside the position limits, shape (n,) [rad].
        """
        before = np.linspace(0.0, self.count - 1, len(shortfalls)).astype(int)
        raises = np.zeros(self._margins.shape)
        for shift in (0, 1):  # way-points on both sides
            np.maximum.at(raises, np.minimum(before + shift, self.count - 1), shortfalls)
        present = joined(self.bounds.constraints, self._kinematics.evaluate(waypoints), self._velocity @ waypoints,
                         _REACH).values
        least = np.where(present < _REACH, np.maximum(present, self._margins), self._margins)
        margins = np.where(raises > 0, least + _RAISE * raises + _LEAST_RAISE, self._margins)
        inset = self._inset + np.where(excess > 0, _RAISE * excess + _LEAST_RAISE, 0.0)
        return PlanningProblem(*self._arguments, guess=self.aim, margins=margins, inset=inset)

    def within(self, waypoints: Array) -> Array:
        """Move free way-points inside the position limits, shape (H, n) [rad]."""
        return self.complete(np.clip(waypoints[self.free], self.lower, self.upper))

    def qp_constants(self) -> QPConstants:
        """Return what all quadratic models of this problem share."""
        return QPConstants(self.rates[:, self.free], self.rate_limits, self.roughness_hessian, self.roughness_weights,
                           spline_basis(self.count, ends_free=self.goal is None), self.velocity)

    def complete(self, free: Array) -> Array:
        """Add the fixed ends to free way-points.

        Args:
            free: Joint positions, shape (m, n) [rad].

        Returns:
            All way-points, shape (H, n) [rad].
        """
        ends = [] if self.goal is None else [self.goal[None]]
        return np.concatenate([self.start[None], free, *ends])

    def evaluate(self, waypoints: Array) -> Evaluation:
        """Compute cost, constraints and derivatives.

        Args:
            waypoints: Joint positions, shape (H, n) [rad].

        Raises:
            PlanningError: The reward or its gradient is not finite.
        """
        pose = self._kinematics.evaluate(waypoints)
        values, gradients = self._reward(pose.states)
        over = joined(self.bounds.constraints, pose, self._velocity @ waypoints, self._near)
        free = self.free
        to_joints = (gradients[free, None] @ pose.state_jacobians[free])[:, 0]
        accelerations = self._acceleration @ waypoints
        roughness = float((accelerations**2 @ self.roughness_weights).sum())
        return Evaluation(
            waypoints=waypoints,
            cost=roughness - float(values.sum()) / self.scale,
            reward_gradients=-to_joints / self.scale,
            roughness_gradient=2.0 * self._acceleration[:, free].T @ accelerations * self.roughness_weights,
            clearances=over.values[free] - self._margins[free], clearance_jacobians=over.jacobians[free],
            rate_jacobians=None if over.rate_jacobians is None else over.rate_jacobians[free])

    def reward_curvature(self, at: Evaluation, step: float) -> Array:
        """Measure the curvature of the reward's part of the cost by forward differences of its gradient.

        Args:
            at: Where.
            step: Change of each joint [rad].

        Returns:
            Symmetric, at each free way-point, shape (m, n, n) [1/rad^2].

        Raises:
            PlanningError: The gradient is not finite.
        """
        m, n = len(self.free), self.joints
        beside = at.waypoints[self.free] + step * np.eye(n)[:, None]
        pose = self._kinematics.evaluate(beside.reshape(n * m, n))
        to_joints = (self._reward(pose.states)[1][:, None] @ pose.state_jacobians)[:, 0]
        changes = (-to_joints.reshape(n, m, n) / self.scale - at.reward_gradients) / step
        return 0.5 * (changes.transpose(1, 0, 2) + changes.transpose(1, 2, 0))

    def rate_shares(self, waypoints: Array) -> Array:
        """Compute rates over their limits, shape (R, n); feasible between -1 and 1."""
        return np.asarray((self.rates @ waypoints) / self.rate_limits)

    def _spread(self) -> float:
        """Measure how much the reward changes along the straight line, or within half a radian where that is more."""
        goal = self.start if self.aim is None else self.aim
        line = self.start + np.linspace(0.0, 1.0, self.count)[:, None] * (goal - self.start)
        pose = self._kinematics.evaluate(line)
        values, gradients = self._reward(pose.states)
        slope = np.linalg.norm((gradients[:, None] @ pose.state_jacobians)[:, 0], axis=1).mean()
        return max(float(np.ptp(values)), 0.5 * float(slope), _SMALLEST_SCALE) if self.reward is not None else 1.0

    def _reward(self, states: Array) -> tuple[Array, Array]:
        if self.reward is None:
            return np.zeros(len(states)), np.zeros_like(states)
        values, gradients = self.reward.value_and_gradient(states)
        if not (np.isfinite(values).all() and np.isfinite(gradients).all()):
            bad = int(np.argmin(np.isfinite(values) & np.isfinite(gradients).all(axis=1)))
            raise PlanningError("the reward is not finite", expected="numbers",
                                got=f"{values[bad]} at tool position {np.round(states[bad, :3], 3).tolist()} m",
                                mend="train the reward again")
        return values, gradients
