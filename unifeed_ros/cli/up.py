"""`unifeed up`: the nodes of a session, each in a process of its own, until Ctrl-C."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from unifeed_ros.cli.arguments import (
    UserMistake,
    add_console_options,
    console_parameters,
    domain,
    prepare_folder,
    require_speed,
    session_files,
)
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses
from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.table import CONSOLE, SessionSetup, node_table


def add_up_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `up` to the command line."""
    parser = commands.add_parser("up", help="start the nodes of a session; Ctrl-C ends them all")
    parser.add_argument("--robot", required=True, help="panda or ur10, or a YAML file")
    parser.add_argument(
        "--task", default="table", help="table, laptop, cup or proximity, or a YAML file (default: table)"
    )
    parser.add_argument("--sim", action="store_true", help="with the simulated arm in place of the robot's driver")
    parser.add_argument("--teacher", default="", metavar="LETTERS",
                        help="with a simulated person who teaches, for example DDCCPP (needs --sim)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--speed", type=float, default=1.0, help="simulated seconds per second (default: 1)")
    parser.add_argument("--out", type=Path, help="folder for logs and bag (default: out/session-<date>-<time>)")
    add_console_options(parser)
    parser.set_defaults(run=run_up)


def run_up(options: argparse.Namespace) -> int:
    """Run a session until Ctrl-C; 1 if a node died."""
    files = session_files(options.robot, options.task)
    if options.teacher and not options.sim:
        raise UserMistake("--teacher", expected="--sim beside it: a simulated person pushes a simulated arm only")
    speed = require_speed(options.speed)
    check_scene(files)
    out = prepare_folder(options.out or Path("out") / time.strftime("session-%Y%m%d-%H%M%S"))
    setup = SessionSetup(
        parameter_files=files,
        simulated=options.sim,
        taught_by=options.teacher.upper(),
        seed=options.seed,
        speed=speed,
        bag=out / "bag",
        console=options.console,
        console_parameters=console_parameters(options),
    )
    with SessionMonitor() as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        with NodeProcesses(node_table(setup), out / "logs") as processes:
            print(f"session in {out}; Ctrl-C ends it", flush=True)
            return _watch(monitor, processes)


def check_scene(files: tuple[Path, ...]) -> None:
    """Refuse robots and tasks that cannot work together, before anything starts.

    Args:
        files: Files of the robot and of the task.

    Raises:
        UnifeedError: A file is malformed, the URDF is missing, a goal is out of reach, or no motion leads to it.
    """
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    start = robot.inverse_kinematics(scene.start, scene.axis)
    goal = robot.inverse_kinematics(scene.goal, scene.axis, seed=start)
    plan = plan_motion(robot, None, start, goal, duration=scene.duration, scene=scene, config=PlannerConfig())
    if not plan.success:
        raise UserMistake(f"no motion for task {scene.task} on {robot.config.name}", got=plan.message)


def _watch(monitor: SessionMonitor, processes: NodeProcesses) -> int:
    said = ""
    while True:
        monitor.spin(0.2)
        if monitor.lesson.message and monitor.lesson.message != said:
            said = monitor.lesson.message
            print(said, flush=True)
        if news := processes.console_news(monitor.value(CONSOLE, "address")):
            print(news, flush=True)
        for name, code in processes.dead().items():
            monitor.stop_arm()
            print(f"unifeed up: {name} died (exit status {code}): {processes.log_tail(name, 1) or 'see its log'}",
                  file=sys.stderr)
            return 1
