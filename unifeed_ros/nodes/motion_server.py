"""The action `execute_trajectory`: one motion at a time, from its goal to its result or to the next one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rclpy.action.server import ServerGoalHandle

from unifeed_msgs.action import ExecuteTrajectory
from unifeed_ros.core.control.command import Command
from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.control.execution import ExecutionRecord
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import RobotState, Trajectory
from unifeed_ros.nodes.conversions import header, trajectory_from_msg, trajectory_to_msg
from unifeed_ros.nodes.deferred import DeferredActionServer
from unifeed_ros.nodes.node import UnifeedNode

FEEDBACK_PERIOD = 0.1
"""Time between two feedback messages of the action [s]."""


@dataclass
class _Execution:
    """The motion under way."""

    handle: ServerGoalHandle
    record: ExecutionRecord
    trajectory: Trajectory
    fed_back: float = 0.0


class MotionServer:
    """Hands motions to the controller and follows them to their end.

    Args:
        node: Whose action it is.
        controller: Carries the motions out.
        ready: Gives the newest state; raises InputError where no motion may begin.
    """

    def __init__(self, node: UnifeedNode, controller: SharedController, ready: Callable[[], RobotState]) -> None:
        self._node, self._controller, self._ready = node, controller, ready
        self._trajectories = node.advertise("trajectory")
        self._execution: _Execution | None = None
        self._server = DeferredActionServer(node, ExecuteTrajectory, "execute_trajectory", self._on_execute)

    @property
    def busy(self) -> bool:
        """True while a motion is under way."""
        return self._execution is not None

    @property
    def duration(self) -> float:
        """Duration of the motion under way; 0 where there is none [s]."""
        return self._execution.trajectory.duration if self._execution is not None else 0.0

    def _on_execute(self, handle: ServerGoalHandle) -> None:
        try:
            self._begin(handle)
        except UnifeedError as error:
            handle.abort()
            result = ExecuteTrajectory.Result(message=str(error))
            self._server.finish(handle, lambda _: result)

    def _begin(self, handle: ServerGoalHandle) -> None:
        state = self._ready()
        trajectory = trajectory_from_msg(handle.request.trajectory, self._controller.robot.joint_names)
        motion_id = handle.request.motion_id or f"motion at {state.time:.3f} s"
        self._controller.track(trajectory, motion_id, state, handle.request.patience)
        self.end(f"{motion_id} is carried out instead")
        handle.request.trajectory.header = header(state.time, motion_id)
        self._trajectories.publish(handle.request.trajectory)
        self._execution = _Execution(handle, ExecutionRecord(trajectory, state.time), trajectory)

    def follow(self, state: RobotState, command: Command) -> None:
        """Take in one tick of the controller; ends the action when the motion has ended.

        Args:
            state: The state of that tick.
            command: The command that answered it.
        """
        execution = self._execution
        if execution is None:
            return
        execution.record.observe(state, command.motion_time, command.control)
        if execution.handle.is_cancel_requested:
            self._controller.hold(state)
            self.end("canceled; the arm holds")
        elif command.finished:
            self._controller.hold(state)
            self.end("")
        elif command.mode is not TeachingMode.TRACK:
            self.end(command.message)
        elif not 0.0 <= state.time - execution.fed_back < FEEDBACK_PERIOD:
            execution.fed_back = state.time
            execution.handle.publish_feedback(ExecuteTrajectory.Feedback(
                motion_time=command.motion_time, authority=command.authority))

    def end(self, why: str) -> None:
        """Finish the action, if there is one: with a reason it was broken off, without one the end was reached.

        Args:
            why: Why it was broken off, as a sentence for a person.
        """
        execution, self._execution = self._execution, None
        if execution is None:
            return
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
        self._server.finish(execution.handle, lambda _: result)
