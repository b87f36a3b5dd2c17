"""Two bare rclpy processes, one that sends joint states and one that only sends every second one back: the floor.

`python -m unifeed_ros.cli.echo_pair source` and `... echo`; the source prints its latencies when it is ended.
"""

from __future__ import annotations

import json
import sys
import time
from collections import deque

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unifeed_ros.nodes.joint_stream import JointReader, JointWriter
from unifeed_ros.nodes.real_time import RealTimeConfig
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos

NAMES = tuple(f"joint{k}" for k in range(1, 8))
STATES, COMMANDS = "bare_states", "bare_commands"
PERIOD = 0.001
"""Time between two states [s]."""


class Source(Node):
    """Sends at 1 kHz, and measures when the answers come."""

    def __init__(self) -> None:
        super().__init__("bare_source")
        self._writer, self._reader = JointWriter(NAMES, ("position", "velocity")), JointReader(NAMES)
        self._sent: deque[tuple[float, float]] = deque(maxlen=500)
        self._latencies: list[float] = []
        self._values, self._count, self._began = np.zeros(len(NAMES)), 0, time.monotonic()
        self._publisher = self.create_publisher(JointState, STATES, publisher_qos("joint_states"))
        self.create_subscription(JointState, COMMANDS, self._on_answer, subscriber_qos("joint_command"), raw=True)
        self.create_timer(PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        due = int((time.monotonic() - self._began) / PERIOD) - self._count
        for _ in range(min(due, 50)):
            self._count += 1
            stamp = self._count * PERIOD
            self._sent.append((stamp, time.monotonic()))
            self._publisher.publish(self._writer.write(stamp, self._values, self._values))
        self._count += max(0, due - 50)

    def _on_answer(self, data: bytes) -> None:
        stamp = self._reader.state(data).time
        while self._sent and self._sent[0][0] < stamp - 1e-6:
            self._sent.popleft()
        if self._sent and abs(self._sent[0][0] - stamp) < 1e-6:
            self._latencies.append(time.monotonic() - self._sent.popleft()[1])

    def close(self) -> None:
        """Print the latencies, the first second left out."""
        latencies = 1e3 * np.array(self._latencies[500:] or [np.nan])
        print(json.dumps({"answers": len(self._latencies), "latency_p50_ms": float(np.percentile(latencies, 50)),
                          "latency_p99_ms": float(np.percentile(latencies, 99)), "worst_ms": float(latencies.max())}),
              flush=True)


class Echo(Node):
    """Sends every second message back as it came; asks for the scheduling that the controller asks for."""

    def __init__(self) -> None:
        super().__init__("bare_echo")
        self.real_time = RealTimeConfig()
        self._count = 0
        self._publisher = self.create_publisher(JointState, COMMANDS, publisher_qos("joint_command"))
        self.create_subscription(JointState, STATES, self._on_state, subscriber_qos("joint_states"), raw=True)

    def _on_state(self, data: bytes) -> None:
        self._count += 1
        if self._count % 2 == 0:
            self._publisher.publish(data)


if __name__ == "__main__":
    sys.exit(run_node(Source if sys.argv[1] == "source" else Echo, args=sys.argv[:1]))
