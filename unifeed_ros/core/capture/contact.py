"""Whether a person touches the arm, judged from external torque at the rate of the control loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.types import Array, frozen_array

RISE_TIME = 0.03
"""Time constant of the filter that the rise of the level is taken from [s]."""


class ContactKind(IntEnum):
    """What a contact is, as numbers that the message Contact uses too."""

    NONE = 0
    """No touch."""
    TOUCH = 1
    """A touch that is meant."""
    COLLISION = 2
    """Short and hard: never learned from."""


@dataclass(frozen=True, kw_only=True)
class ContactConfig:
    """Settings of the contact detector."""

    startup: float = 0.3
    """Time at the start over which the bias is the median; no contact is reported before its end [s]."""
    bias_time: float = 8.0
    """Time constant with which the bias follows while nobody touches [s]."""
    bias_step: float = 0.5
    """Part of a threshold that one sample counts for at most when the bias follows: a push hardly enters [1]."""
    release_level: float = 0.5
    """Level below which a contact ends; contacts begin above 1 [1]."""
    on_delay: float = 0.02
    """Time that the level must stay above 1 before a contact begins; its onset is the first of these samples [s]."""
    off_delay: float = 0.1
    """Time that the level must stay below the release level before a contact ends [s]."""
    moving_allowance: float = 0.75
    """Rise of all thresholds while the arm moves, as a part of them: friction is known less well then [1]."""
    moving_speed: float = 0.1
    """Speed of the fastest joint at which the whole moving allowance holds [rad/s]."""
    moving_memory: float = 0.3
    """Time constant with which the moving allowance fades after a motion [s]."""
    steady_time: float = 6.0
    """A contact whose torque stays the same for so long is a shifted bias; it ends and the bias is set anew [s]."""
    steady_band: float = 0.5
    """Part of a threshold within which a torque counts as the same [1]."""
    collision_rate: float = 80.0
    """Rise of the level above which a contact begins as a collision [1/s]."""
    collision_time: float = 0.25
    """A collision that still presses after this time becomes a touch [s]."""
    gap: float = 0.5
    """Longest step between samples that delays are counted across; stamps that go back by more begin anew [s]."""

    def __post_init__(self) -> None:
        """Reject settings that would make the detector silent or stuck."""
        for name in ("startup", "bias_time", "bias_step", "moving_speed", "moving_memory", "steady_time", "steady_band",
                     "collision_rate", "gap"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        for name in ("on_delay", "off_delay", "moving_allowance", "collision_time"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(name, expected=">= 0 and finite", got=getattr(self, name))
        if not 0.0 < self.release_level <= 1.0:
            raise ConfigError("release_level", expected="above 0, at most 1", got=self.release_level)


@dataclass(frozen=True, kw_only=True)
class ContactSample:
    """What the detector says at one moment."""

    time: float
    """Stamp of the sample [s]."""
    in_contact: bool
    """True while somebody touches the arm."""
    kind: ContactKind
    """NONE, TOUCH or COLLISION."""
    onset: float | None
    """Stamp of the first sample of this contact [s]; None when there is none."""
    level: float
    """Largest bias-free torque over the joints, each divided by its threshold of the moment [1]."""
    torque: Array
    """External torque without bias, shape (n,) [Nm]."""
    bias: Array
    """Bias taken off, shape (n,) [Nm]."""


class ContactDetector:
    """Tell touched from untouched, sample by sample.

    The bias b is the median torque of the first moments, then follows slowly while nobody touches. The level is
    max_j |tau_j - b_j| / threshold_j, divided by 1 + moving_allowance while the arm moves. Levels above 1 begin a
    contact, levels below the release level end it, both only after a delay.

    Known weakness: who touches the arm during the start is taken for bias; it shows as a contact after they let go, and
    ends when the torque has been steady. A push that grows over more than a few bias_time is followed as bias.

    Args:
        thresholds: External torque that counts as a touch of the arm at rest, shape (n,) [Nm], positive.
        config: Settings.

    Raises:
        ConfigError: A threshold is not positive.
    """

    def __init__(self, thresholds: Sequence[float] | Array, config: ContactConfig | None = None) -> None:
        self._thresholds = frozen_array("contact thresholds", thresholds, (None,))
        if len(self._thresholds) == 0 or self._thresholds.min() <= 0.0:
            raise ConfigError("contact thresholds", expected="> 0 Nm, one a joint", got=self._thresholds.tolist())
        self._config = config or ContactConfig()
        self._n = len(self._thresholds)
        self._inverse = 1.0 / self._thresholds
        self._step = self._config.bias_step * self._thresholds
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next sample is the first."""
        self._first_samples: list[Array] = []
        self._start: float | None = None
        self._bias = np.zeros(self._n)
        self._ready = False
        self._speed = 0.0
        self._slow_level = self._rate = 0.0
        self._above_since: float | None = None
        self._below_since: float | None = None
        self._onset: float | None = None
        self._hard = False
        self._steady_torque, self._steady_since = self._bias, 0.0
        self._last: ContactSample | None = None

    @property
    def ready(self) -> bool:
        """True once the bias is known."""
        return self._ready

    def update(self, time: float, torque: ArrayLike, velocities: ArrayLike) -> ContactSample:
        """Judge one sample.

        A sample whose stamp is not later than the one before is skipped: the answer is the last one again. A stamp that
        goes back by more than the gap means that the clock began anew (a simulation that restarted), and so does the
        detector.

        Args:
            time: Stamp [s].
            torque: External torque, bias included, shape (n,) [Nm].
            velocities: Joint velocities, shape (n,) [rad/s].

        Returns:
            The judgement; its arrays never change later.

        Raises:
            ShapeError: Another number of torques or velocities.
            InputError: The stamp, a torque or a velocity is not finite; the detector is as it was before.
        """
        torque, speed = self._checked(time, torque, velocities)
        if self._last is not None and time < self._last.time - self._config.gap:
            self.reset()
        last = self._last
        if last is not None and time <= last.time:
            return last
        step = 0.0 if last is None else time - last.time
        if step > self._config.gap:
            self._above_since = self._below_since = None
            self._steady_since = time
            step = self._config.gap
        if not self._ready:
            return self._start_up(time, torque)
        free = torque - self._bias
        level = self._level(free, speed, step)
        self._judge(time, torque, level)
        if self._onset is None:
            self._follow(free, step)
        return self._answer(time, level, free)

    def _checked(self, time: float, torque: ArrayLike, velocities: ArrayLike) -> tuple[Array, float]:
        torque = np.array(torque, dtype=np.float64)
        velocities = np.asarray(velocities, dtype=np.float64)
        if torque.shape != (self._n,) or velocities.shape != (self._n,):
            raise ShapeError("shapes of torque and velocities", expected=f"({self._n},)",
                             got=(torque.shape, velocities.shape))
        speed = max(float(velocities.max()), -float(velocities.min()))
        if not math.isfinite(time + float(torque.sum()) + speed):
            raise InputError("contact sample is not finite", expected="numbers",
                             got=f"time {time}, torque {torque.tolist()}, velocities {velocities.tolist()}")
        return torque, speed

    def _start_up(self, time: float, torque: Array) -> ContactSample:
        if self._start is None:
            self._start = time
        self._first_samples.append(torque)
        if time - self._start >= self._config.startup:
            self._ready = True
        self._bias = np.median(self._first_samples, axis=0) if self._ready else torque
        if self._ready:
            self._first_samples = []
        return self._answer(time, 0.0, torque - self._bias)

    def _level(self, free: Array, speed: float, step: float) -> float:
        config = self._config
        self._speed = max(speed, self._speed / (1.0 + step / config.moving_memory))
        scaled = free * self._inverse
        level = max(float(scaled.max()), -float(scaled.min()))
        level /= 1.0 + config.moving_allowance * min(1.0, self._speed / config.moving_speed)
        self._rate = (level - self._slow_level) / RISE_TIME
        self._slow_level += (level - self._slow_level) * min(1.0, step / RISE_TIME)
        return level

    def _judge(self, time: float, torque: Array, level: float) -> None:
        if self._onset is None:
            self._judge_free(time, torque, level)
        else:
            self._judge_touched(time, torque, level)

    def _judge_free(self, time: float, torque: Array, level: float) -> None:
        if level <= 1.0:
            self._above_since, self._hard = None, False
            return
        if self._above_since is None:
            self._above_since = time
        self._hard = self._hard or self._rate > self._config.collision_rate
        if time - self._above_since >= self._config.on_delay:
            self._onset, self._above_since, self._below_since = self._above_since, None, None
            self._steady_torque, self._steady_since = torque, time

    def _judge_touched(self, time: float, torque: Array, level: float) -> None:
        config = self._config
        assert self._onset is not None
        if time - self._onset <= config.collision_time:
            self._hard = self._hard or self._rate > config.collision_rate
        elif level > 1.0:
            self._hard = False
        change = np.abs((torque - self._steady_torque) * self._inverse)
        if float(change.max()) > config.steady_band:
            self._steady_torque, self._steady_since = torque, time
        elif time - self._steady_since > config.steady_time:
            self._bias = torque
            self._onset, self._hard = None, False
            return
        if level >= config.release_level:
            self._below_since = None
            return
        if self._below_since is None:
            self._below_since = time
        if time - self._below_since >= config.off_delay:
            self._onset, self._hard = None, False

    def _follow(self, free: Array, step: float) -> None:
        counted = np.minimum(np.maximum(free, -self._step), self._step)
        self._bias = self._bias + counted * (step / self._config.bias_time)

    def _answer(self, time: float, level: float, free: Array) -> ContactSample:
        touched = self._onset is not None
        kind = ContactKind.NONE if not touched else ContactKind.COLLISION if self._hard else ContactKind.TOUCH
        free.flags.writeable = False
        self._bias.flags.writeable = False
        self._last = ContactSample(time=time, in_contact=touched, kind=kind, onset=self._onset, level=level,
                                   torque=free, bias=self._bias)
        return self._last
