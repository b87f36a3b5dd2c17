"""Coactive learning, or online learning from physical human-robot interaction.

Losey, Bajcsy, O'Malley and Dragan 2021 (the paper's reference losey2021physical); Jain and others 2015; "one feature at
a time": Bajcsy and others 2018. Values and departures: docs/methods.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from unifeed_ros.baselines.learner import FeatureSource, LinearReward, feature_counts, features_in
from unifeed_ros.core.errors import ConfigError, ShapeError
from unifeed_ros.core.feedback.deformation import deformation_matrix
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory

Update = Literal["all", "max"]
Reading = Literal["motion", "push"]


@dataclass(frozen=True, kw_only=True)
class CoactiveConfig:
    """How strongly an input moves the weights."""

    gain: float = 2.0
    """Change of a weight for a change of its feature's integral over time [1 / (feature's unit times s)]."""
    cap: float = 1.0
    """Largest weight of a feature; the smallest is 0: a feature is something to have little of."""
    update: Update = "all"
    """Whether an input changes the weights of all features or only that of the feature that it changes the most."""
    reading: Reading = "motion"
    """What of a correction is learned from: the motion that the person made of the robot's ("motion"), or only the
    push at its strongest moment, of which the robot makes a motion itself ("push")."""
    pushed: int = 5
    """Way-points that one push deforms, where only the push is learned from."""
    waypoints: int = 20
    """States that a motion is sampled at."""

    def __post_init__(self) -> None:
        """Reject values that teach nothing."""
        for name, words in (("update", get_args(Update)), ("reading", get_args(Reading))):
            if getattr(self, name) not in words:
                raise ConfigError(f"{name} of Coactive", expected=", ".join(words), got=getattr(self, name))
        for name in ("gain", "cap"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise ConfigError(f"{name} of Coactive", expected="> 0", got=getattr(self, name))
        if self.pushed < 1 or self.waypoints < 2:
            raise ConfigError("way-points of Coactive", expected="a push of 1 or more, a motion of 2 or more",
                              got=(self.pushed, self.waypoints))


class Improvement(NamedTuple):
    """A motion and one that the person holds for better, both taking the same time."""

    before: Array
    """Tool states along the one, shape (H, 6) [m, 1]."""
    after: Array
    """Tool states along the other, shape (H, 6) [m, 1]."""
    duration: float
    """How long each takes [s]."""


def deform(path: Array, index: int, push: Array, pushed: int) -> Array:
    """Let one push deform a path, xi' = xi + mu (A^T A)^-1 u.

    The push u acts on the first of the way-points that it deforms, A holds their second differences, and mu is such
    that their displacement has the push's size as its root mean square. Where fewer are left, fewer are deformed.

    Args:
        path: Way-points, shape (H, D).
        index: The first way-point that is pushed.
        push: Displacement u, shape (D,) [the path's unit].
        pushed: Way-points that are deformed.

    Returns:
        The deformed path, shape (H, D).

    Raises:
        ShapeError: The index is outside the path, or the push has another dimension.
    """
    if not 0 <= index < len(path) or push.shape != path.shape[1:]:
        raise ShapeError("push on a path", expected=f"a way-point below {len(path)}, shape {path.shape[1:]}",
                         got=(index, push.shape))
    count = min(pushed, len(path) - index)
    bump = deformation_matrix(count)[:, 0]
    bent = path.copy()
    bent[index:index + count] += np.sqrt(count) / np.linalg.norm(bump) * bump[:, None] * push
    return bent


class Coactive:
    """Moves the weights of known features by how much each input changes them; satisfies Learner.

    theta <- clip(theta - gain (Phi(xi') - Phi(xi)), 0, cap), and the reward is -theta . phi.

    Attributes:
        sources: The F features.
        weights: Weights theta of the cost, shape (F,) [1 / feature's unit].
    """

    def __init__(self, robot: RobotModel, features: Sequence[FeatureSource], config: CoactiveConfig) -> None:
        """Start with all weights zero.

        Args:
            robot: The arm that is taught.
            features: Features that are known.
            config: Settings.
        """
        self._robot, self._config = robot, config
        self.sources: list[FeatureSource] = list(features)
        self.weights = np.zeros(len(self.sources))

    def add(self, feature: FeatureSource) -> None:
        """Take in one more feature, with weight zero.

        Args:
            feature: Its name, or what makes it for a scene.
        """
        self.sources.append(feature)
        self.weights = np.append(self.weights, 0.0)

    def learn(self, item: FeedbackItem) -> None:
        """Update the weights once for each motion that was held for better than another.

        Args:
            item: What was taught.
        """
        features = features_in(self.sources, item.context)
        for step in self.improvements(item):
            before, after = (feature_counts(features, s, step.duration) for s in (step.before, step.after))
            self.weights = updated(self.weights, after - before, self._config)

    def reward(self, context: Context) -> LinearReward:
        """Give the learned reward in a scene.

        Args:
            context: Goal and objects.

        Returns:
            -theta . phi.
        """
        return LinearReward(features=self.sources, weights=-self.weights, context=context)

    def improvements(self, item: FeedbackItem) -> Iterator[Improvement]:
        """Read an input as motions held for better than others.

        A demonstration is better than what a robot that knows nothing would have done instead: the straight line in
        joint space between its ends. A ranking says so of each of its pairs.

        Args:
            item: What was taught.

        Yields:
            The pairs.
        """
        if isinstance(item, Demonstration):
            shown = item.trajectory
            line = Trajectory(joint_names=shown.joint_names, times=shown.times[[0, -1]],
                              positions=shown.positions[[0, -1]])
            yield Improvement(self._states(line), self._states(shown), shown.duration)
        elif isinstance(item, Correction):
            before, after = self._states(item.planned), self._states(item.corrected)
            if self._config.reading == "push":
                offsets = after - before
                moment = int(np.argmax(np.linalg.norm(offsets[:, :3], axis=1)))
                after = deform(before, moment, offsets[moment], self._config.pushed)
                after[:, 3:] /= np.linalg.norm(after[:, 3:], axis=1, keepdims=True)
            yield Improvement(before, after, item.corrected.duration)
        else:
            for better, worse in item.ranked_pairs:
                motions = item.options[worse], item.options[better]
                yield Improvement(*map(self._states, motions), motions[1].duration)

    def _states(self, motion: Trajectory) -> Array:
        return self._robot.tool_states(motion.resampled(self._config.waypoints))


def updated(weights: Array, change: Array, config: CoactiveConfig) -> Array:
    """Move weights against a change of features.

    Args:
        weights: Weights theta of the cost, shape (F,).
        change: Phi(xi') - Phi(xi), shape (F,).
        config: Gain, cap, and which weights move.

    Returns:
        The new weights, shape (F,).
    """
    step = config.gain * change
    if config.update == "max" and len(change):
        step = np.where(np.arange(len(change)) == np.argmax(np.abs(change)), step, 0.0)
    return np.asarray(np.clip(weights - step, 0.0, config.cap))
