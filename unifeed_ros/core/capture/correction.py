"""From a tracked run that a person pushed to corrections: what the robot meant, and what the person made of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unifeed_ros.core.capture.motion import merged, true_runs
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Trajectory, frozen_array


@dataclass(frozen=True, kw_only=True)
class CorrectionConfig:
    """Settings of what counts as a correction."""

    pre_roll: float = 0.1
    """Time kept before the onset of a contact: the push begins before it passes the threshold [s]."""
    merge_gap: float = 0.1
    """Contacts with less than this between them are one push [s]: a push that has ended for so long can be learned from
    at once."""
    smallest_deviation: float = 0.02
    """A push that moves the tool less far from the plan than this changed nothing [m]."""
    rate: float = 50.0
    """Rate of the points of a correction [Hz]."""

    def __post_init__(self) -> None:
        """Reject settings that cannot give a correction."""
        for name in ("pre_roll", "merge_gap", "smallest_deviation"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(name, expected=">= 0 and finite", got=getattr(self, name))
        if not 0.0 < self.rate < math.inf:
            raise ConfigError("rate", expected="> 0 and finite", got=self.rate)


@dataclass(frozen=True, kw_only=True)
class TrackedRun:
    """What was measured while the arm tracked a motion."""

    times: Array
    """Stamps, shape (N,), strictly increasing [s]."""
    positions: Array
    """Measured joint positions, shape (N, n) [rad]."""
    motion_times: Array
    """Time within the motion that the controller tracked at each stamp, shape (N,) [s]."""
    in_contact: NDArray[np.bool_]
    """Whether a person touched the arm with intent, shape (N,)."""

    def __post_init__(self) -> None:
        """Check shapes, order and finiteness."""
        times = frozen_array("times of the run", self.times, (None,))
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise InputError("times of a run", expected="at least two, strictly increasing", got=f"{len(times)} points")
        touched = np.array(self.in_contact, dtype=bool)
        if touched.shape != times.shape:
            raise ShapeError("shape of in_contact", expected=times.shape, got=touched.shape)
        touched.flags.writeable = False
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "in_contact", touched)
        object.__setattr__(self, "positions", frozen_array("positions of the run", self.positions, (len(times), None)))
        object.__setattr__(self, "motion_times", frozen_array("motion times", self.motion_times, (len(times),)))


    def thinned(self, rate: float) -> TrackedRun:
        """Leave out samples, so that about so many a second stay; the first and the last are kept.

        Args:
            rate: Samples a second [Hz].
        """
        slots = np.floor((self.times - self.times[0]) * rate + 1e-6)
        kept = np.concatenate([[True], np.diff(slots) > 0.0])
        kept[-1] = True
        return TrackedRun(times=self.times[kept], positions=self.positions[kept], motion_times=self.motion_times[kept],
                          in_contact=self.in_contact[kept])


@dataclass(frozen=True, kw_only=True)
class CorrectedSpan:
    """A span of a motion during which a person led."""

    planned: Trajectory
    """What the robot meant to do, times from 0 [s]."""
    corrected: Trajectory
    """What the arm did under the person's hand, at the same times."""
    span: tuple[float, float]
    """Start and end within the robot's motion [s]."""
    deviation_m: float
    """Largest distance of the tool from where the plan had it at that moment [m]."""
    interval: tuple[float, float] = (0.0, 0.0)
    """Stamps of its start and end [s]."""


def extract_corrections(run: TrackedRun, planned: Trajectory, robot: RobotModel,
                        config: CorrectionConfig | None = None) -> list[CorrectedSpan]:
    """Find the spans of a tracked run in which a person changed the motion.

    The same as contact_spans without those in which the tool stayed within the smallest deviation.

    Args:
        run: Measured samples.
        planned: The motion that was tracked; motion time 0 is its first point.
        robot: The arm, for the position of its tool.
        config: Settings.

    Returns:
        The corrections in the order in which they happened; empty if nobody changed anything.

    Raises:
        ShapeError: Another number of joints.
        InputError: The joints are not the robot's.
    """
    config = config or CorrectionConfig()
    return [s for s in contact_spans(run, planned, robot, config) if s.deviation_m >= config.smallest_deviation]


def contact_spans(run: TrackedRun, planned: Trajectory, robot: RobotModel,
                  config: CorrectionConfig | None = None) -> list[CorrectedSpan]:
    """Cut out every span of a tracked run in which a person touched the arm.

    A span goes from the onset of the contact, less the pre-roll, to its end, where control goes back. What the
    controller does then (it leads the arm back to its plan over about a second) is nobody's wish and is left out. Point
    k of both trajectories belongs to the same moment: the plan is read at the motion time that the controller had then,
    so that a controller that waits or slows down under the hand is compared rightly.

    Args:
        run: Measured samples.
        planned: The motion that was tracked; motion time 0 is its first point.
        robot: The arm, for the position of its tool.
        config: Settings.

    Returns:
        One span a push, however little it changed; none for a push during which the motion time stood still.

    Raises:
        ShapeError: Another number of joints.
        InputError: The joints are not the robot's.
    """
    config = config or CorrectionConfig()
    if planned.joint_names != robot.joint_names:
        raise InputError("joints of the tracked motion", expected=robot.joint_names, got=planned.joint_names)
    if run.positions.shape[1] != robot.n:
        raise ShapeError("joints of the run", expected=robot.n, got=run.positions.shape[1])
    pushes = merged(true_runs(run.in_contact), run.times, config.merge_gap)
    earliest = float(run.times[0])
    spans = []
    for first, last in pushes:
        start = max(earliest, float(run.times[first]) - config.pre_roll)
        earliest = end = float(run.times[last])
        span = _span(run, planned, robot, (start, end), config.rate)
        if span is not None:
            spans.append(span)
    return spans


def _span(run: TrackedRun, planned: Trajectory, robot: RobotModel, interval: tuple[float, float],
          rate: float) -> CorrectedSpan | None:
    duration = interval[1] - interval[0]
    stamps = np.linspace(*interval, max(2, round(duration * rate) + 1))
    motion_times = np.interp(stamps, run.times, run.motion_times)
    if duration <= 0.0 or motion_times[-1] <= motion_times[0]:
        return None
    measured = _interpolated(stamps, run.times, run.positions)
    meant = planned.positions_at(planned.times[0] + motion_times)
    apart = robot.tool_states(measured)[:, :3] - robot.tool_states(meant)[:, :3]
    times = stamps - stamps[0]
    return CorrectedSpan(
        planned=Trajectory(joint_names=robot.joint_names, times=times, positions=meant),
        corrected=Trajectory(joint_names=robot.joint_names, times=times, positions=measured),
        span=(float(motion_times[0]), float(motion_times[-1])),
        deviation_m=float(np.linalg.norm(apart, axis=1).max()), interval=(float(stamps[0]), float(stamps[-1])))


def _interpolated(stamps: Array, times: Array, positions: Array) -> Array:
    return np.stack([np.interp(stamps, times, column) for column in positions.T], axis=-1)
