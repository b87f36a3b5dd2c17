"""The wire between the simulated arm and the other nodes, with faults on demand.

The arm's topics are remapped to raw/<name>; this process passes them on. A word on `fault` (std_msgs/String) breaks the
wire in one way, an empty one mends it. Each time it is mended, what happened since it broke is printed as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from unifeed_msgs.msg import TeachingState
from unifeed_ros.core.types import RobotState
from unifeed_ros.nodes.joint_stream import JointReader, JointWriter
from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos

STILL = 0.1
"""Speed of the fastest joint of an arm that has been stopped [rad/s]."""
DELAY = 0.05
"""Time by which commands are late [s]."""
SATURATED, DRIFT = 20.0, 5.0
"""Torque of a saturated sensor [Nm], and drift of a drifting one [Nm/s]."""
CLOCK_STEP = 10.0
"""Time by which the clock is set ahead, or back [s]."""
FAULTS = ("states stop", "states freeze", "states jump", "joints permuted", "states NaN", "torques NaN",
          "torque saturates", "torque drifts", "commands 50 ms late", "clock set ahead", "clock set back",
          "network cut")
"""The ways in which the wire can break; "joints permuted" gives values to the wrong names."""


class FaultyWire(UnifeedNode):
    """Passes states, torques and commands on, whole or broken."""

    def __init__(self) -> None:
        super().__init__("faulty_wire")
        names = self.load_robot().joint_names
        self._states, self._torques = JointReader(names), JointReader(names)
        self._state_writer = JointWriter(names, ("position", "velocity"))
        self._torque_writer = JointWriter(names, ("effort",))
        self._fault, self._since = "", 0.0
        self._frozen: RobotState | None = None
        self._held: deque[tuple[float, bytes]] = deque()
        self._mode = TeachingState.INACTIVE
        self._clear()
        for name, pass_on in (("joint_states", self._on_state), ("external_torques", self._on_torque)):
            self._pipe(f"raw/{name}", name, name, pass_on)
        self._pipe("joint_command", "raw/joint_command", "joint_command", self._on_command)
        self.create_subscription(String, "fault", self._on_fault, 10)
        self.listen("teaching_state", self._on_teaching)
        self.create_timer(0.002, self._release, clock=self.steady)

    def _pipe(self, source: str, target: str, topic: str, pass_on: Callable[[bytes, Callable[[bytes], None]], None]
              ) -> None:
        publisher = self.create_publisher(JointState, target, publisher_qos(topic))
        self.create_subscription(JointState, source, lambda data: pass_on(data, publisher.publish),
                                 subscriber_qos(topic), raw=True)
        if topic == "joint_command":
            self._publish_command = publisher.publish

    def _clear(self) -> None:
        self._visible: float | None = None
        self._stopped: float | None = None
        self._moving = 0.0
        self._message = ""

    def _on_fault(self, msg: String) -> None:
        if self._fault and not msg.data:
            print(json.dumps({
                "fault": self._fault, "message": self._message,
                "stop_s": None if self._stopped is None or self._visible is None else self._stopped - self._visible,
                "still_s": None if self._visible is None else max(0.0, self._moving - self._visible)}),
                flush=True)
        if msg.data and not self._fault:
            self._clear()
        self._fault, self._since, self._frozen = msg.data, time.monotonic(), None

    def _see(self) -> None:
        """Note when the fault first showed."""
        if self._visible is None:
            self._visible = time.monotonic()

    def _on_state(self, data: bytes, send: Callable[[bytes], None]) -> None:
        state = self._states.state(data)
        if np.abs(state.velocities).max() > STILL:
            self._moving = time.monotonic()
        fault = self._fault
        if fault in ("states stop", "network cut"):
            self._see()
            return
        if fault not in ("states freeze", "states jump", "joints permuted", "states NaN", "clock set ahead",
                         "clock set back"):
            send(data)
            return
        self._see()
        send(self._state_writer.write(*self._broken(state, fault)))

    def _broken(self, state: RobotState, fault: str) -> tuple[float, np.ndarray, np.ndarray]:
        time_, positions, velocities = state.time, state.positions, state.velocities
        if fault == "states freeze":
            self._frozen = self._frozen or state
            return time_, self._frozen.positions, self._frozen.velocities
        if fault == "states jump":
            return time_, positions + 0.3, velocities
        if fault == "joints permuted":
            return time_, np.roll(positions, 1), np.roll(velocities, 1)
        if fault == "states NaN":
            return time_, np.full_like(positions, np.nan), velocities
        return time_ + (CLOCK_STEP if fault == "clock set ahead" else -CLOCK_STEP), positions, velocities

    def _on_torque(self, data: bytes, send: Callable[[bytes], None]) -> None:
        stamp, torque = self._torques.torques(data, "external torques")
        fault = self._fault
        if fault == "network cut":
            return
        if fault in ("torques NaN", "torque saturates", "torque drifts"):
            self._see()
            torque = np.array(torque)
            torque[1] = {"torques NaN": np.nan, "torque saturates": SATURATED,
                         "torque drifts": torque[1] + DRIFT * (time.monotonic() - self._since)}[fault]
        elif fault in ("clock set ahead", "clock set back"):
            stamp += CLOCK_STEP if fault == "clock set ahead" else -CLOCK_STEP
        else:
            send(data)
            return
        send(self._torque_writer.write(stamp, torque))

    def _on_command(self, data: bytes, send: Callable[[bytes], None]) -> None:
        if self._fault == "network cut":
            return
        if self._fault == "commands 50 ms late":
            self._see()
            self._held.append((time.monotonic() + DELAY, data))
            return
        send(data)

    def _release(self) -> None:
        while self._held and self._held[0][0] <= time.monotonic():
            self._publish_command(self._held.popleft()[1])

    def _on_teaching(self, msg: TeachingState) -> None:
        if msg.mode == TeachingState.STOPPED and self._mode != TeachingState.STOPPED and self._visible is not None:
            self._stopped, self._message = time.monotonic(), msg.message
        self._mode = msg.mode


if __name__ == "__main__":
    sys.exit(run_node(FaultyWire))
