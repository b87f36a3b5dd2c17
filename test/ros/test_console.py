"""The node `console` in a real session: it shows, it refuses, it costs the session nothing."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import rclpy
import viser
import websockets
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import session_files, start_session

from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_msgs.srv import ListFeedback
from unifeed_ros.cli.page_client import PageClient
from unifeed_ros.console.state import KINDS, Phase, allowed
from unifeed_ros.console.terminal import TeachingTerminal
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.terminal import TerminalNode, parameters_of_session
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.resources import config_path


def test_phases_are_those_of_the_message():
    wanted = {name: getattr(LessonState, name) for name in Phase.__members__}
    assert {phase.name: int(phase) for phase in Phase} == wanted


def test_kinds_are_those_of_the_message():
    from unifeed_msgs.msg import Feedback

    assert {number: getattr(Feedback, word.upper()) for number, word in KINDS.items()} == {1: 1, 2: 2, 3: 3}


STARTUP_S = 110.0
"""Longest time in which the page is there on a busy machine: it loads the arm's meshes [s]."""


@pytest.fixture
def values(ros_node):
    """What the console says on /diagnostics, newest first."""
    found = {}

    def listen(msg):
        for status in msg.status:
            if status.name.endswith("console"):
                found.update({pair.key: pair.value for pair in status.values})

    ros_node.create_subscription(DiagnosticArray, "/diagnostics", listen, publisher_qos("diagnostics"))
    return found


def get(address, **headers):
    request = urllib.request.Request(address, headers=headers)
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(request, timeout=20) as answer:
            return answer.status, dict(answer.headers)
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers)


async def connect(address, **headers):
    """Open the page's connection as the page does; gives the status that it was refused with, or 101."""
    try:
        async with websockets.connect(address.replace("http", "ws"), proxy=None, additional_headers=headers,
                                      subprotocols=[f"viser-v{viser.__version__}"]):
            return 101
    except websockets.exceptions.InvalidStatus as refusal:
        return refusal.response.status_code


def test_other_machines_need_the_token_for_page_and_connection(start_node, spin_until, values):
    start_node("console", {"console.host": "0.0.0.0", "console.port": 0}, parameter_files=session_files())
    spin_until(lambda: "address" in values, STARTUP_S)
    address = values["address"]
    bare, _, token = address.partition("?token=")
    assert len(token) >= 20
    assert get(bare)[0] == 403 and get(bare + "?token=wrong")[0] == 403
    status, headers = get(address)
    assert status == 200 and token in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert get(bare, Cookie=cookie)[0] == 200
    assert asyncio.run(connect(bare)) == 403
    assert asyncio.run(connect(bare, Cookie=cookie)) == 101
    assert asyncio.run(connect(bare, Cookie=cookie, Origin="http://evil.example")) == 403


class Watcher:
    """Listens to a session."""

    def __init__(self, node, spin_until):
        self.lesson, self.teaching, self.spin_until = LessonState(), TeachingState(), spin_until
        node.create_subscription(LessonState, "lesson_state", self._on_lesson, subscriber_qos("lesson_state"))
        node.create_subscription(TeachingState, "teaching_state", self._on_teaching, subscriber_qos("teaching_state"))

    def _on_lesson(self, msg):
        self.lesson = msg

    def _on_teaching(self, msg):
        self.teaching = msg

    def wait(self, condition, timeout=60.0):
        self.spin_until(condition, timeout, lambda: f"(lesson: {self.lesson.message}; arm: {self.teaching.message})")

    def spin(self, duration):
        end = time.monotonic() + duration
        self.wait(lambda: time.monotonic() > end)


@pytest.mark.timeout(300)
def test_a_person_teaches_from_one_page_while_another_watches(start_node, ros_node, spin_until, values, call):
    processes = start_session(start_node, console=True, console_parameters={"port": 0, "coarse": True},
                              changes={"session": {"session.node_timeout": 30.0}})  # the meshes keep a machine busy
    session, wrenches = Watcher(ros_node, spin_until), []
    ros_node.create_subscription(WrenchStamped, "hand_wrench", wrenches.append, subscriber_qos("hand_wrench"))
    session.wait(lambda: session.lesson.phase == LessonState.READY and "address" in values, STARTUP_S)
    check_this_machine_only(values["address"])
    first = PageClient(values["address"])
    session.wait(lambda: first.can_press("Show a motion") and "You teach from this page" in first.text())
    second = PageClient(values["address"])
    session.wait(lambda: "You are watching" in second.text())
    assert not wrenches  # the hand is open until somebody pulls

    second.press("Show a motion")  # a page that watches gives no command, whatever it sends
    session.wait(lambda: any("another page has control" in note for note in second.notes))
    assert session.lesson.phase == LessonState.READY
    first.press("I have finished")  # nor does one in control, at the wrong time
    session.wait(lambda: any("Not now" in note for note in first.notes))

    first.press("Show a motion")
    session.wait(lambda: session.teaching.mode == TeachingState.GUIDE)
    robot, scene = RobotModel(load_robot(config_path("robots", "panda"))), load_scene(config_path("tasks", "table"))
    tool = robot.tool_pose(np.asarray(session.teaching.positions))[0]
    way = np.linspace(tool, [*scene.goal[:2], 0.3], 30)
    second.pull(way[:3])
    assert not wrenches
    pulling = threading.Thread(target=first.pull, args=(way, 0.2))
    pulling.start()
    session.wait(lambda: not pulling.is_alive())
    session.spin(1.0)
    assert len(wrenches) > 20 and wrenches[-1].wrench.force.x == 0.0, processes["console"].output  # the mouse let go
    assert max(np.hypot(w.wrench.force.x, w.wrench.force.y) for w in wrenches) > 5.0
    moved = robot.tool_pose(np.asarray(session.teaching.positions))[0]
    assert np.linalg.norm(moved - tool) > 0.2 and len(first.places) > 30, session.teaching.message
    first.press("I have finished")
    session.wait(lambda: session.lesson.phase == LessonState.SHOWING)
    session.wait(lambda: "You showed a motion" in first.text() and "You showed a motion" in second.text())

    second.press("STOP")  # what ends motion is open to every page
    session.wait(lambda: session.teaching.mode == TeachingState.STOPPED)
    session.wait(lambda: session.lesson.phase == LessonState.FAULT and first.can_press("Discard the last") is False)
    first.close()  # the page in control goes away: nothing moves, the other one may go on
    session.wait(lambda: "You teach from this page" in second.text() and second.can_press("Back to start"))
    second.press("Back to start")
    session.wait(lambda: session.lesson.phase == LessonState.READY and second.can_press("Discard the last"))
    second.press("Discard the last")
    session.wait(lambda: call(ListFeedback, "list_feedback").ids == [])
    session.wait(lambda: second.can_press("Give it back"))
    second.press("Give it back")
    session.wait(lambda: call(ListFeedback, "list_feedback").ids == ["demonstration-1"])

    asyncio.run(teach_from_a_terminal(ros_node.context, session, second))
    session.wait(lambda: "You teach from this page" in second.text())  # the terminal died in control, without a word

    here = np.asarray(session.teaching.positions)
    processes["console"].send(signal.SIGKILL)
    session.spin(1.0)
    assert session.lesson.phase == LessonState.READY
    assert np.abs(np.asarray(session.teaching.positions) - here).max() < 0.05
    assert call(Trigger, "start_demonstration").success and call(Trigger, "pause").success


async def teach_from_a_terminal(context, session, page):
    """Take control from a page, teach with keys, and leave like a connection that broke."""
    asking, executor = rclpy.create_node("asks", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(asking)
    node = TerminalNode(parameters_of_session(asking, executor), context=context)
    executor.add_node(node)
    ended = threading.Event()
    thread = threading.Thread(target=lambda: [executor.spin_once(0.05) for _ in iter(ended.is_set, True)])
    thread.start()
    app = TeachingTerminal(node)
    async with app.run_test(size=(100, 30)) as pilot:
        async def wait(happened):
            end = time.monotonic() + 60.0
            while not happened():
                assert time.monotonic() < end, (app.export_screenshot(), node.view())
                session.spin(0.05)
                await pilot.pause(0.05)

        def control():
            return str(app.query_one("#control").content)

        await wait(lambda: "a page (console" in control() and node.view().phase is Phase.READY)
        await wait(lambda: app.query_one("DataTable").row_count == 1)
        await pilot.press("d")  # it only watches
        await pilot.press("c")
        await wait(lambda: control() == "You teach from this terminal.")
        await wait(lambda: "You are watching: a terminal on" in page.text())
        assert session.lesson.phase == LessonState.READY
        page.press("Show a motion")
        await wait(lambda: any("a terminal on" in note for note in page.notes))
        assert session.lesson.phase == LessonState.READY
        await pilot.press("d")
        await wait(lambda: session.lesson.phase == LessonState.DEMONSTRATING)
        await pilot.press("escape")
        await wait(lambda: session.teaching.mode == TeachingState.STOPPED)
        await wait(lambda: node.view().phase is Phase.FAULT)
        await pilot.press("r")
        await wait(lambda: session.lesson.phase == LessonState.READY and "undo" in allowed(node.view()))
        await pilot.press("u")
        await wait(lambda: node.view().items[0].taken_back and "forgotten" in map(
            str, app.query_one("DataTable").get_row_at(0)))
    ended.set()
    thread.join()
    executor.shutdown()
    node.destroy_node()
    asking.destroy_node()


def check_this_machine_only(address):
    assert address.startswith("http://127.0.0.1:") and "token" not in address
    assert get(address)[0] == 200 and get(address, Host="evil.example")[0] == 403
    assert asyncio.run(connect(address)) == 101
    assert asyncio.run(connect(address, Origin="http://evil.example")) == 403
    port = int(address.rsplit(":", 1)[1].rstrip("/"))
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port]
    assert listening and all(place.startswith("0100007F") for place in listening)
