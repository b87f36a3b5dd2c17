from __future__ import annotations

import signal
import sys
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from unifeed_msgs.msg import Feedback, Interaction
from unifeed_msgs.srv import Mark
from unifeed_ros.core.recording import bag_info, check_bag, read_bag, recover_bag
from unifeed_ros.nodes.topics import TOPICS, publisher_qos

PUBLISHER = """
import sys, time
import rclpy
from sensor_msgs.msg import JointState
from unifeed_ros.nodes.topics import publisher_qos
seconds = float(sys.argv[1])
rclpy.init()
node = rclpy.create_node("arm")
publishers = [node.create_publisher(JointState, t, publisher_qos(t)) for t in ("joint_states", "external_torques")]
while any(p.get_subscription_count() == 0 for p in publishers):
    time.sleep(0.01)
names = [f"joint{k}" for k in range(1, 8)]
start, number = time.perf_counter(), 0
while number < 1000 * seconds:
    message = JointState(name=names, position=[0.5] * 7, velocity=[0.1] * 7, effort=[float(number)] + [0.0] * 6)
    for publisher in publishers:
        publisher.publish(message)
    number += 1
    time.sleep(max(0.0, start + number * 0.001 - time.perf_counter()))
print("published", number, flush=True)
time.sleep(0.2)
"""


@pytest.fixture
def status(ros_node):
    """What the recorder says on /diagnostics; topics by name with their counts."""
    values = {}
    ros_node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: values.update(
        {v.key: v.value for s in m.status for v in s.values}), 10)
    return values


@pytest.fixture
def wait_for_count(status, spin_until):
    def wait(topic, count):
        spin_until(lambda: int(status.get(topic, 0)) >= count, 30.0, lambda: f"({status})")

    return wait


@pytest.fixture
def start_recorder(start_node, tmp_path):
    def start(**parameters):
        recorder = start_node("recorder", {"recorder.folder": tmp_path / "bag",
                                           **{f"recorder.{k}": v for k, v in parameters.items()}})
        recorder.wait_for("recording")
        return recorder

    return start


def assert_sound(folder):
    assert [str(f) for f in check_bag(folder) if f.problems] == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_two_streams_at_1_khz_are_recorded_without_loss(start_recorder, start_process, tmp_path, number):
    recorder = start_recorder()
    arm = start_process([sys.executable, "-c", PUBLISHER, 2], name="arm")
    assert arm.wait(30) == 0
    status, seconds = recorder.stop(number)
    assert status == 0, recorder.output
    assert seconds < 3.0
    assert_sound(tmp_path / "bag")
    heard = {"/joint_states": [], "/external_torques": []}
    for message in read_bag(tmp_path / "bag", list(heard)):
        heard[message.topic].append(deserialize_message(message.data, JointState).effort[0])
    assert heard == {topic: [float(k) for k in range(2000)] for topic in heard}


def test_ending_while_messages_stream_in_closes_the_bag(start_recorder, start_process, wait_for_count, tmp_path):
    recorder = start_recorder()
    arm = start_process([sys.executable, "-c", PUBLISHER, 60], name="arm")
    wait_for_count("/joint_states", 500)
    status, seconds = recorder.stop(signal.SIGTERM)
    assert status == 0, recorder.output
    assert seconds < 3.0
    assert arm.returncode is None
    assert_sound(tmp_path / "bag")
    assert bag_info(tmp_path / "bag").message_count > 500


def test_messages_lost_while_the_process_was_stopped_are_counted(
        start_recorder, start_process, wait_for_count, tmp_path):
    recorder = start_recorder()
    arm = start_process([sys.executable, "-c", PUBLISHER, 7], name="arm")
    wait_for_count("/joint_states", 1)
    recorder.send(signal.SIGSTOP)
    time.sleep(5.0)  # longer than publishers keep
    recorder.send(signal.SIGCONT)
    arm.wait_for("published")
    wait_for_count("lost", 1)
    assert recorder.stop()[0] == 0
    heard = sum(1 for _ in read_bag(tmp_path / "bag", ["/joint_states", "/external_torques"]))
    said = [v.value for m in read_bag(tmp_path / "bag", ["/diagnostics"])
            for v in deserialize_message(m.data, DiagnosticArray).status[0].values if v.key == "lost"]
    assert heard + int(said[-1]) == 14000


def test_a_killed_recorder_leaves_a_bag_that_recovers(start_recorder, start_process, wait_for_count, tmp_path):
    recorder = start_recorder()
    start_process([sys.executable, "-c", PUBLISHER, 60], name="arm")
    wait_for_count("/joint_states", 500)
    recorder.send(signal.SIGKILL)
    recorder.wait()
    killed = time.time_ns()
    recover_bag(tmp_path / "bag")
    assert_sound(tmp_path / "bag")
    times = [m.time for m in read_bag(tmp_path / "bag", ["/joint_states"])]
    assert killed - times[-1] < 1e9
    assert len(times) >= 300


def test_latched_messages_sent_before_the_recorder_came_are_recorded(
        ros_node, start_recorder, wait_for_count, tmp_path):
    publisher = ros_node.create_publisher(Feedback, "feedback", publisher_qos("feedback"))
    for k in range(3):
        publisher.publish(Feedback(id=f"early {k}"))
    recorder = start_recorder(topics="[feedback]")
    wait_for_count("/feedback", 3)
    publisher.publish(Feedback(id="late"))
    wait_for_count("/feedback", 4)
    assert recorder.stop()[0] == 0
    ids = [deserialize_message(m.data, Feedback).id for m in read_bag(tmp_path / "bag")]
    assert ids == ["early 0", "early 1", "early 2", "late"]


def test_split_mark_status_and_best_effort_publishers(
        ros_node, start_recorder, status, wait_for_count, call, tmp_path):
    recorder = start_recorder(topics="[joint_states, /diagnostics, '/words std_msgs/msg/String']")
    fast = ros_node.create_publisher(
        JointState, "joint_states", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    words = ros_node.create_publisher(String, "words", 10)
    ros_node.create_timer(0.01, lambda: (fast.publish(JointState()), words.publish(String(data="x"))))

    assert call(Mark, "mark", Mark.Request(text="before")).success
    wait_for_count("/joint_states", 10)
    wait_for_count("/words", 10)
    answer = call(Trigger, "split")
    assert answer.success
    assert "bag_0.mcap" in answer.message
    assert call(Mark, "mark").message == "marked: mark"
    assert int(status["lost"]) == 0
    assert float(status["free_mib"]) > 0
    assert recorder.stop()[0] == 0
    info = bag_info(tmp_path / "bag")
    assert info.files == ("bag_0.mcap", "bag_1.mcap")
    assert [text for _, text in info.marks] == ["before", "mark"]
    assert_sound(tmp_path / "bag")


@pytest.mark.parametrize(("episodes", "files"), [("interaction", 3), ("''", 1)])
def test_every_interaction_ends_a_file(ros_node, start_recorder, wait_for_count, tmp_path, episodes, files):
    recorder = start_recorder(topics="[interaction]", episodes=episodes)
    publisher = ros_node.create_publisher(Interaction, "interaction", publisher_qos("interaction"))
    for k in (1, 2):
        publisher.publish(Interaction(index=k))
    wait_for_count("/interaction", 2)
    assert recorder.stop()[0] == 0
    assert_sound(tmp_path / "bag")
    assert bag_info(tmp_path / "bag").files == tuple(f"bag_{k}.mcap" for k in range(files))
    assert [deserialize_message(m.data, Interaction).index for m in read_bag(tmp_path / "bag")] == [1, 2]


def test_an_almost_full_disk_stops_the_recording_and_says_so(start_node, tmp_path):
    recorder = start_node("recorder", {"recorder.folder": tmp_path / "bag", "recorder.min_free_mib": 1e9})
    recorder.wait_for("almost full")
    status, _ = recorder.stop()
    assert status == 1
    assert_sound(tmp_path / "bag")


@pytest.mark.parametrize(("parameters", "message"), [
    ({}, "folder"),
    ({"recorder.folder": "/proc/bag"}, "cannot make bag"),
    ({"recorder.folder": "x", "recorder.topics": "[nothing]"}, "topic to record"),
    ({"recorder.folder": "x", "recorder.topics": "['/a no_msgs/msg/No']"}, "no_msgs"),
    ({"recorder.folder": "x", "recorder.colour": "red"}, "colour"),
])
def test_settings_that_cannot_be_used_end_it_with_one_line(start_node, parameters, message):
    recorder = start_node("recorder", parameters)
    assert recorder.wait() == 2
    lines = recorder.output.strip().splitlines()
    assert len(lines) == 1, recorder.output
    assert message in lines[0]


def test_every_topic_of_the_table_is_in_the_bag(start_recorder, tmp_path):
    assert start_recorder().stop()[0] == 0
    expected = {f"/{t.name.lstrip('/')}": t.type for t in TOPICS}
    assert {t.name: t.type for t in bag_info(tmp_path / "bag").topics} == expected
