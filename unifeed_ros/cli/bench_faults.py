"""`unifeed bench faults`: every fault tried against the running nodes: how soon the arm stops, what is said.

The session is recorded; a mark with the fault's name stands where each begins, and MENDED where it ends.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from std_msgs.msg import String
from std_srvs.srv import Trigger

from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_msgs.srv import ListFeedback, Mark
from unifeed_ros.cli.arguments import UserMistake, domain, prepare_folder, session_files
from unifeed_ros.cli.faulty_wire import FAULTS
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses, node_environment
from unifeed_ros.core.control.safety import LONGEST_TICK
from unifeed_ros.core.recording import bag_info, read_bag
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.table import NodeSpec, SessionSetup, node_table
from unifeed_ros.nodes.topics import subscriber_qos

KILLED = ("capture", "reward_learner", "trajectory_optimizer", "session", "shared_control")
"""Nodes that are killed."""
START_S, MOTION_S = 300.0, 30.0
"""Longest waits for a session that gets ready, and for a motion that begins [s]."""
ATTEMPTS = 5
"""How often a motion is asked for before the session counts as broken."""
MENDED = "mended"
"""Mark where a fault ends."""
SHORTEST_TICK = 0.002
"""Time between two commands at 500 Hz [s]."""
BROKEN_S = 1.0
"""How long the wire stays broken [s]."""
NOTICED_S = 12.0
"""Longest time in which a killed node is noticed [s]."""
REMAPPED = ("joint_states:=raw/joint_states", "external_torques:=raw/external_torques",
            "joint_command:=raw/joint_command")


@dataclass
class Tries:
    """What happened in all tries of one fault."""

    stops: list[float] = field(default_factory=list)
    """Time from when the fault showed to the stop [s]; as many as the arm was stopped."""
    stills: list[float] = field(default_factory=list)
    """Time from when the fault showed until the arm's joints were slower than 0.1 rad/s [s]."""
    messages: list[str] = field(default_factory=list)
    """What was said."""
    kept: int = 0
    """Tries after which everything that was taught was still there."""
    invented: int = 0
    """Inputs that nobody gave: taken from the fault."""

    def row(self, name: str) -> dict[str, Any]:
        """Give the figures of the fault."""
        return {"fault": name, "tries": len(self.messages), "stopped": len(self.stops),
                "stop_max_s": max(self.stops, default=float("nan")),
                "still_max_s": max(self.stills, default=float("nan")),
                "kept": self.kept, "invented": self.invented,
                "messages": sorted(set(self.messages))}


def run(options: argparse.Namespace) -> int:
    """Try the faults and print the table; 0 only if every try ended with the arm ready again."""
    names = [*FAULTS, *(f"kill -9 {name}" for name in KILLED)]
    chosen = options.fault or names
    if unknown := [name for name in chosen if name not in names]:
        raise UserMistake("unknown fault", expected=", ".join(names), got=", ".join(unknown))
    out = prepare_folder(options.out or Path("out") / time.strftime("bench-faults-%Y%m%d-%H%M%S"))
    setup = SessionSetup(parameter_files=session_files("panda", "table"), simulated=True, taught_by="D",
                         bag=out / "bag")
    specs = [_changed(spec) for spec in node_table(setup)]
    with SessionMonitor("unifeed_bench") as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        with _Wire(setup, out) as wire, NodeProcesses(specs, out / "logs") as processes:
            trial = _Trial(monitor, processes, wire)
            rows = [trial.tries(name, options.tries, np.random.default_rng(options.seed)) for name in chosen]
    rates = largest_rates(out / "bag", RobotModel(load_robot(setup.parameter_files[0])).joint_names)
    rows = [{**row, "torque_rate_max": rates.get(row["fault"], float("nan"))} for row in rows]
    table = {"machine": {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}, "faults": rows}
    (out / "faults.json").write_text(json.dumps(table, indent=2) + "\n")
    print(json.dumps(table, indent=2) if options.json else markdown(rows))
    return 0 if all(row["tries"] == options.tries for row in rows) else 1


def _changed(spec: NodeSpec) -> NodeSpec:
    """Put the wire between arm and nodes, and let the person go on after faults of a busy machine."""
    if spec.executable == "sim_arm":
        return replace(spec, remaps=REMAPPED)
    if spec.executable == "sim_teacher":
        return replace(spec, parameters={**spec.parameters, "teacher.resets": 1000})
    return spec


def markdown(rows: list[dict[str, Any]]) -> str:
    """Write the table."""
    lines = ["| fault | tries | stopped | latest stop [s] | latest rest [s] | largest torque rate [Nm/s] "
             "| taught things kept | learned from it | says |", "| --- " * 9 + "|"]
    lines += [f"| {r['fault']} | {r['tries']} | {r['stopped']} | {r['stop_max_s']:.3f} | {r['still_max_s']:.2f} | "
              f"{r['torque_rate_max']:.0f} | {r['kept']} | {r['invented']} | {' / '.join(r['messages'])} |"
              for r in rows]
    return "\n".join(lines)


def largest_rates(bag: Path, joint_names: Sequence[str]) -> dict[str, float]:
    """Give the fastest change of the recorded torque commands, from each fault's mark to the next fault's [Nm/s].

    Args:
        bag: Recording with a mark where each fault begins.
        joint_names: Names of the arm's joints.
    """
    begins = [(time, text) for time, text in bag_info(bag).marks if text != MENDED]
    reader, rates = JointReader(joint_names), dict.fromkeys((text for _, text in begins), 0.0)
    last: tuple[float, np.ndarray] | None = None
    for message in read_bag(bag, ["/joint_command"]):
        stamp, torque = reader.torques(message.data, "commands")
        command = stamp, np.array(torque)
        at = bisect_right(begins, message.time, key=lambda begin: begin[0])
        if last is not None and at:
            name = begins[at - 1][1]
            rates[name] = max(rates[name], torque_rate(last, command))
        last = command
    return rates


def torque_rate(before: tuple[float, np.ndarray], after: tuple[float, np.ndarray]) -> float:
    """Give the largest change of a torque from one command to the next.

    The time between them counts as the controller's rate limit counts it: at most LONGEST_TICK, here at least a period
    of commands, so that commands that come in one burst, or with stamps that leap, have a rate.

    Args:
        before: Stamp [s] and torques, shape (n,) [Nm].
        after: Those of the next command.

    Returns:
        Rate [Nm/s].
    """
    dt = min(max(after[0] - before[0], SHORTEST_TICK), LONGEST_TICK)
    return float(np.abs(after[1] - before[1]).max()) / dt


class _Wire:
    """The process between arm and nodes, and the lines that it prints."""

    def __init__(self, setup: SessionSetup, out: Path) -> None:
        spec = NodeSpec(executable="faulty_wire", parameter_files=setup.parameter_files)
        self._command = [sys.executable, "-m", "unifeed_ros.cli.faulty_wire", *spec.arguments()]
        self._log = out / "faulty_wire.log"

    def __enter__(self) -> _Wire:
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=subprocess.STDOUT,
                                             stdin=subprocess.DEVNULL, env=node_environment())
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGINT)
        self._process.wait(10.0)

    def reports(self) -> list[dict[str, Any]]:
        """Give what was printed so far, one report a fault that was mended."""
        return [json.loads(line) for line in self._log.read_text().splitlines() if line.startswith("{")]


class _Trial:
    """Tries faults in motions of the session."""

    def __init__(self, monitor: SessionMonitor, processes: NodeProcesses, wire: _Wire) -> None:
        self._monitor, self._processes, self._wire = monitor, processes, wire
        self._fault = monitor.node.create_publisher(String, "fault", 10)
        self._teaching = TeachingState()
        monitor.node.create_subscription(TeachingState, "teaching_state", self._on_teaching,
                                         subscriber_qos("teaching_state"))
        self._clients = {name: monitor.node.create_client(Trigger, name) for name in ("run", "reset", "stop")}
        self._list = monitor.node.create_client(ListFeedback, "list_feedback")
        self._marks = monitor.node.create_client(Mark, "mark")
        if not monitor.spin(START_S, lambda: len(monitor.interactions) > 0 and self._ready()):
            raise UserMistake("nothing was taught", got=monitor.lesson.message, mend="see the logs")

    def _on_teaching(self, msg: TeachingState) -> None:
        self._teaching = msg

    def _ready(self) -> bool:
        return self._monitor.lesson.phase == LessonState.READY

    def tries(self, name: str, count: int, rng: np.random.Generator) -> dict[str, Any]:
        """Try one fault at random moments of motions."""
        tries = Tries()
        for k in range(count):
            self._recover()
            before = self._taught()
            self._begin_motion(name)
            self._monitor.spin(float(rng.uniform(0.3, 2.0)))
            self._mark(name)
            (self._kill if name.startswith("kill") else self._break)(name, tries)
            self._mark(MENDED)
            self._recover()
            after = self._taught()
            tries.kept += before <= after
            tries.invented += len(after - before)
            print(f"{name} {k + 1}/{count}: {tries.messages[-1]}", file=sys.stderr, flush=True)
        return tries.row(name)

    def _begin_motion(self, name: str) -> None:
        """Let the robot carry out its motion; a busy machine stalls the simulated arm now and then, and it holds."""
        def moves() -> bool:
            return self._teaching.mode == TeachingState.TRACK and self._teaching.motion_id.startswith("run")

        for _ in range(ATTEMPTS):
            self._recover()
            self._call("run")
            self._monitor.spin(MOTION_S, lambda: moves() or self._monitor.lesson.phase == LessonState.FAULT)
            if moves():
                return
        raise UserMistake(f"{name}: no motion began", got=self._monitor.lesson.message, mend="see the logs")

    def _break(self, name: str, tries: Tries) -> None:
        """Break the wire for a while; the wire itself measures."""
        before = len(self._wire.reports())
        self._fault.publish(String(data=name))
        self._monitor.spin(BROKEN_S)
        self._fault.publish(String())
        self._await(lambda: len(self._wire.reports()) > before, 10.0, f"{name}: the wire did not answer")
        report = self._wire.reports()[-1]
        if report["stop_s"] is not None:
            tries.stops.append(report["stop_s"])
        if report["still_s"] is not None:
            tries.stills.append(report["still_s"])
        tries.messages.append(report["message"] or f"goes on: {self._teaching.message}")

    def _kill(self, name: str, tries: Tries) -> None:
        """Kill a node; what counts is the arm's stop, which the session or the controller brings about."""
        victim = name.rpartition(" ")[2]
        at = time.monotonic()
        self._processes.kill(victim)
        if victim == "shared_control":
            self._monitor.spin(BROKEN_S)
            tries.messages.append("no commands: the arm holds itself")
        else:
            if self._monitor.spin(NOTICED_S, lambda: self._teaching.mode == TeachingState.STOPPED):
                tries.stops.append(time.monotonic() - at)
                self._monitor.spin(1.0, lambda: self._monitor.lesson.phase == LessonState.FAULT)  # on another topic
            tries.messages.append(self._teaching.message if victim == "session" else self._monitor.lesson.message)
        self._processes.start_again(victim)

    def _recover(self) -> None:
        """Wait until the session is ready again; reset one that waits for it, never one that is on its way."""
        deadline = time.monotonic() + START_S
        while not self._monitor.spin(5.0, self._ready):
            if time.monotonic() > deadline:
                raise UserMistake("the session did not recover", got=self._monitor.lesson.message)
            if self._monitor.lesson.phase in (LessonState.FAULT, LessonState.PAUSED):
                self._call("reset")

    def _taught(self) -> set[str]:
        answer = self._ask(self._list, ListFeedback.Request())
        return set(answer.ids) if answer is not None else set()

    def _mark(self, text: str) -> None:
        self._ask(self._marks, Mark.Request(text=text))

    def _call(self, name: str) -> None:
        self._ask(self._clients[name], Trigger.Request())

    def _ask(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        return future.result() if self._monitor.spin(5.0, future.done) else None

    def _await(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        if not self._monitor.spin(seconds, condition):
            raise UserMistake(what, got=self._monitor.lesson.message, mend="see the logs")
