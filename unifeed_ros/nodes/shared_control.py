"""Carries motions out and yields to the person's hand: joint states and external torques in, commands out."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

from std_srvs.srv import Trigger

from unifeed_msgs.msg import LessonState
from unifeed_msgs.srv import SetMode
from unifeed_ros.core.capture.contact import ContactDetector, ContactSample
from unifeed_ros.core.capture.contact_config import ContactConfig, ContactKind
from unifeed_ros.core.control.clock import ClockWatch
from unifeed_ros.core.control.command import Command
from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.control.silence import Silence
from unifeed_ros.core.errors import ConfigError, InputError, UnifeedError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.types import Array, RobotState
from unifeed_ros.nodes.command_output import CommandOutput
from unifeed_ros.nodes.conversions import teaching_state_to_msg
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.lifecycle import ManagedNode
from unifeed_ros.nodes.loop_figures import LoopFigures
from unifeed_ros.nodes.motion_server import MotionServer
from unifeed_ros.nodes.node import ERROR, OK, WARN
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.real_time import RealTimeConfig
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.torque_input import TorqueInput

STATE_PERIOD = 0.01
"""Time between two messages on `teaching_state` while the mode stays [s]."""
WATCH_PERIOD = 0.02
"""Time between two looks at what comes [s]."""


@dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """How the control loop runs."""

    rate: float = 500.0
    """Rate of commands; each answers a joint state [Hz]."""
    late: float = 0.010
    """Wall-clock time between two commands that counts as a missed deadline [s]."""
    session_timeout: float = 2.0
    """Silence of a session that was there, while a motion is carried out, that stops the arm [s]."""

    def __post_init__(self) -> None:
        """Reject rates that cannot be kept."""
        if not (10.0 <= self.rate <= 1000.0 and self.late > 0.0 and self.session_timeout > 0.1):
            raise ConfigError("control loop", expected="rate 10 to 1000 Hz, late > 0 s, session_timeout > 0.1 s",
                              got=f"{self.rate} Hz, {self.late} s, {self.session_timeout} s")


class SharedControlNode(ManagedNode):
    """Answer joint states with commands, while it is active and a mode has been chosen."""

    def __init__(self) -> None:
        super().__init__("shared_control")
        self.real_time = settings(self, "real_time", RealTimeConfig)
        self._robot = self.load_robot()
        self._loop = settings(self, "loop", LoopConfig)
        config = settings(self, "control", ControlConfig)
        self._controller = SharedController(self._robot, config)
        self._detector = ContactDetector(
            self._robot.config.contact_thresholds, settings(self, "contact", ContactConfig), self._robot
        )
        self._state_reader = JointReader(self._robot.joint_names)
        self._torque_input = TorqueInput(self, self._robot, self._on_torque,
                                         lambda reason: self._fault(f"external torque: {reason}"))
        self._clock_watch = ClockWatch(config.clock_step)
        self._figures = LoopFigures(self._loop.rate, self._loop.late)
        self._state: RobotState | None = None
        self._torque: Array | None = None
        self._torque_time = self._commanded = self._sent_state = 0.0
        self._state_silence, self._session_silence = Silence(WATCH_PERIOD), Silence(WATCH_PERIOD)
        self._session_seen = False
        self._last: Command | None = None
        self._connect()

    def _connect(self) -> None:
        self._output = CommandOutput(self, self._robot, self._controller.config.output, 1.0 / self._loop.rate)
        self._teaching = self.advertise("teaching_state")
        self._motions = MotionServer(self, self._controller, self._require_ready)
        self.listen("joint_states", self._on_state, raw=True)
        self.listen("lesson_state", self._on_lesson)
        self.create_service(SetMode, "set_mode", self._on_set_mode)
        self.create_service(Trigger, "stop", self._on_stop)
        self.create_timer(WATCH_PERIOD, self._watch, clock=self.steady)
        self.say(OK, "waiting for joint states")

    # Inputs.

    def _on_torque(self, time: float, torque: Array) -> None:
        self._figures.torque()
        if self._state is None:
            return
        try:
            sample = self._detector.update(time, torque, self._state.velocities, self._state.positions)
        except InputError as error:
            self._fault(f"external torque: {error}")
            return
        if sample.kind is ContactKind.COLLISION:
            self._on_collision(sample)
        self._torque, self._torque_time = sample.torque, sample.time

    def _on_collision(self, sample: ContactSample) -> None:
        """Stop an arm that was hit on its way; one that holds or is guided yields anyway."""
        if self._controller.mode is TeachingMode.TRACK:
            self._controller.stop(f"something hit the arm at or beyond {self._robot.joint_names[sample.link - 1]}: "
                                  "clear its way, then set_mode or the session's reset")

    def _on_state(self, data: bytes) -> None:
        now = self._figures.state()
        try:
            state = self._state_reader.state(data)
        except InputError as error:
            self._fault(f"joint state: {error}")
            return
        if (fault := self._clock_watch.fault_of(state.time, now)) is not None:
            self._commanded = -1.0 / self._loop.rate  # answered at once, with the stop
            self._fault(fault)
        elif self._state is None or state.time > self._state.time:
            self._state_silence.end()  # a driver that repeats itself is as silent as one that says nothing
        self._state = state
        self._torque_input.observe_state(state)
        if not 0.0 <= state.time - self._commanded < 1.0 / self._loop.rate - 0.0005:
            self._commanded = state.time
            self._tick(state)

    def _on_lesson(self, _: LessonState) -> None:
        self._session_seen = True
        self._session_silence.end()

    def _fault(self, reason: str) -> None:
        if self._controller.mode is not TeachingMode.INACTIVE:
            self._controller.stop(reason)
        self.say(ERROR, reason)
        self._announce()

    def _announce(self) -> None:
        """Tell a stop at once, also where no state comes that a tick could answer."""
        if self._state is not None and self._last is not None and self._controller.mode is not self._last.mode:
            self._last = self._controller.report()
            self._publish_state(self._state, self._last)

    # The loop.

    def _tick(self, state: RobotState) -> None:
        fresh = abs(state.time - self._torque_time) < self._controller.config.stale_after
        command = self._controller.step(state, self._torque if fresh else None)
        if self.active and self._output.send(state.time, command):
            self._figures.command()
        else:
            self._figures.pause()
        self._motions.follow(state, command)
        changed = self._last is None or command.mode is not self._last.mode
        self._last = command
        if changed or not 0.0 <= state.time - self._sent_state < STATE_PERIOD:
            self._publish_state(state, command)

    def _publish_state(self, state: RobotState, command: Command) -> None:
        self._teaching.publish(teaching_state_to_msg(
            command, state, self._motions.duration, self._robot.config.base_frame))
        self._sent_state = state.time
        message = command.message if self.active else "not active: the session, or ros2 lifecycle set, activates it"
        self.say(WARN if command.mode is TeachingMode.STOPPED else OK, message)

    def _watch(self) -> None:
        """Notice what does not come any more, and who else sends commands."""
        now = time.monotonic()
        state_silence, session_silence = self._state_silence.look(now), self._session_silence.look(now)
        if self._state is None:
            return
        if not self._controller.check_fresh(state_silence):
            self.say(ERROR, "joint states stopped coming: check the robot's driver")
            self._motions.end("joint states stopped coming")
            self._announce()
        leading = self._controller.mode not in (TeachingMode.INACTIVE, TeachingMode.STOPPED)
        if leading and self._session_seen and session_silence > self._loop.session_timeout:
            self._session_seen = False
            (self._controller.stop if self._motions.busy else self._controller.tell)("the session died; start it again")
        if leading and self._output.rivals() > 0:
            self._fault(f"another node publishes on {self._output.topic}; end it, then choose a mode")

    # Services and states.

    def _require_ready(self) -> RobotState:
        """Give the newest state, where commands are permitted."""
        if not self.active:
            raise InputError("shared_control is not active", mend="ros2 lifecycle set shared_control configure, then "
                             "activate; or the session's reset")
        if self._state is None:
            raise InputError("no joint state yet", mend="start the robot's driver")
        return self._state

    def _on_set_mode(self, request: SetMode.Request, response: SetMode.Response) -> SetMode.Response:
        try:
            state = self._require_ready()
            if self._motions.busy:
                raise InputError("a motion is under way", mend="wait for its end, or call stop")
            guide = request.mode == SetMode.Request.GUIDE
            (self._controller.guide if guide else self._controller.hold)(state)
        except UnifeedError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = "the arm is weightless" if guide else "the arm holds"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.active:
            self._controller.stop("a person or a node called stop")
        response.success, response.message = True, "stopped; set_mode or the session's reset ends it"
        return response

    def deactivated(self) -> None:
        """Send nothing more: the arm holds itself once commands stop."""
        self._controller.deactivate()
        self._motions.end("shared_control was deactivated; the arm holds itself")

    def refresh_status(self) -> None:
        """Give the figures of the loop, and who leads."""
        last = self._last
        self.say(
            self._status.level, self._status.message, **self._figures.values(), active=self.active,
            contact=last is not None and last.control is Control.PERSON,
            authority=f"{last.authority if last is not None else 0.0:.2f}",
            force_n=f"{last.force if last is not None else 0.0:.1f}",
            energy_j=f"{self._controller.account.level:.2f}")

    def close(self) -> None:
        """Send nothing more: the arm holds itself once commands stop."""
        self._controller.deactivate()


def main() -> int:
    """Run the node `shared_control`."""
    return run_node(SharedControlNode)


if __name__ == "__main__":
    sys.exit(main())
