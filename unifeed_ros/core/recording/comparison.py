"""Whether what is found in a recording today is what was found when it was made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.types import Trajectory

SAMPLES = 50
"""Points at which two motions are compared, evenly spaced in time."""


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How far two results may be apart and still count as the same."""

    time: float = 0.05
    """Ends of spans and durations [s]."""
    position: float = 0.02
    """Joint positions, at equal shares of the duration [rad]."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One result of then beside that of now."""

    what: str
    """What is compared, as a name."""
    same: bool
    """True within the tolerance."""
    message: str
    """How they differ, as a sentence for a person."""
    difference: float | None = None
    """Largest difference of joint positions [rad] or weights [1]; None where only one of them is there."""
    time_difference: float | None = None
    """Largest difference of spans or durations [s]; None where there is none to compare."""


def compare_items(then: Sequence[FeedbackItem], now: Sequence[FeedbackItem],
                  tolerance: Tolerance) -> tuple[Comparison, ...]:
    """Compare what was captured, kind by kind, in the order in which it came.

    Args:
        then: Recorded demonstrations and corrections.
        now: Those found today.
        tolerance: What counts as the same.

    Returns:
        One comparison an item; items that only one side has are not the same.
    """
    found: list[Comparison] = []
    for kind in (Demonstration, Correction):
        old, new = ([item for item in items if isinstance(item, kind)] for items in (then, now))
        found += [_compare_item(a, b, tolerance) for a, b in zip(old, new, strict=False)]
        found += [Comparison(what=item.id, same=False, message="was captured then and is not captured now")
                  for item in old[len(new):]]
        found += [Comparison(what=item.id, same=False, message="is captured now and was not captured then")
                  for item in new[len(old):]]
    return tuple(found)


def compare_models(then: RewardEnsemble, now: RewardEnsemble) -> Comparison:
    """Compare two learned rewards; only equal bytes are the same.

    Args:
        then: The recorded model.
        now: The one that was learned today.

    Returns:
        The comparison.
    """
    name, old, new = f"model {then.version}", then.flat_weights(), now.flat_weights()
    if then.layer_sizes != now.layer_sizes or old.shape != new.shape:
        return Comparison(what=name, same=False, message=f"layers {now.layer_sizes} in place of {then.layer_sizes}")
    difference = float(np.abs(old.astype(float) - new).max(initial=0.0))
    same = old.tobytes() == new.tobytes()
    return Comparison(what=name, same=same, difference=difference,
                      message="the same, byte for byte" if same else f"weights differ by up to {difference:.3g}")


def compare_motions(name: str, then: Trajectory, now: Trajectory, tolerance: Tolerance) -> Comparison:
    """Compare two motions at equal shares of their durations.

    Args:
        name: What they are.
        then: The recorded one.
        now: That of today, with the same joints.
        tolerance: What counts as the same.

    Returns:
        The comparison.
    """
    return _compare(name, [(then, now)], abs(then.duration - now.duration), tolerance)


def _compare_item(then: FeedbackItem, now: FeedbackItem, tolerance: Tolerance) -> Comparison:
    if isinstance(then, Demonstration) and isinstance(now, Demonstration):
        return compare_motions(then.id, then.trajectory, now.trajectory, tolerance)
    assert isinstance(then, Correction) and isinstance(now, Correction)
    apart = max(abs(a - b) for a, b in zip(then.span, now.span, strict=True))
    return _compare(then.id, [(then.planned, now.planned), (then.corrected, now.corrected)], apart, tolerance)


def _compare(name: str, motions: Sequence[tuple[Trajectory, Trajectory]], apart: float,
             tolerance: Tolerance) -> Comparison:
    difference = max(float(np.abs(a.resampled(SAMPLES) - b.resampled(SAMPLES)).max()) for a, b in motions)
    same = difference <= tolerance.position and apart <= tolerance.time
    return Comparison(what=name, same=same, difference=difference, time_difference=apart,
                      message=f"{'the same' if same else 'NOT the same'}: times differ by {1e3 * apart:.1f} ms, "
                              f"joints by up to {difference:.2g} rad")
