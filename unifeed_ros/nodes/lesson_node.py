"""What the page and the terminal share: listens to the lesson and knows how it stands."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.msg import (
    Contact,
    Feedback,
    Interaction,
    LessonState,
    PreferenceQuery,
    RewardModel,
    RewardStatus,
    TeachingState,
)
from unifeed_ros.console.health import Status, health_lines
from unifeed_ros.console.motions import DrawnMotion, drawn, is_task_motion
from unifeed_ros.console.record import TaughtRecord
from unifeed_ros.console.state import KINDS, LessonView, Phase, Question
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.types import Trajectory
from unifeed_ros.nodes.control import ControlClaim
from unifeed_ros.nodes.conversions import feedback_from_msg, model_from_msg, seconds, trajectory_from_msg
from unifeed_ros.nodes.lesson_client import LessonClient
from unifeed_ros.nodes.node import DIAGNOSTICS_PREFIX, WARN, UnifeedNode
from unifeed_ros.nodes.topics import find_topic

EXPECTED = ("shared_control", "capture", "reward_learner", "trajectory_optimizer", "session")
ONLOOKERS = {"console", "terminal"}
"""Nodes that come and go without harm."""
COUNTED, WALL_CLOCK = ("teaching_state", "contact", "lesson_state"), {"lesson_state"}
"""Topics whose rates are told, and those of them that do not follow the arm's time."""


class LessonNode(UnifeedNode):
    """Keep what the topics said; give it as a view; carry commands out.

    Args:
        name: Name of the node.
        control_name: What others read when this one has control of the lesson.
        **options: For the node.
    """

    def __init__(self, name: str, control_name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._robot, self._scene = self.load_robot(), self.load_scene()
        self._lesson, self._teaching, self._learner = LessonState(), TeachingState(), RewardStatus(progress=1.0)
        self._statuses: dict[str, tuple[float, Any]] = {}
        self._counts = dict.fromkeys(COUNTED, 0)
        self._rates = {topic: (find_topic(topic).rate, find_topic(topic).rate) for topic in COUNTED}
        self._counted, self._robot_counted, self._contact_at = time.monotonic(), 0.0, None
        self._notes: deque[str] = deque(maxlen=4)
        self._has_model = self._corrected = False
        self._record = TaughtRecord(self._robot)
        self._control_name = control_name

    def connect(self) -> None:
        """Begin to listen; nothing is shown before."""
        self.client = LessonClient(self, self._record, self.tell)
        self.claim = ControlClaim(self, self._control_name, self.somebody_is_there)
        for topic, callback in {
            "lesson_state": self._on_lesson, "teaching_state": self.on_teaching, "contact": self._on_contact,
            "feedback": self._on_feedback, "interaction": self._on_interaction, "reward_model": self._on_model,
            "reward_status": self._on_learner, "trajectory_preview": self._on_preview,
            "preference_query": self._on_query, "diagnostics": self._on_diagnostics,
        }.items():
            self.listen(topic, callback)

    def view(self) -> LessonView:
        """Give everything that is known of the lesson now."""
        self._measure_rates()
        phase = Phase(self._lesson.phase) if self._lesson.phase in set(Phase) else Phase.WAITING
        now = time.monotonic()
        statuses = {name: Status(level=int.from_bytes(s.level, "little"), message=s.message, age=now - at,
                                 values={pair.key: pair.value for pair in s.values})
                    for name, (at, s) in list(self._statuses.items())}
        expected = (*EXPECTED, *sorted(set(statuses) - set(EXPECTED) - ONLOOKERS))
        return LessonView(
            phase=phase, message=self._lesson.message, mode=TeachingMode(self._teaching.mode),
            control=Control(self._teaching.control or Control.NOBODY), stop_reason=self._teaching.message,
            force=self._teaching.force, interactions=self._lesson.interactions, progress=self._learner.progress,
            items=self._record.items, question=self.client.question if phase is Phase.ASKING else None,
            has_model=self._has_model, saved=self.client.saved, corrected=self._corrected,
            busy=self.client.relearning, notes=tuple(self._notes),
            health=health_lines(expected, statuses, self._rates,
                                None if self._contact_at is None else now - self._contact_at))

    # What a person does.

    def press(self, command: str, item: str) -> None:
        """Carry a command of the table out; item is what it is about, or empty. May be called from any thread."""
        self.client.press(command, item)

    @property
    def in_control(self) -> bool:
        """True while this page or terminal has control of the lesson."""
        return self.claim.held

    @property
    def other(self) -> str:
        """Who else has control of the lesson; empty: nobody."""
        return self.claim.holder

    def take_control(self) -> None:
        """Take control of the lesson, whoever has it."""
        self.claim.take()

    def close(self) -> None:
        """Give control back."""
        self.claim.release()

    # What a page or a terminal does differently.

    def somebody_is_there(self) -> bool:
        """Say whether somebody is there who could teach."""
        return True

    def tell(self, message: str) -> None:
        """Show a note; may be called from any thread."""
        self._notes.append(message)

    def show_model(self, model: RewardEnsemble) -> None:
        """Show a new reward."""

    def show_plan(self, plan: DrawnMotion) -> None:
        """Show a new plan."""

    def show_executed(self, name: str, motion: Trajectory) -> None:
        """Show a motion that the arm has carried out."""

    def show_options(self, options: dict[str, DrawnMotion]) -> None:
        """Show the motions of a question."""

    def on_teaching(self, msg: TeachingState) -> None:
        """Keep the arm's state."""
        self._teaching = msg
        self._counts["teaching_state"] += 1

    # What the topics say.

    def _on_lesson(self, msg: LessonState) -> None:
        self._lesson = msg
        self._counts["lesson_state"] += 1

    def _on_contact(self, _: Contact) -> None:
        self._contact_at = time.monotonic()
        self._counts["contact"] += 1

    def _on_feedback(self, msg: Feedback) -> None:
        try:
            self._record.add(feedback_from_msg(msg, self._robot.joint_names))
        except UnifeedError as error:
            self.say(WARN, f"feedback {msg.id} cannot be shown: {error}")
            return
        self.client.keep(msg)

    def _on_interaction(self, msg: Interaction) -> None:
        planned = self._motion(msg.planned)
        if planned is None or (executed := self._motion(msg.executed)) is None:
            return
        self._record.planned(drawn(self._robot, planned), msg.feedback_ids)
        self.show_executed(f"{msg.index}: after the {KINDS.get(msg.kind, 'input')}", executed)
        self._corrected = self._corrected or msg.kind == Feedback.CORRECTION

    def _on_model(self, msg: RewardModel) -> None:
        try:
            self.show_model(model_from_msg(msg))
            self._has_model = True
        except UnifeedError as error:
            self.say(WARN, f"reward model {msg.version} cannot be shown: {error}")

    def _on_learner(self, msg: RewardStatus) -> None:
        self._learner = msg
        self._record.trust({Feedback.DEMONSTRATION: msg.reliability_demonstrations,
                            Feedback.CORRECTION: msg.reliability_corrections,
                            Feedback.PREFERENCE: msg.reliability_preferences})
        self.client.check_list((msg.demonstrations, msg.corrections, msg.preferences))

    def _on_preview(self, msg: JointTrajectory) -> None:
        motion = self._motion(msg)
        if motion is not None and is_task_motion(plan := drawn(self._robot, motion), self._scene.start):
            self.show_plan(plan)
            if self.client.relearning:
                self.tell(f"Now: {self._record.planned(plan, ())}")

    def _on_query(self, msg: PreferenceQuery) -> None:
        options = [self._motion(option) for option in msg.options]
        self.client.question = Question(id=msg.id, information=msg.information, reason=msg.message)
        self.show_options({name: drawn(self._robot, option)
                           for name, option in zip("AB", options, strict=False) if option is not None})

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            self._statuses[status.name.removeprefix(DIAGNOSTICS_PREFIX)] = (time.monotonic(), status)

    def _motion(self, msg: JointTrajectory) -> Trajectory | None:
        try:
            return trajectory_from_msg(msg, self._robot.joint_names)
        except UnifeedError as error:
            self.say(WARN, f"a motion cannot be shown: {error}")
            return None

    def _measure_rates(self) -> None:
        """Count what came; rates of the arm's topics are of its own time, which a simulation may let run slowly."""
        now, robot_now = time.monotonic(), seconds(self._teaching.header.stamp)
        if (elapsed := now - self._counted) < 2.0:
            return
        robot_elapsed = robot_now - self._robot_counted
        if not 0.0 < robot_elapsed < elapsed:  # a simulation that runs fast, or a clock that began anew
            robot_elapsed = elapsed
        self._rates = {name: (count / (elapsed if name in WALL_CLOCK else robot_elapsed), find_topic(name).rate)
                       for name, count in self._counts.items()}
        self._counts, self._counted, self._robot_counted = dict.fromkeys(COUNTED, 0), now, robot_now
