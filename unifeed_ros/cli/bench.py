"""`unifeed bench NAME`: the project's figures, measured again on this machine."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

BENCHMARKS = ("capture", "reward", "planner", "context", "lesson", "reliability", "queries", "loop", "faults",
              "recording", "console")
"""Each has a module unifeed_ros.cli.bench_<name> with a function run(options), loaded only when it is asked for."""


def add_bench_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `bench` to the command line."""
    parser = commands.add_parser("bench", help="measure the figures that the documentation gives")
    names = parser.add_subparsers(dest="benchmark", required=True, metavar="NAME")
    added = {}
    for name, text in (("capture", "what is found of simulated pushes on a moving arm, and when"),
                       ("reward", "training beside the paper's procedure, with the quality of both"),
                       ("planner", "plans beside SciPy's SLSQP on the very same problems"),
                       ("context", "taught at two goals, tested at new goals and object places"),
                       ("lesson", "whole lessons, and how far the last motion is from the best"),
                       ("reliability", "people biased in one kind of feedback: regret with weights and without"),
                       ("queries", "regret by the number of questions, chosen ones beside random ones"),
                       ("loop", "the control loop under load, beside a bare pair that only echoes"),
                       ("faults", "every fault tried against the running nodes: how soon the arm stops, what is said"),
                       ("recording", "what the recorder loses, costs and withstands, beside mcap_ros2's writer"),
                       ("console", "the teaching page: pose lag, updates, clicks, processor time, with a page open and "
                                   "without"),
                       ("all", "all of them, each with its defaults")):
        added[name] = names.add_parser(name, help=text, description=text)
        added[name].add_argument("--json", action="store_true", help="print JSON")
        added[name].set_defaults(run=run_bench)
    _add_capture_options(added["capture"])
    _add_reward_options(added["reward"])
    _add_planner_options(added["planner"])
    _add_context_options(added["context"])
    _add_lesson_options(added["lesson"])
    _add_reliability_options(added["reliability"])
    _add_query_options(added["queries"])
    _add_loop_options(added["loop"])
    _add_fault_options(added["faults"])
    _add_recording_options(added["recording"])
    added["console"].add_argument("--presses", type=int, default=30, help="presses of STOP (default: 30)")
    added["all"].set_defaults(parser=parser)


def run_bench(options: argparse.Namespace) -> int:
    """Run one benchmark, or all; 0 only if everything was completed."""
    if options.benchmark != "all":
        return int(import_module(f"unifeed_ros.cli.bench_{options.benchmark}").run(options))
    more = ["--json"] if options.json else []
    return max(run_bench(options.parser.parse_args([name, *more])) for name in BENCHMARKS)


def _add_capture_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", default="panda", help="the robot (default: panda)")
    parser.add_argument("--pushes", type=int, default=1000, help="pushes, 3 to 30 N, 0.15 to 5 s (default: 1000)")
    parser.add_argument("--minutes", type=float, default=30.0, help="free motion [simulated min] (default: 30)")
    parser.add_argument("--hits", type=int, default=100, help="hits, 60 to 200 N, 15 to 40 ms (default: 100)")
    parser.add_argument("--source", default="joint_state",
                        help="where external torque comes from: joint_state, wrench or momentum (default: joint_state)")
    parser.add_argument("--seed", type=int, default=0, help="seed of sensors, motion and pushes (default: 0)")
    parser.add_argument("--jobs", type=int, default=1, help="processes at once (default: 1)")


def _add_reward_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--people", type=int, default=3, help="simulated people a task (default: 3)")
    parser.add_argument("--repeats", type=int, default=3, help="trainings that a time is the median of (default: 3)")
    parser.add_argument("--horizons", type=int, nargs="+", default=[10, 40], metavar="H",
                        help="numbers of way-points (default: 10 40)")


def _add_planner_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", action="append", help="only this robot (may be repeated; default: panda, ur10)")
    parser.add_argument("--task", action="append", help="only this task (may be repeated; default: table, laptop, cup)")
    parser.add_argument("--waypoints", type=int, action="append", metavar="H",
                        help="only this number of way-points (may be repeated; default: 20, 40)")
    parser.add_argument("--pairs", type=int, default=50, help="start-goal pairs a task (default: 50)")
    parser.add_argument("--peer-pairs", type=int, default=5,
                        help="pairs that the other solvers and SLSQP with exact gradients solve too (default: 5)")
    parser.add_argument("--fd-pairs", type=int, default=1,
                        help="of these, pairs that SLSQP with finite differences solves too (default: 1)")
    parser.add_argument("--starts", type=int, default=1,
                        help="plan from as many starts too, with and without giving up early (default: 1, which is "
                             "measured in any case)")
    parser.add_argument("--zones", action="store_true",
                        help="a laptop's box and a person's capsule that the whole arm keeps out of; plans are checked "
                             "with the arm's meshes too")
    parser.add_argument("--places", action="store_true",
                        help="the same, at other random places in each problem; some cannot be solved then")
    parser.add_argument("--limits", action="store_true",
                        help="a cone, a slow zone, a speed and a workspace that the tool keeps to")
    parser.add_argument("--peer-limit", type=float, default=60.0,
                        help="processor time after which SLSQP is ended; its times are lower bounds then [s] "
                             "(default: 60)")
    parser.add_argument("--results", type=Path, metavar="FILE",
                        help="keep each problem's figures in this file, and go on from what it holds already")
    parser.add_argument("--action", type=int, default=0, metavar="N",
                        help="instead of all that: cancel N goals of the running node at random moments (needs a free "
                             "ROS_DOMAIN_ID)")


def _add_context_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", default="panda", help="the robot (default: panda)")
    parser.add_argument("--task", action="append", help="only this task (may be repeated; default: all)")
    parser.add_argument("--people", type=int, default=3, help="simulated people a task (default: 3)")
    parser.add_argument("--goals", type=int, default=10, help="new goals a task (default: 10)")
    parser.add_argument("--feedback", default="DCPDCP", metavar="LETTERS",
                        help="what is taught, at the two goals in turn (default: DCPDCP)")


def _add_lesson_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", action="append", help="only this robot (may be repeated; default: panda, ur10)")
    parser.add_argument("--task", action="append", help="task (may be repeated; default: table)")
    parser.add_argument("--feedback", type=str.upper, default="DDCCPP", help="inputs of a lesson (default: DDCCPP)")
    parser.add_argument("--jobs", type=int, default=1, help="lessons at once (default: 1); the nodes of each need "
                        "two cores")
    parser.add_argument("--seeds", type=int, help="number of seeds a robot (default: 10 for panda, 5 for ur10)")
    parser.add_argument("--in-process", action="store_true",
                        help="without ROS, in one process, many times faster than real time; the same core code")
    parser.add_argument("--speed", type=float, default=1.0, help="simulated seconds per second (default: 1)")
    parser.add_argument("--out", type=Path, help="folder for the lessons (default: out/bench-<date>-<time>)")


def _add_reliability_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--task", action="append", help="only this task (may be repeated; default: table, cup)")
    parser.add_argument("--people", action="append", metavar="KIND",
                        help="only these people (may be repeated): sound, short demonstrations, careless corrections, "
                             "careless rankings")
    parser.add_argument("--seeds", type=int, default=20, help="people of each kind a task (default: 20)")


def _add_query_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--people", type=int, default=50, help="simulated people (default: 50)")
    parser.add_argument("--questions", type=int, default=16, help="questions to each (default: 16)")
    parser.add_argument("--demonstrated", action="store_true", help="show one motion before the questions")


def _add_loop_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, default=60.0, help="time under load [s] (default: 60)")
    parser.add_argument("--corrections", type=int, default=8, help="corrections of the lesson before (default: 8)")
    parser.add_argument("--out", type=Path, help="folder for logs and figures (default: out/bench-loop-<date>-<time>)")


def _add_fault_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--tries", type=int, default=20, help="tries of each fault (default: 20)")
    parser.add_argument("--fault", action="append", metavar="NAME", help="only this fault (may be repeated)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments at which faults begin (default: 0)")
    parser.add_argument("--out", type=Path,
                        help="folder for logs and the recording (default: out/bench-faults-<date>-<time>)")


def _add_recording_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the live session (default: 10)")
    parser.add_argument("--kills", type=int, default=100, help="recorders that are killed (default: 100)")
    parser.add_argument("--peer-messages", type=int, default=200_000,
                        help="most messages that the peers write too (default: 200000)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments of the kills (default: 0)")
