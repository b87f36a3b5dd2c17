"""`unifeed bench reward`: training the reward beside the paper's procedure, as a table or JSON."""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.experiments.reward_bench import bench_reward
from unifeed_ros.resources import config_path

TASKS = ("table", "laptop")
"""Tasks that the quality is judged on; times are of the first."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the table."""
    figures = measure_reward(options)
    print(json.dumps(figures, indent=2) if options.json else reward_table(figures))
    return 0


def measure_reward(options: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark, telling progress on stderr.

    Args:
        options: Parsed command line.

    Returns:
        The figures, for JSON or reward_table.

    Raises:
        UserMistake: A count that measures nothing.
    """
    for name, least in (("people", 1), ("repeats", 1)):
        if getattr(options, name) < least:
            raise UserMistake(f"--{name}", expected=f"at least {least}", got=getattr(options, name))
    if min(options.horizons) < 5:
        raise UserMistake("--horizons", expected="at least 5 way-points", got=min(options.horizons))
    figures = bench_reward(
        RobotModel(load_robot(config_path("robots", "panda"))), [load_scene(config_path("tasks", t)) for t in TASKS],
        horizons=options.horizons, people=options.people, repeats=options.repeats,
        on_row=lambda row: print(row, file=sys.stderr, flush=True))
    return {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, **figures}


def reward_table(figures: dict[str, Any]) -> str:
    """Write the summary as a Markdown table, one column a horizon."""
    summary = figures["summary"]
    names = next(iter(summary.values()))
    lines = ["| | " + " | ".join(f"H = {horizon}" for horizon in summary) + " |", "| --- " * (len(summary) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(_cell(column[name]) for column in summary.values()) + " |" for name in names]
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
