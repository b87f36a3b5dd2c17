"""Learns the reward from everything that was taught (paper eqs. M1-M9); a worker process trains, the node goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup

from unifeed_msgs.msg import Feedback, PreferenceQuery, RewardStatus, TaskContext, TrackedRun
from unifeed_msgs.srv import (
    AnswerQuery,
    EvaluateReward,
    ListFeedback,
    RankMotions,
    SelectQuery,
    TrainReward,
    UndoFeedback,
)
from unifeed_ros.core.errors import InputError, UnifeedError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.features import make_feature
from unifeed_ros.core.reward.queries import QueryConfig
from unifeed_ros.core.reward.reliability import KINDS
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.nodes.arrivals import Arrivals
from unifeed_ros.nodes.conversions import (
    context_from_msg,
    context_to_msg,
    feedback_from_msg,
    feedback_to_msg,
    header,
    model_to_msg,
    seconds,
    trajectory_from_msg,
    trajectory_to_msg,
)
from unifeed_ros.nodes.deferred import patiently
from unifeed_ros.nodes.kept_feedback import KeptFeedback
from unifeed_ros.nodes.node import ERROR, OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.training_worker import ChosenQuery, TrainingWorker

MESSAGE_KINDS = {"demonstration": Feedback.DEMONSTRATION, "correction": Feedback.CORRECTION,
                 "preference": Feedback.PREFERENCE}

REMEMBERED_RUNS = 100
"""Number of past runs that can be ranked."""


@dataclass(frozen=True, kw_only=True)
class LearnerConfig:
    """Settings of the node."""

    folder: str = ""
    """Folder that keeps what was taught, so that a learner that is started again goes on with it; empty: none."""


class RewardLearnerNode(UnifeedNode):
    """Keep the dataset, train on request, choose questions, evaluate motions."""

    answers_later = True

    def __init__(self) -> None:
        super().__init__("reward_learner")
        self._robot = self.load_robot()
        self._task_context = self.load_scene().context()
        self._training = settings(self, "training", TrainingConfig)
        for feature in self._training.features:
            make_feature(feature, self._task_context)  # refuses what is unknown before anything is taught
        self._questions = settings(self, "query", QueryConfig)
        self._dataset = FeedbackDataset(self._robot.config.name, self._robot.joint_names)
        self._model: RewardEnsemble | None = None
        self._known: RewardEnsemble | None = None
        self._version = 0
        self._reliability = (1.0, 1.0, 1.0)
        self._stamps: dict[str, tuple[int, int]] = {}
        self._runs: dict[str, Trajectory] = {}
        self._rankings = 0
        self._query: PreferenceQuery | None = None
        self._queries_asked = 0
        self._time = 0.0
        self._under_way = 0
        self._arrivals = Arrivals()
        folder = settings(self, "learner", LearnerConfig).folder
        self._kept = KeptFeedback(Path(folder)) if folder else None
        self._relearned: Future[TrainingResult] | None = None
        self._worker = TrainingWorker()
        self._connect()
        self.say(OK, "nothing taught yet")
        if self._kept is not None and self._kept.found:
            self._go_on(self._kept.found)
        self._publish_status_message()

    def _connect(self) -> None:
        self._models = self.advertise("reward_model")
        self._statuses = self.advertise("reward_status")
        self._feedback = self.advertise("feedback")
        self.listen("feedback", self._on_feedback)
        self.listen("tracked_run", self._on_run)
        # groups of their own: while a coroutine waits, its group runs nothing else
        self.create_service(TrainReward, "train_reward", self._on_train, callback_group=ReentrantCallbackGroup())
        self.create_service(EvaluateReward, "evaluate_reward", self._answering(self._evaluate))
        self.create_service(SelectQuery, "select_query", self._on_select, callback_group=ReentrantCallbackGroup())
        self.create_service(AnswerQuery, "answer_query", self._answering(self._answer))
        self.create_service(RankMotions, "rank_motions", self._answering(self._rank))
        self.create_service(UndoFeedback, "undo_feedback", self._answering(self._undo))
        self.create_service(ListFeedback, "list_feedback", self._answering(self._list))
        self.create_timer(0.2, self._tick, clock=self.steady)

    def _answering(self, serve: Callable[[Any, Any], str]) -> Callable[[Any, Any], Any]:
        """Turn a function that returns a sentence or raises into a service callback."""

        def callback(request: Any, response: Any) -> Any:
            try:
                response.message = serve(request, response)
                response.success = True
            except UnifeedError as error:
                response.success, response.message = False, str(error)
            return response

        return callback

    def _go_on(self, found: list[tuple[Feedback, bool]]) -> None:
        """Take what an earlier learner of this session was taught, and learn from it at once."""
        for msg, counts in found:
            self._dataset.add(feedback_from_msg(msg, self._robot.joint_names))
            if not counts:
                self._dataset.undo(msg.id)
            self._stamps[msg.id] = (msg.header.stamp.sec, msg.header.stamp.nanosec)
            self._time = seconds(msg.header.stamp)
        self._version = self._rankings = self._queries_asked = len(found)  # none of its names is used again
        self.say(OK, f"{len(self._dataset.items)} inputs of before are there again")
        if self._dataset.items:
            self._relearned = Future()
            self._under_way += 1
            self._worker.train(self._relearned, self._dataset, self._robot, self._training, from_scratch=False,
                               version=self._version + 1, seed=self._questions.seed, known=None)

    def _finish_going_on(self) -> None:
        if self._relearned is None or not self._relearned.done():
            return
        done, self._relearned = self._relearned, None
        self._under_way -= 1
        try:
            result = done.result()
            if self._model is None:  # else it was trained meanwhile, on request
                self._finish(result, TrainReward.Response())
                self._known = self._model
        except UnifeedError as error:
            self.say(WARN, f"not learned from the inputs of before: {error}")
        self._publish_status_message()

    def _keep(self, msg: Feedback) -> None:
        """Write an input to the folder, if there is one."""
        try:
            if self._kept is not None:
                self._kept.add(msg)
        except OSError as error:
            self.say(WARN, f"{msg.id} is lost if this node ends: {error}")

    def _on_feedback(self, msg: Feedback) -> None:
        stamp = (msg.header.stamp.sec, msg.header.stamp.nanosec)
        # what is given back has a new stamp; what comes twice, as after a kill it may, has not
        if msg.id in {item.id for item in self._dataset.items} or self._stamps.get(msg.id) == stamp:
            return
        self._stamps[msg.id] = stamp
        self._take(msg)
        self._arrivals.note(msg.id, time.monotonic())

    def _take(self, msg: Feedback) -> None:
        try:
            item = feedback_from_msg(msg, self._robot.joint_names)
            self._dataset.add(item)
        except UnifeedError as error:
            self.say(WARN, f"feedback {msg.id} was not taken: {error}")
            return
        self._time = seconds(msg.header.stamp)
        self.say(OK, f"{item.kind} {item.id} taken")
        self._keep(msg)
        self._publish_status_message()

    def _add_ranking(self, item: Preference) -> None:
        self._dataset.add(item)
        msg = feedback_to_msg(item, self._time, self._robot.config.base_frame)
        self._feedback.publish(msg)
        self._keep(msg)
        self._publish_status_message()

    def _on_run(self, msg: TrackedRun) -> None:
        try:
            self._runs[msg.motion_id] = trajectory_from_msg(msg.measured, self._robot.joint_names)
        except UnifeedError as error:
            self.say(WARN, f"run {msg.motion_id} cannot be ranked: {error}")
        while len(self._runs) > REMEMBERED_RUNS:
            del self._runs[next(iter(self._runs))]

    # Training.

    async def _on_train(self, request: TrainReward.Request, response: TrainReward.Response) -> TrainReward.Response:
        await patiently(self._arrivals.expect(request.feedback_ids, self._stamps, time.monotonic()))
        try:
            self._dataset.comparisons()  # answered at once, also while the worker still starts
        except UnifeedError as error:
            response.success, response.message, response.version = False, str(error), self._version
            return response
        self._under_way += 1
        self._publish_status_message()
        done: Future[TrainingResult] = Future()
        number = self._worker.train(
            done, self._dataset, self._robot, self._training, from_scratch=request.from_scratch,
            version=self._version + 1, seed=self._questions.seed, known=self._known)
        try:
            result = await patiently(done)
            self._worker.require_newest(number)
            self._finish(result, response)
            if not request.from_scratch:
                self._known = self._model
        except UnifeedError as error:
            response.success, response.message, response.version = False, str(error), self._version
            if self._under_way == 1:  # else a newer request goes on
                self.say(ERROR, f"not trained, the last good model stays: {error}")
        finally:
            self._under_way -= 1
            self._publish_status_message()
        return response

    def _finish(self, result: TrainingResult, response: TrainReward.Response) -> None:
        self._model, self._version = result.ensemble, result.ensemble.version
        self._models.publish(model_to_msg(self._model, self._time))
        for name in ("seconds", "loss_demonstrations", "loss_corrections", "loss_preferences", "accuracy"):
            setattr(response, name, float(getattr(result, name)))
        self._reliability = result.reliability
        for name, weight in self._trust().items():
            setattr(response, name, weight)
        response.success, response.version, response.steps = True, self._version, int(result.steps)
        response.message = (
            f"model {self._version} learned from {len(self._dataset.items)} inputs in {result.seconds:.2f} s; "
            f"it ranks {100 * result.accuracy:.0f} % of fresh comparisons as you did"
        )
        doubted = [kind for kind, weight in zip(KINDS, result.reliability, strict=True) if weight < 0.5]
        if doubted:
            response.message += f"; {' and '.join(doubted)} contradict the rest and weigh less"
        self.say(OK, response.message)

    # Questions.

    async def _on_select(self, request: SelectQuery.Request, response: SelectQuery.Response) -> SelectQuery.Response:
        try:
            model, context = self._require_model(), self._context_of(request.context)
            given = [trajectory_from_msg(c, self._robot.joint_names) for c in request.candidates]
            given = given or self._past_motions()
            if not given:
                raise InputError("no motions to compare", mend="teach a demonstration, or give candidates")
            self._queries_asked += 1
            number = self._queries_asked
            done: Future[ChosenQuery] = Future()
            self._worker.choose(done, model, given, self._robot, context, self._questions, self._training, number)
            self._query = response.query = self._query_message(await patiently(done), number, context)
            response.success, response.message = True, self._query.message
        except UnifeedError as error:
            response.success, response.message = False, str(error)
        return response

    def _query_message(self, chosen: ChosenQuery, number: int, context: Context) -> PreferenceQuery:
        message = (f"of {chosen.candidates} motions, the networks disagree most about these" if self._questions.active
                   else f"drawn at random from {chosen.candidates} motions")
        return PreferenceQuery(
            header=header(self._time, self._robot.config.base_frame), id=f"query-{number}",
            context=context_to_msg(context), options=[trajectory_to_msg(o) for o in chosen.options],
            information=float(chosen.information), message=f"{message}: {chosen.information:.2f} bit expected")

    # Other services.

    def _evaluate(self, request: EvaluateReward.Request, response: EvaluateReward.Response) -> str:
        model = self._require_model()
        trajectory = trajectory_from_msg(request.trajectory, self._robot.joint_names)
        context = self._context_of(request.context)
        rewards = model.member_rewards(self._robot.tool_states(trajectory.positions), context)
        summed = model.member_rewards(self._robot.tool_states(trajectory.resampled(self._training.waypoints)), context)
        response.version = model.version
        response.reward = list(map(float, rewards.mean(axis=0)))
        response.disagreement = list(map(float, rewards.std(axis=0)))
        response.total = float(summed.mean(axis=0).sum())
        return f"return {response.total:.2f} of at most {self._training.waypoints}"

    def _rank(self, request: RankMotions.Request, response: RankMotions.Response) -> str:
        shown = {item.id: item.trajectory for item in self._dataset.items if isinstance(item, Demonstration)}
        known = {**shown, **self._runs}
        response.known = list(known)
        missing = [name for name in request.motions if name not in known]
        if missing or len(set(request.motions)) < max(2, len(request.motions)):
            raise InputError("motions to rank", expected="two or more different ones of those that are known",
                             got=", ".join(missing or request.motions) or "none",
                             mend="the field known of this answer lists them")
        item = Preference(
            id=f"preference-ranking-{self._rankings + 1}", robot=self._robot.config.name,
            context=self._context_of(request.context), options=tuple(known[name] for name in request.motions),
            ranks=tuple(request.ranks))
        self._add_ranking(item)
        self._rankings += 1
        response.feedback_id = item.id
        return "noted" if item.ranked_pairs else "noted; without a better and a worse motion nothing is learned from it"

    def _answer(self, request: AnswerQuery.Request, response: AnswerQuery.Response) -> str:
        if self._query is None or (request.query_id and request.query_id != self._query.id):
            raise InputError("query", expected=self._query.id if self._query else "select_query first",
                             got=request.query_id or "none")
        item = Preference(
            id=f"preference-{self._query.id}",
            robot=self._robot.config.name,
            context=context_from_msg(self._query.context),
            options=tuple(trajectory_from_msg(o, self._robot.joint_names) for o in self._query.options),
            ranks=tuple(request.ranks),
            query_id=self._query.id,
        )
        self._add_ranking(item)
        self._query = None
        response.feedback_id = item.id
        return "noted" if item.ranks else "noted: neither; nothing is learned from it"

    def _undo(self, request: UndoFeedback.Request, response: UndoFeedback.Response) -> str:
        item = self._dataset.undo(request.id or None)
        response.id, response.remaining = item.id, len(self._dataset.items)
        try:
            if self._kept is not None:
                self._kept.take_back(item.id)
        except OSError as error:
            self.say(WARN, f"{item.id} counts again if this node ends: {error}")
        self._publish_status_message()
        return f"{item.kind} {item.id} taken back; train_reward learns without it"

    def _list(self, _: ListFeedback.Request, response: ListFeedback.Response) -> str:
        items = self._dataset.items
        response.ids = [item.id for item in items]
        response.kinds = [MESSAGE_KINDS[item.kind] for item in items]
        response.summaries = [_summary(item) for item in items]
        response.taken_back = list(self._dataset.undone)
        return f"{len(items)} inputs"

    def _trust(self) -> dict[str, float]:
        """Give the newest model's reliability of each kind of feedback by the name of its message's field."""
        return {f"reliability_{kind}": weight for kind, weight in zip(KINDS, self._reliability, strict=True)}

    def _past_motions(self) -> list[Trajectory]:
        motions: list[Trajectory] = []
        for item in self._dataset.items:
            motions += [item.trajectory] if item.kind == "demonstration" else list(getattr(item, "options", ()))
        return motions

    def _context_of(self, msg: TaskContext) -> Context:
        return context_from_msg(msg) if msg.task else self._task_context

    def _require_model(self) -> RewardEnsemble:
        if self._model is None:
            raise InputError("no reward was learned yet", mend="teach something, then call train_reward")
        return self._model

    def _tick(self) -> None:
        self._finish_going_on()
        self._arrivals.note("", time.monotonic())
        if self._under_way:
            self._publish_status_message()

    def _publish_status_message(self) -> None:
        demonstrations, corrections, preferences = self._dataset.counts
        state = RewardStatus.FAILED if self._status.level == ERROR else RewardStatus.IDLE
        self._statuses.publish(
            RewardStatus(
                header=header(self._time, self._robot.config.base_frame),
                version=self._version,
                demonstrations=demonstrations,
                corrections=corrections,
                preferences=preferences,
                **self._trust(),
                progress=self._worker.progress if self._under_way else 1.0,
                state=RewardStatus.TRAINING if self._under_way else state,
                message=self._status.message,
            )
        )

    def close(self) -> None:
        """End the worker."""
        self._worker.close()


def _summary(item: FeedbackItem) -> str:
    """Say in a few words what an input is."""
    if isinstance(item, Demonstration):
        return f"demonstration of {item.trajectory.duration:.1f} s"
    if isinstance(item, Correction):
        return f"correction from {item.span[0]:.1f} s to {item.span[1]:.1f} s of the motion"
    return f"preference, ranks {list(item.ranks)}" if item.ranks else "preference: neither"


def main() -> int:
    """Run the node `reward_learner`."""
    return run_node(RewardLearnerNode)


if __name__ == "__main__":
    sys.exit(main())
