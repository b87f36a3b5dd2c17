"""A feature that is learned from traces of it, the first half of FERL (ferl.py)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import expit
from torch import Tensor, nn

from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.reward.features import Feature
from unifeed_ros.core.reward.inputs import SceneInputs, scene_inputs
from unifeed_ros.core.robot import TOOL_STATE
from unifeed_ros.core.types import Array, Context, frozen_array

LEAK = 0.01
"""Slope of the hidden layers' activation below zero."""
EQUAL = 0.5
"""Label of a pair whose feature values are the same."""


@dataclass(frozen=True, kw_only=True)
class TraceTraining:
    """How a feature's network is trained on traces."""

    hidden: tuple[int, ...] = (128, 128, 128)
    """Widths of the hidden layers of a feature's network."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    weight_decay: float = 1e-3
    """Weight decay of Adam."""
    batch: int = 32
    """Pairs of states in one step."""
    epochs: int = 100
    """Passes over all pairs."""
    choosing_epochs: int = 10
    """Passes over half the traces, before the other half says which inputs explain the feature better."""
    copies: int = 5
    """How often each pair of equal states stands among the pairs."""
    equal_weight: float = 10.0
    """How much more such a pair counts than others, besides."""

    def __post_init__(self) -> None:
        """Reject values that train nothing."""
        for name in ("batch", "epochs", "choosing_epochs", "copies"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} of the features' training", expected="at least 1", got=getattr(self, name))
        if not self.hidden or min(self.hidden) < 1:
            raise ConfigError("hidden of the features' training", expected="widths of at least 1", got=self.hidden)


@dataclass(frozen=True, kw_only=True)
class FeatureTrace:
    """A path along which a person let a feature fall all the way, to show what it is."""

    context: Context
    """Goal and objects at that time."""
    states: Array
    """Tool states from where the feature is largest to where it is least, shape (T, 6), T >= 2 [m, 1]."""

    def __post_init__(self) -> None:
        """Check the shape, and that there is a pair of states.

        Raises:
            ShapeError: Not six columns.
            InputError: Fewer than two states.
        """
        object.__setattr__(self, "states", frozen_array("states of a feature trace", self.states,
                                                         (None, len(TOOL_STATE))))
        if len(self.states) < 2:
            raise InputError("states of a feature trace", expected="at least two", got=len(self.states))


@dataclass(frozen=True, kw_only=True)
class LearnedFeature:
    """A feature as a network, between 0 and 1 over the traces that it was learned from; a source of features."""

    inputs: tuple[str, ...]
    """Names of the network's inputs."""
    network: nn.Sequential
    """The network, whose output is a softplus."""
    low: float
    """Its smallest output over the traces."""
    high: float
    """Its largest."""

    def __call__(self, context: Context) -> Feature:
        """Make the feature for a scene.

        Args:
            context: Goal and objects.

        Returns:
            Values [1] and gradients over tool states.
        """
        inputs, scale = scene_inputs(self.inputs, context), 1.0 / (self.high - self.low)
        layers = [(linear.weight.numpy().T, linear.bias.numpy())
                  for linear in self.network if isinstance(linear, nn.Linear)]

        def feature(states: Array) -> tuple[Array, Array]:
            hidden, slopes = inputs.values(states).astype(np.float32), []
            for weight, bias in layers[:-1]:
                hidden = hidden @ weight + bias
                slopes.append(np.where(hidden > 0.0, np.float32(1.0), np.float32(LEAK)))
                hidden = hidden * slopes[-1]
            output = hidden @ layers[-1][0] + layers[-1][1]
            backward = expit(output)  # of the softplus
            for (weight, _), slope in zip(reversed(layers), (*reversed(slopes), None), strict=True):
                backward = backward @ weight.T
                if slope is not None:
                    backward = backward * slope
            values = np.logaddexp(0.0, output[:, 0].astype(np.float64))
            return scale * (values - self.low), scale * backward.astype(np.float64) @ inputs.matrix.T

        return feature


def learn_feature(traces: Sequence[FeatureTrace], config: TraceTraining, seed: int) -> LearnedFeature:
    """Learn a feature from traces.

    Of two states of a trace the earlier has more of it, P(s1 has more) = sigmoid(phi(s1) - phi(s2)); all traces begin
    with as much of it as one another, and end with as little. The network sees either where the tool is or how it is
    turned, whichever orders more states rightly in traces that it was not trained on.

    Args:
        traces: At least two, of scenes with the same objects.
        config: Settings.
        seed: Seed of everything random.

    Returns:
        The feature.

    Raises:
        InputError: Fewer than two traces, or the network gives all their states the same value.
    """
    if len(traces) < 2:
        raise InputError("traces of a feature", expected="at least two", got=len(traces))
    rng = np.random.default_rng(seed)
    things = sorted(set.intersection(*(set(trace.context.objects) for trace in traces)) | {"goal"})
    position = (*TOOL_STATE[:3], *(f"{thing}_d{axis}" for thing in things for axis in "xyz"))
    order = rng.permutation(len(traces))
    kept, held_out = ([traces[k] for k in part] for part in np.array_split(order, 2))
    trials = []
    for inputs in (position, TOOL_STATE[3:]):
        network = _train(_Pairs(kept, inputs, config), config, config.choosing_epochs, rng)
        trials.append((_Pairs(held_out, inputs, config).misordered(network), inputs))
    inputs = min(trials)[1]
    network = _train(_Pairs(traces, inputs, config), config, config.epochs, rng)
    with torch.no_grad():
        values = torch.cat([network(_tensor(scene_inputs(inputs, trace.context), trace.states)) for trace in traces])
    low, high = float(values.min()), float(values.max())
    if not high > low:
        raise InputError("a feature learned from traces is the same everywhere", mend="give traces that differ more")
    return LearnedFeature(inputs=inputs, network=network, low=low, high=high)


class _Pairs:
    """Pairs of states as network inputs, and the probability that the first has more of the feature."""

    def __init__(self, traces: Sequence[FeatureTrace], inputs: Sequence[str], config: TraceTraining) -> None:
        states = [_tensor(scene_inputs(inputs, trace.context), trace.states) for trace in traces]
        starts = np.cumsum([0, *(len(s) for s in states)])
        inside = [(first + i, first + j, 1.0) for first, s in zip(starts, states, strict=False)
                  for i, j in itertools.combinations(range(len(s)), 2)]
        ends = [(int(row[a]), int(row[b]), EQUAL) for row in (starts[:-1], starts[1:] - 1)
                for a, b in itertools.combinations(range(len(states)), 2) for _ in range(config.copies)]
        first, second, labels = zip(*inside, *ends, strict=True)
        self._states = torch.cat(states)
        self._first, self._second, self._labels = torch.tensor(first), torch.tensor(second), torch.tensor(labels)

    def __len__(self) -> int:
        return len(self._labels)

    @property
    def width(self) -> int:
        """Number of inputs."""
        return self._states.shape[1]

    def misordered(self, network: nn.Sequential) -> float:
        """Compute in what share of the pairs of one trace a network has the order wrong."""
        with torch.no_grad():
            values = network(self._states)[:, 0]
        return float((values[self._first] <= values[self._second])[self._labels != EQUAL].double().mean())

    def some(self, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Give some pairs: first states, second states, labels."""
        return (self._states[self._first[chosen]], self._states[self._second[chosen]],
                self._labels[chosen].to(torch.float32))


def _train(pairs: _Pairs, config: TraceTraining, epochs: int, rng: np.random.Generator) -> nn.Sequential:
    """Train a network on pairs."""
    generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
    widths = (pairs.width, *config.hidden, 1)
    layers: list[nn.Module] = []
    for into, out in itertools.pairwise(widths):
        linear = nn.utils.skip_init(nn.Linear, into, out)
        bound = into**-0.5  # torch's own rule, from a generator of our own
        nn.init.uniform_(linear.weight, -bound, bound, generator=generator)
        nn.init.uniform_(linear.bias, -bound, bound, generator=generator)
        layers += [linear, nn.LeakyReLU(LEAK)]
    network = nn.Sequential(*layers[:-1], nn.Softplus())
    adam = torch.optim.Adam(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay,
                            fused=True)
    for _ in range(epochs):
        for chosen in torch.randperm(len(pairs), generator=generator).split(config.batch):
            adam.zero_grad()
            _loss(network, *pairs.some(chosen), config).backward()
            adam.step()
    return network.requires_grad_(False)


def _loss(network: nn.Sequential, first: Tensor, second: Tensor, labels: Tensor, config: TraceTraining) -> Tensor:
    """Cross-entropy of which of two states has more."""
    weights = 1.0 + config.equal_weight * (labels == EQUAL)
    values = network(torch.cat([first, second]))[:, 0]
    gaps = values[:len(first)] - values[len(first):]
    return nn.functional.binary_cross_entropy_with_logits(gaps, labels, weight=weights)


def _tensor(inputs: SceneInputs, states: Array) -> Tensor:
    return torch.from_numpy(inputs.values(states).astype(np.float32))
