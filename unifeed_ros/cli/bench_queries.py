"""`unifeed bench queries`: how many questions a reward takes, chosen ones beside random ones."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.experiments.query_bench import QueryBench, bench_queries
from unifeed_ros.resources import config_path


def run(options: argparse.Namespace) -> int:
    """Measure and print the curves."""
    figures = measure_queries(options)
    print(json.dumps(figures, indent=2) if options.json else query_table(figures))
    return 0


def measure_queries(options: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark, telling progress on stderr.

    Args:
        options: Parsed command line.

    Returns:
        The figures, for JSON or query_table.

    Raises:
        UserMistake: A count that measures nothing.
    """
    for name in ("people", "questions"):
        if getattr(options, name) < 1:
            raise UserMistake(f"--{name}", expected="at least 1", got=getattr(options, name))
    bench = QueryBench(people=options.people, questions=options.questions, demonstrated=options.demonstrated)
    return bench_queries(RobotModel(load_robot(config_path("robots", "panda"))), bench,
                         on_row=lambda row: print(row, file=sys.stderr, flush=True))


def query_table(figures: dict[str, Any]) -> str:
    """Write the median curves as a Markdown table, one row a question, and what they come to."""
    summary = figures["summary"]
    rows = zip(summary["active"], summary["passive"], summary["matched"], strict=True)
    lines = ["| answers | active | passive | active questions for that of passive |", "| --- | --- | --- | --- |"]
    lines += [f"| {k} | {active:.3f} | {passive:.3f} | {matched or '-'} |"
              for k, (active, passive, matched) in enumerate(rows, start=1)]
    return "\n".join([*lines, "", f"ratio {summary['ratio']}, of the best of passive {summary['best_ratio']}"])
