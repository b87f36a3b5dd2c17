"""Two numbered streams at 1 kHz, with the time of every message in a file: what a killed recorder is held against."""

from __future__ import annotations

import os
import struct
import sys
import time

import rclpy
from sensor_msgs.msg import JointState

from unifeed_ros.nodes.topics import publisher_qos

STREAMS = ("joint_states", "external_torques")
PERIOD = 0.001
ENTRY = struct.Struct("<q")
"""When a message was handed to the middleware [ns since the epoch]; the n-th entry is that of the n-th message."""


def main(log: str) -> None:
    """Publish until the process is ended."""
    rclpy.init()
    node = rclpy.create_node("stream")
    publishers = [node.create_publisher(JointState, topic, publisher_qos(topic)) for topic in STREAMS]
    names = [f"joint{k}" for k in range(1, 8)]
    target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    start, number = time.monotonic(), 0
    while True:
        os.write(target, ENTRY.pack(time.time_ns()))
        msg = JointState(name=names, position=[0.1 * number] * 7, velocity=[0.5] * 7, effort=[float(number)] * 7)
        for publisher in publishers:
            publisher.publish(msg)
        number += 1
        time.sleep(max(0.0, start + number * PERIOD - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1])
