"""From contact samples to touches: intervals of time in which somebody held, pushed or hit the arm."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.capture.contact import ContactDetector, ContactSample
from unifeed_ros.core.capture.contact_config import ContactKind

SHORTEST_TOUCH = 0.12
"""A contact shorter than this is a knock: nobody shows anything in so short a time [s]."""


@dataclass(frozen=True, kw_only=True)
class Touch:
    """One contact from its onset to its end."""

    onset: float
    """Stamp of its first sample [s]."""
    end: float
    """When it let go, or stamp of the latest sample if it goes on [s]."""
    meant: bool
    """False for a collision that stayed one to its end, and for a knock."""
    link: int = 0
    """Outermost link that surely felt it; 1 is moved by the first joint; 0 if that is not known."""


class TouchLog:
    """Gather contact samples into touches as they come."""

    def __init__(self) -> None:
        self._touches: list[Touch] = []
        self._going_on = False

    @property
    def going_on(self) -> bool:
        """True while somebody touches the arm."""
        return self._going_on

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Touches so far, in order, one that goes on included."""
        return tuple(self._touches)

    def add(self, sample: ContactSample) -> None:
        """Add the next sample of a detector."""
        if not sample.in_contact or sample.onset is None:
            if self._going_on and sample.release is not None:
                last = self._touches[-1]
                meant = last.meant and sample.release - last.onset >= SHORTEST_TOUCH
                self._touches[-1] = replace(last, end=sample.release, meant=meant)
            self._going_on = False
            return
        if not self._going_on or self._touches[-1].onset != sample.onset:
            self._touches.append(Touch(onset=sample.onset, end=sample.time, meant=False))
            self._going_on = True
        touch = self._touches[-1]
        meant = touch.meant or sample.kind is ContactKind.TOUCH
        self._touches[-1] = replace(touch, end=sample.time, meant=meant, link=sample.link)

    def forget_ended(self) -> None:
        """Forget all touches but one that goes on."""
        self._touches = self._touches[-1:] if self._going_on else []


def judge_recording(detector: ContactDetector, times: ArrayLike, torque: ArrayLike,
                    velocities: ArrayLike) -> tuple[list[ContactSample], tuple[Touch, ...]]:
    """Run a detector over a recording.

    Args:
        detector: A fresh detector.
        times: Stamps, shape (N,) [s].
        torque: External torques, shape (N, n) [Nm].
        velocities: Joint velocities, shape (N, n) [rad/s].

    Returns:
        One contact sample a row (rows out of order repeat the one before), and the touches.

    Raises:
        ShapeError: Another number of joints than the detector's.
        InputError: A value is not finite.
    """
    rows = zip(np.asarray(times, dtype=np.float64).tolist(), np.asarray(torque, dtype=np.float64),
               np.asarray(velocities, dtype=np.float64), strict=True)
    log, samples = TouchLog(), []
    for time, row, speeds in rows:
        samples.append(detector.update(time, row, speeds))
        log.add(samples[-1])
    return samples, log.touches


def inside_any(times: ArrayLike, touches: Iterable[Touch]) -> NDArray[np.bool_]:
    """Say which times fall into a touch, its ends included.

    Args:
        times: Stamps, shape (N,) [s].
        touches: Touches.

    Returns:
        Shape (N,).
    """
    times = np.asarray(times, dtype=np.float64)
    inside = np.zeros(len(times), dtype=bool)
    for touch in touches:
        inside |= (times >= touch.onset) & (times <= touch.end)
    return inside
