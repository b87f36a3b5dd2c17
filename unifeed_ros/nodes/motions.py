"""What the session lets the arm do: motions planned by the optimizer and carried out by the shared controller."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.action import ExecuteTrajectory, OptimizeTrajectory
from unifeed_msgs.msg import TeachingState
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.types import Array, Context
from unifeed_ros.nodes.conversions import context_to_msg
from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.waiting import Action, Interrupted, LessonError, Waiting

STEADY_GAP = 0.1
"""Time without a state of the arm that counts as a gap [s]."""
PLANNING_S = 60.0
"""Longest search for a motion [s]."""
HAND_OVER_S, POLL_S = 2.0, 0.005
"""Longest time in which the controller takes a motion in place of another, and the time between two looks at it [s]."""
MODEL_S = 1.0
"""Longest time that a new reward model is on its way to the optimizer [s]."""
LOST_S = 3.0
"""Time without any motion in which the controller must have ended the one that it was given [s]."""
SHORTEST_REST = 1.0
"""Shortest duration that the rest of a motion is planned with [s]."""
AT_START = 0.01
"""Distance of a joint from the start within which the arm is there [rad]."""


@dataclass(frozen=True)
class Motion:
    """A motion that was given to the controller."""

    id: str
    """Its name on `trajectory` and `teaching_state`."""
    action: Action
    """What goes on."""

    @property
    def ended(self) -> bool:
        """True if its result is there."""
        return self.action.result.done()


class Motions:
    """Plan motions and have them carried out, from a thread beside the executor's.

    Args:
        node: The session.
        start: Joint positions at which lessons begin, shape (n,) [rad].
        context: Goal and objects of the task.
        waiting: How to wait for answers.
        on_return: Called before the arm moves back to the start.
    """

    def __init__(self, node: UnifeedNode, start: Array, context: Context, waiting: Waiting,
                 on_return: Callable[[], None]) -> None:
        self._node, self._start, self._context = node, start, context_to_msg(context)
        self._waiting, self._on_return = waiting, on_return
        self._optimize = ActionClient(node, OptimizeTrajectory, "optimize_trajectory")
        self._execute = ActionClient(node, ExecuteTrajectory, "execute_trajectory")
        self._motion: Motion | None = None
        self._back: threading.Thread | None = None
        self._heard = self._tracked = 0.0
        self.teaching: TeachingState | None = None
        """What the controller said last; None before that."""
        self.steady_since = 0.0
        """Since when its states have come without a gap; steady time [s]."""
        node.listen("teaching_state", self._on_teaching)

    def _on_teaching(self, msg: TeachingState) -> None:
        now = time.monotonic()
        if now - self._heard > STEADY_GAP:
            self.steady_since = now
        if self._motion is None or msg.mode == TeachingState.TRACK:
            self._tracked = now
        self.teaching, self._heard = msg, now

    @property
    def stopped(self) -> bool:
        """True if the controller has stopped the arm."""
        return self.teaching is not None and self.teaching.mode == TeachingState.STOPPED

    @property
    def lost(self) -> bool:
        """True if the controller was given a motion and does something else: it was started anew."""
        now = time.monotonic()
        lasts = self._motion is not None and not self._motion.ended
        return lasts and now - self._heard < STEADY_GAP and now - self._tracked > LOST_S

    def plan(self, *, start: Sequence[float] = (), goal: Sequence[float] = (), smoothest: bool = False,
             duration: float = 0.0, version: int = 0) -> OptimizeTrajectory.Result:
        """Have a motion planned.

        Args:
            start: Joint positions [rad]; empty: the task's start.
            goal: Joint positions [rad]; empty: the task's goal.
            smoothest: True: without the reward.
            duration: Duration [s]; 0: the task's.
            version: Oldest version of the reward model; one that was just learned may still be on its way.

        Returns:
            The result of the action.

        Raises:
            LessonError: There is no motion.
            Interrupted: The person interrupted.
        """
        request = OptimizeTrajectory.Goal(context=self._context, smoothest=smoothest, start=list(map(float, start)),
                                          goal=list(map(float, goal)), duration=float(duration))
        deadline = time.monotonic() + MODEL_S
        while True:
            result, status = self._waiting.act(self._optimize, request, PLANNING_S)
            if result.model_version >= version or time.monotonic() > deadline:
                break
            time.sleep(POLL_S)
        if status != GoalStatus.STATUS_SUCCEEDED or not result.success:
            raise LessonError(f"no motion: {result.message or 'the optimizer gave up'}", mend="reset goes on")
        return result

    def plan_rest(self, version: int) -> OptimizeTrajectory.Result | None:
        """Have the rest of the motion under way planned, from where the arm is now.

        Args:
            version: As of plan.

        Returns:
            As plan; None if hardly anything is left of it.

        Raises:
            LessonError: There is no motion.
            Interrupted: The person interrupted.
        """
        left = self.teaching.motion_duration - self.teaching.motion_time
        if left < 0.5 * SHORTEST_REST:
            return None
        return self.plan(start=self.teaching.positions, duration=max(left, SHORTEST_REST), version=version)

    def begin(self, trajectory: JointTrajectory, name: str, patience: float = 0.0) -> Motion:
        """Give a motion to the controller.

        Args:
            trajectory: The motion.
            name: First part of its name.
            patience: How long the arm waits for another motion where it was pushed to [s].

        Returns:
            The motion, under way or not yet.

        Raises:
            LessonError: The controller is not there, or refuses.
            Interrupted: The person interrupted.
        """
        motion_id = f"{name} {uuid.uuid4().hex[:8]}"
        goal = ExecuteTrajectory.Goal(trajectory=trajectory, motion_id=motion_id, patience=patience)
        motion = Motion(motion_id, self._waiting.begin(self._execute, goal))
        self._tracked = time.monotonic()
        self._motion = motion
        return motion

    def end(self, motion: Motion) -> ExecuteTrajectory.Result:
        """Wait for the end of a motion.

        Args:
            motion: The motion.

        Returns:
            The result of the action.

        Raises:
            LessonError: The end was not reached.
            Interrupted: The person interrupted.
        """
        try:
            result, status = self._waiting.end(motion.action, None)
        finally:
            self._motion = None
        if status != GoalStatus.STATUS_SUCCEEDED:
            raise LessonError(f"motion stopped: {result.message or 'the controller gave up'}", mend="reset goes on")
        return result

    def carry_out(self, trajectory: JointTrajectory, name: str) -> ExecuteTrajectory.Result:
        """Give a motion to the controller and wait for its end; see begin and end."""
        return self.end(self.begin(trajectory, name))

    def replace(self, motion: Motion, trajectory: JointTrajectory, name: str,
                patience: float) -> tuple[Motion, TeachingState] | None:
        """Have another motion carried out in place of the one under way.

        Args:
            motion: The one under way.
            trajectory: The other one.
            name: First part of its name.
            patience: As of begin.

        Returns:
            The other one, and what the controller said of it first; None if it refused it, as when the person has taken
            the arm again, and the old one goes on.

        Raises:
            LessonError: The controller is not there.
            Interrupted: The person interrupted.
        """
        other = self.begin(trajectory, name, patience)
        deadline = time.monotonic() + HAND_OVER_S
        while time.monotonic() < deadline and not other.ended:
            if self.teaching.motion_id == other.id:
                return other, self.teaching
            time.sleep(POLL_S)
        self._motion = motion
        return None

    def cancel(self) -> None:
        """Let the controller break off what it carries out; a controller that died cannot, and is not asked again."""
        motion, self._motion = self._motion, None
        if motion is not None:
            motion.action.handle.cancel_goal_async()

    def return_to_start(self) -> None:
        """Move back to the start, unless the arm is there.

        Raises:
            LessonError: The start was not reached.
            Interrupted: The person interrupted.
        """
        here = np.array(self.teaching.positions)
        if float(np.abs(here - self._start).max()) < AT_START:
            return
        self._on_return()
        self.carry_out(self.plan(start=here, goal=self._start, smoothest=True).trajectory, "return")

    def begin_return(self) -> None:
        """Move back to the start while the lesson goes on, unless the arm is on its way already."""
        if self._back is None:
            self._back = threading.Thread(target=self._return_quietly, name="return")
            self._back.start()

    def end_return(self) -> None:
        """Wait until the arm that was sent back is there."""
        if self._back is not None:
            self._back.join()
            self._back = None

    def _return_quietly(self) -> None:
        """Move back; a failure here is met again by the move before the next motion."""
        try:
            self.return_to_start()
        except (UnifeedError, Interrupted) as error:
            self._node.get_logger().warning(f"moving back: {error or 'interrupted'}")
