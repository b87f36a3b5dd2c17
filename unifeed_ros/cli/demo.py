"""`unifeed demo`: a whole lesson on a simulated arm with a simulated person, ending in a report."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TextIO

from unifeed_msgs.msg import Interaction, LessonState
from unifeed_ros.cli.arguments import (
    UserMistake,
    add_console_options,
    console_parameters,
    domain,
    prepare_folder,
    require_letters,
    require_speed,
    session_files,
)
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses
from unifeed_ros.cli.report import KINDS, build_report, describe, save_report
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.conversions import trajectory_from_msg
from unifeed_ros.nodes.sim_teacher import DONE, GAVE_UP
from unifeed_ros.nodes.table import CONSOLE, SessionSetup, node_table
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, measure

FAULT_S = 6.0
"""Time that a fault may last before the demo gives up: the simulated person presses reset sooner [s]."""
PHASES = {value: name.lower() for name, value in vars(LessonState).items() if name.isupper() and isinstance(value, int)}


def add_demo_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `demo` to the command line."""
    parser = commands.add_parser("demo", help="watch a simulated arm being taught, from start to report")
    parser.add_argument("--robot", default="panda", help="panda or ur10, or a YAML file (default: panda)")
    parser.add_argument(
        "--task", default="table", help="table, laptop, cup or proximity, or a YAML file (default: table)"
    )
    parser.add_argument(
        "--feedback", default="DDCCPP", help="D demonstration, C correction, P preference, in any order"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated person, the noise and the training")
    parser.add_argument("--speed", type=float, default=1.0, help="simulated seconds per second (default: 1)")
    parser.add_argument("--out", type=Path, help="folder for report, figures and bag (default: out/demo-<date>-<time>)")
    parser.add_argument("--timeout", type=float, default=600.0, help="longest time of the whole lesson, in s")
    parser.add_argument("--json", action="store_true", help="print the report as JSON on stdout, progress on stderr")
    add_console_options(parser)
    parser.set_defaults(run=run_demo)


def run_demo(options: argparse.Namespace) -> int:
    """Run the lesson; 0 only if every interaction was completed."""
    if options.seed < 0:
        raise UserMistake("--seed", expected="0 or more", got=options.seed)
    speed, letters = require_speed(options.speed), require_letters(options.feedback.upper())
    files = session_files(options.robot, options.task)
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    task = TrueTask(scene=scene)
    out = prepare_folder(options.out or Path("out") / time.strftime("demo-%Y%m%d-%H%M%S"))
    setup = SessionSetup(parameter_files=files, simulated=True, taught_by=letters, seed=options.seed, speed=speed,
                         bag=out / "bag", console=options.console, console_parameters=console_parameters(options))
    progress = sys.stderr if options.json else sys.stdout
    with SessionMonitor() as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}",
                              mend="end it, or set another ROS_DOMAIN_ID")
        lesson = _Lesson(monitor, measure(robot, task), letters, progress)
        with NodeProcesses(node_table(setup), out / "logs") as processes:
            ok, message = lesson.watch(processes, options.timeout)
        report = build_report(lesson.yardstick, monitor, seed=options.seed, ok=ok, message=message, bag=out / "bag",
                              letters=letters)
        save_report(report, lesson.yardstick, monitor, out)
    print(describe(report, out) if not options.json else report.to_json(), file=sys.stdout)
    if not ok:
        print(f"unifeed demo: {message}", file=sys.stderr)
    return 0 if ok else 1


class _Lesson:
    """Follow one lesson and print what happens."""

    def __init__(self, monitor: SessionMonitor, yardstick: Yardstick, letters: str, progress: TextIO) -> None:
        self._monitor, self.yardstick, self._letters, self._progress = monitor, yardstick, letters, progress
        self._began = time.monotonic()
        self._printed = 0
        self._said = ""

    def watch(self, processes: NodeProcesses, timeout: float) -> tuple[bool, str]:
        """Wait for the end; say whether it was a good one, and why not."""
        sound = time.monotonic()
        deadline = sound + timeout
        while time.monotonic() < deadline:
            self._monitor.spin(0.2)
            self._print_news()
            if news := processes.console_news(self._monitor.value(CONSOLE, "address")):
                self._print(news)
            if dead := processes.dead():
                name, code = next(iter(dead.items()))
                self._monitor.stop_arm()
                return False, f"{name} died (exit status {code}): {processes.log_tail(name, 1) or 'see its log'}"
            lesson = self._monitor.lesson
            if lesson.phase != LessonState.FAULT:
                sound = time.monotonic()
            elif time.monotonic() - sound > FAULT_S:
                return False, lesson.message
            if lesson.phase == LessonState.READY and (end := self._end()) is not None:
                return end
        return False, f"the lesson did not end within {timeout:.0f} s; it was {self._said or 'starting'}"

    def _end(self) -> tuple[bool, str] | None:
        """Say whether the person has ended, and how; None while they go on."""
        count, wanted = len(self._monitor.interactions), len(self._letters)
        if count >= wanted:
            return True, "every interaction was completed"
        outcome = self._monitor.value("sim_teacher", "outcome")
        if outcome == GAVE_UP:
            return False, f"the simulated person {self._monitor.diagnostics['sim_teacher'].message}"
        passed = int(self._monitor.value("sim_teacher", "passed") or 0)
        if outcome == DONE and count + passed >= wanted:
            return True, f"{count} interactions were completed; in {passed} the person had nothing to correct"
        return None

    def _print_news(self) -> None:
        for interaction in self._monitor.interactions[self._printed:]:
            self._printed += 1
            self._print(self._interaction_line(interaction))
        lesson = self._monitor.lesson
        said = f"{PHASES.get(lesson.phase, '?')}: {lesson.message}" if lesson.message else ""
        if said and said != self._said:
            self._said = said
            self._print(said)

    def _interaction_line(self, interaction: Interaction) -> str:
        executed = trajectory_from_msg(interaction.executed, self.yardstick.robot.joint_names)
        return (f"== interaction {interaction.index} of {len(self._letters)}, {KINDS[interaction.kind]}: "
                f"regret {self.yardstick.regret(executed):.2f}, "
                f"normalised {self.yardstick.normalised_regret(executed):.3f} "
                f"(trained {interaction.train_s:.2f} s, planned {interaction.plan_s:.2f} s)")

    def _print(self, text: str) -> None:
        print(f"[{time.monotonic() - self._began:6.1f} s] {text}", file=self._progress, flush=True)
