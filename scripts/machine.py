"""What set-up needs to know of the machine: which Python, which ROS, which compilers."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass

DISTRO = "jazzy"
CANDIDATES = ("python3.11", "python3.12", "python3.13", "python3")
VERSIONS = ((3, 11), (3, 12), (3, 13))

PROBE = """
import json, os, sys, sysconfig
def imports(*names):
    try:
        return bool([__import__(name) for name in names])
    except ImportError:
        return False
print(json.dumps({"path": getattr(sys, "_base_executable", sys.executable), "version": sys.version_info[:2],
    "venv": imports("venv", "ensurepip"), "rclpy": bool(os.environ.get("ROS_DISTRO")) and imports("rclpy"),
    "headers": os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h"))}))
"""


class SetupError(Exception):
    """Something is missing; the message says in one line what, and how to get it."""


class KilledError(SetupError):
    """A command was ended from outside, and may have left half of its work."""


@dataclass(frozen=True)
class Interpreter:
    """One Python, as it described itself."""

    path: str
    """Its executable, outside any virtual environment."""
    version: tuple
    """Major and minor version."""
    venv: bool
    """True if it can make virtual environments."""
    rclpy: bool
    """True if a ROS is sourced and it imports rclpy."""
    headers: bool
    """True if extension modules can be compiled for it."""


@dataclass(frozen=True)
class Choice:
    """What the environment is made from."""

    ros: str
    """Where ROS comes from: "wheels" or "sourced"."""
    python: Interpreter
    """The Python that runs everything."""


def probe(command: str) -> Interpreter | None:
    """Ask a Python about itself.

    Args:
        command: Its name or path.

    Returns:
        What it said; None where it is not there or does not run.
    """
    try:
        answer = subprocess.run([command, "-c", PROBE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
        values = json.loads(answer.stdout)
    except (OSError, subprocess.CalledProcessError, ValueError):
        return None
    return Interpreter(**{**values, "version": tuple(values["version"])})


def choose(environ: Mapping[str, str], ask: Callable[[str], Interpreter | None]) -> Choice:
    """Decide where ROS comes from and which Python runs.

    Args:
        environ: Environment variables.
        ask: Function that describes a Python, as `probe`.

    Returns:
        The decision.

    Raises:
        SetupError: Another ROS is sourced, or no suitable Python is there.
    """
    distro = environ.get("ROS_DISTRO")
    with_ros = [python for python in map(ask, ("python3", "/usr/bin/python3") if distro else ()) if python]
    with_ros = [python for python in with_ros if python.rclpy]
    if with_ros and distro != DISTRO:
        raise SetupError(f"ROS {distro} is sourced, this project needs {DISTRO}: open a shell without it")
    if with_ros:
        return Choice("sourced", check_python(with_ros[0]))
    found = [python for python in map(ask, CANDIDATES) if python]
    suitable = [python for python in found if python.version in VERSIONS]
    if not suitable:
        seen = ", ".join(sorted({"{}.{}".format(*p.version) for p in found})) or "none"
        raise SetupError(f"Python 3.11, 3.12 or 3.13 is needed, found {seen}: sudo apt install python3.11 "
                         "python3.11-venv python3.11-dev (or the same of 3.12 or 3.13)")
    complete = [python for python in suitable if python.venv and python.headers]
    return Choice("wheels", complete[0] if complete else check_python(suitable[0]))


def check_python(python: Interpreter) -> Interpreter:
    """Refuse a Python that cannot make virtual environments or compile extension modules."""
    name = "python{}.{}".format(*python.version)
    packages = [] if python.venv else [f"{name}-venv"]
    packages += [] if python.headers else [f"{name}-dev"]
    if packages:
        raise SetupError(f"{python.path} lacks {' and '.join(packages)}: sudo apt install {' '.join(packages)}")
    return python


def check_tools(choice: Choice, which: Callable[[str], str | None] = shutil.which) -> None:
    """Refuse a machine without compilers, or a sourced ROS without colcon.

    Raises:
        SetupError: Names all that is missing.
    """
    missing = [names[0] for names in (("gcc", "cc"), ("g++", "c++")) if not any(map(which, names))]
    if missing:
        raise SetupError(f"no {' and no '.join(missing)}: sudo apt install build-essential")
    if choice.ros == "sourced" and not which("colcon"):
        raise SetupError("ROS is sourced but colcon is not there: sudo apt install python3-colcon-common-extensions")
