"""`unifeed bench context`: taught at two goals, tested at new goals and object places, as a table or JSON."""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

from unifeed_ros.cli.arguments import UserMistake, require_letters
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.experiments.context_bench import bench_context
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.tasks import LAPTOP_RADIUS, PERSON_RADIUS, TASKS

FEATURES = {"table": "height(0.0)", "laptop": f"near_xy(laptop, {LAPTOP_RADIUS})", "cup": "tilt",
            "proximity": f"near_xy(person, {PERSON_RADIUS})"}
"""What matters in each task besides the distance to the goal."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the table."""
    figures = measure_context(options)
    print(json.dumps(figures, indent=2) if options.json else context_table(figures))
    return 0


def measure_context(options: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark, telling progress on stderr.

    Args:
        options: Parsed command line.

    Returns:
        The figures, for JSON or context_table.

    Raises:
        UserMistake: A count that measures nothing, or another letter, robot or task.
    """
    for name in ("people", "goals"):
        if getattr(options, name) < 1:
            raise UserMistake(f"--{name}", expected="at least 1", got=getattr(options, name))
    letters, tasks = require_letters(options.feedback), options.task or list(TASKS)
    if unknown := sorted(set(tasks) - set(TASKS)):
        raise UserMistake("--task", expected=", ".join(TASKS), got=", ".join(unknown))
    trainings = {
        "from scratch": lambda task: TrainingConfig(),
        "distance to the goal given": lambda task: TrainingConfig(features=["distance(goal)"]),
        "all features given": lambda task: TrainingConfig(features=["distance(goal)", FEATURES[task]])}
    figures = bench_context(
        RobotModel(load_robot(config_path("robots", options.robot))),
        [load_scene(config_path("tasks", task)) for task in tasks], trainings, people=options.people,
        letters=letters, goals=options.goals, on_row=lambda row: print(row, file=sys.stderr, flush=True))
    return {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, **figures}


def context_table(figures: dict[str, Any]) -> str:
    """Write the summary as a Markdown table: normalised regret by way of learning and task."""
    lines = ["| learned | task | motions | median | 90th percentile | worst | median where taught |",
             "| --- " * 7 + "|"]
    lines += [f"| {way} | {task} | {f['motions']} | {f['median']:.3f} | {f['p90']:.3f} | {f['worst']:.3f} | "
              f"{f['taught_median']:.3f} |" for way, tasks in figures["summary"].items() for task, f in tasks.items()]
    return "\n".join(lines)
