"""What `unifeed replay` gives each node, and what it compares of its answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Feedback
from unifeed_msgs.srv import TrainReward, UndoFeedback
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.feedback.items import FeedbackItem, Preference
from unifeed_ros.core.recording import BagMessage
from unifeed_ros.core.recording.comparison import (
    Comparison,
    Tolerance,
    compare_items,
    compare_models,
    compare_motions,
)
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.nodes.capture import KEPT_SAMPLES
from unifeed_ros.nodes.conversions import feedback_from_msg, model_from_msg, trajectory_from_msg
from unifeed_ros.nodes.player import Player
from unifeed_ros.nodes.recorded import RecordedMessages

LAST_WORDS_S = 2.0
"""Longest wait for what capture makes of the last run [s]."""
ANSWER_S = 300.0
"""Longest wait for a training or a plan [s]."""
AT_START = 0.01
"""A planned motion that ends this near the task's start was one that moves the arm back [rad]."""


class ReplayedNode(Protocol):
    """One node that a recording is played to."""

    name: str
    """Its name in the table of nodes."""
    inputs: tuple[str, ...]
    """Topics of the table that it is fed."""
    outputs: tuple[str, ...]
    """Topics of the table with what it said then; they must be in the recording for anything to be compared."""

    def connect(self, player: Player) -> None:
        """Start to hear what it says, and wait until it is there."""

    def take(self, player: Player, topic: str, message: BagMessage) -> bool:
        """Give it its part of a recorded message; true if recorded time stood still meanwhile."""

    def finish(self, player: Player) -> Sequence[Comparison]:
        """Wait for its last words and compare."""


class CaptureReplay:
    """Gives capture the sensors, the controller's state and the motions; compares demonstrations and corrections."""

    name = "capture"
    inputs: tuple[str, ...] = ("joint_states", "external_torques", "teaching_state", "trajectory")
    outputs = ("feedback",)

    def __init__(self, recorded: RecordedMessages, robot: RobotModel, tolerance: Tolerance) -> None:
        self._recorded, self._robot, self._tolerance = recorded, robot, tolerance
        self._then: list[FeedbackItem] = []
        self._now: list[FeedbackItem] = []

    def connect(self, player: Player) -> None:
        """Hear what is captured, and wait for the node."""
        player.hear(self.name, "feedback", lambda msg: self._now.append(self._item(msg)))
        player.connect(self.name, self.inputs, fast=KEPT_SAMPLES)

    def take(self, player: Player, topic: str, message: BagMessage) -> bool:
        """Send inputs on; keep what was captured then."""
        if topic in self.inputs:
            player.send(self.name, topic, self._recorded.installed_bytes(message))
        elif topic == "feedback":
            item = self._item(self._recorded.read(message))
            if not isinstance(item, Preference) and item.id not in {known.id for known in self._then}:
                self._then.append(item)
        return False

    def finish(self, player: Player) -> Sequence[Comparison]:
        """Wait for the last run's items and compare all of them."""
        player.settle(self.name)
        player.spin(LAST_WORDS_S, lambda: len(self._now) >= len(self._then))
        player.spin(0.2)  # items too many would come now
        return compare_items(self._then, self._now, self._tolerance)

    def _item(self, msg: Feedback) -> FeedbackItem:
        return feedback_from_msg(msg, self._robot.joint_names)


class LearnerReplay:
    """Gives the learner what each recorded model was learned from, asks it to train, compares the models.

    A recording does not hold service calls: undone feedback is what a model did not use any more, and every training is
    asked for as the session asks.
    """

    name = "reward_learner"
    inputs: tuple[str, ...] = ("feedback",)
    outputs = ("reward_model",)

    def __init__(self, recorded: RecordedMessages) -> None:
        self._recorded = recorded
        self._taught: dict[str, bytes] = {}
        self._given: list[str] = []
        self._models: list[Any] = []
        self._compared: list[Comparison] = []
        self._versions: set[int] = set()

    def connect(self, player: Player) -> None:
        """Hear the models, and wait for the node."""
        player.hear(self.name, "reward_model", self._models.append)
        player.connect(self.name, self.inputs)

    def take(self, player: Player, topic: str, message: BagMessage) -> bool:
        """Keep feedback; at a recorded model, teach what it knew and train."""
        if topic == "feedback":
            msg = self._recorded.read(message)
            self._taught.setdefault(msg.id, self._recorded.installed_bytes(message))
            return False
        if topic != "reward_model":
            return False
        then = model_from_msg(self._recorded.read(message))
        if then.version in self._versions:  # latched messages come again in the next file
            return False
        self._versions.add(then.version)
        self._compared.append(self._train(player, then))
        return True

    def finish(self, player: Player) -> Sequence[Comparison]:
        """Give the comparisons that were made on the way."""
        return self._compared

    def _train(self, player: Player, then: Any) -> Comparison:
        missing = [name for name in then.feedback_ids if name not in self._taught]
        if missing:
            return Comparison(what=f"model {then.version}", same=False,
                              message=f"was learned from {', '.join(missing)}, which the recording does not hold")
        for name in [name for name in self._given if name not in then.feedback_ids]:
            player.call(self.name, UndoFeedback, "undo_feedback", UndoFeedback.Request(id=name), ANSWER_S)
            self._given.remove(name)
        for name in then.feedback_ids:
            if name not in self._given:
                player.send(self.name, "feedback", self._taught[name])
                self._given.append(name)
        heard = len(self._models)
        answer = player.call(self.name, TrainReward, "train_reward", TrainReward.Request(), ANSWER_S)
        if not answer.success or not player.spin(LAST_WORDS_S, lambda: len(self._models) > heard):
            return Comparison(what=f"model {then.version}", same=False, message=answer.message or "no model came")
        return compare_models(then, model_from_msg(self._models[-1]))


class PlannerReplay:
    """Gives the planner each recorded model and asks for every recorded motion again.

    A recording does not hold action goals: a motion that ends at the task's start was the smoothest one from where the
    arm was, one that begins elsewhere the rest of the task's after a push, every other one the task's own. The
    planner's search ends by wall-clock time, so that a busy machine may find another motion.
    """

    name = "trajectory_optimizer"
    inputs: tuple[str, ...] = ("reward_model",)
    outputs = ("trajectory_preview",)

    def __init__(self, recorded: RecordedMessages, robot: RobotModel, scene: Scene, tolerance: Tolerance) -> None:
        self._recorded, self._robot, self._tolerance = recorded, robot, tolerance
        self._start = robot.inverse_kinematics(scene.start, scene.axis)
        self._compared: list[Comparison] = []

    def connect(self, player: Player) -> None:
        """Wait for the node; what it plans comes as the action's result."""
        player.connect(self.name, self.inputs)

    def take(self, player: Player, topic: str, message: BagMessage) -> bool:
        """Send models on; at a recorded motion, plan."""
        if topic == "reward_model":
            player.send(self.name, topic, self._recorded.installed_bytes(message))
        elif topic == "trajectory_preview":
            self._compared.append(self._plan(player, self._recorded.read(message)))
            return True
        return False

    def finish(self, player: Player) -> Sequence[Comparison]:
        """Give the comparisons that were made on the way."""
        return self._compared

    def _plan(self, player: Player, msg: Any) -> Comparison:
        then = trajectory_from_msg(msg, self._robot.joint_names)
        back, whole = (float(np.abs(end - self._start).max()) < AT_START for end in then.positions[[-1, 0]])
        goal = OptimizeTrajectory.Goal(smoothest=back)
        if back or not whole:
            goal.start = list(map(float, then.positions[0]))
        if back:
            goal.goal = list(map(float, self._start))
        elif not whole:
            goal.duration = then.duration
        kind = "back to the start" if back else "the task" if whole else "the rest of the task"
        name = f"motion {len(self._compared) + 1} ({kind})"
        result = player.act(self.name, OptimizeTrajectory, "optimize_trajectory", goal, ANSWER_S)
        if not result.success:
            return Comparison(what=name, same=False, message=result.message)
        try:
            return compare_motions(name, then, trajectory_from_msg(result.trajectory, self._robot.joint_names),
                                   self._tolerance)
        except UnifeedError as error:
            return Comparison(what=name, same=False, message=str(error))
