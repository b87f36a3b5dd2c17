"""`unifeed bench planner --action`: how soon the node answers a cancel, and has a first feasible motion."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import RewardModel
from unifeed_ros.cli.arguments import UserMistake, domain, session_files
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.conversions import model_to_msg
from unifeed_ros.nodes.table import SessionSetup, node_table
from unifeed_ros.nodes.topics import publisher_qos
from unifeed_ros.simulation.planning_problems import taught_reward

READY_S = 60.0
"""Longest time until the node has the reward model, and of one plan [s]."""
WHOLE_PLANS = 5
"""Plans that are not canceled: their median is what the moments are drawn from, and whose shares are printed."""
NODE = "trajectory_optimizer"


def run_action(options: argparse.Namespace) -> int:
    """Start the node, cancel goals at random moments, and print how long that took; 0 if all were answered."""
    robot, task = (options.robot or ["panda"])[0], (options.task or ["table"])[0]
    files = session_files(robot, task)
    model = taught_reward(RobotModel(load_robot(files[0])), load_scene(files[1]))
    specs = [spec for spec in node_table(SessionSetup(parameter_files=files)) if spec.executable == NODE]
    goal = OptimizeTrajectory.Goal(waypoints=(options.waypoints or [40])[0])
    with tempfile.TemporaryDirectory() as folder, SessionMonitor("unifeed_bench") as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        with NodeProcesses(specs, Path(folder)):
            asked = _Goals(monitor, goal)
            asked.teach(model_to_msg(model, 1.0), model.version)
            whole = [asked.plan() for _ in range(WHOLE_PLANS)]
            seconds = float(np.median([took for took, _ in whole]))
            rng, late = np.random.default_rng(0), []
            while len(late) < options.action:
                answered = asked.cancel(rng.uniform(0.0, seconds))
                late += [answered] if answered is not None else []
    row: dict[str, Any] = {
        "robot": robot, "task": task, "waypoints": goal.waypoints, "canceled": len(late), "plan_s": seconds,
        "cancel_median_s": float(np.median(late)), "cancel_p95_s": float(np.percentile(late, 95)),
        "cancel_worst_s": max(late),
        "first_feasible_share": float(np.median([r.first_feasible_s / r.seconds for _, r in whole]))}
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, "clock": "wall clock", "summary": row}
    print(json.dumps(table, indent=2) if options.json else "\n".join(
        f"{name:22} {value:.4f}" if isinstance(value, float) else f"{name:22} {value}" for name, value in row.items()))
    return 0


class _Goals:
    """Sends the same goal again and again."""

    def __init__(self, monitor: SessionMonitor, goal: OptimizeTrajectory.Goal) -> None:
        self._monitor, self._goal = monitor, goal
        self._client = ActionClient(monitor.node, OptimizeTrajectory, "optimize_trajectory")
        self._models = monitor.node.create_publisher(RewardModel, "reward_model", publisher_qos("reward_model"))
        self._wait(self._client.server_is_ready, "the node did not start")

    def teach(self, model: RewardModel, version: int) -> None:
        """Publish a reward model, and wait until plans are made with it."""
        self._models.publish(model)
        self._wait(lambda: self.plan()[1].model_version == version, "the node did not take the reward model")

    def plan(self) -> tuple[float, OptimizeTrajectory.Result]:
        """Plan once; give the time from asking to the result [s], and the result."""
        began = time.perf_counter()
        answer = self._send().get_result_async()
        self._wait(answer.done, "no plan came")
        return time.perf_counter() - began, answer.result().result

    def cancel(self, after: float) -> float | None:
        """Cancel a goal a while after it was taken; give the time until its result came [s], None: it was done."""
        handle = self._send()
        answer = handle.get_result_async()
        time.sleep(after)
        asked = time.perf_counter()
        handle.cancel_goal_async()
        self._wait(answer.done, "no answer to a cancel came")
        took = time.perf_counter() - asked
        return took if answer.result().status == GoalStatus.STATUS_CANCELED else None

    def _send(self) -> Any:
        sent = self._client.send_goal_async(self._goal)
        self._wait(sent.done, "no goal was taken")
        return sent.result()

    def _wait(self, until: Any, what: str) -> None:
        if not self._monitor.spin(READY_S, until):
            raise UserMistake(what, expected=f"within {READY_S:.0f} s")
