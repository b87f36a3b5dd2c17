"""Cut a session into runs of the arm, sampled evenly, with the moments at which a person led."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import Array, frozen_array

LARGEST_GAP = 0.1
"""Time without a joint state that ends an episode's usefulness [s]."""


@dataclass(frozen=True, kw_only=True)
class SensorLog:
    """What the arm's sensors said, in the order of the stamps."""

    times: Array
    """Stamps, shape (N,) [s]."""
    positions: Array
    """Joint positions, shape (N, n) [rad]."""
    velocities: Array
    """Joint velocities, shape (N, n) [rad/s]."""
    torque_times: Array
    """Stamps of the external torques, shape (M,) [s]; M may be 0."""
    torques: Array
    """External torques, shape (M, n) [Nm]."""

    def __post_init__(self) -> None:
        """Check shapes."""
        n = np.shape(self.positions)[-1]
        for name, shape in (("times", (None,)), ("positions", (None, n)), ("velocities", (None, n)),
                            ("torque_times", (None,)), ("torques", (None, n))):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), shape))


@dataclass(frozen=True, kw_only=True)
class ControlLog:
    """What the controller said it did, in the order of the stamps."""

    times: Array
    """Stamps, shape (K,) [s]."""
    modes: Sequence[int]
    """Teaching modes."""
    person_leads: Sequence[bool]
    """True where a person led."""
    motions: Sequence[str]
    """Names of the motions that were tracked; empty where none was."""


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One run of the arm at an even rate: guided by a person, or tracking a motion that a person may have pushed."""

    kind: str
    """"guided", or the name of the motion that was tracked."""
    times: Array
    """Time since the first frame, shape (F,) [s]."""
    positions: Array
    """Joint positions, shape (F, n) [rad]."""
    velocities: Array
    """Joint velocities, shape (F, n) [rad/s]."""
    torques: Array
    """External torques, shape (F, n) [Nm]; zero where none were recorded."""
    intervention: NDArray[np.bool_]
    """True where a person led, shape (F,)."""


def cut_episodes(sensors: SensorLog, control: ControlLog, *, rate: float, left_out: Sequence[str] = ()
                 ) -> tuple[Episode, ...]:
    """Cut a session into its guided and tracked runs.

    Args:
        sensors: What the sensors said.
        control: What the controller said.
        rate: Frames a second [Hz].
        left_out: Runs of motions whose names begin with one of these are left out.

    Returns:
        Episodes in order. Runs of fewer than two frames, and those with a gap in the joint states, give none.
    """
    found = []
    for first, last in _runs(control):
        kind = "guided" if control.modes[first] == TeachingMode.GUIDE else control.motions[first]
        if kind.startswith(tuple(left_out)) and left_out:
            continue
        start, end = float(control.times[first]), float(control.times[last])
        episode = _sampled(sensors, control, kind, start, end, rate)
        if episode is not None:
            found.append(episode)
    return tuple(found)


def _runs(control: ControlLog) -> list[tuple[int, int]]:
    """Find first and last index of each stretch of one motion or of guiding."""
    keys = [(mode, name) if mode in (TeachingMode.GUIDE, TeachingMode.TRACK) else None
            for mode, name in zip(control.modes, control.motions, strict=True)]
    runs, first = [], 0
    for k in range(1, len(keys) + 1):
        if k == len(keys) or keys[k] != keys[first]:
            if keys[first] is not None and k - 1 > first:
                runs.append((first, k - 1))
            first = k
    return runs


def _sampled(sensors: SensorLog, control: ControlLog, kind: str, start: float, end: float,
             rate: float) -> Episode | None:
    inside = sensors.times[(sensors.times >= start) & (sensors.times <= end)]
    if len(inside) < 2 or np.diff(inside).max() > LARGEST_GAP:
        return None
    frames = inside[0] + np.arange(int((inside[-1] - inside[0]) * rate + 1e-9) + 1) / rate
    if len(frames) < 2 or inside[0] - start > LARGEST_GAP or end - inside[-1] > LARGEST_GAP:
        return None
    held = np.clip(np.searchsorted(control.times, frames + 1e-9, side="right") - 1, 0, None)
    led = np.array([control.person_leads[k] or control.modes[k] == TeachingMode.GUIDE for k in held])
    return Episode(
        kind=kind, times=frames - frames[0], positions=_at(frames, sensors.times, sensors.positions),
        velocities=_at(frames, sensors.times, sensors.velocities),
        torques=_at(frames, sensors.torque_times, sensors.torques), intervention=led)


def _at(frames: ArrayLike, times: Array, values: Array) -> Array:
    """Interpolate linearly; zero where nothing was recorded."""
    if not len(times):
        return np.zeros((len(np.asarray(frames)), values.shape[1]))
    return np.stack([np.interp(np.asarray(frames), times, column) for column in values.T], axis=-1)
