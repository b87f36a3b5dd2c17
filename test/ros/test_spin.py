from __future__ import annotations

import signal
import sys

import pytest
from std_msgs.msg import String

NODE = """
import sys, time
from rclpy.node import Node
from std_msgs.msg import String
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.nodes import spin

mode = sys.argv[1]

class Example(Node):
    def __init__(self):
        super().__init__("example")
        if mode == "refuses":
            raise ConfigError("goal", expected="within reach", got="(9, 9, 9)")
        self.words = self.create_publisher(String, "words", 10)
        self.ticks = 0
        self.create_timer(0.01, self.tick)
        print("up", flush=True)

    def tick(self):
        self.ticks += 1
        if self.ticks % 20 == 0:
            print("heard by", self.words.get_subscription_count(), flush=True)
        if self.ticks < 20:
            return
        if mode == "hangs":
            print("hanging", flush=True)
            time.sleep(60)
        elif mode == "ends":
            self.exit_status = 3
        elif mode == "fails":
            raise ConfigError("too late")
        elif mode == "bug":
            raise ValueError("a bug")

    def close(self):
        self.words.publish(String(data="last words"))
        time.sleep(0.2)
        print("closed", flush=True)

if mode == "fallback":
    spin._runs_a_timer = lambda executor, node: False
sys.exit(spin.run_node(Example, ["example", *sys.argv[2:]]))
"""


@pytest.fixture
def start(start_process):
    def run(mode, *arguments):
        return start_process([sys.executable, "-c", NODE, mode, *arguments], name=mode)

    return run


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("mode", ["runs", "fallback"])
def test_a_signal_lets_the_node_say_its_last_words(start, ros_node, spin_until, mode, number):
    heard = []
    ros_node.create_subscription(String, "words", lambda m: heard.append(m.data), 10)
    process = start(mode)
    process.wait_for("heard by 1")
    status, seconds = process.stop(number)
    assert status == 0, process.output
    assert seconds < 2.0
    assert process.output.count("closed") == 1
    spin_until(lambda: heard == ["last words"])


def test_a_node_that_hangs_is_ended_within_three_seconds(start):
    process = start("hangs")
    process.wait_for("hanging")
    status, seconds = process.stop(signal.SIGTERM)
    assert status == 1
    assert seconds < 3.0
    assert "tick" in process.output  # the trace names the callback


@pytest.mark.parametrize(("mode", "status", "closed"), [("ends", 3, True), ("fails", 1, True), ("bug", 1, True)])
def test_a_node_that_ends_by_itself_is_closed(start, mode, status, closed):
    process = start(mode)
    assert process.wait() == status
    assert ("closed" in process.output) == closed


def test_refused_settings_are_one_line_and_status_2(start):
    process = start("refuses")
    assert process.wait() == 2
    assert process.output == "goal: expected within reach, got (9, 9, 9)\n"


def test_a_missing_parameter_file_is_one_line_and_status_2(start):
    process = start("runs", "--ros-args", "--params-file", "/nowhere.yaml")
    assert process.wait() == 2
    assert "/nowhere.yaml" in process.output.splitlines()[-1]
