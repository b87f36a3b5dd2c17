"""Launch descriptions made from the table of nodes; imported by launch/*.launch.py only, where ROS launch is there."""

from __future__ import annotations

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from unifeed_ros.nodes.table import SessionSetup, node_table
from unifeed_ros.resources import config_path

ARGUMENTS = {
    "robot": ("panda", "panda or ur10, or a YAML file"),
    "task": ("table", "table, laptop, cup or proximity, or a YAML file"),
    "bag": ("", "folder of the recording; empty: nothing is recorded"),
    "seed": ("0", "seed of the training and of the questions"),
    "console": ("false", "true: with the teaching page in the browser"),
    "console_host": ("127.0.0.1", "address that the page listens on; other machines need a token"),
    "console_port": ("8080", "port of the page; the next free one is taken"),
}
"""Arguments of every launch file: default and description."""

SIMULATION_ARGUMENTS = {
    "teacher": ("", "inputs of a simulated person, for example DDCCPP; empty: nobody touches the arm"),
    "speed": ("1.0", "simulated seconds per second"),
}
"""Further arguments where the arm is simulated."""


def describe_session(*, simulated: bool) -> LaunchDescription:
    """Describe a session as `unifeed up` starts it.

    Args:
        simulated: True: with the simulated arm in place of the robot's driver.

    Returns:
        The description, with its arguments.
    """
    arguments = {**ARGUMENTS, **(SIMULATION_ARGUMENTS if simulated else {})}
    declared = [DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in arguments.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=_session_nodes, args=[simulated])])


def _session_nodes(context: LaunchContext, simulated: bool) -> list[Node]:
    """Turn the launch arguments into the nodes of the table."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    files = (config_path("robots", value("robot")), config_path("tasks", value("task")), config_path("", "session"))
    setup = SessionSetup(
        parameter_files=tuple(path.resolve() for path in files), simulated=simulated, seed=int(value("seed")),
        taught_by=value("teacher").upper() if simulated else "", speed=float(value("speed")) if simulated else 1.0,
        bag=Path(value("bag")).expanduser().resolve() if value("bag") else None,
        console=value("console").lower() == "true",
        console_parameters={"host": value("console_host"), "port": int(value("console_port"))})
    return [Node(package="unifeed_ros", executable=spec.executable, name=spec.executable, output="screen",
                 arguments=spec.arguments()) for spec in node_table(setup)]
