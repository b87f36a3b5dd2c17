"""`unifeed bench lesson`: whole lessons, and how far their last motion is from the best one."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from unifeed_ros.cli.arguments import UserMistake, domain, prepare_folder
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.lesson import run_lesson


def run(options: argparse.Namespace) -> int:
    """Run the lessons one after the other, print the table and keep it in a file; 0 only if all were completed."""
    out = prepare_folder(options.out or Path("out") / time.strftime("bench-%Y%m%d-%H%M%S"))
    lessons = _chosen(options)
    rows = []
    for k, (robot, task, seed) in enumerate(lessons):
        rows.append(_in_process(robot, task, seed) if options.in_process
                    else _run_lesson(robot, task, seed, out, options.speed))
        print(f"{k + 1}/{len(lessons)} {_line(rows[-1])}", file=sys.stderr, flush=True)
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0], "speed": options.speed}, "lessons": rows,
             "summary": [_summary(rows, robot) for robot in dict.fromkeys(row["robot"] for row in rows)]}
    (out / "lessons.json").write_text(json.dumps(table, indent=2) + "\n")
    print(json.dumps(table, indent=2) if options.json else markdown(table))
    return 0 if all(row["ok"] for row in rows) else 1


def markdown(table: dict[str, Any]) -> str:
    """Write the summary as a Markdown table."""
    lines = [
        "| robot | task | lessons | ok | median after first input | median final | 90th percentile | worst | better "
        "than first | median time [s] |",
        "| --- " * 10 + "|",
    ]
    for s in table["summary"]:
        lines.append(f"| {s['robot']} | {s['task']} | {s['lessons']} | {s['ok']} | {s['first_median']:.3f} | "
                     f"{s['final_median']:.3f} | {s['final_p90']:.3f} | {s['final_worst']:.3f} | "
                     f"{s['improved']}/{s['lessons']} | {s['seconds_median']:.0f} |")
    return "\n".join(lines)


def _chosen(options: argparse.Namespace) -> list[tuple[str, str, int]]:
    robots = options.robot or ["panda", "ur10"]
    counts = {"panda": 10, "ur10": 5}
    if unknown := sorted(set(robots) - set(counts)):
        raise UserMistake("unknown robot", expected="panda or ur10", got=", ".join(unknown))
    return [(r, options.task, seed) for r in robots for seed in range(options.seeds or counts[r])]


def _run_lesson(robot: str, task: str, seed: int, out: Path, speed: float) -> dict[str, Any]:
    """Run one demo in a process of its own, on a domain of its own, and read its report."""
    folder = out / f"{robot}-{task}-{seed}"
    environment = dict(os.environ, ROS_DOMAIN_ID=os.environ.get("ROS_DOMAIN_ID", "71"))
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "unifeed_ros.cli.main", "demo", "--robot", robot, "--task", task, "--seed", str(seed),
         "--speed", str(speed), "--out", str(folder)], env=environment, capture_output=True, text=True, check=False)
    row: dict[str, Any] = {"robot": robot, "task": task, "seed": seed, "ok": done.returncode == 0,
                           "seconds": time.monotonic() - began, "first": np.nan, "final": np.nan, "message": ""}
    report = folder / "report.json"
    if report.is_file():
        figures = json.loads(report.read_text())
        regrets = [i["normalised_regret"] for i in figures["interactions"]]
        if regrets:
            row.update(first=regrets[0], final=regrets[-1], regrets=regrets)
        row["message"], row["dropped"], row["loop"] = (
            figures["message"],
            figures["recording"]["dropped"],
            figures["loop"],
        )
    if not row["ok"]:
        row["message"] = row["message"] or (done.stderr.strip().splitlines() or [f"on domain {domain()}"])[-1]
    return row


def _in_process(robot: str, task: str, seed: int) -> dict[str, Any]:
    """Run one lesson without ROS: the nodes' core code, the same simulated arm and person."""
    began = time.monotonic()
    row: dict[str, Any] = {"robot": robot, "task": task, "seed": seed, "ok": False, "first": np.nan, "final": np.nan,
                           "message": ""}
    try:
        result = run_lesson(RobotModel(load_robot(config_path("robots", robot))),
                            load_scene(config_path("tasks", task)), seed=seed)
        regrets = [step.normalised_regret for step in result.interactions]
        row.update(ok=True, first=regrets[0], final=regrets[-1], regrets=regrets)
    except UnifeedError as error:
        row["message"] = str(error)
    return {**row, "seconds": time.monotonic() - began}


def _line(row: dict[str, Any]) -> str:
    return (f"{row['robot']} {row['task']} seed {row['seed']}: {'ok' if row['ok'] else 'FAILED ' + row['message']}, "
            f"normalised regret {row['first']:.3f} -> {row['final']:.3f}, {row['seconds']:.0f} s")


def _summary(rows: list[dict[str, Any]], robot: str) -> dict[str, Any]:
    chosen = [row for row in rows if row["robot"] == robot]
    first = np.array([row["first"] for row in chosen], dtype=float)
    final = np.array([row["final"] for row in chosen], dtype=float)
    return {
        "robot": robot, "task": chosen[0]["task"], "lessons": len(chosen), "ok": sum(row["ok"] for row in chosen),
        "first_median": float(np.median(first)), "final_median": float(np.median(final)),
        "final_p90": float(np.percentile(final, 90)), "final_worst": float(final.max()),
        "improved": int((final < first).sum()), "seconds_median": float(np.median([row["seconds"] for row in chosen])),
    }
