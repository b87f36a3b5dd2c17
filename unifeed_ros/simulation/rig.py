"""Arm, controller, capture and person in one loop, without ROS and faster than real time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.contact_config import ContactConfig
from unifeed_ros.core.capture.feedback_capture import (
    CaptureConfig,
    Captured,
    CapturedCorrections,
    CapturedDemonstration,
    FeedbackCapture,
)
from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, Trajectory
from unifeed_ros.simulation.arm import ArmConfig, SimulatedArm
from unifeed_ros.simulation.person import SimulatedPerson

T = TypeVar("T", CapturedDemonstration, CapturedCorrections)


class LessonError(UnifeedError):
    """A lesson that cannot go on."""


@dataclass(frozen=True, kw_only=True)
class RigConfig:
    """Settings of everything between the learner and the person."""

    arm: ArmConfig = field(default_factory=ArmConfig)
    """The simulated arm."""
    control: ControlConfig = field(default_factory=ControlConfig)
    """The shared controller."""
    contact: ContactConfig = field(default_factory=ContactConfig)
    """The contact detector."""
    capture: CaptureConfig = field(default_factory=CaptureConfig)
    """What is cut out of guided and tracked runs."""
    patience: float = 30.0
    """A guided or tracked run that takes longer is given up [s]."""
    record_rate: float = 100.0
    """Rate at which executed motions are recorded [Hz]."""


@dataclass(frozen=True, kw_only=True)
class Execution:
    """A motion as the arm carried it out."""

    executed: Trajectory
    """Measured motion, from the start of tracking for the planned duration [rad]."""
    captured: CapturedCorrections
    """What capture made of it."""


class Rig:
    """One arm with its controller and its capture; the person is a guest.

    Args:
        robot: The arm.
        table_height: Height of the table [m].
        seed: Seed of the arm's sensors.
        start: Posture at time zero, shape (n,) [rad].
        config: Settings.
    """

    def __init__(self, robot: RobotModel, *, table_height: float, seed: int, start: ArrayLike,
                 config: RigConfig | None = None) -> None:
        self._robot = robot
        self._config = config or RigConfig()
        self._arm = SimulatedArm(robot, seed=seed, table_height=table_height, config=self._config.arm)
        self._arm.reset(start)
        self._controller = SharedController(robot, self._config.control)
        self._contact = ContactDetector(robot.config.contact_thresholds, self._config.contact, robot)
        self._capture = FeedbackCapture(robot, self._config.capture)
        self._controller.hold(self._arm.state())
        self.rest(0.5)  # the detector learns the sensors' bias while nobody touches

    @property
    def positions(self) -> Array:
        """Measured joint positions now, shape (n,) [rad]."""
        return self._arm.state().positions

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._arm.time

    def rest(self, seconds: float) -> None:
        """Hold still for a while.

        Args:
            seconds: How long [s].
        """
        until = self._arm.time + seconds
        self._run(None, lambda _: self._arm.time >= until)

    def guide(self, person: SimulatedPerson) -> CapturedDemonstration:
        """Make the arm weightless until the person has guided it.

        Args:
            person: Who guides.

        Returns:
            What capture made of it.

        Raises:
            LessonError: The person does not come to an end.
        """
        state = self._arm.state()
        self._controller.guide(state)
        person.begin_demonstration(state.positions)
        self._run(person, lambda _: person.finished)
        self.rest(0.2)
        self._controller.hold(self._arm.state())
        return self._until_captured(CapturedDemonstration)

    def execute(self, motion: Trajectory, motion_id: str, person: SimulatedPerson | None = None) -> Execution:
        """Carry a motion out.

        Args:
            motion: Motion from where the arm is.
            motion_id: Its name.
            person: Who watches and corrects; nobody by default.

        Returns:
            The motion as carried out, and what capture made of it.

        Raises:
            LessonError: The motion does not come to an end, or the controller stopped it.
        """
        state = self._arm.state()
        self._capture.observe_trajectory(motion_id, motion)
        self._controller.track(motion, motion_id, state)
        if person is not None:
            person.begin_correction(motion)
        began = self._arm.time
        states: list[RobotState] = []
        self._run(person, lambda finished: finished, states)
        times = np.array([s.time for s in states]) - began
        kept = times <= motion.duration + 0.5 / self._config.record_rate
        executed = Trajectory(joint_names=motion.joint_names, times=times[kept],
                              positions=np.array([s.positions for s in states])[kept])
        self._controller.hold(self._arm.state())
        return Execution(executed=executed, captured=self._until_captured(CapturedCorrections))

    def _until_captured(self, kind: type[T]) -> T:
        found: list[Captured] = []
        self._run(None, lambda _: bool(found), captured=found)
        if not isinstance(found[0], kind):
            raise LessonError("capture", expected=kind.__name__, got=type(found[0]).__name__)
        return found[0]

    def _run(self, person: SimulatedPerson | None, done: Callable[[bool], bool],
             states: list[RobotState] | None = None, captured: list[Captured] | None = None) -> None:
        """Advance by milliseconds until a condition on the controller's `finished` holds."""
        arm, limit = self._arm, self._arm.time + self._config.patience
        step, due = 1.0 / self._config.record_rate, self._arm.time
        motion_time, finished = 0.0, False
        while not done(finished):
            if arm.time > limit:
                raise LessonError("a run did not end", expected=f"within {self._config.patience} s")
            state = arm.state()
            contact = self._contact.update(state.time, arm.external_torque(), state.velocities, state.positions)
            command = self._controller.step(state, contact.torque)
            self._capture.observe_state(state)
            self._capture.observe_contact(contact)
            found = self._capture.observe_teaching(state.time, command.mode, command.motion_id, command.motion_time)
            if captured is not None:
                captured.extend(found)
            motion_time, finished = command.motion_time, command.finished
            arm.command(command.torque)
            if person is not None:
                arm.push(person.hand_wrench(state.time, state.positions, state.velocities, motion_time))
            if states is not None and state.time >= due - 1e-9:
                states.append(state)
                due += step
            arm.step()
        arm.push(np.zeros(6))
