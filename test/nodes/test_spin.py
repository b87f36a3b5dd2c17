"""The flag that signals raise, each case in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

PROCESS = """
import os, signal, sys
from unifeed_ros.nodes.spin import StopSignal

place, seen = int(sys.argv[1]), []

def interrupt(frame, event, argument):
    if event == "line" and len(seen) <= place and any(f.f_code.co_name == "_on_signal" for f in callers(frame)):
        seen.append(frame.f_lineno)
        if len(seen) == place + 1:
            signal.raise_signal(signal.SIGTERM)
    return interrupt

def callers(frame):
    while frame is not None:
        yield frame
        frame = frame.f_back

stop = StopSignal()
stop.install()
sys.settrace(interrupt)
signal.raise_signal(signal.SIGTERM)
sys.settrace(None)
print(stop.raised, len(seen) > place, flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("place", [*range(12), 20, 40])
def test_a_signal_in_the_middle_of_the_handler_of_another_one_does_no_harm(place):
    """Linux tells of a parent's death once for each of its threads, microseconds apart."""
    result = subprocess.run([sys.executable, "-c", PROCESS, str(place)], capture_output=True, text=True, timeout=20,
                            check=True)
    assert result.stdout == "True True\n"
