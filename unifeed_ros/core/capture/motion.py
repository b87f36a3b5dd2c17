"""Where an arm moves and where it rests, judged from joint positions over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.types import Array, frozen_array


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Settings that tell motion from rest."""

    start_speed: float = 0.05
    """Speed of the fastest joint that a motion reaches at least once [rad/s]."""
    stop_speed: float = 0.02
    """Speed of the fastest joint below which the arm rests [rad/s]."""
    window: float = 0.1
    """Time over which speed is measured, or two samples if that is longer [s]."""
    shortest_pause: float = 0.2
    """Shorter rests are part of the motion around them [s]."""
    smallest_motion: float = 0.02
    """Motions in which no joint moves through more than this are none: a hand that takes hold of the arm [rad]."""

    def __post_init__(self) -> None:
        """Reject settings that contradict each other."""
        for name in ("stop_speed", "window", "shortest_pause", "smallest_motion"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        if not self.stop_speed <= self.start_speed < math.inf:
            raise ConfigError("start_speed", expected=f"at least stop_speed {self.stop_speed} rad/s",
                              got=self.start_speed)


def ordered_samples(times: ArrayLike, positions: ArrayLike) -> tuple[Array, Array]:
    """Check recorded samples and leave out those whose stamp is not later than all before.

    Args:
        times: Stamps, shape (N,) [s].
        positions: Joint positions, shape (N, n) [rad].

    Returns:
        Stamps, strictly increasing, and their positions.

    Raises:
        ShapeError: Shapes do not fit.
        InputError: A value is not finite, or fewer than two samples are left.
    """
    times = frozen_array("times", times, (None,))
    positions = frozen_array("positions", positions, (len(times), None))
    later = np.ones(len(times), dtype=bool)
    later[1:] = times[1:] > np.maximum.accumulate(times)[:-1]
    if later.sum() < 2:
        raise InputError("recorded motion", expected="at least two samples", got=int(later.sum()))
    return times[later], positions[later]


def fastest_joint_speed(times: Array, positions: Array, window: float) -> Array:
    """Measure the speed of the fastest joint across a centred window; repeated samples and jitter hardly disturb it.

    Args:
        times: Stamps, strictly increasing, shape (N,) [s].
        positions: Joint positions, shape (N, n) [rad].
        window: Time across which positions are compared; two median steps if that is longer [s].

    Returns:
        Speed, shape (N,) [rad/s].
    """
    half = 0.5 * max(window, 2.0 * float(np.median(np.diff(times))))
    early, late = np.maximum(times - half, times[0]), np.minimum(times + half, times[-1])
    moved = [np.abs(np.interp(late, times, column) - np.interp(early, times, column)) for column in positions.T]
    return np.asarray(np.max(moved, axis=0) / (late - early))


def moving_segments(times: Array, positions: Array, config: MotionConfig) -> list[tuple[int, int]]:
    """Find the stretches of time in which the arm moves.

    A segment lasts while the fastest joint is above the stop speed and exceeds the start speed somewhere in it.

    Args:
        times: Stamps, strictly increasing, shape (N,) [s].
        positions: Joint positions, shape (N, n) [rad].
        config: Settings.

    Returns:
        First and last sample of each segment, in order, not overlapping.
    """
    speed = fastest_joint_speed(times, positions, config.window)
    runs = [run for run in true_runs(speed > config.stop_speed) if speed[run[0]:run[1] + 1].max() > config.start_speed]
    segments = merged(runs, times, config.shortest_pause)
    return [(a, b) for a, b in segments if np.ptp(positions[a:b + 1], axis=0).max() >= config.smallest_motion]


def true_runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Find the runs of True.

    Args:
        mask: Shape (N,).

    Returns:
        First and last index of each run, in order.
    """
    edges = np.diff(np.concatenate([[0], np.asarray(mask, dtype=np.int8), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def merged(runs: list[tuple[int, int]], times: Array, gap: float) -> list[tuple[int, int]]:
    """Join runs that are closer in time than a gap.

    Args:
        runs: First and last sample of each run, in order.
        times: Stamps of the samples, shape (N,) [s].
        gap: Runs with less than this between them become one [s].

    Returns:
        First and last sample of each joined run.
    """
    joined: list[tuple[int, int]] = []
    for first, last in runs:
        if joined and times[first] - times[joined[-1][1]] < gap:
            joined[-1] = (joined[-1][0], last)
        else:
            joined.append((first, last))
    return joined
