"""FERL: learns the features that are missing from traces (learned_feature.py), then the reward as Coactive does.

Bobu, Wiggert, Tomlin and Dragan 2022, "Inducing structure in reward learning by learning features" (the paper's
reference bobu2022inducing). Values and departures: docs/methods.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from unifeed_ros.baselines.coactive import Coactive, CoactiveConfig
from unifeed_ros.baselines.learned_feature import FeatureTrace, LearnedFeature, TraceTraining, learn_feature
from unifeed_ros.baselines.learner import LinearReward, features_in
from unifeed_ros.core.feedback.items import Correction, FeedbackItem
from unifeed_ros.core.reward.features import Feature, evaluate
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context


@dataclass(frozen=True, kw_only=True)
class FerlConfig:
    """How features and their weights are learned."""

    coactive: CoactiveConfig = field(default_factory=CoactiveConfig)
    """How the weights of all features are learned."""
    traces: TraceTraining = field(default_factory=TraceTraining)
    """How a missing feature is learned from traces."""
    confidence: float = 1.0
    """Confidence under which no known feature explains a correction."""


class Ferl:
    """Coactive with features that are learned from traces first; satisfies Learner.

    Attributes:
        coactive: The weights of known and learned features.
    """

    def __init__(self, robot: RobotModel, features: Sequence[str], config: FerlConfig, seed: int) -> None:
        """Start with the features that are known.

        Args:
            robot: The arm that is taught.
            features: Features that are known.
            config: Settings.
            seed: Seed of the networks.
        """
        self._robot, self._config, self._seed = robot, config, seed
        self.coactive = Coactive(robot, features, config.coactive)

    def learn_feature(self, traces: Sequence[FeatureTrace]) -> None:
        """Learn one missing feature.

        Args:
            traces: What the person showed of it.

        Raises:
            InputError: See learned_feature.py.
        """
        self.add(learn_feature(traces, self._config.traces, self._seed + len(self.coactive.sources)))

    def add(self, feature: LearnedFeature) -> None:
        """Take in one missing feature that was learned.

        Args:
            feature: What was learned from traces of it.
        """
        self.coactive.add(feature)

    def learn(self, item: FeedbackItem) -> None:
        """Update the weights of all features.

        Args:
            item: What was taught.
        """
        self.coactive.learn(item)

    def reward(self, context: Context) -> LinearReward:
        """Give the learned reward in a scene.

        Args:
            context: Goal and objects.

        Returns:
            -theta . phi.
        """
        return self.coactive.reward(context)

    def misses_feature(self, correction: Correction) -> bool:
        """Tell whether no feature explains a correction, which asks for traces of one that would.

        Args:
            correction: What was taught.

        Returns:
            True if the largest confidence is below the configured one; without any feature, always.
        """
        return float(self.confidences(correction).max(initial=0.0)) < self._config.confidence

    def confidences(self, correction: Correction) -> Array:
        """Compute how well each feature alone explains a correction.

        beta_i = F ||u*_i||^2 / (2 (||u||^2 - ||u*_i||^2)), u the correction and u*_i the smallest one that changes
        feature i as much: the feature explains what of the effort had to be made for it.

        Args:
            correction: What was taught.

        Returns:
            Confidences beta, shape (F,) [1]; inf: it was made for nothing else.
        """
        (step,) = self.coactive.improvements(correction)
        features = features_in(self.coactive.sources, correction.context)
        effort = float(((step.after - step.before)**2).sum())
        if effort == 0.0:
            return np.zeros(len(features))
        shares = np.array([min(_least_effort(feature, step.before, step.after) / effort, 1.0) for feature in features])
        with np.errstate(divide="ignore"):
            return np.asarray(len(features) * shares / (2.0 * (1.0 - shares)))


def _least_effort(feature: Feature, before: Array, after: Array, rounds: int = 5) -> float:
    """Find the smallest change of a path that changes the sum of a feature as another path does, squared.

    Newton's steps along the feature's gradient, as long as it is not flat.
    """
    wanted = float(evaluate([feature], after)[0].sum())
    path = before
    for _ in range(rounds):
        values, gradients = evaluate([feature], path)
        steep = float((gradients**2).sum())
        if steep < 1e-9:
            break
        path = path + (wanted - float(values.sum())) / steep * gradients[:, 0]
    return float(((path - before)**2).sum())
