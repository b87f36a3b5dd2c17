"""From the recording of a guided arm to a demonstration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.capture.motion import MotionConfig, fastest_joint_speed, moving_segments, ordered_samples
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.types import Array, Trajectory


@dataclass(frozen=True, kw_only=True)
class DemonstrationConfig:
    """Settings of what is cut out of a guided run."""

    motion: MotionConfig = field(default_factory=MotionConfig)
    """What counts as motion."""
    rate: float = 50.0
    """Rate of the demonstration's points [Hz]."""
    longest_pause: float = 0.5
    """Pauses inside are shortened to this; inf keeps them as they were [s]."""
    spacing: str = "time"
    """How points are spaced, and so the way-points that are learned from: "time" keeps the person's speeds, "arc" goes
    through the path of the joints at one speed."""
    shortest: float = 0.5
    """A demonstration shorter than this is refused [s]."""

    def __post_init__(self) -> None:
        """Reject settings that cannot give a trajectory."""
        for name in ("rate", "shortest"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        if self.spacing not in ("time", "arc"):
            raise ConfigError("spacing", expected="time or arc", got=self.spacing)
        if not self.longest_pause >= self.motion.shortest_pause:
            raise ConfigError("longest_pause", expected=f"at least shortest_pause {self.motion.shortest_pause} s",
                              got=self.longest_pause)


def extract_demonstration(times: ArrayLike, positions: ArrayLike, joint_names: Sequence[str],
                          config: DemonstrationConfig | None = None) -> Trajectory:
    """Cut the motion out of a guided run: from where the arm first moves to where it last moves.

    Speeds come from the positions themselves, so that recordings without velocities serve as well. A long pause is not
    cut but run through faster, so that the path keeps its shape where the arm creeps; it stays slow enough to be rest.

    Args:
        times: Stamps, shape (N,) [s]; samples out of order are left out.
        positions: Joint positions, shape (N, n) [rad].
        joint_names: Names of the n joints.
        config: Settings.

    Returns:
        The demonstration, evenly spaced points near the rate of the settings, times from 0; the postures at the first
        and the last motion are kept exactly.

    Raises:
        ShapeError: Shapes do not fit.
        InputError: A value is not finite, the arm did not move, or moved for too short a time.
    """
    config = config or DemonstrationConfig()
    times, positions = ordered_samples(times, positions)
    segments = moving_segments(times, positions, config.motion)
    if not segments:
        raise _did_not_move(times, positions, config.motion)
    retimed = _shorten_pauses(times, positions, segments, config)
    first, last = segments[0][0], segments[-1][1]
    duration = float(retimed[last] - retimed[first])
    if duration < config.shortest:
        raise InputError("the guided motion is too short", expected=f"at least {config.shortest} s",
                         got=f"{duration:.2f} s", mend="guide the arm through the whole motion")
    names, inside = tuple(joint_names), slice(first, last + 1)
    moved = Trajectory(joint_names=names, times=retimed[inside] - retimed[first], positions=positions[inside])
    if config.spacing == "arc":
        moved = at_one_speed(moved)
    count = max(2, round(duration * config.rate) + 1)
    return Trajectory(joint_names=names, times=np.linspace(0.0, duration, count), positions=moved.resampled(count))


def at_one_speed(trajectory: Trajectory) -> Trajectory:
    """Go through the same path in the same time, at one speed: evenly spaced times are evenly spaced on the path.

    The length of the path is that of all joints together, s = sum |q_k+1 - q_k| [rad]. Points where the arm rests are
    left out.

    Args:
        trajectory: A motion in which a joint moves.

    Returns:
        The motion at one speed.
    """
    steps = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    kept = np.concatenate([[True], steps > 1e-12])
    length = np.concatenate([[0.0], np.cumsum(steps)])[kept]
    return Trajectory(joint_names=trajectory.joint_names, times=trajectory.duration * length / length[-1],
                      positions=trajectory.positions[kept])


def _did_not_move(times: Array, positions: Array, config: MotionConfig) -> InputError:
    speed = float(fastest_joint_speed(times, positions, config.window).max())
    moved = float(np.ptp(positions, axis=0).max())
    return InputError(
        "the arm did not move",
        expected=f"a joint above {config.start_speed} rad/s, through {config.smallest_motion} rad",
        got=f"{speed:.3f} rad/s, {moved:.3f} rad in {times[-1] - times[0]:.1f} s",
        mend="take the arm at its tool and guide it through the motion")


def _shorten_pauses(times: Array, positions: Array, segments: list[tuple[int, int]],
                    config: DemonstrationConfig) -> Array:
    steps = np.diff(times)
    for (_, pause_start), (pause_end, _) in pairwise(segments):
        length = float(times[pause_end] - times[pause_start])
        creep = float(np.ptp(positions[pause_start:pause_end + 1], axis=0).max())
        wanted = max(config.longest_pause, creep / config.motion.stop_speed)
        if wanted < length:
            steps[pause_start:pause_end] *= wanted / length
    return np.concatenate([[0.0], np.cumsum(steps)])
