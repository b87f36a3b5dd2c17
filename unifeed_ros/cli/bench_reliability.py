"""`unifeed bench reliability`: regret with and without the reliability of each kind of feedback."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.experiments.biased_people import PEOPLE
from unifeed_ros.experiments.reliability_bench import bench_reliability
from unifeed_ros.resources import config_path

TASKS = ("table", "cup")
"""Tasks in which it matters where a motion ends. In Laptop it hardly does: the goal lies beside the laptop."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the table."""
    figures = measure_reliability(options)
    print(json.dumps(figures, indent=2) if options.json else reliability_table(figures))
    return 0


def measure_reliability(options: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark, telling progress on stderr.

    Args:
        options: Parsed command line.

    Returns:
        The figures, for JSON or reliability_table.

    Raises:
        UserMistake: No seeds, or people that are not known.
    """
    if options.seeds < 1:
        raise UserMistake("--seeds", expected="at least 1", got=options.seeds)
    people = options.people or list(PEOPLE)
    if unknown := set(people) - set(PEOPLE):
        raise UserMistake("--people", expected=", ".join(PEOPLE), got=", ".join(sorted(unknown)))
    return bench_reliability(
        RobotModel(load_robot(config_path("robots", "panda"))),
        [load_scene(config_path("tasks", task)) for task in options.task or TASKS],
        people=people, seeds=options.seeds, on_row=lambda row: print(row, file=sys.stderr, flush=True))


def reliability_table(figures: dict[str, Any]) -> str:
    """Write the summary as a Markdown table, one row for each task and kind of people."""
    lines = ["| task: people | median regret, weighted | unweighted | ratio | p (weighted worse) | D | C | P |",
             "| --- " * 8 + "|"]
    for name, row in figures["summary"].items():
        p = "-" if row["worse_p"] is None else f"{row['worse_p']:.2g}"
        lines.append(f"| {name} | {row['weighted']:.3f} | {row['unweighted']:.3f} | {row['ratio']:.2f} | {p} | "
                     + " | ".join(f"{row[letter]:.2f}" for letter in "DCP") + " |")
    return "\n".join(lines)
