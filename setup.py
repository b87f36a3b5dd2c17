"""Package description for colcon (ament_python) and pip."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from setuptools import Command, find_packages, setup
from setuptools.command.develop import develop
from setuptools.command.install import install

PACKAGE = "unifeed_ros"
MESSAGES = "unifeed_msgs"
HERE = Path(__file__).resolve().parent
NODES = ("sim_arm", "sim_teacher", "capture", "reward_learner", "trajectory_optimizer", "shared_control", "session",
         "recorder", "console")
DATA = ("config", "launch", "msg_docs")


def data_files() -> list[tuple[str, list[str]]]:
    """List what is installed below share/, with the folders of the source tree kept."""
    share = f"share/{PACKAGE}"
    files = [("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]), (share, ["package.xml"])]
    for top in DATA:
        for folder in [HERE / top, *sorted(p for p in (HERE / top).rglob("*") if p.is_dir())]:
            names = sorted(p.relative_to(HERE).as_posix() for p in folder.glob("*")
                           if p.suffix in {".yaml", ".py", ".md", ".rviz"})
            if names:
                files.append((f"{share}/{folder.relative_to(HERE).as_posix()}", names))
    return files


def messages_are_built() -> bool:
    """Look for the message package in the prefixes that colcon or a sourced ROS names."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return any(Path(p, "share/ament_index/resource_index/packages", MESSAGES).exists() for p in prefixes if p)


def build_messages(command: Command, prefix: str) -> None:
    """Build the nested message package into the same prefix.

    colcon stops descending at the first package.xml, so a plain `colcon build` in a workspace never sees the nested
    package. Where colcon was told of it, it has been built before this package, and nothing happens here.
    """
    if messages_are_built():
        return
    print(f"{MESSAGES} was not built before {PACKAGE}: building it into {prefix}", flush=True)
    build = Path(command.get_finalized_command("build").build_base).absolute() / MESSAGES
    jobs = str(os.cpu_count() or 1)
    subprocess.run(["cmake", "-S", str(HERE / MESSAGES), "-B", str(build), f"-DCMAKE_INSTALL_PREFIX={prefix}",
                    "-DBUILD_TESTING=OFF"], check=True)
    subprocess.run(["cmake", "--build", str(build), "--parallel", jobs, "--target", "install"], check=True)


class InstallWithMessages(install):
    """`setup.py install` as colcon calls it; a wheel (root is set) never builds messages."""

    def run(self) -> None:
        """Install, then see to the messages."""
        super().run()
        if self.root is None:
            build_messages(self, self.install_base)


class DevelopWithMessages(develop):
    """`setup.py develop` as `colcon build --symlink-install` calls it."""

    def run(self) -> None:
        """Link, then see to the messages."""
        super().run()
        build_messages(self, sys.prefix)


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Teach robot arms by touch: demonstrations, corrections and preferences become one reward.",
    license="Apache-2.0",
    maintainer="unifeed maintainers",
    maintainer_email="maintainers@unifeed.org",
    python_requires=">=3.11",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=data_files(),
    zip_safe=False,
    entry_points={"console_scripts": [*(f"{name} = {PACKAGE}.nodes.{name}:main" for name in NODES),
                                      f"unifeed = {PACKAGE}.cli.main:main"]},
    cmdclass={"install": InstallWithMessages, "develop": DevelopWithMessages},
)
