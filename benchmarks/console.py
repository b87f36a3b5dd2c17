"""What the teaching page costs and how fast it acts: a page without a browser beside a session on the simulated arm.

Prints a JSON object: how long a press of STOP takes to stop the arm, how often and how late the arm's pose is drawn,
and the share of a core that the node `console` takes. Run: .venv/bin/python benchmarks/console.py
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "test" / "ros")]

from page_client import PageClient  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from unifeed_msgs.msg import LessonState, TeachingState  # noqa: E402
from unifeed_msgs.srv import SetMode  # noqa: E402
from unifeed_ros.cli.arguments import session_files  # noqa: E402
from unifeed_ros.cli.monitor import SessionMonitor  # noqa: E402
from unifeed_ros.cli.processes import NodeProcesses  # noqa: E402
from unifeed_ros.nodes.table import SessionSetup, node_table  # noqa: E402
from unifeed_ros.nodes.topics import subscriber_qos  # noqa: E402

PRESSES = 30
"""Presses of STOP."""


def main() -> int:
    """Measure and print."""
    setup = SessionSetup(parameter_files=session_files("panda", "table"), console=True, console_parameters={"port": 0})
    with tempfile.TemporaryDirectory() as logs, SessionMonitor() as monitor, \
            NodeProcesses(node_table(setup), Path(logs)):
        ready = monitor.spin(120.0, lambda: monitor.lesson.phase == LessonState.READY
                             and bool(monitor.value("console", "address")))
        if not ready:
            print(f"the session did not start: {monitor.lesson.message}", file=sys.stderr)
            return 1
        node = rclpy.create_node("measure")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        seen: list[TeachingState] = []
        node.create_subscription(TeachingState, "teaching_state", lambda m: seen.append(m),
                                 subscriber_qos("teaching_state"))
        page = PageClient(monitor.value("console", "address"))
        figures = {"load_1min": round(os.getloadavg()[0], 1), "cores": os.cpu_count(), **moving(monitor, page)}
        figures["stop_ms"] = stopping(node, executor, seen, page)
        print(json.dumps(figures))
        page.close()
        node.destroy_node()
    return 0


def moving(monitor: SessionMonitor, page: PageClient) -> dict[str, float]:
    """Measure poses and processor time while the arm moves."""
    run = monitor.node.create_client(Trigger, "run")
    run.wait_for_service(timeout_sec=10.0)
    run.call_async(Trigger.Request())
    monitor.spin(30.0, lambda: monitor.lesson.phase == LessonState.RUNNING)
    monitor.spin(0.5)
    before, began, shares = page.moves, time.monotonic(), []
    while monitor.lesson.phase == LessonState.RUNNING and time.monotonic() - began < 2.0:
        monitor.spin(0.1)
        with contextlib.suppress(ValueError):
            shares.append(float(monitor.value("console", "cpu_percent")))
    rate = (page.moves - before) / (time.monotonic() - began)
    monitor.spin(60.0, lambda: monitor.lesson.phase == LessonState.READY)
    monitor.spin(3.0)
    return {"poses_per_s": round(rate, 1), "cpu_percent_moving": max(shares, default=float("nan")),
            "cpu_percent_still": monitor.figure("console", "cpu_percent")}


def stopping(node: rclpy.node.Node, executor: SingleThreadedExecutor, seen: list[TeachingState],
             page: PageClient) -> dict[str, float]:
    """Measure the time from a press of STOP to the first state that says that the arm is stopped."""
    hold = node.create_client(SetMode, "set_mode")
    times = []
    for _ in range(PRESSES):
        hold.call_async(SetMode.Request())
        wait(executor, lambda: bool(seen) and seen[-1].mode == TeachingState.HOLD)
        began = time.monotonic()
        page.press("STOP")
        wait(executor, lambda: seen[-1].mode == TeachingState.STOPPED)
        times.append(1e3 * (time.monotonic() - began))
    return {f"p{share}": round(float(np.percentile(times, share)), 1) for share in (50, 95, 100)}


def wait(executor: SingleThreadedExecutor, condition: object) -> None:
    """Take messages until a condition holds, for ten seconds at most."""
    end = time.monotonic() + 10.0
    while not condition() and time.monotonic() < end:  # type: ignore[operator]
        executor.spin_once(timeout_sec=0.002)


if __name__ == "__main__":
    sys.exit(main())
