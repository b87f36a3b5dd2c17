"""Our method in the shape of the compared ones: everything that was taught, learned as a session learns it."""

from __future__ import annotations

from numpy.typing import ArrayLike

from unifeed_ros.core.errors import TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import FeedbackItem
from unifeed_ros.core.planning.problem import StateReward
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.learning import learn_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Context


class Ours:
    """The ensemble of the paper's section "Unifying", retrained after each input (paper Algorithm 1).

    Attributes:
        ensemble: What was learned so far; None before the first input with a comparison.
        dataset: What was taught.
    """

    def __init__(self, robot: RobotModel, config: TrainingConfig, seed: int, *, kappa: float = 0.0,
                 among: ArrayLike | None = None) -> None:
        """Start without knowing anything.

        Args:
            robot: The arm that is taught.
            config: Settings of the training; its `features` are what is known beforehand.
            seed: Seed of the training.
            kappa: How many times the members' disagreement is taken off their mean in planning [1].
            among: Tool states over which members' means are alike for that, shape (N, 6) [m, 1].
        """
        self._robot, self._config, self._seed, self._kappa, self._among = robot, config, seed, kappa, among
        self.dataset = FeedbackDataset(robot.config.name, robot.joint_names)
        self.ensemble: RewardEnsemble | None = None

    def learn(self, item: FeedbackItem) -> None:
        """Train on one more input; a ranking of ties alone is kept and changes nothing.

        Args:
            item: What was taught.

        Raises:
            TrainingError: A member stayed dead or diverged.
        """
        self.dataset.add(item)
        if item.kind == "preference" and not item.ranked_pairs:
            return
        self.ensemble = learn_reward(self.dataset, self._robot, self._config, version=len(self.dataset.items),
                                     seed=self._seed, known=self.ensemble).ensemble

    def reward(self, context: Context) -> StateReward:
        """Give the members' mean in a scene, less kappa times their disagreement.

        Args:
            context: Goal and objects.

        Returns:
            The learned reward.

        Raises:
            TrainingError: Nothing was learned yet.
        """
        if self.ensemble is None:
            raise TrainingError("nothing was learned yet", mend="teach something first")
        return self.ensemble.bind(context, self._kappa, self._among)
