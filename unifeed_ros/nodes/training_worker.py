"""Trains and chooses questions in a process of its own: a thread would keep the node from answering.

Only that process loads torch, which takes seconds; the node answers before.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from typing import Any

import numpy as np

from unifeed_ros.core.errors import TrainingError, UnifeedError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.queries import QueryConfig, random_query, select_query, with_variations
from unifeed_ros.core.robot import RobotConfig, RobotModel
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.nodes.parent_death import end_with_parent
from unifeed_ros.nodes.real_time import set_niceness

NICENESS = 10
"""Priority given up, so that training never delays the control loop on a machine with few cores."""

_progress: Synchronized[float] | None = None
_newest: Synchronized[int] | None = None


@dataclass(frozen=True, kw_only=True)
class ChosenQuery:
    """A question and what it was chosen from."""

    options: tuple[Trajectory, ...]
    """Motions to compare."""
    information: float
    """Expected information of the answer [bit]."""
    candidates: int
    """Number of motions that it was chosen from."""


class TrainingWorker:
    """One process that learns, started at once so that the first training does not wait for it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._shared, self._newest = context.Value("d", 0.0), context.Value("L", 0)
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_prepare,
                                         initargs=(self._shared, self._newest))
        self._pool.submit(_warm_up)

    @property
    def progress(self) -> float:
        """Share of the training under way that is done, 0 to 1."""
        return float(self._shared.value)

    def train(self, done: Future[Any], dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig,
              *, from_scratch: bool, **arguments: Any) -> int:
        """Start a training; an older one that is not done ends with a TrainingError that says so.

        Args:
            done: Gets the TrainingResult, or a TrainingError whatever went wrong.
            dataset: What was taught.
            robot: The arm.
            config: Settings.
            from_scratch: Whether to train on everything at once, and not as if the inputs had come one by one.
            **arguments: The rest of learn_reward's arguments.

        Returns:
            Number of the training, for require_newest.
        """
        self._shared.value = 0.0
        self._newest.value += 1
        self._start(done, _train, self._newest.value, dataset, robot.config, config, from_scratch, arguments)
        return int(self._newest.value)

    def require_newest(self, number: int) -> None:
        """Refuse the result of a training that a newer one was asked for.

        Args:
            number: Number of the training.

        Raises:
            TrainingError: It is not the newest one.
        """
        _require_newest(number, self._newest)

    def choose(self, done: Future[Any], ensemble: RewardEnsemble, given: Sequence[Trajectory], robot: RobotModel,
               context: Context, config: QueryConfig, training: TrainingConfig, number: int) -> None:
        """Start to choose a question; it waits for a training that is under way.

        Args:
            done: Gets the ChosenQuery, or a UnifeedError.
            ensemble: Learned reward.
            given: Motions to choose from and to vary.
            robot: The arm.
            context: Goal and objects.
            config: How the question is chosen.
            training: How returns are compared.
            number: Number of the question, a part of its seed.
        """
        self._start(done, _choose, ensemble, given, robot.config, context, config, training, number)

    def _start(self, done: Future[Any], work: Callable[..., Any], *arguments: Any) -> None:
        try:
            started = self._pool.submit(work, *arguments)
        except RuntimeError as error:
            done.set_exception(TrainingError("the training process ended", got=str(error), mend="start the node again"))
            return
        started.add_done_callback(lambda finished: _hand_over(finished, done))

    def close(self) -> None:
        """End the process, also in the middle of a training."""
        for process in list((self._pool._processes or {}).values()):
            process.kill()
        self._pool.shutdown(wait=False, cancel_futures=True)


def _hand_over(finished: Future[Any], done: Future) -> None:
    error = finished.exception() if not finished.cancelled() else TrainingError("the training was canceled")
    if error is None:
        done.set_result(finished.result())
    elif isinstance(error, UnifeedError):
        done.set_exception(error)
    else:
        done.set_exception(TrainingError("the training process failed", got=repr(error), mend="see the log"))


def _prepare(progress: Synchronized[float], newest: Synchronized[int]) -> None:
    """Set the process up: it ends with its parent, and leaves Ctrl-C to it."""
    global _progress, _newest
    _progress, _newest = progress, newest
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(signal.SIGKILL)


def _warm_up() -> None:
    """Load what the first training would wait for, then give up priority."""
    import unifeed_ros.core.reward.learning  # noqa: F401

    set_niceness(NICENESS, leader=os.getppid())


def _train(number: int, dataset: FeedbackDataset, robot: RobotConfig, config: TrainingConfig, from_scratch: bool,
           arguments: dict[str, Any]) -> TrainingResult:
    from unifeed_ros.core.reward.learning import learn_reward

    _set_progress(number, 0.0)
    config = replace(config, warm_steps=0) if from_scratch else config
    return learn_reward(dataset, RobotModel(robot), config, on_progress=partial(_set_progress, number), **arguments)


def _choose(ensemble: RewardEnsemble, given: Sequence[Trajectory], robot: RobotConfig, context: Context,
            config: QueryConfig, training: TrainingConfig, number: int) -> ChosenQuery:
    arm, rng = RobotModel(robot), np.random.default_rng([config.seed, number])
    candidates = with_variations(arm, given, config.variation_size, config.candidates, rng)
    choose = select_query if config.active else partial(random_query, rng=rng)
    query = choose(ensemble, candidates, arm, context, waypoints=training.waypoints, rationality=training.rationality,
                   options=config.options)
    return ChosenQuery(options=tuple(candidates[k] for k in query.indices), information=query.information,
                       candidates=len(candidates))


def _set_progress(number: int, progress: float) -> None:
    """Tell how far a training is, and end it if a newer one was asked for."""
    assert _progress is not None and _newest is not None
    _require_newest(number, _newest)
    _progress.value = progress


def _require_newest(number: int, newest: Synchronized[int]) -> None:
    if number != newest.value:
        raise TrainingError("the training was given up", mend="a newer request took its place: its answer counts")
