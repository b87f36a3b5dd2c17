"""Topics, messages and bags for the tests of the recording layer."""

from __future__ import annotations

import struct

import pytest

from unifeed_ros.core.recording import BagWriter, Qos, RecordedTopic, message_type
from unifeed_ros.core.recording.schema import install_prefixes

START = 1_700_000_000_000_000_000


def serialise(text):
    """Serialise a std_msgs/String (CDR, little endian)."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(data)) + data


@pytest.fixture(scope="session")
def string_message():
    return serialise


@pytest.fixture(scope="session")
def topics():
    if not install_prefixes():
        pytest.skip("no ROS packages: AMENT_PREFIX_PATH is empty")
    string, joints = message_type("std_msgs/msg/String"), message_type("sensor_msgs/msg/JointState")
    return (
        RecordedTopic(name="/words", type=string),
        RecordedTopic(name="/latched", type=string, qos=(Qos(durability="transient_local", depth=1),)),
        RecordedTopic(name="/joint_states", type=joints),
    )


@pytest.fixture
def make_bag(tmp_path, topics):
    """Write a closed bag of numbered words, one every millisecond, in chunks of a few messages."""

    def make(name="bag", count=200, **settings):
        settings = {"chunk_bytes": 1000, "flush_period": 60.0, **settings}
        with BagWriter(tmp_path / name, topics, **settings) as bag:
            for k in range(count):
                bag.write("/words", serialise(f"word {k}"), START + k * 1_000_000)
        return tmp_path / name

    return make
