"""Carries out what a person presses: calls the services of the lesson and follows what comes of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient
from rclpy.task import Future
from std_srvs.srv import Trigger

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Feedback
from unifeed_msgs.srv import AnswerQuery, ListFeedback, TrainReward, UndoFeedback
from unifeed_ros.console.commands import RANKS
from unifeed_ros.console.record import TaughtRecord
from unifeed_ros.console.state import Question
from unifeed_ros.nodes.node import UnifeedNode

TRIGGERS = ("start_demonstration", "finish_demonstration", "run", "pause", "stop", "ask", "save", "reset")


class LessonClient:
    """The buttons of a lesson, for a page or a terminal.

    Args:
        node: The node behind the page or the terminal.
        record: What was taught; kept up to date with what counts.
        tell: Called with every answer that the person should read.
    """

    def __init__(self, node: UnifeedNode, record: TaughtRecord, tell: Callable[[str], None]) -> None:
        self._record, self._tell = record, tell
        self._messages: dict[str, Feedback] = {}
        self._known, self._given_back = (0, 0, 0), ""
        self.question: Question | None = None
        """The question that waits for its answer."""
        self.saved = ""
        """File of the newest save."""
        self.relearning = False
        """True while the reward is learned again after an undo."""
        self._feedback, self._clock_now = node.advertise("feedback"), node.get_clock().now
        self._buttons = {name: node.create_client(Trigger, name) for name in TRIGGERS}
        self._answer = node.create_client(AnswerQuery, "answer_query")
        self._undo = node.create_client(UndoFeedback, "undo_feedback")
        self._list = node.create_client(ListFeedback, "list_feedback")
        self._train = node.create_client(TrainReward, "train_reward")
        self._optimize = ActionClient(node, OptimizeTrajectory, "optimize_trajectory")

    def press(self, command: str, item: str = "") -> None:
        """Carry a command of the table out.

        Args:
            command: Its name.
            item: Input that it is about; empty: the newest.
        """
        if command in self._buttons:
            self._call(self._buttons[command], Trigger.Request(), self._on_answer)
        elif command in RANKS and self.question is not None:
            request = AnswerQuery.Request(query_id=self.question.id, ranks=list(RANKS[command]))
            self._call(self._answer, request, self._on_answered)
        elif command == "undo":
            name = item or self._record.newest(taken_back=False)
            self._call(self._undo, UndoFeedback.Request(id=name), self._on_undone)
        elif command == "redo":
            self._give_back(item or self._record.newest(taken_back=True))

    def keep(self, msg: Feedback) -> None:
        """Keep an input as it came, so that it can be given back."""
        self._messages[msg.id] = msg

    def check_list(self, counts: tuple[int, int, int]) -> None:
        """Ask the learner which inputs count, when the numbers of demonstrations, corrections, preferences changed."""
        if counts != self._known and self._list.service_is_ready():
            self._known = counts
            self._list.call_async(ListFeedback.Request()).add_done_callback(self._on_list)

    def _call(self, client: Any, request: Any, on_answer: Callable[[Future], None]) -> None:
        if client.service_is_ready():
            client.call_async(request).add_done_callback(on_answer)
        else:
            self._tell(f"Not done: {client.srv_name} is not there; see Health")

    def _on_answer(self, future: Future) -> None:
        answer = future.result()
        saved = answer.message.startswith("saved ")
        if saved:
            self.saved = answer.message.removeprefix("saved ")
        if saved or not answer.success:
            self._tell(answer.message)

    def _on_answered(self, future: Future) -> None:
        self.question = None if future.result().success else self.question
        self._tell(future.result().message)

    def _on_undone(self, future: Future) -> None:
        self._tell(future.result().message.partition(";")[0])
        if future.result().success:
            self._learn_again()

    def _give_back(self, name: str) -> None:
        if name in self._messages:
            self._given_back = name
            self._messages[name].header.stamp = self._clock_now().to_msg()
            self._feedback.publish(self._messages[name])

    def _on_list(self, future: Future) -> None:
        ids = list(future.result().ids)
        self._record.keep_only(ids)
        if self._given_back and self._given_back in ids:
            self._given_back = ""
            self._learn_again()

    def _learn_again(self) -> None:
        """Train on what is left and plan anew, so that the person sees what the undo changed."""
        self.relearning = True
        self._train.call_async(TrainReward.Request()).add_done_callback(self._on_trained)

    def _on_trained(self, future: Future) -> None:
        if not future.result().success:
            self.relearning = False
            self._tell(f"The last motion stays: {future.result().message}")
            return
        self._optimize.send_goal_async(OptimizeTrajectory.Goal()).add_done_callback(self._on_goal)

    def _on_goal(self, future: Future) -> None:
        future.result().get_result_async().add_done_callback(self._on_planned)

    def _on_planned(self, future: Future) -> None:
        if not future.result().result.success:
            self._tell(f"No motion: {future.result().result.message}")
        self.relearning = False
