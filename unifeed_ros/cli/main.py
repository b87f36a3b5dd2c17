"""The command `unifeed`."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from unifeed_ros import __version__
from unifeed_ros.core.errors import UnifeedError

OK, FAILED, USER_MISTAKE, INTERRUPTED = 0, 1, 2, 130


def build_parser() -> argparse.ArgumentParser:
    """Build the whole command line."""
    from unifeed_ros.cli.bag import add_bag_commands
    from unifeed_ros.cli.bench import add_bench_command
    from unifeed_ros.cli.demo import add_demo_command
    from unifeed_ros.cli.doctor import add_doctor_command
    from unifeed_ros.cli.experiment import add_experiment_command
    from unifeed_ros.cli.learn import add_learn_command
    from unifeed_ros.cli.replay import add_replay_command
    from unifeed_ros.cli.teach import add_teach_command
    from unifeed_ros.cli.up import add_up_command

    parser = argparse.ArgumentParser(prog="unifeed", description="Teach a robot arm by touch.")
    parser.add_argument("--version", action="version", version=f"unifeed {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    add_demo_command(commands)
    add_up_command(commands)
    add_teach_command(commands)
    add_learn_command(commands)
    add_replay_command(commands)
    add_bag_commands(commands)
    add_bench_command(commands)
    add_experiment_command(commands)
    add_doctor_command(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words after `unifeed`; those of the process by default.

    Returns:
        Exit status: 0 on success, 1 if the work failed, 2 for a user's mistake, 130 after Ctrl-C or SIGTERM.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    signal.signal(signal.SIGTERM, _interrupt)
    options = build_parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except KeyboardInterrupt:
        print(f"unifeed {options.command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except UnifeedError as error:
        print(f"unifeed {options.command}: {' '.join(str(error).split())}", file=sys.stderr)
        return USER_MISTAKE


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
