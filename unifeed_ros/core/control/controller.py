"""The shared controller: holds, guides, tracks and stops, and yields to the person's hand at any moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.control.arbitration import Arbitration
from unifeed_ros.core.control.impedance import ImpedanceLaw
from unifeed_ros.core.control.reference import Braking, Reference, SampledMotion, Setpoint, require_motion
from unifeed_ros.core.control.safety import LONGEST_TICK, SafetyFilter, all_finite
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, Trajectory

FORCE_TICKS = 10
"""Ticks between estimates of the force at the tool: only people read it."""
SETTLED_SPEED = 0.05
"""Speed of the fastest joint below which a motion counts as ended [rad/s]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """What the controller decided in one tick."""

    torque: Array | None
    """Joint torques, without gravity where the robot's driver adds it, shape (n,) [Nm]; None: send nothing."""
    mode: TeachingMode
    """What the controller does."""
    control: Control
    """Who leads."""
    authority: float
    """Share of the robot in the command, in [0, 1] [1]."""
    motion_id: str
    """Name of the motion that is tracked; empty otherwise."""
    motion_time: float
    """Time within that motion [s]."""
    force: float
    """Size of the person's force at the tool, estimated from external torque [N]."""
    message: str
    """A sentence for a person."""
    finished: bool
    """True once the tracked motion has ended and the arm rests at its end."""


class SharedController:
    """Joint impedance around a reference that both the plan and the person's hand shape.

    Call hold, guide or track to choose a mode, then step once a tick. A stop lasts until hold or guide. Faults of the
    input do not raise in step: the arm stops and the command's message says why.

    Args:
        robot: The arm.
        config: Settings.
    """

    def __init__(self, robot: RobotModel, config: ControlConfig | None = None) -> None:
        self.robot, self.config = robot, config or ControlConfig()
        self.mode = TeachingMode.INACTIVE
        """What the controller does."""
        self._law = ImpedanceLaw(robot)
        self._arbitration = Arbitration(robot.config.contact_thresholds, self.config)
        self._safety = SafetyFilter(robot, self.config)
        self._reference: Reference | None = None
        self._motion: SampledMotion | None = None
        self._motion_id, self._message = "", "no mode chosen yet"
        self._state: RobotState | None = None
        self._braking: Braking | None = None
        self._now, self._blind = 0.0, 0.0
        self._force, self._ticks = 0.0, 0
        self._zero = np.zeros(robot.n)

    def hold(self, state: RobotState) -> None:
        """Hold the arm where it is; it yields to force and stays where it is left. Ends a stop.

        Args:
            state: Measured state.

        Raises:
            InputError: The state cannot be used.
        """
        start = self._begin(state)
        self._reference = Reference(start, None, self.robot, self.config)
        self._enter(TeachingMode.HOLD, "holding; push to move the arm")

    def guide(self, state: RobotState) -> None:
        """Make the arm weightless, for guiding. Ends a stop.

        Args:
            state: Measured state.

        Raises:
            InputError: The state cannot be used.
        """
        start = self._begin(state)
        self._reference = Reference(start, None, self.robot, self.config)
        self._enter(TeachingMode.GUIDE, "weightless; guide the arm by hand")

    def track(self, trajectory: Trajectory, motion_id: str, state: RobotState) -> None:
        """Carry out a motion; the person may push at any moment.

        Args:
            trajectory: The motion; its first point is where the arm is.
            motion_id: Name of the motion.
            state: Measured state.

        Raises:
            InputError: The arm is stopped, the state cannot be used, or the motion is of another arm, beyond the limits
                or starts elsewhere.
        """
        if self.mode is TeachingMode.STOPPED:
            raise InputError("the arm is stopped", got=self._message, mend="choose hold or guide first")
        robot = self.robot
        require_motion(trajectory, robot.joint_names, robot.lower - robot.config.position_margin,
                       robot.upper + robot.config.position_margin, robot.velocity_limits)
        start = self._begin(state)
        gap = float(np.abs(trajectory.positions[0] - start.positions).max())
        if gap > self.config.start_tolerance:
            raise InputError("the motion starts elsewhere", got=f"{gap:.3f} rad away",
                             expected=f"within {self.config.start_tolerance} rad of the arm",
                             mend="move to its start first")
        self._motion = SampledMotion(trajectory)
        self._reference = Reference(start, self._motion, robot, self.config)
        self._enter(TeachingMode.TRACK, f"carrying out {motion_id}")
        self._motion_id = motion_id

    def stop(self, reason: str) -> None:
        """Stop and hold softly in place, until hold or guide; the first reason stays.

        Args:
            reason: Why, as a clause for a person.
        """
        if self.mode is not TeachingMode.STOPPED:
            self._braking = None
            self._enter(TeachingMode.STOPPED, f"stopped: {reason}")

    def deactivate(self) -> None:
        """Send nothing more; the arm holds itself."""
        self._safety.start_from(None)
        self._enter(TeachingMode.INACTIVE, "inactive; choose hold or guide")

    def check_fresh(self, age: float) -> bool:
        """Stop if the newest joint state is too old; call it where no new state comes to step with.

        Args:
            age: Age of the newest joint state [s].

        Returns:
            True if the state is fresh.
        """
        fresh = age <= self.config.stale_after
        if not fresh and self.mode is not TeachingMode.INACTIVE:
            self.stop(f"no joint state for {age:.2f} s; check the robot's driver")
        return fresh

    def step(self, state: RobotState, external_torque: Array | None, now: float | None = None) -> Command:
        """Decide the torques of one tick.

        Args:
            state: Newest measured state.
            external_torque: External torque without bias, shape (n,) [Nm]; None if it is unknown, which stops a motion
                if it lasts.
            now: Present time on the clock of the state's stamp [s]; by default the stamp itself.

        Returns:
            The command.
        """
        now = state.time if now is None else now
        period, self._now = now - self._now, now
        fresh = self.check_fresh(now - state.time)
        fault = self._safety.fault_of(state)
        if fault is not None and self.mode is not TeachingMode.INACTIVE:
            self.stop(fault)
        usable = fault is None or self._safety.readable(state)
        dt = 0.0
        if usable:
            dt = min(max(state.time - self._state.time, 0.0), LONGEST_TICK) if self._state is not None else 0.0
            self._state = state
            self._listen(state, external_torque, dt)
        if self._state is None or self.mode is TeachingMode.INACTIVE:
            return self._answer(None)
        wanted = self._torque(state, dt) if fresh and usable else self._law.weight(self._state.positions)
        if not self._safety.started:
            self._safety.start_from(self._law.weight(self._state.positions))
        return self._answer(self._safety.limited(wanted, period))

    def _begin(self, state: RobotState) -> Setpoint:
        """Check a state and say from where a new reference goes on, so that it does not jump."""
        fault = self._safety.fault_of(state)
        if fault is not None:
            raise InputError(fault, mend="let the arm come to rest, and check its driver")
        if self.mode is TeachingMode.INACTIVE:
            self._now, self._blind = state.time, 0.0
        if self.mode in (TeachingMode.HOLD, TeachingMode.TRACK) and self._reference is not None:
            return self._reference.setpoint
        self._arbitration.reset(0.0)
        return Setpoint(np.array(state.positions), self._zero, self._zero)

    def _enter(self, mode: TeachingMode, message: str) -> None:
        self.mode, self._message, self._motion_id = mode, message, ""
        if mode is not TeachingMode.TRACK:
            self._motion = None

    def _listen(self, state: RobotState, torque: Array | None, dt: float) -> None:
        """Take in the person's push."""
        if torque is None:
            self._blind += dt  # a leap of the clock counts as one long tick: its torques may still be on their way
            if self._blind > self.config.stale_after and self.mode is TeachingMode.TRACK:
                self.stop(f"no external torque for {self._blind:.2f} s; a push would not be felt")
            torque = self._zero
        elif torque.shape != (self.robot.n,) or not all_finite(torque):
            if self.mode is not TeachingMode.INACTIVE:
                self.stop(f"external torque is not {self.robot.n} finite numbers")
            torque = self._zero
        else:
            self._blind = 0.0
        velocities = state.velocities.tolist()
        self._arbitration.step(torque, max(max(velocities), -min(velocities)), dt)
        self._ticks += 1
        if self._ticks % FORCE_TICKS == 0:
            jacobian = self.robot.tool_jacobian(state.positions)[:3]
            force = np.linalg.solve(jacobian @ jacobian.T + 1e-3 * np.eye(3), jacobian @ torque)
            self._force += 0.3 * (float(np.sqrt(force @ force)) - self._force)

    def _torque(self, state: RobotState, dt: float) -> Array:
        if self.mode is TeachingMode.STOPPED:
            return self._stopped_torque(state, dt)
        assert self._reference is not None
        guided = self.mode is TeachingMode.GUIDE
        share = 0.0 if guided else self._arbitration.authority
        damping = self.config.guide_damping if guided else self.config.yield_damping
        setpoint = self._reference.step(state.positions, share, dt)
        return self._law.torque(state.positions, state.velocities, setpoint, share, damping)

    def _stopped_torque(self, state: RobotState, dt: float) -> Array:
        if self._braking is None:
            self._braking = Braking(state, self.robot, self.config)
        setpoint = self._braking.step(state.positions, dt)
        return self._law.soft_hold(state.positions, state.velocities, setpoint, self.config.stop_stiffness)

    def _finished(self) -> bool:
        reference, state = self._reference, self._state
        if self.mode is not TeachingMode.TRACK or reference is None or state is None or not reference.at_end:
            return False
        near = np.abs(reference.setpoint.positions - state.positions).max() < self.config.goal_tolerance
        back = np.abs(reference.offset).max() < self.config.goal_tolerance
        slow = np.abs(state.velocities).max() < SETTLED_SPEED
        return bool(near and back and slow and not self._arbitration.person_leads)

    def _answer(self, torque: Array | None) -> Command:
        person = self._arbitration.person_leads
        leads = self.mode in (TeachingMode.HOLD, TeachingMode.TRACK)
        control = Control.ROBOT if leads else Control.NOBODY
        if person and (leads or self.mode is TeachingMode.GUIDE):
            control = Control.PERSON
        message = "a person leads; let go and the motion goes on" if person and self._motion_id else self._message
        return Command(
            torque=torque, mode=self.mode, control=control, authority=self._arbitration.authority if leads else 0.0,
            motion_id=self._motion_id, motion_time=self._reference.time if self._motion_id and self._reference else 0.0,
            force=self._force, message=message, finished=self._finished())
