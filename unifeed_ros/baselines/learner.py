"""The shape that all compared methods share: taught one thing after the other, they give a reward to plan with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ShapeError
from unifeed_ros.core.feedback.items import FeedbackItem
from unifeed_ros.core.planning.problem import StateReward
from unifeed_ros.core.reward.features import Feature, evaluate, make_feature
from unifeed_ros.core.types import Array, Context, frozen_array

FeatureSource: TypeAlias = str | Callable[[Context], Feature]
"""A feature by its name, or what makes it for a scene (one that was learned, say)."""


class Learner(Protocol):
    """A method that learns a reward from what a person teaches; what it plans, `plan_motion` does for all alike."""

    def learn(self, item: FeedbackItem) -> None:
        """Learn from one more demonstration, correction or preference.

        Args:
            item: What was taught.
        """
        ...

    def reward(self, context: Context) -> StateReward:
        """Give the reward that was learned so far, for one scene.

        Args:
            context: Goal and objects.

        Returns:
            Values and gradients over tool states, which the planner maximises.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class LinearReward:
    """A weighted sum of features, r(s) = theta . phi(s) (paper eq. P1); satisfies the planner's StateReward."""

    features: Sequence[FeatureSource]
    """The F features, by names as in core/reward/features.py, for example "distance(goal)", or by what makes them."""
    weights: Array
    """Weights theta, shape (F,) [reward per unit of the feature]."""
    context: Context
    """Scene that the features refer to."""

    def __post_init__(self) -> None:
        """Check the weights, and look the features up once."""
        object.__setattr__(self, "weights", frozen_array("weights of the features", self.weights,
                                                         (len(self.features),)))
        object.__setattr__(self, "_made", features_in(self.features, self.context))

    def value_and_gradient(self, tool_states: ArrayLike) -> tuple[Array, Array]:
        """Evaluate the reward.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,), and their gradients by the tool state, shape (N, 6).

        Raises:
            ShapeError: Not six columns.
        """
        values, gradients = self.feature_values(tool_states)
        return values @ self.weights, self.weights @ gradients

    def feature_values(self, tool_states: ArrayLike) -> tuple[Array, Array]:
        """Evaluate the features.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Features, shape (N, F), and their gradients, shape (N, F, 6).

        Raises:
            ShapeError: Not six columns.
        """
        states = frozen_array("tool states", tool_states, (None, None))
        if states.shape[1] != 6:
            raise ShapeError("shape of tool states", expected="(any, 6)", got=states.shape)
        return evaluate(self._made, states)  # type: ignore[attr-defined]


def features_in(sources: Sequence[FeatureSource], context: Context) -> tuple[Feature, ...]:
    """Make features for a scene.

    Args:
        sources: Names, or what makes them.
        context: The scene.

    Returns:
        The features.
    """
    return tuple(make_feature(source, context) if isinstance(source, str) else source(context) for source in sources)


def feature_counts(features: Sequence[Feature], states: Array, duration: float) -> Array:
    """Integrate features over time along motions, Phi(xi).

    An integral, where references have sums over way-points: it means the same for a whole motion and for a span of one,
    however densely they are sampled.

    Args:
        features: F features.
        states: Tool states along the motions, evenly spaced in time, shape (..., H, 6) [m, 1].
        duration: How long each motion takes [s].

    Returns:
        Integrals, shape (..., F) [the feature's unit times s].
    """
    values, _ = evaluate(features, states.reshape(-1, states.shape[-1]))
    return np.asarray(duration * values.reshape(*states.shape[:-1], len(features)).mean(axis=-2))
