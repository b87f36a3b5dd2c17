"""RRIC: reward-rational implicit choice, Bayesian inference of feature weights from all kinds of feedback.

Jeon, Milli and Dragan 2020 (the paper's reference jeon2020reward). Values and departures: docs/methods.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from unifeed_ros.baselines.learner import FeatureSource, LinearReward, feature_counts, features_in
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.feedback.deformation import Ends, deform_tool_states
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory


@dataclass(frozen=True, kw_only=True)
class RricConfig:
    """How rational people are taken to be, what they are taken to choose from, and how the posterior is sampled."""

    demonstration_rationality: float = 20.0
    """Rationality beta of demonstrations [1 / (reward times s)]."""
    correction_rationality: float = 20.0
    """Rationality of corrections [1 / (reward times s)]."""
    preference_rationality: float = 20.0
    """Rationality of rankings [1 / (reward times s)]."""
    choices: int = 200
    """Alternatives that stand for all that could have been demonstrated, or that a motion could have been corrected
    to."""
    position_sizes: Sequence[float] = (0.02, 0.05, 0.1, 0.2, 0.3)
    """Sizes of their displacement, one drawn for each (RMS of the middle in each coordinate) [m]."""
    axis_sizes: Sequence[float] = (0.0, 0.1, 0.3, 1.0)
    """Sizes of the tilt of their axis, one drawn for each [rad]."""
    samples: int = 10000
    """Samples of the posterior, the first half of which is forgotten."""
    step: float = 0.25
    """Largest change of a weight from one sample to the next that is proposed [reward / feature's unit]."""
    waypoints: int = 20
    """States that a motion is sampled at."""

    def __post_init__(self) -> None:
        """Reject values that infer nothing."""
        for name in ("demonstration_rationality", "correction_rationality", "preference_rationality", "step"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise ConfigError(f"{name} of RRIC", expected="> 0", got=getattr(self, name))
        for name, least in (("choices", 1), ("samples", 2), ("waypoints", 3)):
            if getattr(self, name) < least:
                raise ConfigError(f"{name} of RRIC", expected=f"at least {least}", got=getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One choice that a person made: P(it | theta) = 1 / sum_k exp(beta theta . gap_k) (paper eq. M3 for two)."""

    gaps: Array
    """Features of each of what could have been chosen less those of what was, shape (K, F); one row is zeros, its
    own."""
    rationality: float
    """Rationality beta."""


class Rric:
    """Infers the weights of known features; satisfies Learner.

    P(theta | choices) is proportional to the product of the choices' probabilities, over theta inside the unit ball,
    and the reward is its mean times phi. A demonstration is chosen among all motions, for which deformations of it
    stand; a correction among the robot's motion, the person's and deformations of the robot's; the better of each
    ranked pair from that pair.

    Attributes:
        choices: Choices that were made.
        samples: Samples of the posterior, shape (S, F); zeros before the first choice.
    """

    def __init__(self, robot: RobotModel, features: Sequence[FeatureSource], config: RricConfig, seed: int) -> None:
        """Start with nothing but the prior.

        Args:
            robot: The arm that is taught.
            features: Features that are known.
            config: Settings.
            seed: Seed of alternatives and samples.
        """
        self._robot, self._features, self._config, self._seed = robot, tuple(features), config, seed
        self.choices: list[Choice] = []
        self.samples = np.zeros((1, len(self._features)))

    def learn(self, item: FeedbackItem) -> None:
        """Take an input for choices, and sample the posterior of all choices anew.

        Args:
            item: What was taught.
        """
        rng = np.random.default_rng([self._seed, len(self.choices)])
        self.choices += self._choices_of(item, rng)
        drawn = sample_posterior(self.choices, len(self._features), self._config, rng)
        self.samples = drawn[len(drawn) // 2:]

    def reward(self, context: Context) -> LinearReward:
        """Give the posterior's mean in a scene.

        Args:
            context: Goal and objects.

        Returns:
            The mean weights times the features.
        """
        return LinearReward(features=self._features, weights=self.samples.mean(axis=0), context=context)

    def _choices_of(self, item: FeedbackItem, rng: np.random.Generator) -> Iterator[Choice]:
        config = self._config
        if isinstance(item, Demonstration):
            shown = self._states(item.trajectory)
            among = [shown, *self._alternatives(shown, "fixed", rng), *self._alternatives(shown, "free", rng)]
            yield self._first_of(among, item, item.trajectory.duration, config.demonstration_rationality)
        elif isinstance(item, Correction):
            planned, corrected = self._states(item.planned), self._states(item.corrected)
            among = [corrected, planned, *self._alternatives(planned, "fixed", rng)]
            yield self._first_of(among, item, item.corrected.duration, config.correction_rationality)
        elif isinstance(item, Preference):
            options = [self._states(option) for option in item.options]
            for better, worse in item.ranked_pairs:
                yield self._first_of([options[better], options[worse]], item, item.options[better].duration,
                                     config.preference_rationality)

    def _first_of(self, motions: Sequence[Array], item: FeedbackItem, duration: float, rationality: float) -> Choice:
        counts = feature_counts(features_in(self._features, item.context), np.stack(motions), duration)
        return Choice(gaps=counts - counts[0], rationality=rationality)

    def _states(self, motion: Trajectory) -> Array:
        return self._robot.tool_states(motion.resampled(self._config.waypoints))

    def _alternatives(self, states: Array, ends: Ends, rng: np.random.Generator) -> Array:
        config = self._config
        return deform_tool_states(states, rng.choice(config.position_sizes, config.choices),
                                  rng.choice(config.axis_sizes, config.choices), rng, ends=ends)


def sample_posterior(choices: Sequence[Choice], features: int, config: RricConfig, rng: np.random.Generator) -> Array:
    """Sample weights by Metropolis's rule, from the middle of the unit ball on.

    Args:
        choices: Choices that were made.
        features: Number of features F.
        config: Number of samples and size of the steps.
        rng: Source of randomness.

    Returns:
        Samples, each but the first near the one before, shape (S, F).
    """
    log_posterior = posterior_of(choices, features)
    theta = np.zeros(features)
    likely = log_posterior(theta)
    samples = np.empty((config.samples, features))
    proposals = rng.uniform(-config.step, config.step, size=samples.shape)
    thresholds = np.log(rng.random(config.samples))
    for k in range(config.samples):
        other = theta + proposals[k]
        other_likely = log_posterior(other)
        if other_likely - likely >= thresholds[k]:
            theta, likely = other, other_likely
        samples[k] = theta
    return samples


def posterior_of(choices: Sequence[Choice], features: int) -> Callable[[Array], float]:
    """Give the posterior of weights, a uniform prior over the unit ball times the choices' probabilities.

    Args:
        choices: Choices that were made.
        features: Number of features F.

    Returns:
        Its logarithm up to a constant [nat], of weights of shape (F,).
    """
    scaled = np.concatenate([np.zeros((0, features)), *(c.rationality * c.gaps for c in choices)])
    starts = np.cumsum([0, *(len(c.gaps) for c in choices)])[:-1]

    def log_posterior(theta: Array) -> float:
        if theta @ theta > 1.0:
            return -np.inf
        return -float(np.logaddexp.reduceat(scaled @ theta, starts).sum()) if len(starts) else 0.0

    return log_posterior
