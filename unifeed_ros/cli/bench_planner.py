"""`unifeed bench planner`: how fast and how good plans are, beside SciPy's SLSQP on the very same problems."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from unifeed_ros.baselines.slsqp import SlsqpResult, solve_with_slsqp
from unifeed_ros.core.planning.check import TOLERANCE, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import Plan, plan_motion
from unifeed_ros.core.planning.problem import PlanningProblem, StateReward
from unifeed_ros.core.planning.qp import SOLVERS
from unifeed_ros.core.planning.starts import straight_line
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene, load_scene
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.core.zones import Zone
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.planning_problems import PlanningPair, random_pairs, taught_reward
from unifeed_ros.simulation.touching import MeshScene

ZONES = {"laptop": Zone(shape="box", position=np.array([0.45, -0.05, 0.12]), size=np.array([0.3, 0.2, 0.24])),
         "person": Zone(shape="capsule", position=np.array([0.8, 0.25, 0.6]), size=np.array([0.15, 1.2]))}
"""Beside and on the way of the tasks' motions."""
ROBOTS, TASKS, WAYPOINTS = ("panda", "ur10"), ("table", "laptop", "cup"), (20, 40)


def run(options: argparse.Namespace) -> int:
    """Measure every robot, task and number of way-points, and print a table; 0 if all are solved and touch nothing."""
    rows = []
    for name, task in itertools.product(options.robot or ROBOTS, [options.task] if options.task else TASKS):
        robot, scene = RobotModel(load_robot(config_path("robots", name))), load_scene(config_path("tasks", task))
        model = taught_reward(robot, scene)
        scene = replace(scene, zones=ZONES if options.zones else {})
        pairs = list(itertools.islice(random_pairs(robot, scene, PlannerConfig()), options.pairs))
        for count in WAYPOINTS:
            problems = [_measure(robot, model, pair, PlannerConfig(waypoints=count, time_budget=60.0),
                                 options.peer_limit if k < options.peer_pairs else 0.0, rough=k < options.fd_pairs,
                                 starts=options.starts)
                        for k, pair in enumerate(pairs)]
            rows.append({"robot": name, "task": task, "waypoints": count, **_summary(problems)})
            print(_line(rows[-1]), file=sys.stderr, flush=True)
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, "clock": "processor time of one thread",
             "peer_limit_s": options.peer_limit, "summary": rows}
    print(json.dumps(table, indent=2) if options.json else "\n".join(_line(row) for row in rows))
    return 0 if all(row["solved"] == row["problems"] and not row["touching"] and row["worst_violation"] <= TOLERANCE
                    for row in rows) else 1


def _measure(robot: RobotModel, model: RewardEnsemble, pair: PlanningPair, config: PlannerConfig,
             peer_limit: float, *, rough: bool, starts: int = 1) -> dict[str, Any]:
    """Solve one problem with each solver, and by the peers too where they have a time limit.

    Args:
        robot: The arm.
        model: A learned reward.
        pair: Start and goal.
        config: Settings of the planner.
        peer_limit: Processor time after which SLSQP is ended; 0: neither it nor the other solvers are measured [s].
        rough: True: SLSQP is measured with finite differences too.
        starts: Where more than 1, plans from as many are measured too, with halving and with all searched to their end.
    """
    reward = model.bind(pair.scene.context())
    bounds = motion_bounds(robot, pair.scene, pair.start, pair.goal, config)
    problem = PlanningProblem(robot, reward, pair.start, pair.goal, pair.scene.duration, bounds, config)
    figures: dict[str, Any] = {}
    for solver in SOLVERS:
        if solver != config.qp_solver and not peer_limit:
            continue
        began = time.thread_time()
        plan = plan_motion(robot, reward, pair.start, pair.goal, duration=pair.scene.duration, scene=pair.scene,
                           config=replace(config, qp_solver=solver))
        figures[f"{solver}_s"] = time.thread_time() - began
        if solver == config.qp_solver:
            chosen = plan
    figures.update(seconds=figures[f"{config.qp_solver}_s"], solved=chosen.success,
                   floor=_evaluation_time(problem, chosen) * chosen.iterations,
                   violation=_violation(robot, pair.scene, problem, chosen.trajectory, chosen.waypoints)
                   if chosen.success else 0.0, first=chosen.first_feasible,
                   first_share=chosen.first_feasible / chosen.seconds, message=chosen.message,
                   cancel=_cancel_time(robot, reward, pair, config, figures[f"{config.qp_solver}_s"]),
                   touching=MeshScene(robot, pair.scene).touching(chosen.trajectory.positions)
                   if chosen.success and pair.scene.zones else 0)
    for name, halving in (("halved", config.halving), ("full", 0)) if starts > 1 else ():
        began = time.thread_time()
        plan = plan_motion(robot, reward, pair.start, pair.goal, duration=pair.scene.duration, scene=pair.scene,
                           config=replace(config, starts=starts, halving=halving))
        figures[f"{name}_share"] = (time.thread_time() - began) / figures["seconds"]
        figures[f"{name}_gain"] = (plan.objective - chosen.objective) / abs(chosen.objective)
    if peer_limit:
        exact = solve_with_slsqp(problem, straight_line(problem), exact=True, limit=peer_limit)
        figures.update(exact=exact, gap=_gap(problem, chosen, exact))
        if rough:
            figures["fd"] = solve_with_slsqp(problem, straight_line(problem), exact=False, limit=peer_limit)
    return figures


def _cancel_time(robot: RobotModel, reward: StateReward, pair: PlanningPair, config: PlannerConfig,
                 seconds: float) -> float:
    """Measure the longest time from asking a plan to stop until it has, asked at four moments of its search [s]."""
    late = []
    for share in (0.2, 0.4, 0.6, 0.8):
        asked = time.thread_time() + share * seconds
        plan = plan_motion(robot, reward, pair.start, pair.goal, duration=pair.scene.duration, scene=pair.scene,
                           config=config, should_stop=lambda asked=asked: time.thread_time() >= asked)
        if plan.status == "canceled":
            late.append(time.thread_time() - asked)
    return max(late, default=np.nan)


def _gap(problem: PlanningProblem, plan: Plan, peer: SlsqpResult) -> float:
    """Compute how much lower the objective of a plan is than the peer's, as a share of it; negative: higher."""
    ours, theirs = (problem.evaluate(w).cost for w in (plan.waypoints, peer.waypoints))
    return (ours - theirs) / abs(theirs)


def _evaluation_time(problem: PlanningProblem, plan: Plan) -> float:
    """Measure one evaluation of network and kinematics with gradients at all way-points [s]."""
    times = []
    for _ in range(10):
        began = time.thread_time()
        pose = problem.bounds.kinematics.evaluate(plan.waypoints)
        problem.reward.value_and_gradient(pose.states)
        times.append(time.thread_time() - began)
    return float(np.median(times))


def _violation(robot: RobotModel, scene: Scene, problem: PlanningProblem, motion: Trajectory,
               waypoints: Array) -> float:
    """Check a motion at 1 kHz, apart from the planner's own check: largest excess over any limit [rad, 1, 1, m]."""
    duration, bounds = motion.duration, problem.bounds
    spline = CubicSpline(np.linspace(0.0, duration, len(waypoints)), waypoints, bc_type="clamped")
    times = np.linspace(0.0, duration, int(1000 * duration) + 1)
    q: Array = spline(times)
    heights = robot.tool_states(q)[:, 2]
    return max(0.0, float(np.maximum(bounds.lower - q, q - bounds.upper).max()),
               float((np.abs(spline(times, 1)) / bounds.velocity).max() - 1.0),
               float((np.abs(spline(times, 2)) / bounds.acceleration).max() - 1.0),
               float(min(scene.floor, heights[0], heights[-1]) - heights.min()))


def _summary(problems: list[dict[str, Any]]) -> dict[str, Any]:
    seconds = np.array([p["seconds"] for p in problems])
    median = float(np.median(seconds))
    summary: dict[str, Any] = {"median_s": median, "p95_s": float(np.percentile(seconds, 95))}
    for solver in SOLVERS:
        summary[f"{solver}_s"] = _median([p[f"{solver}_s"] for p in problems if f"{solver}_s" in p])
    for name in ("fd", "exact"):
        peers = [p for p in problems if name in p]
        summary[f"{name}_problems"] = len(peers)
        summary[f"slsqp_{name}_s"] = _median([p[name].seconds for p in peers])
        summary[f"slsqp_{name}_converged"] = sum(p[name].converged for p in peers)
        beside = [p[name].seconds / p["seconds"] for p in peers]
        summary[f"ratio_{name}"] = _median(beside)
    for figure in ("halved_share", "halved_gain", "full_share", "full_gain"):
        summary[figure] = _median([p[figure] for p in problems if figure in p])
    gaps = [p["gap"] for p in problems if "gap" in p]
    return {**summary, "floor_s": _median([p["floor"] for p in problems]),
            "first_feasible_s": _median([p["first"] for p in problems if np.isfinite(p["first"])]),
            "first_feasible_share": _median([p["first_share"] for p in problems if np.isfinite(p["first_share"])]),
            "cancel_worst_s": _worst([p["cancel"] for p in problems if np.isfinite(p["cancel"])]),
            "touching": sum(p["touching"] > 0 for p in problems),
            "failures": [p["message"] for p in problems if not p["solved"]],
            "worst_violation": max(p["violation"] for p in problems),
            "objective_gap_p95": float(np.percentile(gaps, 95)) if gaps else None,
            "objective_gap_worst": max(gaps, default=None),
            "solved": sum(p["solved"] for p in problems), "problems": len(problems)}


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _worst(values: list[float]) -> float | None:
    return max(values, default=None)


def _line(row: dict[str, Any]) -> str:
    line = (f"{row['robot']} {row['task']} {row['waypoints']}: median {row['median_s']:.3f} s, p95 {row['p95_s']:.3f} s"
            f" (floor {row['floor_s']:.3f} s), solved {row['solved']}/{row['problems']}, worst violation "
            f"{row['worst_violation']:.1e}, touching {row['touching']}, canceled within "
            f"{row['cancel_worst_s'] or np.nan:.3f} s, first feasible {row['first_feasible_s'] or np.nan:.4f} s, "
            f"{row['first_feasible_share'] or np.nan:.0%} of all")
    if row["halved_share"] is not None:
        line += "; more starts " + ", ".join(
            f"{name} x{row[f'{name}_share']:.2f} of the time, objective {row[f'{name}_gain']:+.3%}"
            for name in ("halved", "full"))
    if not row["exact_problems"]:
        return line
    solvers = ", ".join(f"{solver} {row[f'{solver}_s']:.3f} s" for solver in SOLVERS)
    peers = ", ".join(
        f"{name} {row[f'slsqp_{name}_s']:.1f} s (x{row[f'ratio_{name}']:.0f}, converged "
        f"{row[f'slsqp_{name}_converged']}/{row[f'{name}_problems']})"
        for name in ("fd", "exact") if row[f"{name}_problems"])
    return (f"{line}; {solvers}; SLSQP {peers}; gap p95 {row['objective_gap_p95']:+.4f}, worst "
            f"{row['objective_gap_worst']:+.4f}")
