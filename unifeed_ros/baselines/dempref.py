"""DemPref (Palan et al. 2019, Biyik et al. 2022): demonstrations are a prior over weights, then come questions.

The reward is linear in features, r(s) = w . phi(s) with |w| <= 1. What is known of w is a density,

    p(w) ~ prod_d exp(beta_D w . Phi(xi_d)) prod_q P(answer_q | w),
    P(1 | w) = 1 / (1 + exp(-beta_P w . (Phi_1 - Phi_2))),

of which adaptive Metropolis draws samples; the reward planned with has their mean as weights. Questions are those whose
answer tells the most about w, or removes the most of its volume.

Departures from the authors' code: features of motions are centred on and scaled by those of motions known beforehand,
because exp(beta_D w . Phi) without its normaliser favours weights by the features' offsets; several chains run at once
and adapt together, and only before samples are kept; the volume is that of the worst answer, each averaged over the
samples for itself (there the average was taken before the minimum, which is nought for every question).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_expit

from unifeed_ros.baselines.learner import LinearReward
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.reward.queries import information_gain
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory, frozen_array

Objective = Literal["information", "volume"]
_WEIGHING = 100
"""About how many samples questions are weighed with."""


@dataclass(frozen=True, kw_only=True)
class DemPrefConfig:
    """Settings of DemPref."""

    demonstration_rationality: float = 0.1
    """beta_D: how strongly a demonstration's features tell of the weights [1]."""
    answer_rationality: float = 5.0
    """beta_P: how strongly returns decide an answer [1]."""
    objective: Objective = "information"
    """What a question is chosen by: the information that its answer gives, or the volume that it removes."""
    chains: int = 25
    """Chains that run at once."""
    warm_up: int = 150
    """Steps of each chain in which it adapts, and that are thrown away."""
    steps: int = 160
    """Steps of each chain after that; every 16th is kept."""

    def __post_init__(self) -> None:
        """Reject values that no posterior comes of."""
        if self.objective not in get_args(Objective):
            raise ConfigError("objective of questions", expected=", ".join(get_args(Objective)), got=self.objective)
        for name, least in (("chains", 2), ("warm_up", 20), ("steps", 16)):
            if getattr(self, name) < least:
                raise ConfigError(name, expected=f"at least {least}", got=getattr(self, name))
        for name in ("demonstration_rationality", "answer_rationality"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise ConfigError(name, expected="0 or more", got=getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class MotionFeatures:
    """Features Phi of whole motions: means over states, less a centre, over a spread."""

    names: Sequence[str]
    """Names of the F features, as in core/reward/features.py."""
    context: Context
    """Scene that they refer to."""
    waypoints: int
    """States of a motion, evenly spaced in time."""
    centre: Array
    """What counts as nought, shape (F,) [units of the features]."""
    spread: Array
    """What counts as one, shape (F,) [units of the features]."""

    def __post_init__(self) -> None:
        """Check shapes, and that every feature has a spread."""
        for name in ("centre", "spread"):
            object.__setattr__(self, name, frozen_array(f"{name} of the features", getattr(self, name),
                                                         (len(self.names),)))
        if (self.spread <= 0.0).any():
            raise ConfigError("spread of the features", expected="above 0", got=self.spread.tolist())

    def of(self, robot: RobotModel, motions: Sequence[Trajectory]) -> Array:
        """Compute the features of motions.

        Args:
            robot: The arm.
            motions: Motions, N of them [rad].

        Returns:
            Features, shape (N, F) [1].
        """
        states = robot.tool_states(np.concatenate([m.resampled(self.waypoints) for m in motions]))
        values, _ = self.reward(np.zeros(len(self.names))).feature_values(states)
        means = values.reshape(len(motions), self.waypoints, -1).mean(axis=1)
        return np.asarray((means - self.centre) / self.spread)

    def reward(self, weights: ArrayLike) -> LinearReward:
        """Give the reward of single states whose mean over a motion is w . Phi, up to a constant.

        Args:
            weights: w, shape (F,).

        Returns:
            The reward.
        """
        return LinearReward(features=self.names, weights=np.asarray(weights) / self.spread, context=self.context)

    def without(self, name: str) -> MotionFeatures:
        """Leave a feature out.

        Args:
            name: Its name.

        Returns:
            The other features.
        """
        kept = [k for k, other in enumerate(self.names) if other != name]
        return MotionFeatures(names=[self.names[k] for k in kept], context=self.context, waypoints=self.waypoints,
                              centre=self.centre[kept], spread=self.spread[kept])


class DemPref:
    """The learner.

    Attributes:
        samples: Weights drawn from what is known of them, shape (N, F).
    """

    def __init__(self, robot: RobotModel, features: MotionFeatures, config: DemPrefConfig,
                 rng: np.random.Generator) -> None:
        """Start with all weights in the unit ball equally likely.

        Args:
            robot: The arm that is taught.
            features: What the reward is made of.
            config: Settings.
            rng: Source of randomness of the chains.
        """
        self._robot, self._features, self._config, self._rng = robot, features, config, rng
        self._shown: Array = np.zeros((0, len(features.names)))
        self._gaps: Array = np.zeros((0, len(features.names)))
        self.samples = self._sample()

    def learn(self, item: FeedbackItem) -> None:
        """Learn from a demonstration or a ranking, each pair of it by itself.

        Args:
            item: What was taught.

        Raises:
            InputError: A correction, which DemPref has no model of.
        """
        if isinstance(item, Correction):
            raise InputError("feedback for DemPref", expected="a demonstration or a preference", got=item.kind)
        if isinstance(item, Demonstration):
            self._shown = np.concatenate([self._shown, self._features.of(self._robot, [item.trajectory])])
        elif item.ranked_pairs:
            phi = self._features.of(self._robot, item.options)
            self._gaps = np.concatenate([self._gaps, [phi[better] - phi[worse] for better, worse in item.ranked_pairs]])
        self.samples = self._sample()

    def reward(self, context: Context) -> LinearReward:
        """Give the reward with the mean weights.

        Args:
            context: Scene; the one that the features refer to.

        Returns:
            The reward of single states.
        """
        return self._features.reward(self.samples.mean(axis=0))

    def select(self, questions: ArrayLike) -> int:
        """Choose the question that tells the most.

        Args:
            questions: Features of each question's options, shape (Q, K, F) [1].

        Returns:
            Its number.
        """
        few = self.samples[::max(1, len(self.samples) // _WEIGHING)]
        returns = self._config.answer_rationality * np.einsum("qkf,sf->qsk", questions, few)
        worth = information_gain(returns) if self._config.objective == "information" else removed_volume(returns)
        return int(np.argmax(worth))

    def _sample(self) -> Array:
        config = self._config
        pull = config.demonstration_rationality * self._shown.sum(axis=0)

        def log_density(weights: Array) -> Array:
            known = weights @ pull + log_expit(config.answer_rationality * weights @ self._gaps.T).sum(axis=1)
            return np.where((weights**2).sum(axis=1) <= 1.0, known, -np.inf)

        return adaptive_metropolis(log_density, len(self._features.names), config, self._rng)


def removed_volume(returns: ArrayLike) -> Array:
    """Compute the share of the weights' volume that the worst answer to each question removes.

    min_i mean_w (1 - P(i | w)), P the softmax of the returns. Known weakness of the objective: two equal options score
    as much as two that half of the weights would choose between.

    Args:
        returns: Each sample's return of each option, times beta, shape (..., N, K) [1].

    Returns:
        Shares, shape (...), 0 to 1 - 1/K.
    """
    returns = np.asarray(returns, dtype=np.float64)
    choice = np.exp(returns - returns.max(axis=-1, keepdims=True))
    choice /= choice.sum(axis=-1, keepdims=True)
    return np.asarray((1.0 - choice).mean(axis=-2).min(axis=-1))


def adaptive_metropolis(log_density: Callable[[Array], Array], dimensions: int, config: DemPrefConfig,
                        rng: np.random.Generator) -> Array:
    """Draw from a density in the unit ball (Haario et al. 2001), several chains at once.

    Steps are normal; in the warm-up, their covariance becomes 2.38^2 / F times that of what all chains have visited.

    Args:
        log_density: Logarithm of the density at points, shape (C, F) to (C,), up to a constant; -inf outside.
        dimensions: F.
        config: Number of chains and steps.
        rng: Source of randomness.

    Returns:
        Draws, shape (N, F).
    """
    here = rng.normal(size=(config.chains, dimensions))
    here *= 0.5 / np.linalg.norm(here, axis=1, keepdims=True)
    value, spread = log_density(here), 0.25 * np.eye(dimensions)
    visited: list[Array] = []
    for step in range(config.warm_up + config.steps):
        there = here + rng.normal(size=here.shape) @ spread.T
        proposed = log_density(there)
        accepted = np.log(rng.random(config.chains)) < proposed - value
        here, value = np.where(accepted[:, None], there, here), np.where(accepted, proposed, value)
        visited.append(here)
        if step < config.warm_up and (step + 1) % 25 == 0:
            covariance = np.cov(np.concatenate(visited[len(visited) // 2:]).T).reshape(dimensions, dimensions)
            spread = np.linalg.cholesky(2.38**2 / dimensions * covariance + 1e-6 * np.eye(dimensions))
    return np.concatenate(visited[config.warm_up::16])
