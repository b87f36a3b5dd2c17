"""Smooth alternatives near a given motion (paper eqs. M1 and M2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, ShapeError
from unifeed_ros.core.types import Array

Ends = Literal["fixed", "free"]
"""What a deformation does to the last point: keeps it ("fixed") or moves it ("free"). The first point always stays."""


Norm = Literal["velocity", "acceleration", "jerk"]
"""Which derivative of a deformation M keeps small: the higher, the smoother."""
Noise = Literal["gaussian", "impulse"]
"""What M makes a deformation of: noise at every point, or one push at a random point for each coordinate."""

_DIFFERENCES: dict[str, tuple[float, ...]] = {
    "velocity": (1.0, -1.0), "acceleration": (1.0, -2.0, 1.0), "jerk": (1.0, -3.0, 3.0, -1.0)}


@dataclass(frozen=True, kw_only=True)
class DeformationShape:
    """What deformations look like, whatever their size."""

    norm: Norm = "acceleration"
    """The norm on the space of trajectories, M^-1 (paper eq. M2)."""
    noise: Noise = "gaussian"
    """The noise lambda (paper eq. M1)."""

    def __post_init__(self) -> None:
        """Reject other words."""
        for name, words in (("norm", get_args(Norm)), ("noise", get_args(Noise))):
            if getattr(self, name) not in words:
                raise ConfigError(f"{name} of deformations", expected=", ".join(words), got=getattr(self, name))


PAPERS = DeformationShape()
"""The paper's choice."""


@lru_cache(maxsize=32)
def deformation_matrix(count: int, ends: Ends = "fixed", norm: Norm = "acceleration") -> Array:
    """Compute the matrix that makes a smooth deformation of noise.

    M = (A^T A)^{-1}, A the differences of the points followed and preceded by zeros: second ones for the acceleration
    norm (paper eq. M2). With a free end the rows of A that reach past the last point are left out.

    Args:
        count: Number of points that move, at least 1.
        ends: Whether the points past the last one stay ("fixed") or do not exist ("free").
        norm: Which derivative is kept small.

    Returns:
        M, symmetric positive definite, read-only, shape (count, count).

    Raises:
        ConfigError: No points, or another word for the ends.
    """
    if count < 1 or ends not in ("fixed", "free"):
        raise ConfigError("deformation", expected="points to move, ends fixed or free", got=(count, ends))
    coefficients = _DIFFERENCES[norm]
    differences = np.zeros((count + len(coefficients) - 1, count))
    for row, value in enumerate(coefficients):
        differences[np.arange(count) + row, np.arange(count)] = value
    if ends == "free":
        differences = differences[:count]
    inverse = np.linalg.inv(differences.T @ differences)
    matrix: Array = 0.5 * (inverse + inverse.T)
    matrix.flags.writeable = False
    return matrix


def noise_scale(count: int, ends: Ends = "fixed", shape: DeformationShape = PAPERS) -> float:
    """Compute the noise that deforms the middle of a trajectory by one unit.

    The middle point of M lambda has the variance sigma^2 sum_j M_mj^2 for independent lambda_j of deviation sigma, and
    a part in count of that for one lambda_j at a random j.

    Args:
        count: Number of points that move.
        ends: As for the matrix.
        shape: Norm and noise.

    Returns:
        Standard deviation of lambda for a root-mean-square mid-trajectory deformation of 1.
    """
    middle = np.linalg.norm(deformation_matrix(count, ends, shape.norm)[(count - 1) // 2])
    return float((np.sqrt(count) if shape.noise == "impulse" else 1.0) / middle)


def sample_deformations(points: int, sizes: ArrayLike, rng: np.random.Generator, *, ends: Ends = "fixed",
                        shape: DeformationShape = PAPERS) -> Array:
    """Draw smooth deformations M lambda (paper eq. M1).

    Args:
        points: Number of points H of the trajectory, both ends included, at least 3.
        sizes: Root-mean-square deformation of the middle, one a coordinate, shape (..., D) [the coordinate's unit].
        rng: Source of randomness.
        ends: Whether the last point stays. The first one always does.
        shape: Norm and noise.

    Returns:
        Deformations, shape (..., H, D) [the coordinates' units].

    Raises:
        ShapeError: Fewer than three points.
        ConfigError: A size is negative or not finite.
    """
    if points < 3:
        raise ShapeError("points of a trajectory to deform", expected="at least 3", got=points)
    sizes = np.asarray(sizes, dtype=np.float64)
    if not (np.isfinite(sizes) & (sizes >= 0)).all():
        raise ConfigError("size of a deformation", expected="finite, not negative", got=float(np.min(sizes)))
    moving = points - (2 if ends == "fixed" else 1)
    *alternatives, coordinates = sizes.shape
    noise = rng.standard_normal((*alternatives, moving, coordinates))
    if shape.noise == "impulse":
        pushed = rng.integers(moving, size=(*alternatives, 1, coordinates))
        noise *= np.arange(moving)[:, None] == pushed
    noise *= noise_scale(moving, ends, shape) * sizes[..., None, :]
    deformations = np.zeros((*alternatives, points, coordinates))
    np.matmul(deformation_matrix(moving, ends, shape.norm), noise, out=deformations[..., 1:1 + moving, :])
    return deformations


def deform_tool_states(states: Array, position_sizes: ArrayLike, axis_sizes: ArrayLike, rng: np.random.Generator, *,
                       ends: Ends = "fixed", shape: DeformationShape = PAPERS) -> Array:
    """Draw alternatives near a motion of the tool (paper eq. M1, in the space of the tool).

    The tool's axis is deformed like a position and brought back to unit length. Deforming the tool instead of the
    joints makes the size mean the same for every arm and posture, and lets position and axis vary apart, so that the
    reward can tell which of them mattered. The arm need not be able to carry the alternatives out.

    Args:
        states: Tool states along the motion, shape (H, 6) [m, 1].
        position_sizes: Root-mean-square deformation of the middle for each alternative, shape (K,) [m].
        axis_sizes: The same for the axis, shape (K,) [rad].
        rng: Source of randomness.
        ends: Whether the last state stays.
        shape: Norm and noise.

    Returns:
        Alternatives, shape (K, H, 6) [m, 1].
    """
    alternatives = np.repeat(states[None], len(np.asarray(position_sizes)), axis=0)
    for columns, sizes in ((slice(0, 3), position_sizes), (slice(3, 6), axis_sizes)):
        moved = np.flatnonzero(sizes)
        wanted = np.repeat(np.asarray(sizes, dtype=np.float64)[moved, None], 3, axis=1)
        alternatives[moved, :, columns] += sample_deformations(len(states), wanted, rng, ends=ends, shape=shape)
    axes = alternatives[moved, :, 3:]  # of those that were tilted, the others' are as they were
    alternatives[moved, :, 3:] = axes / np.maximum(np.linalg.norm(axes, axis=-1, keepdims=True), 1e-9)
    return alternatives


def delay(states: Array, sizes: ArrayLike, rng: np.random.Generator, *, ends: Ends = "fixed",
          shape: DeformationShape = PAPERS) -> Array:
    """Draw alternatives along the same path that fall behind (paper eq. M1, of the progress in time).

    Progress, 0 at the start and 1 at the end, is deformed like a coordinate, always towards later, and kept from
    running backwards, so that an alternative waits where it would have turned round. With a free end, some never
    arrive. Only delays are drawn because the shown motion could have been slower, but perhaps not faster: an
    alternative that nobody could choose says nothing.

    Args:
        states: States along the motion, evenly spaced in time, shape (H, D).
        sizes: Root-mean-square delay of the middle for each alternative, shape (K,) [share of the whole motion].
        rng: Source of randomness.
        ends: Whether every alternative ends where the motion does.
        shape: Norm and noise.

    Returns:
        Alternatives, shape (K, H, D).
    """
    progress = np.linspace(0.0, 1.0, len(states))
    wanted = np.asarray(sizes, dtype=np.float64)[:, None]
    shifts = sample_deformations(len(states), wanted, rng, ends=ends, shape=shape)[..., 0]
    delayed = np.maximum.accumulate(np.clip(progress - np.abs(shifts), 0.0, 1.0), axis=1)
    return np.stack([np.interp(delayed, progress, column) for column in states.T], axis=-1)


def shortcuts(states: Array, count: int, smallest: float, rng: np.random.Generator) -> Array:
    """Draw alternatives that cut a corner: a part of the path gives way to the straight line between its ends.

    Deformations of eq. M1 are smooth noise in all directions, and a straight line is hardly ever among them; yet it is
    what a planner finds first where nothing speaks against it. The timing stays, as in eq. M1.

    Args:
        states: Tool states along the motion, shape (H, 6) [m, 1].
        count: Number of alternatives K.
        smallest: Least displacement of the tool that counts as a corner [m]: below it, a bend may be chance.
        rng: Source of randomness.

    Returns:
        Alternatives, shape (K, H, 6) [m, 1]: the part and the share of the way to the line are random, displaced by at
        least that much; shape (0, H, 6) if the path has no such corner.
    """
    begins, ends = np.triu_indices(len(states), k=2)
    index = np.arange(len(states))
    along = np.clip((index - begins[:, None]) / (ends - begins)[:, None], 0.0, 1.0)[..., None]
    inside = ((index >= begins[:, None]) & (index <= ends[:, None]))[..., None]
    lines = states[begins][:, None] + along * (states[ends] - states[begins])[:, None]
    moves = np.where(inside, lines - states, 0.0)
    largest = np.linalg.norm(moves[..., :3], axis=-1).max(axis=1)
    corners = np.flatnonzero(largest >= smallest)
    if not len(corners):
        return np.zeros((0, *states.shape))
    drawn = rng.choice(corners, count)
    shares = rng.uniform(smallest / largest[drawn], 1.0)
    alternatives: Array = states + shares[:, None, None] * moves[drawn]
    alternatives[..., 3:] /= np.maximum(np.linalg.norm(alternatives[..., 3:], axis=-1, keepdims=True), 1e-9)
    return alternatives
