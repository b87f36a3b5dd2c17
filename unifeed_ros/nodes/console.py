"""Serves the teaching page: shows what the topics say, calls the services that a person presses."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from rclpy.task import Future
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.action import OptimizeTrajectory
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
from unifeed_msgs.srv import AnswerQuery, ListFeedback, TrainReward, UndoFeedback
from unifeed_ros.console.commands import RANKS
from unifeed_ros.console.health import Status, health_lines
from unifeed_ros.console.motions import drawn, is_task_motion
from unifeed_ros.console.page import TeachingPage
from unifeed_ros.console.record import TaughtRecord
from unifeed_ros.console.state import KINDS, LessonView, Phase, Question
from unifeed_ros.core.errors import ConfigError, UnifeedError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.nodes.conversions import feedback_from_msg, header, model_from_msg, seconds, trajectory_from_msg
from unifeed_ros.nodes.node import DIAGNOSTICS_PREFIX, OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.topics import find_topic
from unifeed_ros.simulation.mouse_hand import MouseHand

if TYPE_CHECKING:
    from unifeed_ros.core.scene import Scene
    from unifeed_ros.simulation.tasks import Yardstick

DRAW_PERIOD, VIEW_PERIOD = 0.03, 0.1
"""Time between two postures, and between two looks of the widgets [s]."""
EXPECTED = ("shared_control", "capture", "reward_learner", "trajectory_optimizer", "session")
COUNTED = ("teaching_state", "contact", "lesson_state")
TRIGGERS = ("start_demonstration", "finish_demonstration", "run", "pause", "stop", "ask", "save", "reset")


@dataclass(frozen=True, kw_only=True)
class ConsoleConfig:
    """Where the page is, and what it may do."""

    host: str = "127.0.0.1"
    """Address to listen on; another than this machine's own asks for a token."""
    port: int = 8080
    """Port to listen on; the next free one is taken."""
    token: str = ""
    """Token that a page must show; empty: one is made up where other machines could reach the page."""
    coarse: bool = False
    """True: coarse meshes and no shadows, for tablets and machines without a graphics card."""
    pullable: bool = False
    """True: the mouse pulls the hand of the simulated arm."""
    true_reward: bool = False
    """True: a simulated person teaches, and the regret is shown."""

    def __post_init__(self) -> None:
        """Reject ports that are none."""
        if not 0 <= self.port <= 65535:
            raise ConfigError("port of the console", expected="0 to 65535", got=self.port)


class ConsoleNode(UnifeedNode):
    """Keep what the topics said, hand it to the page ten times a second, carry its commands out."""

    def __init__(self) -> None:
        super().__init__("console")
        self._robot, scene = self.load_robot(), self.load_scene()
        self._config = settings(self, "console", ConsoleConfig)
        self._start = scene.start
        self._lesson, self._teaching, self._learner = LessonState(), TeachingState(), RewardStatus(progress=1.0)
        self._statuses: dict[str, tuple[float, Any]] = {}
        self._record = TaughtRecord(self._robot)
        self._question: Question | None = None
        self._counts = dict.fromkeys(COUNTED, 0)
        self._rates = {name: (find_topic(name).rate, find_topic(name).rate) for name in COUNTED}
        self._counted, self._contact_at = time.monotonic(), None
        self._notes: deque[str] = deque(maxlen=4)
        self._messages: dict[str, Feedback] = {}
        self._relearning, self._given_back, self._corrected = False, "", False
        self._has_model, self._saved, self._known = False, "", (0, 0, 0)
        self._executed: list[Trajectory] = []
        self._yardstick: Yardstick | None = None
        self._mouse, self._target, self._pulling = MouseHand(self._robot), None, False
        self._used = time.process_time()
        self._page = TeachingPage(
            self._robot, scene, self, host=self._config.host, port=self._config.port, token=self._config.token,
            pullable=self._config.pullable, coarse=self._config.coarse)
        self._connect()
        if self._config.true_reward:
            threading.Thread(target=self._measure, args=(scene,), daemon=True).start()
        self.say(OK, f"teaching page: {self._page.address}", address=self._page.address)

    def _connect(self) -> None:
        self._wrenches = self.advertise("hand_wrench") if self._config.pullable else None
        self._feedback = self.advertise("feedback")
        for topic, callback in {
            "lesson_state": self._on_lesson, "teaching_state": self._on_teaching, "contact": self._on_contact,
            "feedback": self._on_feedback, "interaction": self._on_interaction, "reward_model": self._on_model,
            "reward_status": self._on_learner, "trajectory_preview": self._on_preview,
            "preference_query": self._on_query, "diagnostics": self._on_diagnostics,
        }.items():
            self.listen(topic, callback)
        self._buttons = {name: self.create_client(Trigger, name) for name in TRIGGERS}
        self._answer = self.create_client(AnswerQuery, "answer_query")
        self._undo = self.create_client(UndoFeedback, "undo_feedback")
        self._list = self.create_client(ListFeedback, "list_feedback")
        self._train = self.create_client(TrainReward, "train_reward")
        self._optimize = ActionClient(self, OptimizeTrajectory, "optimize_trajectory")
        self.create_timer(DRAW_PERIOD, self._draw, clock=self.steady)
        self.create_timer(VIEW_PERIOD, self._show, clock=self.steady)

    # What the topics say.

    def _on_lesson(self, msg: LessonState) -> None:
        self._lesson = msg
        self._counts["lesson_state"] += 1

    def _on_contact(self, _: Contact) -> None:
        self._contact_at = time.monotonic()
        self._counts["contact"] += 1

    def _on_teaching(self, msg: TeachingState) -> None:
        self._teaching = msg
        self._counts["teaching_state"] += 1
        self._pull_hand(msg)

    def _on_feedback(self, msg: Feedback) -> None:
        try:
            self._record.add(feedback_from_msg(msg, self._robot.joint_names))
        except UnifeedError as error:
            self.say(WARN, f"feedback {msg.id} cannot be shown: {error}")
            return
        self._messages[msg.id] = msg

    def _on_interaction(self, msg: Interaction) -> None:
        planned = self._motion(msg.planned)
        if planned is None or (executed := self._motion(msg.executed)) is None:
            return
        self._record.planned(drawn(self._robot, planned), msg.feedback_ids)
        self._executed.append(executed)
        self._page.add_past(f"{msg.index}: after the {KINDS.get(msg.kind, 'input')}", drawn(self._robot, executed))
        self._corrected = self._corrected or msg.kind == Feedback.CORRECTION

    def _on_model(self, msg: RewardModel) -> None:
        try:
            self._page.show_model(model_from_msg(msg))
            self._has_model = True
        except UnifeedError as error:
            self.say(WARN, f"reward model {msg.version} cannot be shown: {error}")

    def _on_learner(self, msg: RewardStatus) -> None:
        self._learner = msg
        self._record.trust({Feedback.DEMONSTRATION: msg.reliability_demonstrations,
                            Feedback.CORRECTION: msg.reliability_corrections,
                            Feedback.PREFERENCE: msg.reliability_preferences})
        counts = (msg.demonstrations, msg.corrections, msg.preferences)
        if counts != self._known and self._list.service_is_ready():
            self._known = counts
            self._list.call_async(ListFeedback.Request()).add_done_callback(self._on_list)

    def _on_list(self, future: Future) -> None:
        ids = list(future.result().ids)
        self._record.keep_only(ids)
        if self._given_back and self._given_back in ids:
            self._given_back = ""
            self._learn_again()

    def _on_preview(self, msg: JointTrajectory) -> None:
        motion = self._motion(msg)
        if motion is not None and is_task_motion(plan := drawn(self._robot, motion), self._start):
            self._page.show_plan(plan)
            if self._relearning:
                self._note(f"Now: {self._record.planned(plan, ())}")

    def _on_query(self, msg: PreferenceQuery) -> None:
        options = [self._motion(option) for option in msg.options]
        self._question = Question(id=msg.id, information=msg.information, reason=msg.message)
        self._page.show_options({name: drawn(self._robot, option)
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

    # What the page shows.

    def _draw(self) -> None:
        if self._page.watched and len(self._teaching.positions) == self._robot.n:
            self._page.move_arm(np.asarray(self._teaching.positions))
            self._page.animate(time.monotonic())

    def _show(self) -> None:
        self._measure_rates()
        self._page.show(self._view())

    def _view(self) -> LessonView:
        phase = Phase(self._lesson.phase) if self._lesson.phase in set(Phase) else Phase.WAITING
        now = time.monotonic()
        statuses = {name: Status(level=int.from_bytes(s.level, "little"), message=s.message, age=now - at,
                                 values={pair.key: pair.value for pair in s.values})
                    for name, (at, s) in list(self._statuses.items())}
        expected = (*EXPECTED, *sorted(set(statuses) - set(EXPECTED) - {"console"}))
        return LessonView(
            phase=phase, message=self._lesson.message, mode=TeachingMode(self._teaching.mode),
            control=Control(self._teaching.control or Control.NOBODY), stop_reason=self._teaching.message,
            force=self._teaching.force, interactions=self._lesson.interactions, progress=self._learner.progress,
            items=self._record.items, question=self._question if phase is Phase.ASKING else None,
            has_model=self._has_model, saved=self._saved, corrected=self._corrected, busy=self._relearning,
            simulated=self._config.pullable, taught_by_machine=self._config.true_reward, regret=self._regrets(),
            notes=tuple(self._notes),
            health=health_lines(expected, statuses, self._rates,
                                None if self._contact_at is None else now - self._contact_at))

    def _measure_rates(self) -> None:
        if (elapsed := time.monotonic() - self._counted) >= 2.0:
            self._rates = {name: (count / elapsed, find_topic(name).rate) for name, count in self._counts.items()}
            self._counts, self._counted = dict.fromkeys(COUNTED, 0), time.monotonic()

    def _measure(self, scene: Scene) -> None:
        from unifeed_ros.simulation.tasks import TrueTask, measure  # the planner is not needed where a person teaches

        self._yardstick = measure(self.load_robot(), TrueTask(scene=scene))

    def _regrets(self) -> tuple[float, ...]:
        if self._yardstick is None:
            return ()
        return tuple(self._yardstick.normalised_regret(motion) for motion in self._executed)

    def _note(self, message: str) -> None:
        self._notes.append(message)
        self._page.tell(message)

    # What the person does.

    def press(self, command: str, item: str) -> None:
        """Carry a command of the page out."""
        if command in self._buttons:
            self._call(self._buttons[command], Trigger.Request(), self._on_answer)
        elif command in RANKS and self._question is not None:
            request = AnswerQuery.Request(query_id=self._question.id, ranks=list(RANKS[command]))
            self._call(self._answer, request, self._on_answered)
        elif command == "undo":
            name = item or self._record.newest(taken_back=False)
            self._call(self._undo, UndoFeedback.Request(id=name), self._on_undone)
        elif command == "redo":
            self._give_back(item or self._record.newest(taken_back=True))

    def pull(self, target: Array | None) -> None:
        """Pull the arm's hand towards a place, shape (3,) [m]; None lets go."""
        self._target = target

    def _call(self, client: Any, request: Any, on_answer: Any) -> None:
        if client.service_is_ready():
            client.call_async(request).add_done_callback(on_answer)
        else:
            self._note(f"Not done: {client.srv_name} is not there; see Health")

    def _on_answer(self, future: Future) -> None:
        answer = future.result()
        saved = answer.message.startswith("saved ")
        if saved:
            self._saved = answer.message.removeprefix("saved ")
        if saved or not answer.success:
            self._note(answer.message)

    def _on_answered(self, future: Future) -> None:
        self._question = None if future.result().success else self._question
        self._note(future.result().message)

    def _on_undone(self, future: Future) -> None:
        self._note(future.result().message.partition(";")[0])
        if future.result().success:
            self._learn_again()

    def _give_back(self, name: str) -> None:
        if name in self._messages:
            self._given_back = name
            self._feedback.publish(self._messages[name])

    def _learn_again(self) -> None:
        """Train on what is left and plan anew, so that the page shows what the undo changed."""
        self._relearning = True
        self._train.call_async(TrainReward.Request()).add_done_callback(self._on_trained)

    def _on_trained(self, future: Future) -> None:
        if not future.result().success:
            self._relearning = False
            self._note(f"The last motion stays: {future.result().message}")
            return
        self._optimize.send_goal_async(OptimizeTrajectory.Goal()).add_done_callback(self._on_goal)

    def _on_goal(self, future: Future) -> None:
        future.result().get_result_async().add_done_callback(self._on_planned)

    def _on_planned(self, future: Future) -> None:
        if not future.result().result.success:
            self._note(f"No motion: {future.result().result.message}")
        self._relearning = False

    def _pull_hand(self, msg: TeachingState) -> None:
        """Answer the arm's state with the mouse's force, like a person who holds the hand."""
        target = self._target  # read once: the page's thread may let go meanwhile
        if self._wrenches is None or (target is None and not self._pulling):
            return
        wrench, now = np.zeros(6), seconds(msg.header.stamp)
        if target is not None:
            wrench = self._mouse.wrench(now, np.asarray(msg.positions), target)
        else:
            self._mouse.let_go()
        self._pulling = target is not None
        out = WrenchStamped(header=header(now, self._robot.config.base_frame))
        for part, values in ((out.wrench.force, wrench[:3]), (out.wrench.torque, wrench[3:])):
            part.x, part.y, part.z = map(float, values)
        self._wrenches.publish(out)

    def refresh_status(self) -> None:
        """Say where the page is and what it costs; the status comes once a second."""
        used, self._used = time.process_time() - self._used, time.process_time()
        self.say(OK, f"teaching page: {self._page.address}", address=self._page.address,
                 pages=int(self._page.watched), cpu_percent=f"{100 * used:.0f}")

    def close(self) -> None:
        """Let go of the arm's hand and end the page."""
        self._target = None
        if self._pulling:
            self._pull_hand(self._teaching)
        self._page.close()


def main() -> int:
    """Run the node `console`."""
    return run_node(ConsoleNode)


if __name__ == "__main__":
    sys.exit(main())
