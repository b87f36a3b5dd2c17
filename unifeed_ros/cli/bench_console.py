"""`unifeed bench console`: what the teaching page costs and how far it is behind, with a page open and without."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.client import Client
from std_srvs.srv import Trigger

from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_msgs.srv import SetMode
from unifeed_ros.cli.arguments import UserMistake, domain, session_files
from unifeed_ros.cli.bench_loop import processor_time
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.page_client import PageClient
from unifeed_ros.cli.processes import NodeProcesses
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Array
from unifeed_ros.nodes.table import CONSOLE, SessionSetup, node_table
from unifeed_ros.nodes.topics import subscriber_qos

START_S, STEP_S = 120.0, 60.0
"""Longest time until the session and its page are there, and of one step of it [s]."""
STILL_S = 5.0
"""Time over which an arm that stands still is looked at [s]."""
SAME_PLACE = 1e-5
"""Places closer than this are one [m]."""

Places = Sequence[tuple[float, Array]]
"""Where the tool was, shape (3,) [m], each with the steady time at which that came [s]; oldest first."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the figures."""
    if options.presses < 1:
        raise UserMistake("--presses", expected="at least 1", got=options.presses)
    figures = measure_console(options.presses)
    print(json.dumps(figures, indent=2) if options.json else describe(figures))
    return 0


def measure_console(presses: int) -> dict[str, Any]:
    """Run a session with the page, first with nobody at it, then with one page open.

    Args:
        presses: How often STOP is pressed.

    Returns:
        The figures, for JSON or describe.

    Raises:
        UserMistake: The session does not run.
    """
    setup = SessionSetup(parameter_files=session_files("panda", "table"), console=True, console_parameters={"port": 0})
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as logs, SessionMonitor("unifeed_bench") as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        with NodeProcesses(node_table(setup), Path(logs)) as processes:
            bench = _Bench(monitor, processes)
            figures = {"without_page": bench.costs()}
            page = PageClient(monitor.value(CONSOLE, "address"))
            try:
                figures |= {"with_page": bench.costs(), "pose": bench.poses(page),
                            "click_ms": bench.clicks(page, presses)}
            finally:
                page.close()
    machine = {"cpus": os.cpu_count(), "load_before": load_before, "load_after": os.getloadavg()[0]}
    return {"machine": machine, **figures}


def lags(drawn: Places, states: Places) -> Array:
    """Find how long after its state each pose of a moving arm came to the page.

    Args:
        drawn: Places that the page drew.
        states: Places of the arm's states, from before the first drawn one on.

    Returns:
        Times from the state to the pose, shape (N,) [s]; poses whose state is not there are left out.
    """
    times, places = np.array([t for t, _ in states]), np.array([p for _, p in states])
    found = []
    for time_drawn, place in drawn:
        same = np.flatnonzero((np.abs(places - place).max(axis=1) < SAME_PLACE) & (times <= time_drawn))
        if same.size:
            found.append(time_drawn - times[same[-1]])
    return np.array(found)


def describe(figures: dict[str, Any]) -> str:
    """Write the figures as lines."""
    machine = figures["machine"]
    lines = [f"load of the machine before {machine['load_before']:.1f}, after {machine['load_after']:.1f}, "
             f"{machine['cpus']} cpus"]
    for part in ("without_page", "with_page", "pose", "click_ms"):
        lines += [f"{part + '.' + name:34} {value:.3f}" for name, value in figures[part].items()]
    return "\n".join(lines)


class _Bench:
    """A session that is measured."""

    def __init__(self, monitor: SessionMonitor, processes: NodeProcesses) -> None:
        self._monitor, self._processes = monitor, processes
        self._robot = RobotModel(load_robot(session_files("panda", "table")[0]))
        self._states: list[tuple[float, TeachingState]] = []
        node = monitor.node
        node.create_subscription(TeachingState, "teaching_state", self._on_state, subscriber_qos("teaching_state"))
        self._run, self._reset = (node.create_client(Trigger, name) for name in ("run", "reset"))
        self._hold = node.create_client(SetMode, "set_mode")
        self._until(lambda: monitor.lesson.phase == LessonState.READY and bool(monitor.value(CONSOLE, "address")),
                    START_S, "the session did not get ready")

    def costs(self) -> dict[str, float]:
        """Measure the console's share of a core, and how many commands were late, while the arm stands and moves."""
        still = self._share(lambda: self._monitor.spin(STILL_S))
        commands, late = self._counters()
        moving = self._share(self._move)
        self._monitor.spin(1.5)  # the counters come once a second
        after = self._counters()
        return {"core_still": still, "core_moving": moving, "commands": after[0] - commands, "late": after[1] - late}

    def poses(self, page: PageClient) -> dict[str, float]:
        """Measure how often and how late the pose of a moving arm is drawn."""
        self._states.clear()
        page.places.clear()
        self._move()
        moved = [(t, self._robot.tool_pose(np.asarray(s.positions))[0]) for t, s in self._states
                 if s.mode == TeachingState.TRACK and s.motion_time < s.motion_duration]
        drawn = [(t, place) for t, place in list(page.places) if moved[0][0] <= t <= moved[-1][0]]
        behind = 1e3 * lags(drawn, moved)
        if not behind.size:
            raise UserMistake("the page drew no pose of the moving arm")
        return {"per_s": len(drawn) / (moved[-1][0] - moved[0][0]), "poses": float(len(drawn)),
                **{f"lag_p{share}_ms": float(np.percentile(behind, share)) for share in (50, 95, 100)}}

    def clicks(self, page: PageClient, presses: int) -> dict[str, float]:
        """Measure the time from a press of STOP in the page to the first state that says that the arm is stopped."""
        times = []
        for _ in range(presses):
            self._call(self._hold, SetMode.Request())
            self._until(lambda: self._mode() == TeachingState.HOLD, STEP_S, "the arm does not hold")
            began = time.monotonic()
            page.press("STOP")
            self._until(lambda: self._mode() == TeachingState.STOPPED, STEP_S, "STOP did not stop the arm")
            times.append(1e3 * (self._states[-1][0] - began))
        return {f"p{share}": float(np.percentile(times, share)) for share in (50, 95, 100)}

    def _move(self) -> None:
        """Let the arm carry its motion out, and come back to the start."""
        self._call(self._run, Trigger.Request())
        self._until(lambda: self._monitor.lesson.phase == LessonState.RUNNING, STEP_S, "the arm did not begin to move")
        self._until(lambda: self._monitor.lesson.phase in (LessonState.READY, LessonState.FAULT), STEP_S,
                    "the motion did not end")
        if self._monitor.lesson.phase == LessonState.FAULT:
            raise UserMistake("the arm was stopped", got=self._monitor.lesson.message, mend="close other programs")

    def _share(self, work: Any) -> float:
        """Give the console's processor time during some work, as a share of one core."""
        pids = [self._processes.pid(CONSOLE)]
        used, began = processor_time(pids), time.monotonic()
        work()
        return (processor_time(pids) - used) / (time.monotonic() - began)

    def _counters(self) -> tuple[float, float]:
        return self._monitor.figure("shared_control", "commands"), self._monitor.figure("sim_arm", "late")

    def _call(self, client: Client, request: Any) -> None:
        client.wait_for_service(timeout_sec=STEP_S)
        answer = client.call_async(request)
        self._until(answer.done, STEP_S, f"{client.srv_name} did not answer")
        if not answer.result().success:
            raise UserMistake(f"{client.srv_name} was refused", got=answer.result().message)

    def _until(self, happened: Any, timeout: float, mistake: str) -> None:
        if not self._monitor.spin(timeout, happened):
            raise UserMistake(mistake, got=self._monitor.lesson.message, mend="close other programs")

    def _mode(self) -> int:
        return self._states[-1][1].mode if self._states else TeachingState.INACTIVE

    def _on_state(self, msg: TeachingState) -> None:
        self._states.append((time.monotonic(), msg))
