"""The node `console` in a real session: it shows, it refuses, it costs the session nothing."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import viser
import websockets
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import session_files, start_session

from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_ros.console.state import KINDS, Phase
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos


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


@pytest.mark.timeout(240)
def test_a_session_goes_on_without_its_console(start_node, ros_node, spin_until, values, call):
    processes = start_session(start_node, console=True, console_parameters={"port": 0})
    lesson, teaching = LessonState(), TeachingState()

    def on_lesson(msg):
        nonlocal lesson
        lesson = msg

    def on_teaching(msg):
        nonlocal teaching
        teaching = msg

    ros_node.create_subscription(LessonState, "lesson_state", on_lesson, subscriber_qos("lesson_state"))
    ros_node.create_subscription(TeachingState, "teaching_state", on_teaching, subscriber_qos("teaching_state"))
    spin_until(lambda: lesson.phase == LessonState.READY and "address" in values, STARTUP_S, lambda: lesson.message)
    check_this_machine_only(values["address"])
    wrenches = []
    ros_node.create_subscription(WrenchStamped, "hand_wrench", wrenches.append, subscriber_qos("hand_wrench"))
    with socket.create_connection(("127.0.0.1", int(values["address"].rsplit(":", 1)[1].rstrip("/")))):
        pass  # a connection that says nothing and goes away
    end = time.monotonic() + 1.0
    spin_until(lambda: time.monotonic() > end, 5.0)
    assert not wrenches  # the hand is open until somebody pulls
    here = np.asarray(teaching.positions)
    processes["console"].send(signal.SIGKILL)
    end = time.monotonic() + 1.0
    spin_until(lambda: time.monotonic() > end, 5.0)
    assert lesson.phase == LessonState.READY
    assert np.abs(np.asarray(teaching.positions) - here).max() < 0.05
    assert call(Trigger, "start_demonstration").success
    assert call(Trigger, "pause").success


def check_this_machine_only(address):
    assert address.startswith("http://127.0.0.1:") and "token" not in address
    assert get(address)[0] == 200 and get(address, Host="evil.example")[0] == 403
    assert asyncio.run(connect(address)) == 101
    assert asyncio.run(connect(address, Origin="http://evil.example")) == 403
    port = int(address.rsplit(":", 1)[1].rstrip("/"))
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port]
    assert listening and all(place.startswith("0100007F") for place in listening)
