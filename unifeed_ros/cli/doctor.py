"""`unifeed doctor`: what is installed, what is missing, whether this machine can hold the loop."""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

import numpy as np

PACKAGES = {"rclpy": "rclpy", "torch": "torch", "pinocchio": "pin", "osqp": "osqp", "piqp": "piqp",
            "mujoco": "mujoco", "mcap": "mcap"}
"""Distribution that holds each module."""
LOOP_SECONDS = 2.0
"""Time over which the control loop's timing is tried [s]."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    name: str
    """What was looked at."""
    ok: bool
    """Whether it is as it should be."""
    text: str
    """What was found, and how to mend it."""


def add_doctor_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `doctor` to the command line."""
    parser = commands.add_parser("doctor", help="what is installed, what is missing, can this machine hold the loop")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run_doctor)


def run_doctor(options: argparse.Namespace) -> int:
    """Look at everything; 0 only if all is well."""
    findings = [_guarded(name, check) for name, check in CHECKS.items()]
    if options.json:
        print(json.dumps({"ok": all(f.ok for f in findings), "findings": [asdict(f) for f in findings]}, indent=2))
    else:
        for finding in findings:
            print(f"{'ok     ' if finding.ok else 'MISSING'} {finding.name}: {finding.text}")
    return 0 if all(f.ok for f in findings) else 1


def _guarded(name: str, check: Callable[[], tuple[bool, str]]) -> Finding:
    try:
        return Finding(name, *check())
    except Exception as error:  # a broken installation fails in any way; each is a finding
        return Finding(name, False, f"{type(error).__name__}: {error}")


def _python() -> tuple[bool, str]:
    return sys.version_info >= (3, 10), f"{sys.version.split()[0]} (3.10 or newer)"


def _packages() -> tuple[bool, str]:
    missing, found = [], []
    for module, distribution in PACKAGES.items():
        try:
            import_module(module)
            found.append(f"{module} {version(distribution)}")
        except ImportError:
            missing.append(module)
        except PackageNotFoundError:
            found.append(module)
    return not missing, ", ".join(found) if not missing else f"missing {', '.join(missing)}: run make setup"


def _messages() -> tuple[bool, str]:
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    from unifeed_msgs.msg import Feedback

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("unifeed_doctor")
        node.create_publisher(Feedback, "unifeed_doctor", 1)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return True, "unifeed_msgs is built, and the middleware publishes it"


def _robots() -> tuple[bool, str]:
    from unifeed_ros.core.robot import RobotModel, load_robot
    from unifeed_ros.resources import config_names, config_path

    names = config_names("robots")
    for name in names:
        RobotModel(load_robot(config_path("robots", name)))
    return bool(names), f"{', '.join(names)}: models load"


def _traffic() -> tuple[bool, str]:
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return True, f"ROS_DOMAIN_ID {domain}, discovery {reach}"


def _disk() -> tuple[bool, str]:
    free = shutil.disk_usage(tempfile.gettempdir()).free / 2**30
    return free > 2.0, f"{free:.1f} GiB free (a session takes about 1 MiB a second)"


def _real_time() -> tuple[bool, str]:
    """Say whether the control loop's processes may take real-time priority; it is no fault if they may not."""
    highest = 99 if os.geteuid() == 0 else resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if highest == 0:
        return True, "not permitted; commands come more evenly with a line '@users - rtprio 99' in limits.conf"
    return True, f"priorities up to {highest} under SCHED_FIFO are permitted"


def _loop() -> tuple[bool, str]:
    """Time a 1 kHz loop of the arm's gravity torques, as the controller runs it."""
    from unifeed_ros.core.robot import RobotModel, load_robot
    from unifeed_ros.resources import config_path

    robot = RobotModel(load_robot(config_path("robots", "panda")))
    q = np.array(robot.config.seed)
    late = []
    due = time.perf_counter()
    for _ in range(int(LOOP_SECONDS * 1000)):
        due += 0.001
        while (rest := due - time.perf_counter()) > 0:
            time.sleep(rest)
        late.append(time.perf_counter() - due)
        robot.gravity(q)
        due = max(due, time.perf_counter() - 0.01)
    p99, worst = 1e3 * float(np.percentile(late, 99)), 1e3 * max(late)
    cores = os.cpu_count() or 1
    ok = p99 < 2.0 and cores >= 2
    return ok, (f"1 kHz loop is late by {p99:.2f} ms at the 99th percentile, {worst:.1f} ms at worst; {cores} cores "
                f"(2 or more; below 2 ms)")


CHECKS: dict[str, Callable[[], tuple[bool, str]]] = {
    "python": _python,
    "packages": _packages,
    "messages": _messages,
    "robots": _robots,
    "traffic": _traffic,
    "disk": _disk,
    "real time": _real_time,
    "control loop": _loop,
}
