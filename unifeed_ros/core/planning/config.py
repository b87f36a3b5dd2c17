"""Settings of the planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.planning.qp import SOLVERS, SolverName

GoalKind = Literal["posture", "pose", "position", "free"]


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """How a reward becomes a motion."""

    waypoints: int = 20
    """Number of way-points H, start and goal included."""
    smoothness: float = 0.005
    """Largest cost of roughness for a way-point, as a share of the reward's spread over the straight line [1].

    Roughness is the mean square of acceleration over its limit, so it never costs more than this: the optimum is
    hardly moved, and motions of equal reward are told apart.
    """
    starts: int = 1
    """Number of motions that the search starts from, the straight line and given seeds first; a seed comes on top of
    one. Over learned rewards, further starts gained at most 0.3 % of the objective."""
    halving: int = 4
    """Iterations after which the worse half of several starts is given up, and so on until one is left; 0: each is
    searched to its end [1]."""
    max_iterations: int = 60
    """Largest number of iterations from each start."""
    tolerance: float = 4e-3
    """Improvement, in the reward's spread at one way-point, below which a search has ended; less where the objective
    is small [1]."""
    time_budget: float = 5.0
    """Longest wall-clock time of the search [s]; far above the usual 0.3 s, since a search that it ends early depends
    on how busy the machine is."""
    trust_radius: float = 0.15
    """Largest change of a joint in the first iteration [rad]."""
    margin: float = 0.02
    """Share of the velocity and acceleration limits that is left unused [1]."""
    arm_radius: float = 0.06
    """Distance from the joints' centres to the arm's surface, for the height over the table [m]."""
    whole_arm: bool = True
    """True: the arm's capsules keep away from zones, the table and each other; needs the URDF's collision geometry."""
    body_clearance: float = 0.02
    """Distance that they keep [m]."""
    kappa: float = 0.0
    """Planned is the mean reward less this many times the ensemble's disagreement; 0: the mean (paper eq. M10) [1]."""
    jerk_limit: float = 0.0
    """Largest jerk of a joint between the ends of a motion [rad/s^3]; 0: any."""
    goal: GoalKind = "posture"
    """How the task's goal is fixed where a request gives no joint positions: as a posture, as the tool's pose, as its
    position alone, or free, wherever the reward leads."""
    goal_tolerance: float = 1e-3
    """Largest distance from a goal that is given as a position or a pose, by coordinate [m, 1]."""
    slack: float = 1.5
    """Duration over the shortest possible one, where no duration is asked for [1]."""
    max_slowdown: float = 2.0
    """Largest factor by which a motion may be slowed down to become feasible [1]."""
    sample_rate: float = 100.0
    """Rate of the points of the motion [Hz]."""
    check_rate: float = 500.0
    """Rate at which a motion is checked, the controller's [Hz]."""
    qp_solver: SolverName = "piqp"
    """Solver of the quadratic programmes: piqp, osqp or own."""
    seed: int = 0
    """Seed of the deformed starts."""

    def __post_init__(self) -> None:
        """Reject values that would only fail in the middle of a search."""
        if self.waypoints < 5:
            raise ConfigError("waypoints", expected=">= 5", got=self.waypoints)
        if self.qp_solver not in SOLVERS:
            raise ConfigError("qp_solver", expected=", ".join(SOLVERS), got=self.qp_solver)
        if self.goal not in get_args(GoalKind):
            raise ConfigError("goal", expected=", ".join(get_args(GoalKind)), got=self.goal)
        for name, least in (("starts", 1), ("max_iterations", 1), ("halving", 0)):
            if getattr(self, name) < least:
                raise ConfigError(name, expected=f">= {least}", got=getattr(self, name))
        for name in ("smoothness", "tolerance", "time_budget", "trust_radius", "sample_rate", "check_rate",
                     "goal_tolerance"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigError(name, expected="> 0", got=getattr(self, name))
        for name, low, high in (("margin", 0.0, 0.5), ("arm_radius", 0.0, 1.0), ("slack", 1.0, 100.0),
                                ("max_slowdown", 1.0, 100.0), ("body_clearance", 0.0, 1.0), ("kappa", -1e3, 1e3),
                                ("jerk_limit", 0.0, 1e6)):
            if not low <= getattr(self, name) <= high:
                raise ConfigError(name, expected=f"{low} to {high}", got=getattr(self, name))

    def adjusted(self, *, waypoints: int = 0, time_budget: float = 0.0, jerk_limit: float = 0.0, goal: str = "",
                 kappa: Sequence[float] = ()) -> PlannerConfig:
        """Return settings with what a request asks for; zeros and what is empty keep what is there.

        Args:
            waypoints: Number of way-points.
            time_budget: Longest wall-clock time [s].
            jerk_limit: Largest jerk of a joint [rad/s^3].
            goal: How the task's goal is fixed.
            kappa: Weight of the disagreement, one number [1].

        Raises:
            ConfigError: A value that cannot be used.
        """
        return replace(self, waypoints=waypoints or self.waypoints, time_budget=time_budget or self.time_budget,
                       jerk_limit=jerk_limit or self.jerk_limit, goal=cast(GoalKind, goal or self.goal),
                       kappa=kappa[0] if len(kappa) else self.kappa)
