"""How far each kind of feedback tells of the same reward as the others (the paper's future work).

People may be biased in one way of teaching and sound in the others: who cannot reach across the table shows motions
that stop short, and still sees which of two motions is better. A kind of feedback alone always agrees with itself, so
only its conflict with the others says anything. Here "it tells of the common reward" is weighed against "it tells of a
reward that is only like it" by the evidence of both, under a Gaussian process as a stand-in for the networks: it is
fitted in milliseconds, and it knows where it was taught nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from unifeed_ros.core.errors import ConfigError, TrainingError
from unifeed_ros.core.reward.buffer import Indices, Inputs, RankingsBuffer
from unifeed_ros.core.reward.inputs import WEAK, input_scale
from unifeed_ros.core.types import Array

ESTIMATE: Literal["estimate"] = "estimate"
"""Stands for weights that are estimated in every training."""
KINDS = ("demonstrations", "corrections", "preferences")
"""Order of all weights."""
TRUST = 1.0
"""Prior logarithmic odds that a kind tells of the common reward [nat]."""
LIKENESS = 0.5
"""Prior correlation of a biased kind's reward with the common one [1]: most of what it tells is still true."""
DECISIVENESS = 20.0
"""Root-mean-square of how strongly rewards decide the comparisons, before any was answered [nat]."""
REACH = 0.5
"""Distance over which a reward changes on its own [m, rad]."""
LEAST_PAIRS = 6
"""Ranked pairs from which on weights are estimated: on one or two noisy answers of a sound person, the same person's
demonstrations were doubted down to 0.13."""
ALTERNATIVES, MOST = 24, 96
"""About how many alternatives of each demonstration and each correction are weighed, and how many of each kind at most:
time grows with the cube of their number."""
WAVES = 64
"""Random waves that a reward over one group of inputs is made of."""
_ITERATIONS = 50


def check_reliability(value: str | Sequence[float]) -> str | tuple[float, ...]:
    """Check a setting of the weights.

    Args:
        value: "estimate", or a weight for each of KINDS.

    Returns:
        The setting.

    Raises:
        ConfigError: Another word, another number of weights, or one that is not between 0 and 1.
    """
    if isinstance(value, str):
        if value == ESTIMATE:
            return value
    elif len(value) == len(KINDS) and all(0.0 <= float(v) <= 1.0 for v in value) and max(value) > 0.0:
        return tuple(float(v) for v in value)
    raise ConfigError("reliability", got=value,
                      expected=f"{ESTIMATE}, or weights from 0 to 1 of {', '.join(KINDS)}, not all 0")


def reliability_of(buffer: RankingsBuffer, setting: str | Sequence[float]) -> tuple[float, float, float]:
    """Give the weight of each kind of feedback.

    Args:
        buffer: The comparisons.
        setting: "estimate", or the weights.

    Returns:
        Weights of demonstrations, corrections and preferences, 0 to 1.

    Raises:
        TrainingError: The weights leave nothing to learn from.
    """
    if isinstance(setting, str):
        return estimate_reliability(buffer)
    demonstrations, corrections, preferences = setting
    used = (len(buffer.demonstrated), len(buffer.corrected), len(buffer.better))
    if not any(weight and count for weight, count in zip(setting, used, strict=True)):
        raise TrainingError("the weights of the settings leave nothing to learn from", expected="a weight above 0",
                            got=tuple(setting), mend="teach in another way, or raise training.reliability")
    return float(demonstrations), float(corrections), float(preferences)


def estimate_reliability(buffer: RankingsBuffer) -> tuple[float, float, float]:
    """Estimate the probability that each kind of feedback tells of the reward that the others tell of.

    Every set S of kinds may be the sound one. Rewards are then Gaussian processes, the same one for all kinds in S,
    and one with the correlation LIKENESS to it for each other kind: P(S) ~ p(answers | S) exp(TRUST |S|). A kind's
    weight is the sum of P(S) over the sets that it is in, divided by the largest. Known weakness: where two kinds
    conflict, the third decides, and may be about something else; a reward that changes more abruptly than REACH looks
    like a conflict.

    Args:
        buffer: The comparisons.

    Returns:
        Weights of demonstrations, corrections and preferences, 0 to 1, the largest 1. All 1 where fewer than three
        kinds were used, since of two that contradict each other nothing says which is right; or fewer than LEAST_PAIRS.
    """
    differences = _differences(buffer)
    if not all(len(rows) for rows in differences) or len(buffer.better) < LEAST_PAIRS:
        return 1.0, 1.0, 1.0
    rows = np.concatenate(differences)
    kinds = np.repeat(np.arange(len(KINDS)), [len(d) for d in differences])
    kernel = rows @ rows.T
    sets = np.array(list(product((False, True), repeat=len(KINDS))))
    scores = np.array([log_evidence(kernel * _correlations(s, kinds)) + TRUST * s.sum() for s in sets])
    sums = np.exp(scores - scores.max()) @ sets
    demonstrations, corrections, preferences = (float(s) for s in sums / sums.max())
    return demonstrations, corrections, preferences


def _correlations(sound: NDArray[np.bool_], kinds: Indices) -> Array:
    """Say how far the rewards behind each two comparisons agree beforehand, shape (n, n)."""
    each = np.where(sound, 1.0, LIKENESS)[kinds]
    return np.where(kinds[:, None] == kinds, 1.0, each[:, None] * each)


def _differences(buffer: RankingsBuffer) -> list[Array]:
    """Describe each comparison of each kind by what its two motions differ in, shape (n, F) for each kind [nat]."""
    shown = _features(buffer.inputs, buffer.shown)
    versus = []
    for indices, alternatives in ((buffer.demonstrated, buffer.demonstration_alternatives),
                                  (buffer.corrected, buffer.correction_alternatives)):
        each = max(1, min(ALTERNATIVES, MOST // max(1, len(indices))))
        some = alternatives[:, ::max(1, alternatives.shape[1] // each)]
        versus.append((shown[indices][:, None] - _features(buffer.inputs, some)).reshape(-1, shown.shape[-1]))
    corrections = np.concatenate([shown[buffer.corrected] - shown[buffer.planned], versus[1]])
    differences = [versus[0], corrections, shown[buffer.better] - shown[buffer.worse]]
    size = float(np.sqrt(np.square(np.concatenate(differences)).sum(axis=1).mean()))
    return [DECISIVENESS / max(size, 1e-12) * d for d in differences]


def _features(names: Sequence[str], motions: Inputs) -> Array:
    """Describe motions, shape (..., H, I), by waves over each group of inputs, averaged over the states: (..., F).

    A reward of normal weights on them is a sum of smooth functions, one of the position, one of the tool's axis, one
    of the offset to each thing (random Fourier features of squared-exponential kernels).
    """
    rng = np.random.default_rng(0)
    columns: list[Array] = []
    for group in dict.fromkeys(map(_group, names)):
        members = [i for i, name in enumerate(names) if _group(name) == group]
        inputs = motions[..., members] / np.array([input_scale(names[i]) for i in members])
        waves = rng.normal(scale=1.0 / REACH, size=(inputs.shape[-1], WAVES))
        columns.append(np.cos(inputs @ waves + rng.uniform(0.0, 2.0 * np.pi, WAVES)).mean(axis=-2))
    return np.concatenate(columns, axis=-1)


def _group(name: str) -> str:
    """Name the thing that an input is about: the position, the axis, the goal, an object, or a feature."""
    name = name.removesuffix(WEAK)
    if name in ("x", "y", "z"):
        return "position"
    return "axis" if name.startswith("axis_") else name.rpartition("_d")[0] or name


def log_evidence(kernel: Array) -> float:
    """Compute how likely it is that every first motion of a comparison was the better one, by Laplace's approximation.

    The posterior's mode by Newton's method, with the logistic likelihood of paper eq. M3 (Rasmussen and Williams,
    Gaussian Processes for Machine Learning, algorithm 3.1).

    Args:
        kernel: Prior covariance of the differences of returns, shape (n, n) [nat^2].

    Returns:
        Logarithm of the evidence [nat].
    """
    values, objective = np.zeros(len(kernel)), -np.inf
    for _ in range(_ITERATIONS):
        chance = 0.5 * (1.0 + np.tanh(0.5 * values))
        curvature = chance * (1.0 - chance)
        roots = np.sqrt(curvature)
        factor = cho_factor(np.eye(len(kernel)) + roots[:, None] * kernel * roots, lower=True)
        wanted = curvature * values + (1.0 - chance)
        inner = wanted - roots * cho_solve(factor, roots * (kernel @ wanted))
        values = kernel @ inner
        before, objective = objective, float(-np.logaddexp(0.0, -values).sum() - 0.5 * inner @ values)
        if objective - before < 1e-3:
            break
    return objective - float(np.log(np.diag(factor[0])).sum())
