"""`unifeed bench loop`: the control loop under load, beside a bare pair that only echoes, and what a lesson costs."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Feedback, LessonState
from unifeed_msgs.srv import TrainReward
from unifeed_ros.cli.arguments import UserMistake, domain, prepare_folder, session_files
from unifeed_ros.cli.echo_pair import COMMANDS
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses, node_environment
from unifeed_ros.nodes.sim_teacher import DONE, GAVE_UP
from unifeed_ros.nodes.table import NodeSpec, SessionSetup, node_table

LESSON_S = 90.0
"""Longest time of one input of the lesson [s]."""
PAIR_S = 60.0
"""Longest time that the bare pair may take to start [s]."""
SETTLE_S = 3.0
"""Time that the load runs before it counts [s]."""
TICKS = os.sysconf("SC_CLK_TCK")


def run(options: argparse.Namespace) -> int:
    """Teach a lesson, then load the machine, and print both; 0 only if both were completed."""
    if options.seconds < 5.0 or options.corrections < 0:
        raise UserMistake("bench loop", expected="--seconds 5 or more, --corrections 0 or more")
    out = prepare_folder(options.out or Path("out") / time.strftime("bench-loop-%Y%m%d-%H%M%S"))
    letters = "D" + "C" * options.corrections
    setup = SessionSetup(parameter_files=session_files("panda", "table"), simulated=True, taught_by=letters)
    load_before = os.getloadavg()
    with SessionMonitor("unifeed_bench") as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        with NodeProcesses(_in_real_time(node_table(setup)), out / "logs") as processes:
            lesson = _teach(monitor, processes, len(letters))
            loaded = _under_load(monitor, processes, options.seconds, out / "logs")
    table = {"machine": {"cpus": os.cpu_count(), "load_before": load_before[0], "load_after": os.getloadavg()[0]},
             "summary": {**loaded, **lesson}}
    (out / "loop.json").write_text(json.dumps(table, indent=2) + "\n")
    print(json.dumps(table, indent=2) if options.json else describe(table))
    return 0


def describe(table: dict[str, Any]) -> str:
    """Write the figures as lines."""
    return "\n".join([f"load of the machine before {table['machine']['load_before']:.1f}, "
                      f"after {table['machine']['load_after']:.1f}, {table['machine']['cpus']} cpus",
                      *(f"{name:28} {value:.3f}" if isinstance(value, float) else f"{name:28} {value}"
                        for name, value in table["summary"].items())])


def _in_real_time(specs: tuple[NodeSpec, ...]) -> list[NodeSpec]:
    """Let the simulated arm go on when commands are late, as a real arm does, and the person go on after faults."""
    changes = {"sim_arm": {"simulation.patience": 0.0}, "sim_teacher": {"teacher.resets": 1000}}
    return [replace(spec, parameters={**spec.parameters, **changes.get(spec.executable, {})}) for spec in specs]


def _teach(monitor: SessionMonitor, processes: NodeProcesses, inputs: int) -> dict[str, Any]:
    """Watch a lesson; give the times from a correction to the new motion, and the processor time of all nodes."""
    def ended() -> bool:
        _require_alive(processes)
        outcome = monitor.value("sim_teacher", "outcome")
        if outcome == GAVE_UP:
            raise UserMistake("the simulated person gave up", got=monitor.lesson.message)
        return monitor.lesson.phase == LessonState.READY and (len(monitor.interactions) >= inputs or outcome == DONE)

    if not monitor.spin(LESSON_S, lambda: monitor.lesson.phase == LessonState.READY):
        raise UserMistake("the nodes did not get ready", got=monitor.lesson.message, mend="see the logs")
    cpu, began = processor_time(processes.pids), time.monotonic()
    if not monitor.spin(LESSON_S * inputs, ended):
        raise UserMistake("the lesson did not end", got=monitor.lesson.message, mend="see the logs")
    cores = (processor_time(processes.pids) - cpu) / (time.monotonic() - began)
    corrections = [i for i in monitor.interactions if i.kind == Feedback.CORRECTION]
    waits = np.array([i.feedback_to_motion_s for i in corrections] or [np.nan])
    thinking = np.array([i.train_s + i.plan_s for i in corrections] or [np.nan])
    return {"corrections": len(corrections), "feedback_to_motion_p50_s": float(np.percentile(waits, 50)),
            "feedback_to_motion_p95_s": float(np.percentile(waits, 95)),
            "train_and_plan_p50_s": float(np.percentile(thinking, 50)), "cores": cores}


def _under_load(monitor: SessionMonitor, processes: NodeProcesses, seconds: float, logs: Path) -> dict[str, Any]:
    """Run motions, trainings and plans without a pause, and the bare pair beside them; give the figures of the loop."""
    load = _Load(monitor)
    pair = {name: _start_bare(name, logs) for name in ("echo", "source")}
    try:
        if not monitor.spin(PAIR_S, lambda: bool(monitor.node.count_publishers(COMMANDS))):
            raise UserMistake("the bare pair did not start", mend=f"see bare_echo.log in {logs}")
        load.run(SETTLE_S)
        before = _counters(monitor)
        began = time.monotonic()
        load.run(seconds)
        elapsed = time.monotonic() - began
        after = _counters(monitor)
    finally:
        for process in pair.values():
            process.send_signal(signal.SIGINT)
        for process in pair.values():
            process.wait(10.0)
    _require_alive(processes)
    bare = next(json.loads(line) for line in (logs / "bare_source.log").read_text().splitlines()
                if line.startswith("{"))
    figure = monitor.figure
    return {
        "command_hz": (after.commands - before.commands) / elapsed,
        "period_error_p99_ms": figure("shared_control", "period_error_p99_ms"),
        "latency_p50_ms": figure("sim_arm", "latency_p50_ms"), "latency_p99_ms": figure("sim_arm", "latency_p99_ms"),
        "bare_latency_p50_ms": bare["latency_p50_ms"], "bare_latency_p99_ms": bare["latency_p99_ms"],
        "bare_worst_ms": bare["worst_ms"],
        "worst_ms": figure("sim_arm", "latency_max_ms"), "late": int(after.late - before.late),
        "states_hz": figure("shared_control", "states_hz"), "motions": load.motions, "trainings": load.trainings,
        "plans": load.plans, "faults": load.faults, "seconds": elapsed,
    }


def _start_bare(role: str, logs: Path) -> subprocess.Popen[bytes]:
    with (logs / f"bare_{role}.log").open("wb") as log:
        return subprocess.Popen([sys.executable, "-m", "unifeed_ros.cli.echo_pair", role], stdout=log,
                                stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=node_environment())


@dataclass(frozen=True)
class _Counters:
    """What the loop has counted since it began."""

    commands: float
    late: float


def _counters(monitor: SessionMonitor) -> _Counters:
    return _Counters(commands=monitor.figure("shared_control", "commands"), late=monitor.figure("sim_arm", "late"))


class _Load:
    """Asks for the next motion, training and plan as soon as the last is done."""

    def __init__(self, monitor: SessionMonitor) -> None:
        self._monitor = monitor
        self._run = monitor.node.create_client(Trigger, "run")
        self._train = monitor.node.create_client(TrainReward, "train_reward")
        self._optimize = ActionClient(monitor.node, OptimizeTrajectory, "optimize_trajectory")
        self._training = self._planning = self._asking = None
        self.motions = self.trainings = self.plans = 0
        self._reset = monitor.node.create_client(Trigger, "reset")
        self.faults, self._asked = 0, 0.0

    def run(self, seconds: float) -> None:
        """Keep everything busy for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._next_training()
            self._next_plan()
            self._next_motion()
            self._monitor.spin(0.05)

    def _next_training(self) -> None:
        if self._training is None or self._training.done():
            self.trainings += self._training is not None
            self._training = self._train.call_async(TrainReward.Request(from_scratch=True))

    def _next_plan(self) -> None:
        if self._asking is None:
            self._asking = self._optimize.send_goal_async(OptimizeTrajectory.Goal())
        elif self._planning is None and self._asking.done():
            self._planning = self._asking.result().get_result_async()
        elif self._planning is not None and self._planning.done():
            self.plans += 1
            self._asking = self._planning = None

    def _next_motion(self) -> None:
        if self._monitor.lesson.phase == LessonState.READY and time.monotonic() - self._asked > 1.0:
            self._asked = time.monotonic()
            self._run.call_async(Trigger.Request())
            self.motions += 1
        elif self._monitor.lesson.phase == LessonState.FAULT and time.monotonic() - self._asked > 1.0:
            self._asked = time.monotonic()
            self._reset.call_async(Trigger.Request())
            self.faults += 1


def processor_time(pids: list[int]) -> float:
    """Sum the processor time of processes and of all that they started [s]; each leads a session of its own."""
    total = 0
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) in pids:
            total += sum(map(int, fields[11:15]))
    return total / TICKS


def _require_alive(processes: NodeProcesses) -> None:
    for name, code in processes.dead().items():
        raise UserMistake(f"{name} died", got=f"exit status {code}", mend=processes.log_tail(name, 1) or "see its log")
