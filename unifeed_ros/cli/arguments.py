"""Check what the user asked for before anything moves."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.recording import open_bag
from unifeed_ros.resources import config_path

SPEEDS = (0.05, 20.0)
"""Slowest and fastest run of the simulation [simulated seconds per second]."""


class UserMistake(UnifeedError):
    """Something on the command line, or about this machine, that the user can mend; exit status 2."""


def session_files(robot: str, task: str) -> tuple[Path, ...]:
    """Find the parameter files of a session.

    Args:
        robot: Name of a robot in config/robots, or a YAML file.
        task: Name of a task in config/tasks, or a YAML file.

    Returns:
        Files of the robot, the task and the session, in this order.

    Raises:
        ConfigError: An unknown name, or a file that is not there.
    """
    return config_path("robots", robot).resolve(), config_path("tasks", task).resolve(), config_path("", "session")


def prepare_folder(folder: Path) -> Path:
    """Make an output folder, or refuse one that holds a recording already.

    Args:
        folder: Wanted folder.

    Returns:
        The folder, absolute, existing and writeable.

    Raises:
        UserMistake: It cannot be made or written to.
    """
    folder = folder.expanduser().resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".unifeed-probe"
        probe.write_text("")
        probe.unlink()
    except OSError as error:
        raise UserMistake(f"folder {folder} cannot be used", got=error.strerror or str(error),
                          mend="give another one with --out") from error
    if (folder / "bag").exists():
        raise UserMistake(
            f"folder {folder} holds a recording already", mend="give another one with --out, or remove it"
        )
    return folder


def open_recording(folder: Path) -> Path:
    """Find a recording that is to be read; one that a crash left open is recovered first, and that is said on stderr.

    Args:
        folder: A bag, or the folder of a session.

    Returns:
        The bag.

    Raises:
        RecordingError: There is none, it is being recorded at this moment, or it cannot be recovered.
    """
    opened = open_bag(folder.expanduser())
    for report in opened.recovered:
        print(f"{opened.folder} was not closed: {report}", file=sys.stderr)
    return opened.folder


def require_speed(speed: float) -> float:
    """Refuse speeds that the simulation cannot run at.

    Args:
        speed: Simulated seconds per second.

    Returns:
        The speed.

    Raises:
        UserMistake: Outside 0.05 to 20.
    """
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise UserMistake("--speed", expected=f"{SPEEDS[0]} to {SPEEDS[1]:.0f}", got=speed)
    return speed


def require_letters(feedback: str) -> str:
    """Refuse inputs of a lesson that are none.

    Args:
        feedback: Letters.

    Returns:
        The letters.

    Raises:
        UserMistake: No letter, or another than D, C and P.
    """
    if not feedback or set(feedback) - set("DCP"):
        raise UserMistake("--feedback", expected="letters D, C and P, for example DDCCPP", got=feedback)
    return feedback


def domain() -> str:
    """Give the ROS domain of this process."""
    return os.environ.get("ROS_DOMAIN_ID", "0")


def add_console_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the teaching page to a command."""
    parser.add_argument("--console", action="store_true", help="with the teaching page, docs/console.md")
    parser.add_argument("--console-host", default="127.0.0.1", metavar="ADDRESS",
                        help="address that the page listens on; other machines need a token (default: 127.0.0.1)")
    parser.add_argument("--console-port", type=int, default=8080, metavar="PORT",
                        help="port of the page; the next free one is taken (default: 8080)")
    parser.add_argument("--console-coarse", action="store_true",
                        help="draw the arm coarsely, for tablets and machines without a graphics card")


def console_parameters(options: argparse.Namespace) -> Mapping[str, str | int | bool]:
    """Read the options of the teaching page.

    Args:
        options: Options of a command with the page.

    Returns:
        Parameters of the node `console` by name.

    Raises:
        UserMistake: The port is none.
    """
    if not 0 <= options.console_port <= 65535:
        raise UserMistake("--console-port", expected="0 to 65535", got=options.console_port)
    return {"host": options.console_host, "port": options.console_port, "coarse": options.console_coarse}
