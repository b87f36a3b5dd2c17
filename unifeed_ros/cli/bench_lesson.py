"""`unifeed bench lesson`: whole lessons, and how far their last motion is from the best one."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any

import numpy as np

from unifeed_ros.cli.arguments import UserMistake, prepare_folder, require_letters
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.lesson import run_lesson
from unifeed_ros.simulation.tasks import TASKS


def run(options: argparse.Namespace) -> int:
    """Run the lessons, print the table and keep it in a file; 0 only if all were completed."""
    out = prepare_folder(options.out or Path("out") / time.strftime("bench-%Y%m%d-%H%M%S"))
    lessons = _chosen(options)
    rows: list[dict[str, Any]] = []
    spawn = get_context("spawn")
    domains: Queue[int] = spawn.Queue()
    for job in range(options.jobs):
        domains.put(int(os.environ.get("ROS_DOMAIN_ID", "71")) + job)
    with ProcessPoolExecutor(options.jobs, spawn, _take_domain, (domains,)) as pool:
        work = partial(_in_process, options.feedback) if options.in_process else partial(
            _through_nodes, options.feedback, options.speed, out)
        for done in as_completed([pool.submit(work, *lesson) for lesson in lessons]):
            rows.append(done.result())
            print(f"{len(rows)}/{len(lessons)} {_line(rows[-1])}", file=sys.stderr, flush=True)
    rows.sort(key=lambda row: lessons.index((row["robot"], row["task"], row["seed"])))
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0], "speed": options.speed,
                         "jobs": options.jobs},
             "feedback": options.feedback, "lessons": rows,
             "summary": [_summary([row for row in rows if (row["robot"], row["task"]) == kind])
                         for kind in dict.fromkeys((row["robot"], row["task"]) for row in rows)]}
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
    robots, tasks = options.robot or ["panda", "ur10"], options.task or ["table"]
    counts = {"panda": 10, "ur10": 5}
    if unknown := sorted(set(robots) - set(counts)):
        raise UserMistake("unknown robot", expected="panda or ur10", got=", ".join(unknown))
    if unknown := sorted(set(tasks) - set(TASKS)):
        raise UserMistake("unknown task", expected=", ".join(TASKS), got=", ".join(unknown))
    if options.jobs < 1:
        raise UserMistake("--jobs", expected="1 or more", got=options.jobs)
    require_letters(options.feedback)
    return [(r, t, seed) for r in robots for t in tasks for seed in range(options.seeds or counts[r])]


def _take_domain(domains: Queue[int]) -> None:
    """Keep the lessons of this process apart from those of the others."""
    os.environ["ROS_DOMAIN_ID"] = str(domains.get())


def _through_nodes(feedback: str, speed: float, out: Path, robot: str, task: str, seed: int) -> dict[str, Any]:
    """Run one demo as a user would, and read its report."""
    folder = out / f"{robot}-{task}-{seed}"
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "unifeed_ros.cli.main", "demo", "--robot", robot, "--task", task, "--seed", str(seed),
         "--feedback", feedback, "--speed", str(speed), "--timeout", str(150.0 * len(feedback) / speed),
         "--out", str(folder)], capture_output=True, text=True, check=False)
    row: dict[str, Any] = {"robot": robot, "task": task, "seed": seed, "ok": done.returncode == 0,
                           "seconds": time.monotonic() - began, "first": np.nan, "final": np.nan, "message": ""}
    report = folder / "report.json"
    if report.is_file():
        figures = json.loads(report.read_text())
        regrets = [i["normalised_regret"] for i in figures["interactions"]]
        if regrets:
            row.update(first=regrets[0], final=regrets[-1], regrets=regrets)
        row |= {"message": figures["message"], "dropped": figures["recording"]["dropped"], "loop": figures["loop"]}
    if not row["ok"]:
        row["message"] = row["message"] or (done.stderr.strip().splitlines() or ["no output"])[-1]
    return row


def _in_process(feedback: str, robot: str, task: str, seed: int) -> dict[str, Any]:
    """Run one lesson without ROS: the nodes' core code, the same simulated arm and person."""
    began = time.monotonic()
    row: dict[str, Any] = {"robot": robot, "task": task, "seed": seed, "ok": False, "first": np.nan, "final": np.nan,
                           "message": ""}
    try:
        result = run_lesson(RobotModel(load_robot(config_path("robots", robot))),
                            load_scene(config_path("tasks", task)), feedback=feedback, seed=seed)
        regrets = [step.normalised_regret for step in result.interactions]
        row.update(ok=True, first=regrets[0], final=regrets[-1], regrets=regrets)
    except UnifeedError as error:
        row["message"] = str(error)
    return {**row, "seconds": time.monotonic() - began}


def _line(row: dict[str, Any]) -> str:
    lost = f", {row['dropped']} messages lost" if row.get("dropped") else ""
    return (f"{row['robot']} {row['task']} seed {row['seed']}: {'ok' if row['ok'] else 'FAILED ' + row['message']}, "
            f"normalised regret {row['first']:.3f} -> {row['final']:.3f}, {row['seconds']:.0f} s{lost}")


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Put the lessons of one robot and task together; a lesson that failed counts as not learning."""
    first, final = (np.nan_to_num(np.array([row[when] for row in rows], dtype=float), nan=1.0)
                    for when in ("first", "final"))
    length = max(len(row.get("regrets", [])) for row in rows)
    complete = [row["regrets"] for row in rows if len(row.get("regrets", [])) == length]
    return {
        "robot": rows[0]["robot"], "task": rows[0]["task"], "lessons": len(rows), "ok": sum(row["ok"] for row in rows),
        "first_median": float(np.median(first)), "final_median": float(np.median(final)),
        "final_p90": float(np.percentile(final, 90)), "final_worst": float(final.max()),
        "medians": np.median(complete, axis=0).tolist() if length else [],
        "improved": int((final < first).sum()), "dropped": int(sum(row.get("dropped", 0) for row in rows)),
        "seconds_median": float(np.median([row["seconds"] for row in rows])),
    }
