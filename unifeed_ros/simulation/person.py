"""A simulated person with a hidden true reward, who teaches by guiding, pushing and ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.simulation.hand import Hand, HandConfig
from unifeed_ros.simulation.tasks import Yardstick
from unifeed_ros.simulation.wish import Wish, smooth_deviation, wish_along

_SAMPLING = 0.02
"""Step at which a person compares motions [s]."""


@dataclass(frozen=True, kw_only=True)
class PersonConfig:
    """How good a simulated person is."""

    deviation: float = 0.02
    """Standard deviation of the smooth sideways error of one demonstration, in each direction and each of the lowest
    modes along the motion [m]; with three falling modes, peaks are 2 to 6 cm off."""
    correcting_deviation: float = 0.01
    """The same for one correction, which minds a part of the motion only [m]; peaks are 1 to 3 cm off, and the arm's
    resistance to the hand adds as much again."""
    goal_deviation: float = 0.005
    """Standard deviation of where a demonstration ends, in each direction [m]."""
    axis_deviation: float = 0.015
    """Standard deviation of the smooth error in the tool's direction, in each of the lowest modes: a degree, what
    people see of a tilt [rad]."""
    lowest: float = 0.03
    """Height above the table below which the person never brings the tool [m]."""
    pace: float = 1.15
    """How much longer than the optimum a demonstration takes, at the median [1]."""
    pace_spread: float = 0.1
    """Standard deviation of the logarithm of the pace [1]."""
    patience: float = 0.12
    """Lag of the tool behind the guiding hand at which the hand stops to wait [m]."""
    correcting_patience: float = 0.06
    """The same for the correcting hand, which pulls harder [m]."""
    settling: float = 0.3
    """How long the hand rests at the goal before it lets go [s]."""
    ramp: float = 0.25
    """How long the hand takes to take hold, and to let go [s]."""
    corrections: int = 1
    """Most pushes in one run."""
    correction_span: float = 1.5
    """Duration of one push [s], of the robot's motion time."""
    correction_threshold: float = 0.03
    """Mean shortfall of the true reward over a span that is worth a push [reward]."""
    visible: float = 0.03
    """Distance of the tool from where it is wanted that the person notices [m]."""
    always_correct: bool = False
    """True: the worst span gets a push, however good it is; the threshold then decides on further pushes only. A push
    on a motion that is better than the person's own error makes it worse more often than not."""
    rationality: float = 5.0
    """Rationality beta of the Luce choice rule (paper eq. M3) [1/reward]."""
    tie: float = 0.02
    """Returns nearer to each other than this are called equal [reward]."""
    hand: HandConfig = field(default_factory=HandConfig)
    """How the hand holds the tool while guiding."""
    correcting_hand: HandConfig = field(
        default_factory=lambda: HandConfig(stiffness=500.0, damping=50.0, push=1500.0, largest_push=20.0))
    """How the hand holds the tool while correcting: firmer, against an arm that means something else."""

    def __post_init__(self) -> None:
        """Reject values that no person has."""
        for name in ("pace", "ramp", "settling", "correction_span", "patience", "correcting_patience"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the person", expected="> 0", got=getattr(self, name))
        for name in ("deviation", "correcting_deviation", "goal_deviation", "axis_deviation", "pace_spread",
                     "corrections", "rationality", "tie"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} of the person", expected=">= 0", got=getattr(self, name))


class SimulatedPerson:
    """Stands in for a person: sees the arm's joint states and what it is about to do, and answers with a hand.

    Nothing of the true reward leaves it but forces and rankings. The same seed and inputs give the same behaviour.
    Known weakness: it knows its own optimum to a few centimetres, where people find theirs by trying.
    """

    def __init__(self, yardstick: Yardstick, seed: int, config: PersonConfig | None = None) -> None:
        """Make up the person's mind.

        Args:
            yardstick: The arm, the true reward, and the best motion for it.
            seed: Seed of everything that this person draws.
            config: How good the person is.
        """
        self.config = config or PersonConfig()
        self._yardstick = yardstick
        self._rng = np.random.default_rng(seed)
        self._guiding = self._hand = Hand(yardstick.robot, self.config.hand)
        self._correcting = Hand(yardstick.robot, self.config.correcting_hand)
        self._act: _Demonstration | _Correction | None = None

    @property
    def finished(self) -> bool:
        """True if the person has let go and has nothing left to show."""
        return self._act is None or self._act.finished

    def begin_demonstration(self, q: ArrayLike) -> None:
        """Take the tool, to show a whole motion from here to the goal.

        Args:
            q: Joint positions of the arm, shape (n,) [rad].
        """
        config, rng, scene = self.config, self._rng, self._yardstick.task.scene
        pace = config.pace * float(np.exp(rng.normal(scale=config.pace_spread)))
        wish = wish_along(self._yardstick.robot, self._yardstick.optimum, scene.axis, scene.goal)
        here = self._yardstick.robot.tool_states(np.asarray(q, dtype=np.float64)[None])[0]
        wish = wish.slower(pace).deviating(
            smooth_deviation(rng, config.deviation, start=here[:3] - wish.positions[0],
                             end=rng.normal(scale=config.goal_deviation, size=3)),
            smooth_deviation(rng, config.axis_deviation), self._lowest)
        self._hand = self._guiding
        self._hand.take()
        self._act = _Demonstration(wish, config)

    def begin_correction(self, planned: Trajectory) -> bool:
        """Watch a motion that the robot announced, to push where it falls short.

        Args:
            planned: The motion that the robot is about to carry out.

        Returns:
            False if nothing in it is worth a push.
        """
        config, robot = self.config, self._yardstick.robot
        wish = wish_along(robot, self._yardstick.optimum, self._yardstick.task.scene.axis).deviating(
            smooth_deviation(self._rng, config.correcting_deviation),
            smooth_deviation(self._rng, config.axis_deviation), self._lowest)
        spans = worst_spans(self._yardstick, wish, planned, config)
        self._hand = self._correcting
        self._hand.take()
        self._act = _Correction(wish, spans, self._yardstick.task.minds_tilt, config)
        return bool(spans)

    def hand_wrench(self, time: float, q: ArrayLike, v: ArrayLike, motion_time: float = 0.0) -> Array:
        """Compute what the person's hand does to the tool now.

        Args:
            time: Stamp of the joint state [s]; must not go back between calls.
            q: Joint positions, shape (n,) [rad].
            v: Joint velocities, shape (n,) [rad/s].
            motion_time: Time within the motion that the robot carries out [s]; unused while demonstrating.

        Returns:
            Wrench at the tool, axes of the base frame, shape (6,) [N, Nm].
        """
        if self._act is None or self._act.finished:
            return np.zeros(6)
        here = self._yardstick.robot.tool_states(np.asarray(q, dtype=np.float64)[None])[0, :3]
        grip, position, axis, velocity = self._act.step(time, here, motion_time)
        if grip <= 0.0:
            self._hand.take()
            return np.zeros(6)
        return self._hand.wrench(time, q, v, position, axis, velocity, grip)

    def rank(self, options: Sequence[Trajectory]) -> tuple[int, ...]:
        """Rank motions, noisily rational.

        Draws an order by the Luce choice rule, P(i first) ~ exp(beta R_i), then from the rest again (with Gumbel
        noise on beta R); neighbours in that order whose true returns nearly agree tie.

        Args:
            options: Motions to compare, at least two.

        Returns:
            Rank of each option, 0 the best, equal ranks tie.

        Raises:
            InputError: Fewer than two options.
        """
        if len(options) < 2:
            raise InputError("motions to rank", expected="at least two", got=len(options))
        yardstick = self._yardstick
        returns = np.array([yardstick.task.returns(yardstick.robot, o, yardstick.waypoints) for o in options])
        appeal = self.config.rationality * returns + self._rng.gumbel(size=len(options))
        order = np.argsort(-appeal, kind="stable")
        ranks = np.zeros(len(options), dtype=int)
        for place in range(1, len(order)):
            same = abs(returns[order[place]] - returns[order[place - 1]]) < self.config.tie
            ranks[order[place]] = ranks[order[place - 1]] if same else place
        return tuple(int(r) for r in ranks)

    @property
    def _lowest(self) -> float:
        return self._yardstick.task.scene.table_height + self.config.lowest


def worst_spans(yardstick: Yardstick, wish: Wish, planned: Trajectory,
                config: PersonConfig) -> list[tuple[float, float]]:
    """Find where a motion falls furthest short of what the person wants.

    Compares the true reward of both at equal times, averaged over every window of the push's length. Windows in which
    the tool is nowhere visibly off the wish come last: there is nothing to pull.

    Args:
        yardstick: The arm and the true reward.
        wish: What the person wants.
        planned: What the robot is about to do.
        config: Length of a push, how many, and what is worth one.

    Returns:
        Spans of motion time, the earliest first [s]; they do not overlap.
    """
    times = np.arange(0.0, planned.duration, _SAMPLING)
    wanted = wish.states_at(times)
    states = yardstick.robot.tool_states(planned.positions_at(planned.times[0] + times))
    length = min(config.correction_span, planned.duration)
    width = max(round(length / _SAMPLING), 1)
    task = yardstick.task
    short = sliding_window_view(task.rewards(wanted) - task.rewards(states), width).mean(axis=1)
    apart = sliding_window_view(np.linalg.norm(wanted[:, :3] - states[:, :3], axis=1), width).max(axis=1)
    visible = apart >= config.visible
    spans: list[tuple[float, float]] = []
    open_windows = np.ones(len(short), dtype=bool)
    while len(spans) < config.corrections and open_windows.any():
        worth = np.where(visible, short, apart - 1e3)
        worst = int(np.argmax(np.where(open_windows, worth, -np.inf)))
        wrong = visible[worst] and short[worst] >= config.correction_threshold
        if not wrong and (spans or not config.always_correct):
            break
        spans.append((float(times[worst]), float(times[worst]) + length))
        open_windows[max(worst - width, 0):worst + width] = False
    return sorted(spans)


_Aim = tuple[float, Array, Array | None, Array]


class _Demonstration:
    """Lead the tool along a wish: take hold, go on while the arm keeps up, rest at the goal, let go."""

    def __init__(self, wish: Wish, config: PersonConfig) -> None:
        self._wish, self._config = wish, config
        self._begun: float | None = None
        self._last = 0.0
        self._progress = 0.0
        self._rested = 0.0
        self._waited = 0.0
        self._released: float | None = None
        self.finished = False

    def step(self, time: float, here: Array, _motion_time: float) -> _Aim:
        config, wish = self._config, self._wish
        if self._begun is None:
            self._begun = self._last = time
        dt, self._last = max(time - self._last, 0.0), time
        target = wish.states_at([self._progress])[0]
        lag = float(np.linalg.norm(target[:3] - here))
        grip = min((time - self._begun) / config.ramp, 1.0)
        rate = _readiness(lag, config.patience) * grip if self._progress < wish.duration else 0.0
        self._progress = min(self._progress + rate * dt, wish.duration)
        if self._progress >= wish.duration:
            self._waited += dt
            if lag < 0.01 or self._waited > 2.0:
                self._rested += dt
        if self._rested >= config.settling and self._released is None:
            self._released = time
        if self._released is not None:
            grip = max(1.0 - (time - self._released) / config.ramp, 0.0)
            self.finished = grip <= 0.0
        return grip, target[:3], target[3:], rate * wish.velocity_at(self._progress)


class _Correction:
    """Pull the tool towards a wish in some spans of the robot's motion, and lead it along the wish from there."""

    def __init__(self, wish: Wish, spans: list[tuple[float, float]], upright: bool, config: PersonConfig) -> None:
        self._wish, self._upright, self._config = wish, upright, config
        self._spans = list(spans)
        self._last = 0.0
        self._progress = 0.0
        self._taken: float | None = None
        self._released: float | None = None

    @property
    def finished(self) -> bool:
        return not self._spans

    def step(self, time: float, here: Array, motion_time: float) -> _Aim:
        config, wish = self._config, self._wish
        start, end = self._spans[0]
        dt, self._last = max(time - self._last, 0.0), time
        if self._taken is None:
            if motion_time < start:
                return 0.0, here, None, np.zeros(3)
            self._taken, self._progress = time, motion_time
        # A robot that is held lets its motion wait for the hand: who corrects goes on at a pace of their own.
        target = wish.states_at([self._progress])[0]
        rate = _readiness(float(np.linalg.norm(target[:3] - here)), config.correcting_patience) / config.pace
        self._progress += rate * dt
        grip = min((time - self._taken) / config.ramp, 1.0)
        late = time - self._taken > 3.0 * (end - start)
        if self._released is None and (self._progress >= end or late):
            self._released = time
        if self._released is not None:
            grip = min(grip, 1.0 - (time - self._released) / config.ramp)
            if grip <= 0.0:
                self._spans.pop(0)
                self._taken = self._released = None
        axis = target[3:] if self._upright else None
        return max(grip, 0.0), target[:3], axis, rate * wish.velocity_at(self._progress)


def _readiness(lag: float, patience: float) -> float:
    """Say how fast a hand goes on: at full pace up to half the patience, not at all beyond it."""
    return float(np.clip(2.0 - 2.0 * lag / patience, 0.0, 1.0))
