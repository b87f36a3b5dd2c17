"""The shared controller: holds, guides, tracks and stops, and yields to the person's hand at any moment."""

from __future__ import annotations

import math

import numpy as np

from unifeed_ros.core.control.arbitration import Arbitration
from unifeed_ros.core.control.command import Command
from unifeed_ros.core.control.energy import EnergyAccount
from unifeed_ros.core.control.impedance import make_law
from unifeed_ros.core.control.reference import FOLLOW_GAIN, Braking, Reference
from unifeed_ros.core.control.safety import LONGEST_TICK, SafetyFilter, all_finite
from unifeed_ros.core.control.sampled_motion import SampledMotion, Setpoint, require_motion, require_tool
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.control.state_watch import StateWatch
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, Trajectory

FORCE_TICKS = 10
"""Ticks between estimates of the force at the tool: only people read it."""
SETTLED_SPEED = 0.05
"""Speed of the fastest joint below which a motion counts as ended [rad/s]."""
GOAL_DISTANCE = 0.01
"""Distance of the tool from the end of a motion that counts as arrived where the impedance is at the tool [m]."""


class SharedController:
    """Impedance around a reference that both the plan and the person's hand shape.

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
        self.account = EnergyAccount(self.config)
        """What the arm may still give away."""
        self._law = make_law(robot, self.config)
        self._watch = StateWatch(robot)
        self._sent: tuple[Array, Array] | None = None
        self._setpoint: Setpoint | None = None
        self._stiffness = np.zeros(robot.n)
        self._push = np.zeros(robot.n)
        self._dead_zone = self.config.yield_start * np.array(robot.config.contact_thresholds)
        self._arbitration = Arbitration(robot.config.contact_thresholds, self.config)
        self._safety = SafetyFilter(robot, self.config)
        self._reference: Reference | None = None
        self._motion: SampledMotion | None = None
        self._motion_id, self._message = "", "no mode chosen yet"
        self._state: RobotState | None = None
        self._braking: Braking | None = None
        self._now, self._blind, self._unseen = 0.0, 0.0, 0.0
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

    def track(self, trajectory: Trajectory, motion_id: str, state: RobotState, patience: float = 0.0) -> None:
        """Carry out a motion, also in place of another one; the person may push at any moment.

        Args:
            trajectory: The motion; its first point is where the arm is.
            motion_id: Name of the motion.
            state: Measured state.
            patience: After a person has pushed the arm aside: how long it waits there for another motion, before it
                comes back to this one [s].

        Raises:
            InputError: The arm is stopped, a person leads another motion, the state cannot be used, or the motion is of
                another arm, beyond the limits or starts elsewhere. What the arm did goes on.
        """
        if not 0.0 <= patience < math.inf:
            raise InputError("patience of a motion", expected=">= 0 s and finite", got=patience)
        if self.mode is TeachingMode.TRACK and self._arbitration.level > self.config.yield_start:
            raise InputError("a person pushes the arm", mend="wait until they let go")
        if self.mode is TeachingMode.STOPPED:
            raise InputError("the arm is stopped", got=self._message, mend="choose hold or guide first")
        robot = self.robot
        require_motion(trajectory, robot.joint_names, robot.lower - robot.config.position_margin,
                       robot.upper + robot.config.position_margin, robot.velocity_limits)
        require_tool(robot, trajectory, self.config)
        start = self._begin(state)
        gap = float(np.abs(trajectory.positions[0] - start.positions).max())
        if gap > self.config.start_tolerance:
            raise InputError("the motion starts elsewhere", got=f"{gap:.3f} rad away",
                             expected=f"within {self.config.start_tolerance} rad of the arm",
                             mend="move to its start first")
        self._motion = SampledMotion(trajectory)
        self._reference = Reference(start, self._motion, robot, self.config, patience)
        self._enter(TeachingMode.TRACK, f"carrying out {motion_id}")
        self._motion_id = motion_id

    def stop(self, reason: str) -> None:
        """Stop as the stop category says, until hold or guide; the first reason stays.

        Args:
            reason: Why, as a clause for a person.
        """
        if self.mode is not TeachingMode.STOPPED:
            self._braking = None
            self._enter(TeachingMode.STOPPED, f"stopped: {reason}")

    def tell(self, message: str) -> None:
        """Say something else about what the arm goes on doing.

        Args:
            message: A sentence for a person.
        """
        self._message = message

    def deactivate(self) -> None:
        """Send nothing more; the arm holds itself."""
        self._safety.start_from(None)
        self._sent = None
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
        usable = self._check(state)
        dt = 0.0
        self._unseen = 0.0 if fresh and usable else self._unseen + min(max(period, 0.0), LONGEST_TICK)
        if self._watch.frozen and not usable:
            self._unseen = math.inf  # it has not been seen for as long already
        if usable:
            dt = min(max(state.time - self._state.time, 0.0), LONGEST_TICK) if self._state is not None else 0.0
            self._state = state
            self._listen(state, external_torque, dt)
            self._settle(state, dt)
        if self._unseen > self.config.stale_after:
            self._safety.start_from(None)
            self._sent = None
        if self._state is None or self.mode is TeachingMode.INACTIVE or self._unseen > self.config.stale_after:
            return self._answer(None, period)
        wanted = self._torque(state, dt) if fresh and usable else self._blind_torque(self._state)
        weight = self._law.weight(self._state.positions)
        if not self._safety.started:
            self._safety.start_from(weight)
        torque = self._safety.limited(wanted, period)
        self._sent = (torque - weight, self._state.positions)
        return self._answer(torque, period)

    def report(self) -> Command:
        """Say what the controller does, where there is no state to step with; nothing is commanded."""
        return self._answer(None, 0.0)

    def _check(self, state: RobotState) -> bool:
        """Stop if there is something wrong with a state; true if torques can be computed from it."""
        fault = self._safety.fault_of(state)
        usable = fault is None or self._safety.readable(state)
        if usable:
            speeds = self._reference.setpoint.velocities.tolist() if self._motion and self._reference else (0.0,)
            fault = self._watch.fault_of(state, max(max(speeds), -min(speeds))) or fault
            usable = self.mode is TeachingMode.INACTIVE or not (self._watch.doubted or self._watch.frozen)
        if fault is not None and self.mode is not TeachingMode.INACTIVE:
            self.stop(fault)
        return usable

    def _settle(self, state: RobotState, dt: float) -> None:
        """Book the work of the last command; the supply is open while nobody has touched for a while."""
        if self._sent is not None:
            torque, began = self._sent
            arbitration = self._arbitration
            untouched = arbitration.authority == 1.0 and arbitration.level < self.config.untouched_level
            untouched = untouched and self.mode in (TeachingMode.HOLD, TeachingMode.TRACK)
            self.account.settle(float(torque @ (state.positions - began)), dt if untouched else 0.0)

    def _begin(self, state: RobotState) -> Setpoint:
        """Check a state and say from where a new reference goes on, so that it does not jump."""
        fault = self._safety.fault_of(state)
        if fault is not None:
            raise InputError(fault, mend="let the arm come to rest, and check its driver")
        self._watch.accept(state)
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
        self._push = torque
        velocities = state.velocities.tolist()
        self._arbitration.step(torque, max(max(velocities), -min(velocities)), dt)
        self._ticks += 1
        if self._ticks % FORCE_TICKS == 0:
            jacobian = self._safety.jacobian[:3]
            felt = np.linalg.solve(jacobian @ jacobian.T + 1e-3 * np.eye(3), jacobian @ torque)
            force = float(np.sqrt(felt @ felt))
            self._force += 0.3 * (force - self._force)
            if (fault := self._safety.force_fault(force)) is not None and self.mode is not TeachingMode.INACTIVE:
                self.stop(fault)

    def _torque(self, state: RobotState, dt: float) -> Array:
        if self.mode is TeachingMode.STOPPED:
            return self._stopped_torque(state, dt)
        assert self._reference is not None
        guided = self.mode is TeachingMode.GUIDE
        share = 0.0 if guided else self._share
        damping = self.config.guide_damping if guided else self.config.yield_damping
        setpoint = self._reference.step(self._yielding_to(state), share, dt)
        self._setpoint, self._stiffness = setpoint, share * self._law.stiffness
        self._check_following(state, setpoint, share)
        return self._law.torque(state.positions, state.velocities, setpoint, share, damping)

    def _check_following(self, state: RobotState, setpoint: Setpoint, share: float) -> None:
        """Stop, from the next tick on, if the arm does not go where it is sent: its driver may not obey."""
        gaps = (setpoint.positions - state.positions).tolist()
        worst = max(range(len(gaps)), key=lambda joint: abs(gaps[joint]))
        if self.mode is TeachingMode.TRACK and share > 0.9 and abs(gaps[worst]) > self.config.following_error:
            self.stop(f"{self.robot.joint_names[worst]} is {abs(gaps[worst]):.2f} rad from where it should be; check "
                      "that the robot's driver obeys")

    @property
    def _share(self) -> float:
        """The robot's share: what the person's touch leaves it, and what the energy account allows."""
        return min(self._arbitration.authority, self.account.share)

    def _yielding_to(self, state: RobotState) -> Array:
        """Say to where the reference yields: to the arm, or for a stiff servo to where the torque would move it."""
        if self.config.output != "trajectory" or self._reference is None:
            return state.positions
        beyond = self._push - np.minimum(np.maximum(self._push, -self._dead_zone), self._dead_zone)
        return self._reference.setpoint.positions + beyond / (self.config.admittance * FOLLOW_GAIN)

    def _stopped_torque(self, state: RobotState, dt: float) -> Array:
        if self._braking is None:
            self._braking = Braking(state, self.robot, self.config)
        setpoint = self._braking.step(state.positions, dt)
        part = self.config.stop_stiffness if self.config.stop_category == "hold" else 0.0
        self._setpoint, self._stiffness = setpoint, part * self._law.stiffness
        if self.config.stop_category == "zero":
            return self._zero
        return self._law.soft_hold(state.positions, state.velocities, setpoint, part)

    def _blind_torque(self, state: RobotState) -> Array:
        """Say what to send for a moment without a usable state: the weight where the arm was, and what takes its speed.

        Not for longer: an arm whose weight is held unseen falls ever faster, and its driver knows better.
        """
        if self.config.stop_category == "zero":
            return self._zero
        rate = 1.0 / self.config.stop_time
        return self._law.braking(state.positions, rate * math.exp(-rate * self._unseen) * state.velocities)

    def _finished(self) -> bool:
        reference, state = self._reference, self._state
        if self.mode is not TeachingMode.TRACK or reference is None or state is None or not reference.at_end:
            return False
        if self.config.impedance == "tool":  # what the tool leaves free may rest elsewhere
            there, here = (self.robot.tool_pose(q)[0] for q in (reference.setpoint.positions, state.positions))
            near = np.linalg.norm(there - here) < GOAL_DISTANCE
        else:
            near = np.abs(reference.setpoint.positions - state.positions).max() < self.config.goal_tolerance
        back = np.abs(reference.offset).max() < self.config.goal_tolerance
        slow = np.abs(state.velocities).max() < SETTLED_SPEED
        return bool(near and back and slow and not self._arbitration.person_leads)

    def _answer(self, torque: Array | None, period: float) -> Command:
        person = self._arbitration.person_leads
        leads = self.mode in (TeachingMode.HOLD, TeachingMode.TRACK)
        control = Control.ROBOT if leads else Control.NOBODY
        if person and (leads or self.mode is TeachingMode.GUIDE):
            control = Control.PERSON
        message = "a person leads; let go and the motion goes on" if person and self._motion_id else self._message
        setpoint = None if torque is None or self.config.output == "effort" else self._limited_setpoint(period)
        return Command(
            torque=torque, setpoint=setpoint, stiffness=None if setpoint is None else self._stiffness,
            mode=self.mode, control=control, authority=self._share if leads else 0.0,
            motion_id=self._motion_id, motion_time=self._reference.time if self._motion_id and self._reference else 0.0,
            force=self._force, message=message, finished=self._finished())

    def _limited_setpoint(self, period: float) -> Setpoint | None:
        if self._setpoint is None or self._state is None:
            return None
        target = self._safety.limited_target(self._setpoint.positions, self._state.positions, period)
        return Setpoint(target, self._setpoint.velocities, self._setpoint.accelerations)
