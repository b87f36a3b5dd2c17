"""The learned reward as data, and its evaluation without any learning library."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.reward.activations import ACTIVATIONS, require_activation
from unifeed_ros.core.reward.features import input_map
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

    The output is a tanh, so that a state's reward lies between -1 and 1. A constant added to
    all rewards leaves every comparison as it is: never compare absolute values between two ensembles.
    """

    version: int
    """Grows by one with every model of a session; the first is 1."""
    robot: str
    """Robot that it was learned on."""
    frame: str
    """Frame that positions refer to."""
    inputs: tuple[str, ...]
    """Names of the networks' inputs, in order."""
    layer_sizes: tuple[int, ...]
    """Widths from the input to the output, for example (9, 64, 64, 1)."""
    weights: tuple[Weights, ...] = field(repr=False)
    """Matrices of each layer, shape (m, in, out)."""
    biases: tuple[Weights, ...] = field(repr=False)
    """Biases of each layer, shape (m, out)."""
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
        for name, value in {"layer_sizes": sizes, "weights": tuple(weights), "biases": tuple(biases),
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
        """Write all weights in one row: for each layer, for each member, the matrix row by row, then its biases.

        Returns:
            Weights, shape (W,).
        """
        return np.concatenate([
            part for weight, bias in zip(self.weights, self.biases, strict=True)
            for k in range(self.members) for part in (weight[k].ravel(), bias[k])])

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
        layers = list(itertools.pairwise(layer_sizes))
        wanted = members * sum((i + 1) * o for i, o in layers)
        if row.shape != (wanted,):
            raise ShapeError("weights of the reward model", expected=f"({wanted},)", got=row.shape)
        weights, biases, at = [], [], 0
        for i, o in layers:
            block = row[at:at + members * (i + 1) * o].reshape(members, (i + 1) * o)
            weights.append(block[:, :i * o].reshape(members, i, o))
            biases.append(block[:, i * o:])
            at += block.size
        return cls(version=version, robot=robot, frame=frame, inputs=tuple(inputs), layer_sizes=tuple(layer_sizes),
                   weights=tuple(weights), biases=tuple(biases), feedback_ids=tuple(feedback_ids), seed=seed,
                   activation=activation)


class ContextReward:
    """A reward over tool states alone: the ensemble's mean in one scene (paper eq. M10's sum, divided by m).

    With kappa it is the mean less kappa times the standard deviation over the members.
    """

    def __init__(self, ensemble: RewardEnsemble, context: Context, kappa: float = 0.0,
                 among: ArrayLike | None = None) -> None:
        """Fold the scene into the first layer, since the inputs are linear in the tool state."""
        matrix, offset = input_map(ensemble.inputs, context)
        weights = [w.astype(np.float64) for w in ensemble.weights]
        biases = [b.astype(np.float64)[:, None, :] for b in ensemble.biases]
        biases[0] = biases[0] + offset @ weights[0][:, None]
        weights[0] = matrix @ weights[0]
        self._weights, self._biases, self._activate = weights, biases, ACTIVATIONS[ensemble.activation]
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
        return self._forward(_require_states(tool_states))[0]

    def value_and_gradient(self, tool_states: ArrayLike) -> tuple[Array, Array]:
        """Compute the reward of each state, mean less kappa times disagreement, and its gradient.

        Args:
            tool_states: Tool states, shape (N, 6) [m, 1].

        Returns:
            Rewards, shape (N,) [1], and gradients, shape (N, 6) [1/m, 1].

        Raises:
            ShapeError: Another number of columns.
        """
        rewards, slopes = self._forward(_require_states(tool_states))
        backward = (1.0 - rewards**2)[..., None]  # d tanh
        for weight, slope in zip(reversed(self._weights), (*reversed(slopes), None), strict=True):
            backward = backward @ weight.transpose(0, 2, 1)
            if slope is not None:
                backward *= slope
        mean, gradient = rewards.mean(axis=0), backward.mean(axis=0)
        if not self._kappa:
            return mean, gradient
        centred = rewards - self._constants
        apart = centred - centred.mean(axis=0)
        spread = np.sqrt((apart**2).mean(axis=0) + _SMALLEST_VARIANCE)
        by_state = (apart[..., None] * backward).mean(axis=0) / spread[:, None]
        return mean - self._kappa * spread, gradient - self._kappa * by_state

    def _forward(self, states: Array) -> tuple[Array, list[Array]]:
        """Run all members at once; returns their rewards (m, N) and the slopes of the activations (m, N, width)."""
        hidden, slopes = states[None], []
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            hidden, slope = self._activate(hidden @ weight + bias)
            slopes.append(slope)
        return np.tanh(hidden @ self._weights[-1] + self._biases[-1])[..., 0], slopes


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
