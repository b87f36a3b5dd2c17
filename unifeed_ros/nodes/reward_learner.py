"""Learns the reward from everything that was taught (paper eqs. M1-M9); a worker process trains, the node goes on."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from unifeed_msgs.msg import Feedback, PreferenceQuery, RewardStatus, TaskContext
from unifeed_msgs.srv import AnswerQuery, EvaluateReward, ListFeedback, SelectQuery, TrainReward, UndoFeedback
from unifeed_ros.core.errors import ConfigError, InputError, UnifeedError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.features import make_feature
from unifeed_ros.core.reward.queries import random_query, select_query, with_variations
from unifeed_ros.core.types import Context, Trajectory
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
from unifeed_ros.nodes.node import ERROR, OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.training_worker import TrainingWorker

MESSAGE_KINDS = {"demonstration": Feedback.DEMONSTRATION, "correction": Feedback.CORRECTION,
                 "preference": Feedback.PREFERENCE}


@dataclass(frozen=True, kw_only=True)
class QueryConfig:
    """How questions are chosen."""

    seed: int = 0
    """Seed of training and of the variations."""
    active: bool = True
    """True: the most informative question (paper eq. M7); false: a random one."""
    options: int = 2
    """Motions that a question compares."""
    candidates: int = 1000
    """Motions that a question is chosen from: those that are there, and variations of them."""
    variation_size: float = 0.10
    """Size of the variations at the tool [m]."""

    def __post_init__(self) -> None:
        """Reject values that would only fail when a question is asked."""
        if self.options < 2:
            raise ConfigError("options", expected="at least 2", got=self.options)
        if self.candidates < self.options:
            raise ConfigError("candidates", expected=f"at least {self.options}", got=self.candidates)
        if not 0.0 < self.variation_size < 10.0:
            raise ConfigError("variation_size", expected="above 0 and below 10", got=self.variation_size)


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
        self._rng = np.random.default_rng(self._questions.seed)
        self._dataset = FeedbackDataset(self._robot.config.name, self._robot.joint_names)
        self._model: RewardEnsemble | None = None
        self._version = 0
        self._motions: list[Trajectory] = []
        self._query: PreferenceQuery | None = None
        self._queries_asked = 0
        self._time = 0.0
        self._busy = False
        self._worker = TrainingWorker()
        self._connect()
        self.say(OK, "nothing taught yet")
        self._publish_status_message()

    def _connect(self) -> None:
        self._models = self.advertise("reward_model")
        self._statuses = self.advertise("reward_status")
        self._feedback = self.advertise("feedback")
        self.listen("feedback", self._on_feedback)
        # a group of its own: while the coroutine waits, its group runs nothing else
        self.create_service(TrainReward, "train_reward", self._on_train, callback_group=ReentrantCallbackGroup())
        self.create_service(EvaluateReward, "evaluate_reward", self._answering(self._evaluate))
        self.create_service(SelectQuery, "select_query", self._answering(self._select))
        self.create_service(AnswerQuery, "answer_query", self._answering(self._answer))
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

    def _on_feedback(self, msg: Feedback) -> None:
        if msg.id in {item.id for item in self._dataset.items}:
            return
        try:
            item = feedback_from_msg(msg, self._robot.joint_names)
            self._dataset.add(item)
        except UnifeedError as error:
            self.say(WARN, f"feedback {msg.id} was not taken: {error}")
            return
        self._time = seconds(msg.header.stamp)
        self.say(OK, f"{item.kind} {item.id} taken")
        self._publish_status_message()

    # Training.

    async def _on_train(self, request: TrainReward.Request, response: TrainReward.Response) -> TrainReward.Response:
        if self._busy:
            response.success, response.message, response.version = (
                False,
                "a training is under way: ask again",
                self._version,
            )
            return response
        try:
            self._dataset.comparisons()  # answered at once, also while the worker still starts
        except UnifeedError as error:
            response.success, response.message, response.version = False, str(error), self._version
            return response
        self._busy = True
        self._publish_status_message()
        done: Future = Future(executor=self.executor)
        self._worker.train(done, self._dataset, self._robot, self._training, version=self._version + 1,
                           seed=self._questions.seed, previous=None if request.from_scratch else self._model)
        try:
            self._finish(await done, response)
        except UnifeedError as error:
            response.success, response.message, response.version = False, str(error), self._version
            self.say(ERROR, f"not trained, the last good model stays: {error}")
        finally:
            self._busy = False
            self._publish_status_message()
        return response

    def _finish(self, result: TrainingResult, response: TrainReward.Response) -> None:
        self._model, self._version = result.ensemble, result.ensemble.version
        self._models.publish(model_to_msg(self._model, self._time))
        for name in ("seconds", "loss_demonstrations", "loss_corrections", "loss_preferences", "accuracy"):
            setattr(response, name, float(getattr(result, name)))
        response.success, response.version, response.steps = True, self._version, int(result.steps)
        response.message = (
            f"model {self._version} learned from {len(self._dataset.items)} inputs in {result.seconds:.2f} s; "
            f"it ranks {100 * result.accuracy:.0f} % of fresh comparisons as you did"
        )
        self.say(OK, response.message)

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

    def _select(self, request: SelectQuery.Request, response: SelectQuery.Response) -> str:
        model = self._require_model()
        context = self._context_of(request.context)
        given = [trajectory_from_msg(c, self._robot.joint_names) for c in request.candidates] or self._past_motions()
        if not given:
            raise InputError("no motions to compare", mend="teach a demonstration, or give candidates")
        settings, training = self._questions, self._training
        candidates = with_variations(self._robot, given, settings.variation_size, settings.candidates, self._rng)
        choose = select_query if settings.active else partial(random_query, rng=self._rng)
        query = choose(model, candidates, self._robot, context, waypoints=training.waypoints,
                       rationality=training.rationality, options=settings.options)
        message = (f"of {len(candidates)} motions, the networks disagree most about these" if settings.active
                   else f"drawn at random from {len(candidates)} motions")
        self._queries_asked += 1
        frame = self._robot.config.base_frame
        self._query = PreferenceQuery(
            header=header(self._time, frame), id=f"query-{self._queries_asked}", context=context_to_msg(context),
            options=[trajectory_to_msg(candidates[i]) for i in query.indices], information=float(query.information),
            message=f"{message}: {query.information:.2f} bit expected")
        response.query = self._query
        return self._query.message

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
        self._dataset.add(item)
        self._feedback.publish(feedback_to_msg(item, self._time, self._robot.config.base_frame))
        self._query = None
        response.feedback_id = item.id
        self._publish_status_message()
        return "noted" if item.ranks else "noted: neither; nothing is learned from it"

    def _undo(self, request: UndoFeedback.Request, response: UndoFeedback.Response) -> str:
        item = self._dataset.undo(request.id or None)
        response.id, response.remaining = item.id, len(self._dataset.items)
        self._publish_status_message()
        return f"{item.kind} {item.id} taken back; train_reward learns without it"

    def _list(self, _: ListFeedback.Request, response: ListFeedback.Response) -> str:
        items = self._dataset.items
        response.ids = [item.id for item in items]
        response.kinds = [MESSAGE_KINDS[item.kind] for item in items]
        response.summaries = [_summary(item) for item in items]
        return f"{len(items)} inputs"

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
        if self._busy:
            self._publish_status_message()

    def _publish_status_message(self) -> None:
        demonstrations, corrections, preferences = self._dataset.counts
        failed = self._status.level == ERROR
        self._statuses.publish(
            RewardStatus(
                header=header(self._time, self._robot.config.base_frame),
                version=self._version,
                demonstrations=demonstrations,
                corrections=corrections,
                preferences=preferences,
                progress=self._worker.progress if self._busy else 1.0,
                state=RewardStatus.TRAINING if self._busy else RewardStatus.FAILED if failed else RewardStatus.IDLE,
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
