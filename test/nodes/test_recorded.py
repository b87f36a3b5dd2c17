"""Messages recorded by other versions of the definitions, written by an independent library."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.msg import RewardStatus
from unifeed_ros.core.errors import ConfigError, RecordingError
from unifeed_ros.core.recording import BagWriter, MessageType, RecordedTopic, message_type, read_bag
from unifeed_ros.nodes.recorded import RecordedMessages, converted

FIRST_STATUS = """
uint8 IDLE=0
uint8 TRAINING=1
uint8 FAILED=2
std_msgs/Header header
uint8 state
uint32 version
uint32 demonstrations
uint32 corrections
uint32 preferences
float64 progress
string message
"""
"""reward_status as the project first recorded it, before it told of reliability."""
HEADER = message_type("std_msgs/msg/Header").definition
SEPARATOR = "=" * 80
OLD_HASH = "RIHS01_" + 64 * "1"


def old_bag(folder, name, definition, messages, package="unifeed_msgs"):
    """Write messages with rosbags by a definition of our own; each is a mapping of fields."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, f"{package}/msg/{name}"))
    kind = store.types[f"{package}/msg/{name}"]
    header, _, time = HEADER.partition(f"{SEPARATOR}\n")
    text = f"{definition}{SEPARATOR}\nMSG: std_msgs/Header\n{header}{SEPARATOR}\n{time}"
    topic = RecordedTopic(name="/old", type=MessageType(name=f"{package}/msg/{name}", definition=text, hash=OLD_HASH))
    stamp = store.types["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    head = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
    with BagWriter(folder, [topic]) as bag:
        for k, fields in enumerate(messages):
            data = store.serialize_cdr(kind(header=head, **fields), f"{package}/msg/{name}")
            bag.write("/old", bytes(data), 10**9 + k)
    return folder


def test_a_message_of_the_first_version_is_read_and_what_is_new_keeps_its_default(tmp_path):
    bag = old_bag(tmp_path / "bag", "RewardStatus", FIRST_STATUS, [{
        "state": 1, "version": 4, "demonstrations": 2, "corrections": 3, "preferences": 5, "progress": 0.25,
        "message": "training"}])
    recorded = RecordedMessages(bag)
    (message,) = read_bag(bag)
    assert not recorded.is_current("/old")
    for msg in (recorded.read(message), deserialize_message(recorded.installed_bytes(message), RewardStatus)):
        assert isinstance(msg, RewardStatus)
        assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (7, 8, "base")
        assert (msg.state, msg.version, msg.demonstrations, msg.corrections, msg.preferences) == (1, 4, 2, 3, 5)
        assert (msg.progress, msg.message, msg.reliability_corrections) == (0.25, "training", 0.0)


def test_arrays_are_taken_over_and_fields_that_are_gone_left_out(tmp_path):
    definition = "std_msgs/Header header\nstring[] inputs\nuint32[] layer_sizes\nfloat32[] weights\nfloat64[] gone\n"
    bag = old_bag(tmp_path / "bag", "RewardModel", definition, [{
        "inputs": ["x", "y"], "layer_sizes": np.array([2, 1], np.uint32), "weights": np.array([0.5, 1.5], np.float32),
        "gone": np.array([2.0])}])
    (message,) = read_bag(bag)
    msg = RecordedMessages(bag).read(message)
    assert (list(msg.inputs), list(msg.layer_sizes), list(msg.weights)) == (["x", "y"], [2, 1], [0.5, 1.5])
    assert msg.activation == ""


def test_messages_within_messages_are_taken_over():
    old = SimpleNamespace(joint_names=["a"], gone=1, points=[SimpleNamespace(
        positions=[1.0, 2.0], time_from_start=SimpleNamespace(sec=3, nanosec=4))])
    msg = converted(old, JointTrajectory)
    (point,) = msg.points
    assert (msg.joint_names, list(point.positions), list(point.velocities)) == (["a"], [1.0, 2.0], [])
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (3, 4)


def test_a_field_that_became_another_is_refused_in_words(tmp_path):
    definition = "std_msgs/Header header\nstring state\n"
    bag = old_bag(tmp_path / "bag", "RewardStatus", definition, [{"state": "idle"}])
    (message,) = read_bag(bag)
    with pytest.raises(RecordingError, match="field state of RewardStatus was another one"):
        RecordedMessages(bag).read(message)


def test_a_type_that_is_not_installed_is_refused_in_words(tmp_path):
    bag = old_bag(tmp_path / "bag", "Unknown", "std_msgs/Header header\n", [{}], package="other_msgs")
    (message,) = read_bag(bag)
    for read in (RecordedMessages(bag).read, RecordedMessages(bag).installed_bytes):
        with pytest.raises(ConfigError, match="other_msgs/msg/Unknown"):
            read(message)


def test_bytes_without_sense_are_refused_in_words(tmp_path):
    with BagWriter(tmp_path / "bag", [RecordedTopic(name="/s", type=message_type("unifeed_msgs/msg/Feedback"))]) as bag:
        bag.write("/s", b"\x00\x01\x00\x00\x01", 1)
    (message,) = read_bag(tmp_path / "bag")
    with pytest.raises(RecordingError, match="cannot be read"):
        RecordedMessages(tmp_path / "bag").read(message)
