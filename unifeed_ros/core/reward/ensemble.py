"""The learned reward as data, and its evaluation without any learning library."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.reward.activations import ACTIVATIONS, require_activation
from unifeed_ros.core.reward.features import evaluate
from unifeed_ros.core.reward.inputs import feature_count, scene_inputs
from unifeed_ros.core.robot import TOOL_STATE
from unifeed_ros.core.types import Array, Context

Weights = NDArray[np.float32]

_SMALLEST_VARIANCE = 1e-8
"""Added to the members' variance, whose root has no slope at zero [reward^2]."""
RATIONALITY = 5.0
"""How strongly returns decide a comparison, beta of P(x > y) = exp(beta R_x) / (exp(beta R_x) + exp(beta R_y))
[1/reward]. Paper eq. M3 has 1; rewards between -1 and 1 must then saturate to tell near alternatives apart, and a
saturated reward is flat: on the way to the goal the planner no longer sees where it was shown to go."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RewardEnsemble:
    """Networks that were trained on the same feedback (paper sec. "Putting It All Together").

    The output is a tanh, so that a state's reward lies between -1 and 1. Features that are given keep their linear
    structure: r(s) = theta . phi(s) + tanh(network(s, phi(s))). The network sees them too, and then says what they
    cannot explain; bounded as it is, it never outweighs them far from what was taught. A constant added to all rewards
    leaves every comparison as it is: never compare absolute values between two ensembles.
    """

    version: int
    """Grows by one with every model of a session; the first is 1."""
    robot: str
    """Robot that it was learned on."""
    frame: str
    """Frame that positions refer to."""
    inputs: tuple[str, ...]
    """Names of the networks' inputs, in order, F features last."""
    layer_sizes: tuple[int, ...]
    """Widths from the input to the output, for example (9, 64, 64, 1)."""
    weights: tuple[Weights, ...] = field(repr=False)
    """Matrices of each layer, shape (m, in, out)."""
    biases: tuple[Weights, ...] = field(repr=False)
    """Biases of each layer, shape (m, out)."""
    thetas: Weights = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32), repr=False)
    """Weights of the features, shape (m, F); may be left out without features."""
    feedback_ids: tuple[str, ...] = ()
    """Names of the feedback items that it was learned from."""
    seed: int = 0
    """Seed of the training."""
    activation: str = "leaky_relu"
    """Activation of the hidden layers."""

    def __post_init__(self) -> None:
        """Check shapes and finiteness, and make the weights read-only.

        Raises:
            ConfigError: Fewer than two members, sizes that do not fit the inputs, or an unknown activation.
            ShapeError: A layer's weights have another shape.
            InputError: A weight is not finite.
        """
        require_activation(self.activation)
        sizes = tuple(int(s) for s in self.layer_sizes)
        if len(sizes) < 2 or sizes[0] != len(self.inputs) or sizes[-1] != 1 or min(sizes) < 1:
            raise ConfigError("layer sizes", expected=f"{len(self.inputs)} inputs, hidden widths, 1 output", got=sizes)
        if len(self.weights) != len(sizes) - 1 or len(self.biases) != len(sizes) - 1 or len(self.weights[0]) < 2:
            raise ConfigError("weights of the ensemble", expected=f"{len(sizes) - 1} layers of at least 2 members",
                              got=f"{len(self.weights)} layers")
        members = len(self.weights[0])
        layers = list(itertools.pairwise(sizes))
        weights = [_frozen(w, (members, i, o)) for w, (i, o) in zip(self.weights, layers, strict=True)]
        biases = [_frozen(b, (members, o)) for b, (_, o) in zip(self.biases, layers, strict=True)]
        thetas = self.thetas if len(self.thetas) else np.zeros((members, 0))
        thetas = _frozen(thetas, (members, feature_count(self.inputs)))
        for name, value in {"layer_sizes": sizes, "thetas": thetas, "weights": tuple(weights), "biases": tuple(biases),
                            "inputs": tuple(self.inputs), "feedback_ids": tuple(self.feedback_ids)}.items():
            object.__setattr__(self, name, value)

    @property
    def members(self) -> int:
        """Number of networks."""
        return len(self.weights[0])

    def bind(self, context: Context, kappa: float = 0.0, among: ArrayLike | None = None) -> ContextReward:
        """Fix the scene, which makes the reward a function of the tool state alone.

        Args:
            context: Goal and objects.
            kappa: How many times the members' disagreement is taken off their mean [1].
            among: Tool states over which each member's mean is taken off before members are compared, since its
                constant carries no meaning, shape (N, 6) [m, 1]; None: compared as they are.

        Returns:
            The reward for that scene.

        Raises:
            InputError: The scene lacks an object that the reward is about.
        """
        return ContextReward(self, context, kappa, among)

    def member_rewards(self, tool_states: ArrayLike, context: Context) -> Array:
        """Compute every member's reward of each state.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].
            context: Goal and objects.

        Returns:
            Rewards, shape (m, N) [1].
        """
        return self.bind(context).member_rewards(tool_states)

    def disagreement(self, tool_states: ArrayLike, context: Context) -> Array:
        """Compute the standard deviation of the members' rewards, each less its mean over the states.

        The mean is taken off because a member's constant carries no meaning.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].
            context: Goal and objects.

        Returns:
            Standard deviation over the members, shape (N,) [1].
        """
        rewards = self.member_rewards(tool_states, context)
        centred: Array = rewards - rewards.mean(axis=1, keepdims=True)
        return np.asarray(centred.std(axis=0))

    def flat_weights(self) -> Weights:
        """Write all weights in one row.

        For each layer, for each member, the matrix row by row, then its biases; at the end each member's weights of the
        features.

        Returns:
            Weights, shape (W,).
        """
        layers = (part for weight, bias in zip(self.weights, self.biases, strict=True)
                  for k in range(self.members) for part in (weight[k].ravel(), bias[k]))
        return np.concatenate([*layers, self.thetas.ravel()])

    @classmethod
    def from_flat(cls, flat: ArrayLike, *, members: int, layer_sizes: Sequence[int], inputs: Sequence[str],
                  version: int, robot: str, frame: str, feedback_ids: Sequence[str] = (), seed: int = 0,
                  activation: str = "leaky_relu") -> RewardEnsemble:
        """Read an ensemble from the row that flat_weights writes.

        Args:
            flat: Weights, shape (W,).
            members: Number of networks.
            layer_sizes: Widths from the input to the output.
            inputs: Names of the networks' inputs.
            version: Version of the model.
            robot: Robot that it was learned on.
            frame: Frame that positions refer to.
            feedback_ids: Names of the feedback items that it was learned from.
            seed: Seed of the training.
            activation: Activation of the hidden layers.

        Returns:
            The ensemble.

        Raises:
            ShapeError: Another number of weights than the sizes ask for.
            ConfigError: An activation that is not known here.
            InputError: A weight is not finite.
        """
        require_activation(activation)
        row = np.asarray(flat, dtype=np.float32)
        layers, features = list(itertools.pairwise(layer_sizes)), feature_count(inputs)
        wanted = members * (sum((i + 1) * o for i, o in layers) + features)
        if row.shape != (wanted,):
            raise ShapeError("weights of the reward model", expected=f"({wanted},)", got=row.shape)
        weights, biases, at = [], [], 0
        for i, o in layers:
            block = row[at:at + members * (i + 1) * o].reshape(members, (i + 1) * o)
            weights.append(block[:, :i * o].reshape(members, i, o))
            biases.append(block[:, i * o:])
            at += block.size
        return cls(version=version, robot=robot, frame=frame, inputs=tuple(inputs), layer_sizes=tuple(layer_sizes),
                   weights=tuple(weights), biases=tuple(biases), thetas=row[at:].reshape(members, features),
                   feedback_ids=tuple(feedback_ids), seed=seed, activation=activation)


class ContextReward:
    """A reward over tool states alone: the ensemble's mean in one scene (paper eq. M10's sum, divided by m).

    With kappa it is the mean less kappa times the standard deviation over the members.
    """

    def __init__(self, ensemble: RewardEnsemble, context: Context, kappa: float = 0.0,
                 among: ArrayLike | None = None) -> None:
        """Fold the scene into the first layer, since all inputs but features are linear in the tool state."""
        inputs = scene_inputs(ensemble.inputs, context)
        weights = [w.astype(np.float64) for w in ensemble.weights]
        biases = [b.astype(np.float64)[:, None, :] for b in ensemble.biases]
        linear, features = np.split(weights[0], [len(inputs.offset)], axis=1)
        biases[0] = biases[0] + inputs.offset @ linear[:, None]
        weights[0] = np.concatenate([inputs.matrix @ linear, features], axis=1)
        self._weights, self._biases, self._activate = weights, biases, ACTIVATIONS[ensemble.activation]
        self._features, self._thetas = inputs.features, ensemble.thetas.astype(np.float64)
        self._kappa = kappa
        self._constants: Array = np.zeros((len(weights[0]), 1))
        if kappa and among is not None:
            self._constants = self.member_rewards(among).mean(axis=1, keepdims=True)

    def member_rewards(self, tool_states: ArrayLike) -> Array:
        """Compute every member's reward of each state.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (m, N) [1].

        Raises:
            ShapeError: Another number of columns.
        """
        states = _require_states(tool_states)
        phi, _ = evaluate(self._features, states)
        return self._network(states, phi)[0] + self._thetas @ phi.T

    def value_and_gradient(self, tool_states: ArrayLike) -> tuple[Array, Array]:
        """Compute the reward of each state, mean less kappa times disagreement, and its gradient.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,) [1], and gradients, shape (N, 6) [1/m, 1].

        Raises:
            ShapeError: Another number of columns.
        """
        states = _require_states(tool_states)
        phi, by_state = evaluate(self._features, states)
        residuals, slopes = self._network(states, phi)
        backward = (1.0 - residuals**2)[..., None]  # d tanh
        for weight, slope in zip(reversed(self._weights), (*reversed(slopes), None), strict=True):
            backward = backward @ weight.transpose(0, 2, 1)
            if slope is not None:
                backward *= slope
        if not self._kappa:
            values, slopes_of_mean = residuals.mean(axis=0), backward.mean(axis=0)
            if not self._features:
                return values, slopes_of_mean
            theta = self._thetas.mean(axis=0)
            return values + phi @ theta, _by_state(slopes_of_mean, theta, by_state)
        rewards = residuals + self._thetas @ phi.T
        gradients = _by_state(backward, self._thetas[:, None], by_state)
        centred = rewards - self._constants
        apart = centred - centred.mean(axis=0)
        spread = np.sqrt((apart**2).mean(axis=0) + _SMALLEST_VARIANCE)
        of_spread = (apart[..., None] * gradients).mean(axis=0) / spread[:, None]
        return rewards.mean(axis=0) - self._kappa * spread, gradients.mean(axis=0) - self._kappa * of_spread

    def _network(self, states: Array, phi: Array) -> tuple[Array, list[Array]]:
        """Run all members' networks; returns their outputs (m, N) and the slopes of the activations (m, N, width)."""
        hidden, slopes = np.concatenate([states, phi], axis=1)[None], []
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            hidden, slope = self._activate(hidden @ weight + bias)
            slopes.append(slope)
        return np.tanh(hidden @ self._weights[-1] + self._biases[-1])[..., 0], slopes


def _by_state(gradients: Array, thetas: Array, by_state: Array) -> Array:
    """Chain gradients by (state, features), shape (..., N, 6 + F), through the features' own, shape (N, F, 6)."""
    width = gradients.shape[-1] - thetas.shape[-1]
    by_feature = gradients[..., width:] + thetas
    return np.asarray(gradients[..., :width] + (by_feature[..., None, :] @ by_state)[..., 0, :])


def _require_states(tool_states: ArrayLike) -> Array:
    states = np.asarray(tool_states, dtype=np.float64)
    if states.ndim != 2 or states.shape[1] != len(TOOL_STATE):
        raise ShapeError("shape of tool states", expected=f"(any, {len(TOOL_STATE)})", got=states.shape)
    return states


def _frozen(values: ArrayLike, shape: tuple[int, ...]) -> Weights:
    array = np.array(values, dtype=np.float32)
    if array.shape != shape:
        raise ShapeError("weights of a layer", expected=shape, got=array.shape)
    if not np.isfinite(array).all():
        raise InputError("weights of the reward model are not finite", mend="train again")
    array.flags.writeable = False
    return array
