"""A whole lesson by clicks alone, in a headless browser."""

from __future__ import annotations

import socket
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from browser import Visitor, open_browser, require_browser

from unifeed_msgs.msg import TeachingState
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.topics import subscriber_qos
from unifeed_ros.resources import config_path

SPEED = "0.3"
"""The browser draws without a graphics card on the cores that the arm needs."""


@pytest.fixture
def visitor(tmp_path):
    require_browser()
    browser = open_browser(tmp_path / "profile")
    yield Visitor(browser)
    browser.quit()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.experiment
@pytest.mark.timeout(900)
def test_a_whole_lesson_by_clicks(visitor, start_process, ros_node, spin_until, tmp_path):
    port = free_port()
    session = start_process([sys.executable, "-m", "unifeed_ros.cli.main", "up", "--robot", "panda", "--sim",
                             "--speed", SPEED, "--console", "--console-coarse", "--console-port", port,
                             "--out", tmp_path / "out"])
    session.wait_for("teaching page:", 120.0)
    robot, scene = RobotModel(load_robot(config_path("robots", "panda"))), load_scene(config_path("tasks", "table"))
    teaching = TeachingState()

    def listen(msg):
        nonlocal teaching
        teaching = msg

    def tool():
        now = time.monotonic()
        spin_until(lambda: time.monotonic() > now + 0.1)
        return robot.tool_pose(np.asarray(teaching.positions))[0]

    def running():
        return "If the motion is wrong" in visitor.request() and (tool(), teaching.motion_time > 0.0)[1]

    ros_node.create_subscription(TeachingState, "teaching_state", listen, subscriber_qos("teaching_state"))
    print(f"page there after {visitor.open(f'http://127.0.0.1:{port}/'):.1f} s", flush=True)
    visitor.get_ready()
    visitor.look("ready")

    def demonstrate():
        visitor.press("Show a motion")
        if not visitor.wait_or_stop(lambda: (tool(), teaching.mode == TeachingState.GUIDE)[1], "weightless"):
            return
        visitor.wait(lambda: "lead it to the goal" in visitor.request(), "guiding")
        low = np.array([0.35, -0.1, 0.15])
        visitor.grab(tool())
        visitor.drag([*np.linspace(tool(), low, 12)[1:], *np.linspace(low, scene.goal, 12)[1:]], "demonstration")
        moved = tool()
        assert np.linalg.norm(moved - scene.start) > 0.2, f"the mouse moved the hand to {moved} only"
        visitor.press("I have finished")
        visitor.wait(lambda: not visitor.can_press("Show a motion"), "the robot learns")

    def correct():
        here = tool()
        visitor.grab(here)  # a picture as late as this browser's shows a moving hand where it is no more
        visitor.press("Try it")
        visitor.wait_or_stop(running, "running")
        visitor.drag(np.linspace(here, [*here[:2], 0.1], 8)[1:], "correction")

    def answer():
        visitor.press("Ask me")
        if not visitor.wait_or_stop(lambda: visitor.can_press("A was better"), "question"):
            return
        time.sleep(2.0)
        visitor.look("question")
        visitor.press("A was better")
        visitor.wait(lambda: not visitor.can_press("A was better"), "the robot learns from the answer")

    visitor.teach(1, demonstrate)
    visitor.look("learned")
    visitor.teach(2, correct)
    visitor.look("corrected")
    visitor.teach(3, answer)
    visitor.open_tab("Taught")
    visitor.look("taught")
    visitor.press("Forget 1")
    visitor.wait(lambda: visitor.button("Give 1 back") is not None, "undo")
    visitor.look("undone")
    visitor.open_tab("Look")
    visitor.look("look")
    visitor.open_tab("Health")
    visitor.look("health")
    visitor.open_tab("Teach")
    visitor.wait(lambda: visitor.can_press("Save (S)"), "save")
    visitor.press("Save (S)")
    visitor.wait(lambda: visitor.reads("saved ") and visitor.has_done(4), "saved")
    visitor.look("saved")
    saved = Path(visitor.find(r"saved (\S+\.safetensors)"))
    assert saved.stat().st_size > 1000
    saved.unlink()
    visitor.press("STOP")
    visitor.wait(lambda: visitor.words("who").endswith("the arm holds"), "stopped")
    visitor.look("stopped")
    check_hosts(visitor.browser)


def check_hosts(browser):
    """Everything that the page fetched, or tried to, was on this machine."""
    script = "return performance.getEntries().filter(e => ['navigation', 'resource'].includes(e.entryType))"
    addresses = browser.execute_script(script + ".map(e => e.name)")
    hosts = {urlsplit(address).hostname for address in addresses if address.startswith(("http", "ws"))}
    assert len(addresses) < 250, "the browser keeps no more than 250"
    assert hosts == {"127.0.0.1"}
