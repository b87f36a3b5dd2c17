"""What the tests of whole sessions share."""

from __future__ import annotations

import contextlib
from pathlib import Path

from unifeed_ros.nodes.table import SessionSetup, node_table
from unifeed_ros.resources import config_path


def session_files(robot="panda", task="table"):
    return (config_path("robots", robot), config_path("tasks", task), config_path("", "session"))


def start_session(start_node, bag=None, changes=None, **setup):
    """Start the nodes of a session without a supervisor; gives the processes by name.

    changes are parameters by node name that the table does not give.
    """
    processes = {}
    changes = {"session": {"session.steady": 0.7}, **(changes or {})}
    for spec in node_table(SessionSetup(parameter_files=session_files(), bag=bag, **setup)):
        parameters = {**spec.parameters, **changes.get(spec.executable, {})}
        processes[spec.executable] = start_node(spec.executable, parameters, parameter_files=spec.parameter_files)
    return processes


def nodes_left_behind(domain_id):
    """Look for node processes of this domain, however they were started; gives their command lines."""
    found = []
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            environment = (process / "environ").read_bytes().split(b"\0")
            if "unifeed_ros.nodes" in command and f"ROS_DOMAIN_ID={domain_id}".encode() in environment:
                found.append(command)
    return found
