"""Whether a person touches the arm, judged from external torque at the rate of the control loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.capture.contact_config import ContactConfig, ContactKind
from unifeed_ros.core.capture.edges import EdgeFinder
from unifeed_ros.core.capture.untouched import UntouchedModel
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, frozen_array

RISE_TIME = 0.03
"""Time constant of the filter that the rise of the level is taken from [s]."""
STILL_THERE = 0.8
"""Level of the torque itself, not smoothed, below which a push is gone already [1]."""
LOOK_PERIOD = 0.01
"""Time between two looks at what an untouched arm would show [s]: a fast arm turns by half a degree meanwhile."""


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
    """When this contact began, found again in the moments before it was sure [s]; None when there is none."""
    release: float | None = None
    """When the last contact let go, found again in the moments before that was sure [s]; None while there is one."""
    link: int = 0
    """Outermost link that surely felt this contact; 1 is moved by the first joint; 0 when there is none."""
    level: float
    """Bias-free torque of all joints together, each divided by its threshold of the moment [1]."""
    torque: Array
    """External torque without bias, shape (n,) [Nm]."""
    bias: Array
    """Bias taken off: what an untouched arm would show, shape (n,) [Nm]."""


class ContactDetector:
    """Tell touched from untouched, sample by sample.

    What an untouched arm would show is the median of the first moments, then follows while nobody touches
    (UntouchedModel: bias, friction and payload error). What is left, tau, is smoothed and divided by each joint's
    threshold of the moment,

        level = | tau_j / (share threshold_j (1 + moving_allowance) + doubt_factor doubt_j) |  (Euclidean norm),

    the allowance while the arm moves, the doubt while the model is not sure yet. Levels above 1 begin a contact, levels
    below the release level end it, both only after a delay; when it began and let go is then found in a ring buffer.

    Known weakness: who touches the arm during the start is taken for bias; it shows as a contact after they let go, and
    ends when the torque has been steady. A push that grows over more than a few bias_time is followed as bias.

    Args:
        thresholds: External torque that counts as a touch of the arm at rest, shape (n,) [Nm], positive.
        config: Settings.
        robot: The arm, so that a payload that its driver does not know is told from a push; it needs positions too.

    Raises:
        ConfigError: A threshold is not positive.
    """

    def __init__(self, thresholds: Sequence[float] | Array, config: ContactConfig | None = None,
                 robot: RobotModel | None = None) -> None:
        self._thresholds = frozen_array("contact thresholds", thresholds, (None,))
        if len(self._thresholds) == 0 or self._thresholds.min() <= 0.0:
            raise ConfigError("contact thresholds", expected="> 0 Nm, one a joint", got=self._thresholds.tolist())
        self._config = config or ContactConfig()
        self._n = len(self._thresholds)
        self._inverse = 1.0 / self._thresholds
        self._untouched = UntouchedModel(self._thresholds, self._config.untouched, robot)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next sample is the first."""
        self._untouched.reset()
        self._first_samples: list[Array] = []
        self._start: float | None = None
        self._ready = False
        self._looked = self._speed = 0.0
        self._smooth = self._sum = self._peak = np.zeros(self._n)
        self._summed = self._highest = self._slow_level = self._quick_level = self._rate = 0.0
        self._edges = EdgeFinder()
        self._above_since: float | None = None
        self._below_since: float | None = None
        self._calm_since: float | None = None
        self._fell: float | None = None
        self._onset: float | None = None
        self._release: float | None = None
        self._hard = False
        self._steady_torque, self._steady_since = self._smooth, 0.0
        self._last: ContactSample | None = None

    @property
    def ready(self) -> bool:
        """True once the bias is known."""
        return self._ready

    @property
    def payload(self) -> float:
        """Payload that the arm's driver does not know, as far as it was found [kg]; 0 without a robot."""
        return self._untouched.payload

    def update(self, time: float, torque: ArrayLike, velocities: ArrayLike,
               positions: Array | None = None) -> ContactSample:
        """Judge one sample.

        A sample whose stamp is not later than the one before is skipped: the answer is the last one again. A stamp that
        goes back by more than the gap means that the clock began anew (a simulation that restarted), and so does the
        detector.

        Args:
            time: Stamp [s].
            torque: External torque, bias included, shape (n,) [Nm].
            velocities: Joint velocities, shape (n,) [rad/s].
            positions: Joint positions, shape (n,) [rad], finite; None if they are not known.

        Returns:
            The judgement; its arrays never change later.

        Raises:
            ShapeError: Another number of torques or velocities.
            InputError: The stamp, a torque or a velocity is not finite; the detector is as it was before.
        """
        torque, velocities = self._checked(time, torque, velocities)
        if self._last is not None and time < self._last.time - self._config.gap:
            self.reset()
        last = self._last
        if last is not None and time <= last.time:
            return last
        step = 0.0 if last is None else time - last.time
        if step > self._config.gap:
            self._above_since = self._below_since = self._calm_since = None
            self._steady_since = time
            step = self._config.gap
        if not self._ready:
            return self._start_up(time, torque, velocities, positions)
        if time - self._looked >= LOOK_PERIOD:
            self._follow()
            self._untouched.look(time, positions, velocities)
            self._looked = time
        free = torque - self._untouched.torque
        self._sum, self._summed = self._sum + step * free, self._summed + step
        level = self._level(time, free, max(float(velocities.max()), -float(velocities.min())), step)
        (self._judge_free if self._onset is None else self._judge_touched)(time, level)
        return self._answer(time, level, free, self._untouched.torque)

    def _checked(self, time: float, torque: ArrayLike, velocities: ArrayLike) -> tuple[Array, Array]:
        torque = np.array(torque, dtype=np.float64)
        velocities = np.asarray(velocities, dtype=np.float64)
        if torque.shape != (self._n,) or velocities.shape != (self._n,):
            raise ShapeError("shapes of torque and velocities", expected=f"({self._n},)",
                             got=(torque.shape, velocities.shape))
        if not math.isfinite(time + float(torque.sum()) + float(velocities.sum())):
            raise InputError("contact sample is not finite", expected="numbers",
                             got=f"time {time}, torque {torque.tolist()}, velocities {velocities.tolist()}")
        return torque, velocities

    def _start_up(self, time: float, torque: Array, velocities: Array, positions: Array | None) -> ContactSample:
        if self._start is None:
            self._start = time
        self._first_samples.append(torque)
        bias = torque
        if time - self._start >= self._config.startup:
            self._untouched.look(time, positions, velocities)
            self._untouched.learn(np.median(self._first_samples, axis=0), self._config.startup, clipped=False)
            self._untouched.look(time, positions, velocities)
            self._ready, self._first_samples, self._looked = True, [], time
            bias = self._untouched.torque
        return self._answer(time, 0.0, torque - bias, bias)

    def _level(self, time: float, free: Array, speed: float, step: float) -> float:
        config = self._config
        self._speed = max(speed, self._speed / (1.0 + step / config.moving_memory))
        allowance = 1.0 + config.moving_allowance * min(1.0, self._speed / config.moving_speed)
        scale = (config.share * allowance) * self._thresholds + config.doubt_factor * self._untouched.doubt
        self._smooth = self._smooth + (free - self._smooth) * min(1.0, step / max(config.smooth_time, step))
        quick, slow = free / scale, self._smooth / scale
        level, quick_level = math.sqrt(float(slow @ slow)), math.sqrt(float(quick @ quick))
        self._quick_level = quick_level
        self._edges.add(time, quick_level)
        self._rate = (quick_level - self._slow_level) / RISE_TIME
        self._slow_level += (quick_level - self._slow_level) * min(1.0, step / RISE_TIME)
        return level

    def _judge_free(self, time: float, level: float) -> None:
        if level <= 1.0:
            self._above_since, self._hard = None, False
            return
        if self._above_since is None:
            self._above_since = time
        self._hard = self._hard or self._rate > self._config.collision_rate
        if time - self._above_since >= self._config.on_delay and self._quick_level > STILL_THERE:
            onset = self._edges.rise(self._above_since)
            self._onset = onset if self._release is None else max(onset, self._release)
            self._above_since = self._release = None
            self._peak, self._highest = np.zeros(self._n), level
            self._steady_torque, self._steady_since = self._smooth, time

    def _judge_touched(self, time: float, level: float) -> None:
        config = self._config
        assert self._onset is not None
        self._highest = max(self._highest, level)
        if time - self._onset <= config.collision_time:
            self._hard = self._hard or self._rate > config.collision_rate
        elif level > 1.0:
            self._hard = False
        change = np.abs((self._smooth - self._steady_torque) * self._inverse)
        if float(change.max()) > config.steady_band:
            self._steady_torque, self._steady_since = self._smooth, time
        elif time - self._steady_since > config.steady_time:
            self._untouched.shift(self._smooth)
            self._end(time)
            self._looked = -math.inf
            return
        if level >= 1.0:
            self._below_since = self._calm_since = self._fell = None
            return
        self._below_since = time if self._below_since is None else self._below_since
        if self._fell is None and time - self._below_since >= config.off_delay:
            self._fell = max(self._edges.fall(self._onset, self._below_since), self._onset)
        calm_level = max(config.release_level, config.fade * self._highest)
        self._calm_since = None if level >= calm_level else self._calm_since or time
        calm = self._calm_since is not None and time - self._calm_since >= config.off_delay
        if self._fell is not None and (calm or time - self._below_since >= config.faint_time):
            self._end(self._fell)

    def _end(self, release: float) -> None:
        self._onset, self._release, self._hard = None, release, False
        self._below_since = self._calm_since = self._fell = None
        self._sum, self._summed = np.zeros(self._n), 0.0

    def _follow(self) -> None:
        """Learn from the samples since the last look, unless somebody touches."""
        if self._onset is None and self._summed > 0.0:
            self._untouched.learn(self._sum / self._summed, self._summed)
        self._sum, self._summed = np.zeros(self._n), 0.0

    def _answer(self, time: float, level: float, free: Array, bias: Array) -> ContactSample:
        touched, link = self._onset is not None, 0
        if touched:
            self._peak = np.maximum(self._peak, np.abs(self._smooth) * self._inverse)
            felt = np.flatnonzero(self._peak > self._config.link_level * self._config.share)
            link = int(felt[-1]) + 1 if len(felt) else int(self._peak.argmax()) + 1
        kind = ContactKind.NONE if not touched else ContactKind.COLLISION if self._hard else ContactKind.TOUCH
        free.flags.writeable = False
        bias.flags.writeable = False
        self._last = ContactSample(time=time, in_contact=touched, kind=kind, onset=self._onset, release=self._release,
                                   link=link, level=level, torque=free, bias=bias)
        return self._last
