"""`unifeed bench planner`: how fast and how good plans are, beside SciPy's SLSQP on the very same problems."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.planner_problem import measure_peers, measure_problem
from unifeed_ros.cli.planner_table import describe, summarise
from unifeed_ros.core.planning.check import TOLERANCE
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.planning_problems import (
    ZONES,
    PlanningPair,
    random_pairs,
    taught_reward,
    with_tool_limits,
)

ROBOTS, TASKS, WAYPOINTS = ("panda", "ur10"), ("table", "laptop", "cup"), (20, 40)
SETTINGS = ("zones", "places", "limits", "starts", "peer_limit")
"""Options that change what is measured of a problem; a file of results holds one choice of them."""


def run(options: argparse.Namespace) -> int:
    """Measure every robot, task and number of way-points, and print a table.

    Returns:
        0 if nothing touches anything, no limit is exceeded and, where places are not random, all are solved.
    """
    if min(options.pairs, options.starts) < 1 or min(options.action, options.peer_pairs, options.fd_pairs) < 0:
        raise UserMistake("bench planner", expected="--pairs and --starts 1 or more, no negative numbers")
    if options.action:
        from unifeed_ros.cli.planner_action import run_action

        return run_action(options)
    results = Results(options)
    rows = []
    for name, task in itertools.product(options.robot or ROBOTS, options.task or TASKS):
        case = _Case(options, name, task)
        for count in options.waypoints or WAYPOINTS:
            summary, details = summarise([results.get(case, count, k) for k in range(options.pairs)])
            rows.append(({"robot": name, "task": task, "waypoints": count}, summary, details))
            print(_line(*rows[-1]), file=sys.stderr, flush=True)
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, "clock": "processor time of one thread",
             **{name: getattr(options, name) for name in SETTINGS},
             "summary": [{**where, **summary} for where, summary, _ in rows],
             "details": [{**where, **details} for where, _, details in rows]}
    print(json.dumps(table, indent=2) if options.json else "\n".join(_line(*row) for row in rows))
    return 0 if all((s["solved"] == s["problems"] or options.places) and not d["touching"]
                    and s["worst_violation"] <= TOLERANCE for _, s, d in rows) else 1


def _line(where: dict[str, Any], summary: dict[str, Any], details: dict[str, Any]) -> str:
    return describe(" ".join(map(str, where.values())), summary, details)


class _Case:
    """A robot and a task: its learned reward and its random problems, made when the first one is asked for."""

    def __init__(self, options: argparse.Namespace, name: str, task: str) -> None:
        self.options, self.name, self.task = options, name, task
        self._pairs: list[PlanningPair] = []

    @cached_property
    def robot(self) -> RobotModel:
        return RobotModel(load_robot(config_path("robots", self.name)))

    @cached_property
    def model(self) -> RewardEnsemble:
        return taught_reward(self.robot, load_scene(config_path("tasks", self.task)))

    @cached_property
    def _drawn(self) -> Iterator[PlanningPair]:
        scene = load_scene(config_path("tasks", self.task))
        if self.options.limits:
            scene = with_tool_limits(scene)
        if self.options.zones:
            scene = replace(scene, zones={**scene.zones, **ZONES})
        return random_pairs(self.robot, scene, PlannerConfig(), places=self.options.places)

    def pair(self, k: int) -> PlanningPair:
        """Give random problem k."""
        self._pairs += itertools.islice(self._drawn, max(0, k + 1 - len(self._pairs)))
        return self._pairs[k]


class Results:
    """Figures of single problems, and the file that keeps them, one JSON line each, so that a run can be resumed.

    Args:
        options: Options of the benchmark; those in SETTINGS are the file's first line.

    Raises:
        UserMistake: The file is of a run with other settings, or cannot be read.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options, self._file = options, options.results
        self._known: dict[str, dict[str, Any]] = {}
        if self._file is None:
            return
        settings = {name: getattr(options, name) for name in SETTINGS}
        try:
            lines = [json.loads(line) for line in _whole_lines(self._file)]
            then = lines[0] if lines else settings
            self._known = {line.pop("problem"): line for line in lines[1:]}
        except (OSError, ValueError, KeyError) as error:
            raise UserMistake(f"results {self._file} cannot be read", got=repr(error),
                              mend="give another file with --results") from error
        if then != settings:
            raise UserMistake(f"results {self._file} are of a run with other options", expected=settings, got=then,
                              mend="give another file with --results")
        if not lines:
            self._add(settings)

    def get(self, case: _Case, count: int, k: int) -> dict[str, Any]:
        """Give the figures of one problem, measuring what is not known yet."""
        options, key = self._options, f"{case.name} {case.task} {count} {k}"
        figures = self._known.setdefault(key, {})
        config = PlannerConfig(waypoints=count, time_budget=60.0)
        if "seconds" not in figures:
            figures |= measure_problem(case.robot, case.model, case.pair(k), config, starts=options.starts)
            self._add({"problem": key, **figures})
        rough = k < options.fd_pairs
        if k < options.peer_pairs and ("exact" not in figures or (rough and "fd" not in figures)):
            figures |= measure_peers(case.robot, case.model, case.pair(k), config, limit=options.peer_limit,
                                     rough=rough)
            self._add({"problem": key, **figures})
        return figures

    def _add(self, line: dict[str, Any]) -> None:
        if self._file is not None:
            with self._file.open("a") as file:
                file.write(json.dumps(line) + "\n")


def _whole_lines(file: Path) -> list[str]:
    """Read a file's lines, and cut off a last one that an interruption left incomplete."""
    text = file.read_text() if file.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.write_text(whole)
    return whole.splitlines()
