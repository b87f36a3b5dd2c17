"""Follow a teaching session sample by sample and hand out what the person showed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from unifeed_ros.core.capture.contact import ContactSample
from unifeed_ros.core.capture.correction import CorrectedSpan, CorrectionConfig, TrackedRun, contact_spans
from unifeed_ros.core.capture.demonstration import DemonstrationConfig, extract_demonstration
from unifeed_ros.core.capture.record import JointRecord
from unifeed_ros.core.capture.touches import Touch, TouchLog, inside_any
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, Trajectory

STOPPING_TIME = 0.2
"""A touch that lasts until so long before a stop, or longer, may be what caused it [s]."""
REMEMBERED_MOTIONS = 32
"""Number of trajectories that are kept until the arm tracks them."""


@dataclass(frozen=True, kw_only=True)
class CaptureConfig:
    """Settings of capturing."""

    demonstration: DemonstrationConfig = field(default_factory=DemonstrationConfig)
    """What is cut out of a guided run."""
    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    """What counts as a correction of a tracked run."""
    pre_roll: float = 0.5
    """Time before guiding begins that still belongs to it [s]."""
    rate: float = 200.0
    """Largest rate of the samples kept [Hz]."""
    longest: float = 600.0
    """Longest guided or tracked run that is kept [s]."""
    restart: float = 0.5
    """Stamps that go back by more than this mean that the clock began anew, and all is forgotten [s]."""

    def __post_init__(self) -> None:
        """Reject settings that would record nothing."""
        for name in ("rate", "longest", "restart"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        if not 0.0 <= self.pre_roll < math.inf:
            raise ConfigError("pre_roll", expected=">= 0 s and finite", got=self.pre_roll)


@dataclass(frozen=True, kw_only=True)
class CapturedDemonstration:
    """The end of a guided run."""

    time: float
    """Stamp of its end [s]."""
    trajectory: Trajectory | None
    """The demonstration; None if there is none."""
    reason: str
    """Why there is none; empty otherwise."""


@dataclass(frozen=True, kw_only=True)
class CapturedCorrections:
    """What a person changed in a tracked run: a push that has ended while the run goes on, or the end of the run."""

    time: float
    """Stamp of the end of the push, or of the run [s]."""
    motion_id: str
    """Name of the motion that was tracked."""
    touched: bool
    """Whether a person touched the arm with intent, even if it changed nothing."""
    corrections: tuple[CorrectedSpan, ...]
    """What the person has changed in this run, in order."""
    reason: str
    """Why there is no correction although the arm was touched, or why the run cannot be judged; empty otherwise."""
    run: TrackedRun | None = None
    """The whole run, touched or not; None if it goes on, or is too short to be one."""
    known: int = 0
    """How many of the corrections, the first ones, were handed out before."""
    goes_on: bool = False
    """True for a push within a run, False for the run's end."""


Captured = CapturedDemonstration | CapturedCorrections
"""What a run ends with, and what a push within it ends with."""


class FeedbackCapture:
    """Collect what happens until a run ends, then say what it taught.

    Every observe method only stores; the work (some milliseconds) is done in the observe_teaching call with which a run
    or a push within it ends. A guided run ends when the mode leaves GUIDE, a tracked run when it leaves TRACK, another
    motion begins, or the same motion begins anew. Contacts that stay collisions to their end teach nothing, and nor
    does a touch during which the arm stopped.

    Args:
        robot: The arm.
        config: Settings.
    """

    def __init__(self, robot: RobotModel, config: CaptureConfig | None = None) -> None:
        self._robot = robot
        self._config = config or CaptureConfig()
        self._trajectories: dict[str, Trajectory] = {}
        self._record = JointRecord(pre_roll=self._config.pre_roll, rate=self._config.rate, longest=self._config.longest)
        self.reset()

    def reset(self) -> None:
        """Forget the run under way and every contact; trajectories stay known."""
        self._record.clear()
        self._mode, self._motion_id = TeachingMode.INACTIVE, ""
        self._began = 0.0
        self._pushes, self._handed_out = 0, -math.inf
        self._progress: list[tuple[float, float]] = []
        self._log = TouchLog()
        self._now = -math.inf

    def observe_state(self, state: RobotState) -> None:
        """Store one sample of the arm; its arrays must not be written to later.

        Raises:
            InputError: A position is not finite; nothing is stored.
        """
        if not math.isfinite(state.time + float(np.sum(state.positions))):
            raise InputError("joint state is not finite", got=(state.time, np.asarray(state.positions).tolist()))
        if state.time < self._now - self._config.restart:
            self.reset()
        self._now = max(self._now, state.time)
        self._record.append(state.time, state.positions)

    def observe_contact(self, sample: ContactSample) -> None:
        """Store what the contact detector said."""
        self._log.add(sample)

    def observe_trajectory(self, motion_id: str, trajectory: Trajectory) -> None:
        """Remember a motion by the name under which it will be tracked."""
        self._trajectories.pop(motion_id, None)
        self._trajectories[motion_id] = trajectory
        while len(self._trajectories) > REMEMBERED_MOTIONS:
            del self._trajectories[next(iter(self._trajectories))]

    def observe_teaching(self, time: float, mode: int, motion_id: str, motion_time: float) -> list[Captured]:
        """Store what the controller does, and finish the run that this ends.

        Args:
            time: Stamp of the joint state that the controller acted on [s].
            mode: A TeachingMode or its number.
            motion_id: Name of the motion that is tracked; empty otherwise.
            motion_time: Time within that motion [s].

        Returns:
            The run or the push that ended, if one did.

        Raises:
            InputError: The mode is unknown, or a time is not finite; nothing is stored.
        """
        if not math.isfinite(time + motion_time):
            raise InputError("teaching state is not finite", got=(time, motion_time))
        mode = _known_mode(mode)
        anew = mode is TeachingMode.TRACK and bool(self._progress) and motion_time < self._progress[-1][1] - 0.1
        captured: list[Captured] = []
        if mode is not self._mode or motion_id != self._motion_id or anew:
            if self._mode is TeachingMode.GUIDE and mode is not TeachingMode.GUIDE:
                captured.append(self._finish_guided(time, mode))
            elif self._mode is TeachingMode.TRACK:
                captured.append(self._finish_tracked(time, mode))
            self._begin(time, mode, motion_id)
        if mode is TeachingMode.TRACK and (not self._progress or time > self._progress[-1][0]):
            self._progress.append((time, motion_time))
            captured += self._hand_out(time)
        return captured

    def _hand_out(self, time: float) -> list[CapturedCorrections]:
        """Give the correction that a push was, as soon as it has ended."""
        pushes = self._meant(time)
        ended = bool(pushes) and pushes[-1].end < time - self._config.correction.merge_gap
        if not ended or self._log.going_on or len(pushes) == self._pushes:
            return []
        self._pushes = len(pushes)
        try:
            corrections, _ = self._corrections(self._tracked_run(*self._record.so_far(), pushes, time))
        except InputError:
            return []  # the end of the run says it
        known = self._known(corrections)
        if known == len(corrections):
            return []
        self._handed_out = corrections[-1].interval[1]
        return [CapturedCorrections(time=self._handed_out, motion_id=self._motion_id, touched=True,
                                    corrections=tuple(corrections), reason="", known=known, goes_on=True)]

    def _begin(self, time: float, mode: TeachingMode, motion_id: str) -> None:
        if mode in (TeachingMode.TRACK, TeachingMode.GUIDE) and not self._record.running:
            self._record.start()
        self._mode, self._motion_id, self._began = mode, motion_id, time
        self._pushes, self._handed_out = 0, -math.inf
        self._progress = []
        self._log.forget_ended()

    def _finish_guided(self, time: float, mode: TeachingMode) -> CapturedDemonstration:
        full = self._record.full
        times, positions = self._record.stop()
        if mode in (TeachingMode.STOPPED, TeachingMode.INACTIVE):
            return CapturedDemonstration(
                time=time, trajectory=None, reason="the arm stopped while it was guided; guide it again")
        if full:
            return CapturedDemonstration(
                time=time, trajectory=None,
                reason=f"guided for longer than {self._config.longest:.0f} s; show the motion in shorter time")
        kept = times <= time
        try:
            trajectory = extract_demonstration(
                times[kept], positions[kept], self._robot.joint_names, self._config.demonstration)
        except InputError as error:
            return CapturedDemonstration(time=time, trajectory=None, reason=str(error))
        return CapturedDemonstration(time=time, trajectory=trajectory, reason="")

    def _finish_tracked(self, time: float, mode: TeachingMode) -> CapturedCorrections:
        times, positions = self._record.stop()
        meant = self._meant(time)
        if mode is TeachingMode.STOPPED:  # what stopped the arm was a collision or a fault, whatever it felt like here
            meant = [t for t in meant if t.end < time - STOPPING_TIME]
        corrections: list[CorrectedSpan] = []
        run, reason = None, ""
        try:
            run = self._tracked_run(times, positions, meant, time)
            if meant:
                corrections, reason = self._corrections(run)
        except InputError as error:
            reason = str(error) if meant else ""
        return CapturedCorrections(time=time, motion_id=self._motion_id, touched=bool(meant),
                                   corrections=tuple(corrections), reason=reason, run=run,
                                   known=self._known(corrections))

    def _known(self, corrections: list[CorrectedSpan]) -> int:
        """Count the corrections that were handed out while the run went on."""
        return sum(span.interval[1] <= self._handed_out for span in corrections)

    def _meant(self, time: float) -> list[Touch]:
        """Give the touches of the present run that were meant."""
        return [t for t in self._log.touches if t.meant and t.end >= self._began and t.onset <= time]

    def _tracked_run(self, times: Array, positions: Array, meant: list[Touch], end: float) -> TrackedRun:
        kept = (times >= self._began) & (times <= end)
        times = times[kept]
        stamps, progress = np.array(self._progress).T
        return TrackedRun(times=times, positions=positions[kept], motion_times=np.interp(times, stamps, progress),
                          in_contact=inside_any(times, meant))

    def _corrections(self, run: TrackedRun) -> tuple[list[CorrectedSpan], str]:
        planned = self._trajectories.get(self._motion_id)
        if planned is None:
            return [], f"the arm was touched during motion {self._motion_id}, whose trajectory is unknown"
        spans = contact_spans(run, planned, self._robot, self._config.correction)
        needed = self._config.correction.smallest_deviation
        corrections = [span for span in spans if span.deviation_m >= needed]
        if corrections:
            return corrections, ""
        largest = max((span.deviation_m for span in spans), default=0.0)
        return [], f"the touch changed the motion by {100 * largest:.1f} cm; a correction needs {100 * needed:.1f} cm"


def _known_mode(mode: int) -> TeachingMode:
    try:
        return TeachingMode(mode)
    except ValueError as error:
        raise InputError("teaching mode", expected=f"0 to {max(TeachingMode):d}", got=mode) from error
