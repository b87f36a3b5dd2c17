"""What the tests of the controller share: the arm, its sensors and the controller in one process."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Trajectory
from unifeed_ros.simulation.arm import SimulatedArm

CONFIGS = Path(__file__).parents[3] / "config" / "robots"
ROBOTS = {name: RobotModel(load_robot(CONFIGS / f"{name}.yaml")) for name in ("panda", "ur10")}
START = {"panda": (0.2, 0.2, 0.6), "ur10": (0.3, 0.3, 0.5)}
GOAL = (0.65, -0.4, 0.1)
PERIOD = 0.002


class Loop:
    """Arm, contact detector and controller in one process; commands arrive some steps late."""

    def __init__(self, robot, *, delay=3, seed=1, **config):
        self.robot, self.arm = robot, SimulatedArm(robot, seed=seed)
        self.arm.reset(robot.inverse_kinematics(START[robot.config.name]))
        self.detector = ContactDetector(robot.config.contact_thresholds)
        self.controller = SharedController(robot, ControlConfig(**config))
        self.output = self.controller.config.output
        self.late = deque([None] * delay)
        self.steps, self.commands, self.tool, self.errors = 0, [], [], []

    def run(self, seconds, push=(0.0, 0.0, 0.0)):
        self.arm.push([*push, 0.0, 0.0, 0.0])
        for _ in range(round(seconds * 1000)):
            self.step()
        return self

    def step(self):
        """Advance by a millisecond."""
        if self.steps % 2 == 0:
            self._tick()
        self.late.append(self.commands[-1])
        if (command := self.late.popleft()) is None or self.output == "effort":
            self.arm.command(None if command is None else command.torque)
        else:
            servo = 10.0 * np.array(self.robot.config.stiffness)
            self.arm.drive(command.setpoint.positions, command.setpoint.velocities,
                           servo if self.output == "trajectory" else command.stiffness)
        self.arm.step()
        self.steps += 1

    def _tick(self):
        state = self.arm.state()
        contact = self.detector.update(state.time, self.arm.external_torque(), state.velocities)
        self.commands.append(self.controller.step(state, contact.torque))
        self.tool.append(self.arm.tool_position)

    def straight_motion(self, duration=None):
        start = self.arm.true_positions
        goal = self.robot.inverse_kinematics(GOAL, seed=start)
        fastest = 1.9 * float(np.max(np.abs(goal - start) / self.robot.velocity_limits))
        return minimum_jerk(self.robot, start, goal, duration or max(3.0, fastest))

    def start_tracking(self, **kwargs):
        self.controller.hold(self.arm.state())
        self.run(1.0)
        motion = self.straight_motion(**kwargs)
        self.controller.track(motion, "m1", self.arm.state())
        return motion

    @property
    def largest_torque_step(self):
        torques = np.array([c.torque for c in self.commands])
        return float(np.abs(np.diff(torques, axis=0)).max())


def minimum_jerk(robot, start, goal, duration):
    t = np.append(np.arange(0.0, duration - 0.005, 0.01), duration)
    s = t[:, None] / duration
    way = goal - start
    return Trajectory(
        joint_names=robot.joint_names, times=t, positions=start + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        velocities=way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        accelerations=way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2)
