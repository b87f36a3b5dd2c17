"""One problem of `unifeed bench planner`: what the planner and its peers make of it, as figures that JSON can hold."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from unifeed_ros.baselines.slsqp import solve_with_slsqp
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import Plan, plan_motion
from unifeed_ros.core.planning.problem import PlanningProblem, StateReward
from unifeed_ros.core.planning.qp import SOLVERS
from unifeed_ros.core.planning.starts import straight_line
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.simulation.dense_check import dense_excess
from unifeed_ros.simulation.planning_problems import PlanningPair
from unifeed_ros.simulation.touching import MeshScene

CANCELS = (0.3, 0.7)
"""Shares of a plan's time after which it is asked to stop [1]."""


def measure_problem(robot: RobotModel, model: RewardEnsemble, pair: PlanningPair, config: PlannerConfig, *,
                    starts: int = 1) -> dict[str, Any]:
    """Plan once with the chosen solver, check the motion apart from the planner, and cancel it at two moments.

    Args:
        robot: The arm.
        model: A learned reward.
        pair: Start and goal.
        config: Settings of the planner.
        starts: Where more than 1, plans from as many are measured too, with halving and with all searched to their end.

    Returns:
        Figures by name, times of the processor [s].
    """
    reward = model.bind(pair.scene.context())
    plan, seconds = _timed(robot, reward, pair, config)
    problem = _problem(robot, reward, pair, config)
    figures: dict[str, Any] = {
        "seconds": seconds, "solved": plan.success, "message": plan.message, "iterations": plan.iterations,
        "floor": _evaluation_time(problem, plan) * plan.iterations, "first": _number(plan.first_feasible),
        "first_share": _number(plan.first_feasible / plan.seconds),
        "excess": dense_excess(robot, pair.scene, plan.waypoints, plan.trajectory.duration) if plan.success else {},
        "touching": MeshScene(robot, pair.scene).touching(plan.trajectory.positions)
        if plan.success and pair.scene.zones else 0,
        "cancel": _cancel_time(robot, reward, pair, config, seconds)}
    for name, halving in (("halved", config.halving), ("full", 0)) if starts > 1 else ():
        other, longer = _timed(robot, reward, pair, replace(config, starts=starts, halving=halving))
        figures[f"{name}_share"] = longer / seconds
        figures[f"{name}_gain"] = (other.objective - plan.objective) / abs(plan.objective)
    return figures


def measure_peers(robot: RobotModel, model: RewardEnsemble, pair: PlanningPair, config: PlannerConfig, *,
                  limit: float, rough: bool) -> dict[str, Any]:
    """Let the other solvers, and SLSQP, solve a problem that the planner solves too.

    Args:
        robot: The arm.
        model: A learned reward.
        pair: Start and goal.
        config: Settings of the planner.
        limit: Processor time after which SLSQP is ended [s].
        rough: True: SLSQP with finite differences too, which takes longest.

    Returns:
        Figures by name: seconds with each solver, and for "exact" and "fd" seconds, whether it converged, and how much
        lower the planner's objective is as a share of SLSQP's, negative where it is higher.
    """
    reward = model.bind(pair.scene.context())
    problem = _problem(robot, reward, pair, config)
    slow = pair.scene.tool_speed > 0 or any(zone.speed > 0 for zone in pair.scene.zones.values())
    plans = {solver: _timed(robot, reward, pair, replace(config, qp_solver=solver)) for solver in SOLVERS
             if not (slow and solver == "own")}  # it knows no limits of the tool's speed
    figures: dict[str, Any] = {f"{solver}_s": seconds for solver, (_, seconds) in plans.items()}
    ours = problem.evaluate(plans[config.qp_solver][0].waypoints).cost
    for name in ("exact", "fd") if rough else ("exact",):
        peer = solve_with_slsqp(problem, straight_line(problem), exact=name == "exact", limit=limit)
        theirs = problem.evaluate(peer.waypoints).cost
        figures[name] = {"seconds": peer.seconds, "converged": peer.converged, "gap": (ours - theirs) / abs(theirs)}
    return figures


def _timed(robot: RobotModel, reward: StateReward, pair: PlanningPair, config: PlannerConfig) -> tuple[Plan, float]:
    """Plan, and measure the processor time [s]."""
    began = time.thread_time()
    plan = plan_motion(robot, reward, pair.start, pair.goal, duration=pair.scene.duration, scene=pair.scene,
                       config=config)
    return plan, time.thread_time() - began


def _problem(robot: RobotModel, reward: StateReward, pair: PlanningPair, config: PlannerConfig) -> PlanningProblem:
    bounds = motion_bounds(robot, pair.scene, pair.start, pair.goal, config)
    return PlanningProblem(robot, reward, pair.start, pair.goal, pair.scene.duration, bounds, config)


def _cancel_time(robot: RobotModel, reward: StateReward, pair: PlanningPair, config: PlannerConfig,
                 seconds: float) -> float | None:
    """Measure the longest time from asking a plan to stop until it has [s]; None: it had always ended by then."""
    late = []
    for share in CANCELS:
        asked = time.thread_time() + share * seconds
        plan = plan_motion(robot, reward, pair.start, pair.goal, duration=pair.scene.duration, scene=pair.scene,
                           config=config, should_stop=lambda asked=asked: time.thread_time() >= asked)
        if plan.status == "canceled":
            late.append(time.thread_time() - asked)
    return max(late, default=None)


def _evaluation_time(problem: PlanningProblem, plan: Plan) -> float:
    """Measure one evaluation of network and kinematics with gradients at all way-points [s]."""
    times = []
    for _ in range(10):
        began = time.thread_time()
        pose = problem.bounds.kinematics.evaluate(plan.waypoints)
        problem.reward.value_and_gradient(pose.states)
        times.append(time.thread_time() - began)
    return float(np.median(times))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
