"""Carries motions out and yields to the person's hand: joint states and external torques in, torques out."""

from __future__ import annotations

import sys
import time
from collections import deque
from dataclasses import dataclass

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future
from std_srvs.srv import Trigger

from unifeed_msgs.action import ExecuteTrajectory
from unifeed_msgs.msg import LessonState
from unifeed_msgs.srv import SetMode
from unifeed_ros.core.capture.contact import ContactConfig, ContactDetector
from unifeed_ros.core.control.command import Command
from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.control.execution import ExecutionRecord
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.control.silence import Silence
from unifeed_ros.core.errors import ConfigError, InputError, UnifeedError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import Array, RobotState, Trajectory
from unifeed_ros.nodes.conversions import (
    teaching_state_to_msg,
    trajectory_from_msg,
    trajectory_to_msg,
)
from unifeed_ros.nodes.joint_stream import JointReader, JointWriter
from unifeed_ros.nodes.node import ERROR, OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.real_time import RealTimeConfig
from unifeed_ros.nodes.spin import run_node

STATE_PERIOD = 0.01
"""Time between two messages on `teaching_state` while the mode stays [s]."""
WATCH_PERIOD = 0.02
"""Time between two looks at what comes [s]."""
LONGEST_GAP = 3.0 * WATCH_PERIOD
"""Time between two looks beyond which this process itself was not awake [s]."""
FEEDBACK_PERIOD = 0.1
"""Time between two feedback messages of the action [s]."""


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


@dataclass
class _Execution:
    """The motion under way."""

    handle: ServerGoalHandle
    record: ExecutionRecord
    trajectory: Trajectory
    done: Future
    fed_back: float = 0.0


class SharedControlNode(UnifeedNode):
    """Answer joint states with torques; no torque goes out before the first mode is chosen."""

    def __init__(self) -> None:
        super().__init__("shared_control")
        self.real_time = settings(self, "real_time", RealTimeConfig)
        self._robot = self.load_robot()
        self._loop = settings(self, "loop", LoopConfig)
        self._controller = SharedController(self._robot, settings(self, "control", ControlConfig))
        self._detector = ContactDetector(
            self._robot.config.contact_thresholds, settings(self, "contact", ContactConfig)
        )
        self._state_reader = JointReader(self._robot.joint_names)
        self._torque_reader = JointReader(self._robot.joint_names)
        self._writer = JointWriter(self._robot.joint_names, ("effort",))
        self._state: RobotState | None = None
        self._torque: Array | None = None
        self._torque_time = self._commanded = self._sent_state = 0.0
        self._answered = 0.0
        self._state_silence, self._session_silence = Silence(LONGEST_GAP), Silence(LONGEST_GAP)
        self._execution: _Execution | None = None
        self._session_seen = False
        self._periods: deque[float] = deque(maxlen=20000)
        self._commands = self._late = 0
        self._last_mode: TeachingMode | None = None
        self._connect()

    def _connect(self) -> None:
        self._commands_topic = self.advertise("joint_command")
        self._teaching = self.advertise("teaching_state")
        self._trajectories = self.advertise("trajectory")
        self.listen("joint_states", self._on_state, raw=True)
        self.listen("external_torques", self._on_torque, raw=True)
        self.listen("lesson_state", self._on_lesson)
        self.create_service(SetMode, "set_mode", self._on_set_mode)
        self.create_service(Trigger, "stop", self._on_stop)
        self._server = ActionServer(
            self, ExecuteTrajectory, "execute_trajectory", self._on_execute, goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT)
        self.create_timer(WATCH_PERIOD, self._watch, clock=self.steady)
        self.say(OK, "waiting for joint states")

    # Inputs.

    def _on_torque(self, data: bytes) -> None:
        if self._state is None:
            return
        try:
            time, torque = self._torque_reader.torques(data, "external torques")
            sample = self._detector.update(time, torque, self._state.velocities)
        except InputError as error:
            self._fault(f"external torque: {error}")
            return
        self._torque, self._torque_time = sample.torque, sample.time

    def _on_state(self, data: bytes) -> None:
        try:
            self._state = self._state_reader.state(data)
        except InputError as error:
            self._fault(f"joint state: {error}")
            return
        self._state_silence.end()
        step = self._state.time - self._commanded
        if step < 0.0:
            self._commanded = self._state.time
        if step >= 1.0 / self._loop.rate - 0.0005 or step < 0.0:
            self._commanded = self._state.time
            self._tick(self._state)

    def _on_lesson(self, _: LessonState) -> None:
        self._session_seen = True
        self._session_silence.end()

    def _fault(self, reason: str) -> None:
        if self._controller.mode is not TeachingMode.INACTIVE:
            self._controller.stop(reason)
        self.say(ERROR, reason)

    # The loop.

    def _tick(self, state: RobotState) -> None:
        fresh = 0.0 <= state.time - self._torque_time < self._controller.config.stale_after
        command = self._controller.step(state, self._torque if fresh else None)
        if command.torque is not None:
            self._commands_topic.publish(self._writer.write(state.time, command.torque))
            self._count()
        if self._execution is not None:
            self._follow(self._execution, state, command)
        if command.mode is not self._last_mode or not 0.0 <= state.time - self._sent_state < STATE_PERIOD:
            self._publish_state(state, command)

    def _count(self) -> None:
        now = time.monotonic()
        if self._commands:
            self._periods.append(now - self._answered)
            self._late += now - self._answered > self._loop.late
        self._answered = now
        self._commands += 1

    def _publish_state(self, state: RobotState, command: Command) -> None:
        duration = self._execution.trajectory.duration if self._execution is not None else 0.0
        self._teaching.publish(teaching_state_to_msg(command, state, duration, self._robot.config.base_frame))
        self._last_mode, self._sent_state = command.mode, state.time
        self.say(WARN if command.mode is TeachingMode.STOPPED else OK, command.message)

    def _watch(self) -> None:
        """Notice what does not come any more."""
        now = time.monotonic()
        state_silence, session_silence = self._state_silence.look(now), self._session_silence.look(now)
        if self._state is None:
            return
        if not self._controller.check_fresh(state_silence):
            self.say(ERROR, "joint states stopped coming: check the robot's driver")
            if self._execution is not None:
                self._end(self._execution, "joint states stopped coming")
        if self._execution is not None and self._session_seen and session_silence > self._loop.session_timeout:
            self._controller.stop("the session died; start it again")

    # Motions.

    def _on_goal(self, _: ExecuteTrajectory.Goal) -> GoalResponse:
        return GoalResponse.REJECT if self._execution is not None else GoalResponse.ACCEPT

    async def _on_execute(self, handle: ServerGoalHandle) -> ExecuteTrajectory.Result:
        try:
            execution = self._begin(handle)
        except UnifeedError as error:
            handle.abort()
            return ExecuteTrajectory.Result(message=str(error))
        return await execution.done

    def _begin(self, handle: ServerGoalHandle) -> _Execution:
        if self._state is None:
            raise InputError("no joint state yet", mend="start the robot's driver")
        if self._execution is not None:
            raise InputError("a motion is under way", mend="wait for its end or cancel it")
        trajectory = trajectory_from_msg(handle.request.trajectory, self._robot.joint_names)
        motion_id = handle.request.motion_id or f"motion at {self._state.time:.3f} s"
        self._controller.track(trajectory, motion_id, self._state)
        self._trajectories.publish(trajectory_to_msg(trajectory, self._state.time, motion_id))
        self._execution = _Execution(handle, ExecutionRecord(trajectory, self._state.time), trajectory,
                                     Future(executor=self.executor))
        return self._execution

    def _follow(self, execution: _Execution, state: RobotState, command: Command) -> None:
        execution.record.observe(state, command.motion_time, command.control)
        if execution.handle.is_cancel_requested:
            self._controller.hold(state)
            self._end(execution, "canceled; the arm holds")
        elif command.finished:
            self._controller.hold(state)
            self._end(execution, "")
        elif command.mode is not TeachingMode.TRACK:
            self._end(execution, command.message)
        elif not 0.0 <= state.time - execution.fed_back < FEEDBACK_PERIOD:
            execution.fed_back = state.time
            execution.handle.publish_feedback(ExecuteTrajectory.Feedback(
                motion_time=command.motion_time, authority=command.authority))

    def _end(self, execution: _Execution, why: str) -> None:
        """Finish the action: with a reason it was broken off, without one the end was reached."""
        self._execution = None
        result = ExecuteTrajectory.Result(success=not why, message=why or "the end of the motion was reached")
        executed = execution.record.executed()
        if executed is not None:
            result.executed = trajectory_to_msg(executed)
        result.touched, result.tracking_rms = execution.record.touched, execution.record.tracking_rms()
        if not why:
            execution.handle.succeed()
        elif execution.handle.is_cancel_requested:
            execution.handle.canceled()
        else:
            execution.handle.abort()
        execution.done.set_result(result)

    # Services.

    def _on_set_mode(self, request: SetMode.Request, response: SetMode.Response) -> SetMode.Response:
        try:
            if self._state is None:
                raise InputError("no joint state yet", mend="start the robot's driver")
            if self._execution is not None:
                raise InputError("a motion is under way", mend="wait for its end, or call stop")
            guide = request.mode == SetMode.Request.GUIDE
            (self._controller.guide if guide else self._controller.hold)(self._state)
        except UnifeedError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = "the arm is weightless" if guide else "the arm holds"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._controller.stop("a person or a node called stop")
        response.success, response.message = True, "stopped; set_mode or the session's reset ends it"
        return response

    def refresh_status(self) -> None:
        """Give the figures of the loop."""
        periods = 1e3 * np.array(self._periods) if self._periods else np.array([np.nan])
        self.say(
            self._status.level,
            self._status.message,
            rate_hz=f"{1e3 / np.mean(periods):.1f}",
            commands=self._commands,
            period_p50_ms=f"{np.percentile(periods, 50):.3f}",
            period_p99_ms=f"{np.percentile(periods, 99):.3f}",
            period_max_ms=f"{periods.max():.3f}",
            missed_deadlines=self._late,
        )

    def close(self) -> None:
        """Send nothing more: the arm holds itself once commands stop."""
        self._controller.deactivate()


def main() -> int:
    """Run the node `shared_control`."""
    return run_node(SharedControlNode)


if __name__ == "__main__":
    sys.exit(main())
