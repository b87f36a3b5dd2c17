"""Stands in for a real robot's driver: the arm in MuJoCo, published as a robot would publish itself."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rosgraph_msgs.msg import Clock as ClockMsg
from trajectory_msgs.msg import JointTrajectory

from unifeed_ros.core.capture.external import by_name
from unifeed_ros.core.capture.external_torque import MOMENTUM, ExternalTorqueConfig
from unifeed_ros.core.control.silence import Silence
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.nodes.conversions import seconds, stamp, wrench_from_msg
from unifeed_ros.nodes.joint_stream import JointReader, JointWriter
from unifeed_ros.nodes.node import OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.real_time import set_niceness
from unifeed_ros.nodes.sensor_output import make_sensor_output
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.simulation.arm import SimulatedArm

NICENESS = -10
"""Asked for: hardware does not wait for what else a machine computes."""
SERVO_PART = 10.0
"""Stiffness of the arm as a position servo, as a part of the robot's [1]."""
TICK_PERIOD = 0.004
"""Time in which a tick comes while this process is awake, also on a busy machine [s]."""
LATE = 0.010
"""Wall-clock time from a state to its command that counts as late [s]."""


@dataclass(frozen=True, kw_only=True)
class SimulationConfig:
    """How the simulated arm runs."""

    speed: float = 1.0
    """Simulated seconds per second."""
    seed: int = 0
    """Seed of sensor noise and torque bias."""
    command_timeout: float = 0.1
    """Time without a command after which the arm holds in gravity compensation [s]."""
    command_age: float = 0.03
    """Simulated time since the state that a command answers, after which it is not obeyed, or not any more [s]; torques
    that late would throw the arm."""
    hand_timeout: float = 0.1
    """Simulated time without a hand wrench after which the hand counts as gone [s]."""
    patience: float = 0.004
    """Simulated time that the physics runs on one command before it waits for the next, so that a busy machine makes
    the simulation slow and not unstable [s]; 0: it never waits, as a real arm does not."""
    longest_wait: float = 0.05
    """Time that the physics waits for a command [s]: the controller may itself wait for a state that was lost."""
    largest_lag: float = 0.05
    """Simulated time that is made up for at once when the machine was busy; more is dropped [s]."""

    def __post_init__(self) -> None:
        """Reject speeds and times that cannot be kept."""
        if not 0.05 <= self.speed <= 20.0:
            raise ConfigError("speed of the simulation", expected="0.05 to 20", got=self.speed)
        times = (self.command_timeout, self.command_age, self.hand_timeout, self.largest_lag, self.longest_wait)
        if min(times) <= 0.0 or self.patience < 0.0:
            raise ConfigError("timeouts of the simulation", expected="> 0 s, patience >= 0 s")


class SimArmNode(UnifeedNode):
    """Step the physics by the clock, publish what the sensors say, obey torques and the hand."""

    def __init__(self) -> None:
        super().__init__("sim_arm")
        set_niceness(NICENESS)
        self._robot = self.load_robot()
        scene = self.load_scene()
        self._config = settings(self, "simulation", SimulationConfig)
        self._arm = SimulatedArm(self._robot, seed=self._config.seed, table_height=scene.table_height)
        self._arm.reset(self._robot.inverse_kinematics(scene.start, scene.axis))
        names = self._robot.joint_names
        self._reader, self._setpoint_reader = JointReader(names), JointReader(names)
        sensing = settings(self, "external_torque", ExternalTorqueConfig)
        self._measures_torque = sensing.source == MOMENTUM
        fields = ("position", "velocity", "effort") if self._measures_torque else ("position", "velocity")
        self._state_writer = JointWriter(names, fields)
        self._publish_touch = make_sensor_output(self, self._arm, sensing)
        self._stride = max(1, math.ceil(self._config.speed))
        self._pushed_at = self._answered = -math.inf
        self._silence, self._quiet = Silence(TICK_PERIOD), 0.0
        self._obeying = self._pushed = False
        self._began: float | None = None
        self._slipped = 0.0
        self._sent: deque[tuple[float, float]] = deque(maxlen=500)
        self._latencies: deque[float] = deque(maxlen=30000)
        self._steps = self._late = 0
        self._connect()

    def _connect(self) -> None:
        self._states = self.advertise("joint_states")
        self._clock_topic = self.advertise("clock")
        self.listen("joint_command", self._on_command, raw=True)
        self.listen("joint_setpoint", self._on_setpoint, raw=True)
        self.listen("joint_trajectory", self._on_trajectory)
        self.listen("hand_wrench", self._on_hand)
        self.create_timer(0.001, self._tick, clock=self.steady)

    def _on_command(self, data: bytes) -> None:
        try:
            answered, torque = self._reader.torques(data, "commanded torques")
        except InputError as error:
            self.say(WARN, f"command refused, the arm holds: {error}")
            return
        if self._accepts(answered):
            self._arm.command(torque)
            self._obey(answered)

    def _on_setpoint(self, data: bytes) -> None:
        """Close the loop here, with the stiffness that came as effort."""
        try:
            state = self._setpoint_reader.state(data)
            answered, stiffness = self._setpoint_reader.torques(data, "stiffness")
        except InputError as error:
            self.say(WARN, f"set-point refused, the arm holds: {error}")
            return
        if self._accepts(answered):
            self._arm.drive(state.positions, state.velocities, stiffness)
            self._obey(answered)

    def _on_trajectory(self, msg: JointTrajectory) -> None:
        """Go to the last point as a stiff servo."""
        names, wanted = msg.joint_names, self._robot.joint_names
        try:
            if not msg.points:
                raise InputError("trajectory without points")
            point = msg.points[-1]
            positions = by_name(names, point.positions, wanted, "positions of the trajectory")
            velocities = by_name(names, point.velocities, wanted, "velocities of the trajectory")
        except InputError as error:
            self.say(WARN, f"trajectory refused, the arm holds: {error}")
            return
        answered = seconds(msg.header.stamp)
        if self._accepts(answered):
            self._arm.drive(positions, velocities, SERVO_PART * np.array(self._robot.config.stiffness))
            self._obey(answered)

    def _accepts(self, answered: float) -> bool:
        """Take note of a command, and say whether it is obeyed."""
        self._measure_latency(answered)
        return self._is_recent(answered)

    def _is_recent(self, answered: float) -> bool:
        """Say whether a state is recent enough for the command that answers it."""
        return self._arm.time - answered <= self._config.command_age

    def _obey(self, answered: float) -> None:
        self._answered, self._obeying = answered, True
        self._silence.end()

    def _measure_latency(self, answered: float) -> None:
        """Take the wall-clock time from sending a state to getting the command that answers it."""
        while self._sent and self._sent[0][0] < answered - 1e-6:
            self._sent.popleft()
        if self._sent and abs(self._sent[0][0] - answered) < 1e-6:
            latency = time.monotonic() - self._sent.popleft()[1]
            self._latencies.append(latency)
            self._late += latency > LATE

    def _on_hand(self, msg: WrenchStamped) -> None:
        wrench = wrench_from_msg(msg.wrench)
        if np.isfinite(wrench).all():
            self._arm.push(wrench)
            self._pushed_at, self._pushed = self._arm.time, True

    def _tick(self) -> None:
        speed = self._config.speed
        now = time.monotonic()
        self._quiet = self._silence.look(now)
        if self._began is None:
            self._began = now - self._arm.time / speed
        due = (now - self._began) * speed - self._arm.time
        if due > self._config.largest_lag:
            self._slip(due - self._config.largest_lag)
            due = self._config.largest_lag
        for _ in range(int(due / 0.001)):
            if self._waits():
                break
            self._step()

    def _slip(self, simulated: float) -> None:
        """Let simulated time fall behind the clock."""
        self._slipped += simulated
        self._began += simulated / self._config.speed

    def _waits(self) -> bool:
        """Say whether the physics waits for the controller's next command."""
        if not self._obeying:
            return False
        if self._quiet > self._config.command_timeout:
            self._let_go()
        waits = self._quiet < self._config.longest_wait
        return waits and self._obeying and 0.0 < self._config.patience <= self._arm.time - self._answered

    def _let_go(self) -> None:
        """Let the arm hold itself in gravity compensation."""
        self._arm.command(None)
        self._obeying = False

    def _step(self) -> None:
        arm = self._arm
        if self._obeying and not self._is_recent(self._answered):
            self._let_go()
        if self._pushed and arm.time - self._pushed_at > self._config.hand_timeout:
            arm.push(np.zeros(6))
            self._pushed = False
        arm.step()
        self._steps += 1
        if self._steps % self._stride == 0:
            self._publish()
        if self._steps % (10 * self._stride) == 0:
            self._clock_topic.publish(ClockMsg(clock=stamp(arm.time)))

    def _publish(self) -> None:
        state = self._arm.state()
        self._sent.append((state.time, time.monotonic()))
        efforts = (self._arm.measured_torque(),) if self._measures_torque else ()
        self._states.publish(self._state_writer.write(state.time, state.positions, state.velocities, *efforts))
        self._publish_touch()

    def refresh_status(self) -> None:
        """Say whether commands come, and how late they are."""
        latencies = np.array(self._latencies) if self._latencies else np.array([np.nan])
        message = "obeys joint_command" if self._obeying else "holds in gravity compensation: no command"
        self.say(
            OK,
            message,
            simulated_s=f"{self._arm.time:.3f}",
            slipped_s=f"{self._slipped:.3f}",
            latency_p50_ms=f"{1e3 * np.percentile(latencies, 50):.3f}",
            latency_p99_ms=f"{1e3 * np.percentile(latencies, 99):.3f}",
            latency_max_ms=f"{1e3 * latencies.max():.3f}",
            late=self._late,
        )


def main() -> int:
    """Run the node `sim_arm`."""
    return run_node(SimArmNode)


if __name__ == "__main__":
    sys.exit(main())
