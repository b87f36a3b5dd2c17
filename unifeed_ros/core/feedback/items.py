"""The three kinds of feedback, checked when made (paper sec. "Unifying")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.types import Context, Trajectory


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """A whole motion that the person guided by hand (xi_d of paper eq. M4)."""

    id: str
    """Unique name within the session."""
    robot: str
    """Robot that was taught."""
    context: Context
    """Goal and objects at that time."""
    trajectory: Trajectory
    """The guided motion [rad]."""

    kind: ClassVar[str] = "demonstration"
    letter: ClassVar[str] = "D"

    def __post_init__(self) -> None:
        """Reject an item without a name."""
        _require_name(self.id, self.kind)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that the motion moves."""
        return self.trajectory.joint_names


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A span of the robot's motion, and what the person made of it (xi_r and xi_c of paper eq. M5)."""

    id: str
    """Unique name within the session."""
    robot: str
    """Robot that was taught."""
    context: Context
    """Goal and objects at that time."""
    planned: Trajectory
    """What the robot meant to do in the span [rad]."""
    corrected: Trajectory
    """What the person made of it, at the same times [rad]."""
    span: tuple[float, float]
    """Start and end of the span within the robot's motion [s]."""

    kind: ClassVar[str] = "correction"
    letter: ClassVar[str] = "C"

    def __post_init__(self) -> None:
        """Check that both motions cover the same joints and the same times.

        Raises:
            InputError: They do not, or the span is empty.
        """
        _require_name(self.id, self.kind)
        _require_same_joints(self.id, (self.planned, self.corrected))
        if abs(self.planned.duration - self.corrected.duration) > 1e-6:
            raise InputError(f"durations of correction {self.id}", expected="planned and corrected alike",
                             got=f"{self.planned.duration:.3f} s and {self.corrected.duration:.3f} s")
        start, end = (float(t) for t in self.span)
        if not (np.isfinite([start, end]).all() and start < end):
            raise InputError(f"span of correction {self.id}", expected="start before end", got=self.span)
        object.__setattr__(self, "span", (start, end))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that the motions move."""
        return self.corrected.joint_names


@dataclass(frozen=True, kw_only=True)
class Preference:
    """A ranking of motions (Q of paper eq. M6)."""

    id: str
    """Unique name within the session."""
    robot: str
    """Robot that was taught."""
    context: Context
    """Goal and objects at that time."""
    options: tuple[Trajectory, ...]
    """The motions that were compared, at least two [rad]."""
    ranks: tuple[int, ...]
    """Rank of each option, 0 the best, equal ranks tie; empty: "neither", which nothing is learned from."""
    query_id: str = ""
    """Name of the query that was answered."""

    kind: ClassVar[str] = "preference"
    letter: ClassVar[str] = "P"

    def __post_init__(self) -> None:
        """Check that there is one rank an option, or none at all.

        Raises:
            InputError: Fewer than two options, options of different joints, or ranks that do not fit them.
        """
        _require_name(self.id, self.kind)
        object.__setattr__(self, "options", tuple(self.options))
        object.__setattr__(self, "ranks", tuple(int(r) for r in self.ranks))
        if len(self.options) < 2:
            raise InputError(f"options of preference {self.id}", expected="at least two", got=len(self.options))
        _require_same_joints(self.id, self.options)
        if self.ranks and (len(self.ranks) != len(self.options) or min(self.ranks) < 0):
            raise InputError(f"ranks of preference {self.id}", got=self.ranks,
                             expected=f"{len(self.options)} ranks from 0, or none for neither")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that the options move."""
        return self.options[0].joint_names

    @property
    def ranked_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs (better, worse) of option indices; ties give none."""
        order = range(len(self.ranks))
        return tuple((i, j) for i in order for j in order if self.ranks[i] < self.ranks[j])


FeedbackItem: TypeAlias = Demonstration | Correction | Preference
"""Any one thing that the person taught."""


def _require_name(name: str, kind: str) -> None:
    if not name:
        raise InputError(f"id of a {kind}", expected="a name", got="an empty one")


def _require_same_joints(item: str, trajectories: Sequence[Trajectory]) -> None:
    names = {t.joint_names for t in trajectories}
    if len(names) > 1:
        raise InputError(f"joints of the motions of {item}", expected="the same for all", got=sorted(names))
