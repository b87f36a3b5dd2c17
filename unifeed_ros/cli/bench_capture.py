"""`unifeed bench capture`: segmentation of simulated pushes whose truth is known."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.core.capture.external_torque import FIELD, SOURCES
from unifeed_ros.core.robot import load_robot
from unifeed_ros.experiments.capture_bench import bench_capture
from unifeed_ros.resources import config_path

MEASURED = tuple(source for source in SOURCES if source != FIELD)
"""Sources that differ: a field of a message carries the same numbers as a joint state."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the tables."""
    figures = measure_capture(options)
    print(json.dumps(figures, indent=2) if options.json else capture_tables(figures))
    return 0


def measure_capture(options: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark, telling progress on stderr.

    Args:
        options: Parsed command line.

    Returns:
        The figures, for JSON or capture_tables.

    Raises:
        UserMistake: A number that nothing can be measured with, or an unknown source.
    """
    if min(options.pushes, options.hits) < 0 or options.minutes < 0.0 or options.jobs < 1:
        raise UserMistake("--pushes, --minutes, --hits, --jobs", expected="none negative, at least 1 job",
                          got=f"{options.pushes}, {options.minutes}, {options.hits}, {options.jobs}")
    if options.source not in MEASURED:
        raise UserMistake("--source", expected=", ".join(MEASURED), got=options.source)
    return bench_capture(
        load_robot(config_path("robots", options.robot)), pushes=options.pushes, minutes=options.minutes,
        hits=options.hits, source=options.source, seed=options.seed, jobs=options.jobs,
        on_session=lambda line: print(line, file=sys.stderr, flush=True))


def capture_tables(figures: dict[str, Any]) -> str:
    """Write the figures as two Markdown tables."""
    lines = ["| figure | value |", "| --- | --- |"]
    lines += [f"| {name.replace('_', ' ')} | {_number(value)} |" for name, value in figures["summary"].items()]
    lines += ["", "| force | pushes | found | onset within 50 ms | release within 50 ms | in pieces |",
              "| --- " * 6 + "|"]
    for row in figures["by_force"]:
        low, high = row["force_N"]
        lines.append(f"| {low:.0f} to {high:.0f} N | " + " | ".join(_number(row[key]) for key in (
            "pushes", "found", "onset_within_50ms", "release_within_50ms", "in_pieces")) + " |")
    return "\n".join(lines)


def _number(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)
