from __future__ import annotations

import pytest

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording.schema import definitions, dependencies, install_prefixes, message_type

pytestmark = pytest.mark.skipif(not install_prefixes(), reason="no ROS packages: AMENT_PREFIX_PATH is empty")


def test_root_comes_first_and_every_dependency_once():
    parts = list(definitions(message_type("sensor_msgs/msg/JointState").definition))
    assert [name for name, _ in parts] == [None, "std_msgs/Header", "builtin_interfaces/Time"]
    assert "string[] name" in parts[0][1]


@pytest.mark.parametrize("name", ["unifeed_msgs/msg/Feedback", "unifeed_msgs/msg/Interaction",
                                  "diagnostic_msgs/msg/DiagnosticArray", "rosgraph_msgs/msg/Clock"])
def test_definitions_are_complete(name):
    parts = list(definitions(message_type(name).definition))
    known = {part for part, _ in parts}
    for part, text in parts:
        assert set(dependencies((part or name).split("/")[0], text)) <= known


def test_hash_is_that_of_the_type_description():
    # Known from every Jazzy installation: `ros2 topic info -v` on a std_msgs/String topic.
    expected = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert message_type("std_msgs/msg/String").hash == expected


def test_fields_constants_arrays_and_comments():
    text = "# geometry_msgs/Pose x\nuint8 A=1\nPose[] poses  # Point p\nstring<=5 s\n"
    text += "std_msgs/Header[3] h\nfloat64[<=4] d"
    assert dependencies("geometry_msgs", text) == ("geometry_msgs/Pose", "std_msgs/Header")


@pytest.mark.parametrize("name", ["JointState", "sensor_msgs/JointState", "no_msgs/msg/Nothing", "std_srvs/srv/Trigger",
                                  "../msg/X"])
def test_unknown_types_are_refused(name):
    with pytest.raises(RecordingError):
        message_type(name)
