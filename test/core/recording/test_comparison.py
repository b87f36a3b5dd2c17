from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.feedback.items import Correction, Demonstration
from unifeed_ros.core.recording.comparison import Tolerance, compare_items, compare_motions
from unifeed_ros.core.types import Context, Trajectory

NAMES = ("a", "b")
CONTEXT = Context(goal=np.zeros(3))


def motion(offset=0.0, duration=2.0):
    times = np.linspace(0.0, duration, 30)
    positions = np.stack([times / duration, np.full(30, 1.0 + offset)], axis=1)
    return Trajectory(joint_names=NAMES, times=times, positions=positions)


def correction(name="c", span=(1.0, 3.0), offset=0.0):
    return Correction(id=name, robot="r", context=CONTEXT, planned=motion(), corrected=motion(offset), span=span)


def test_the_same_is_the_same_also_when_it_was_sampled_at_other_moments():
    fine = motion()
    coarse = Trajectory(joint_names=NAMES, times=fine.times[::29], positions=fine.positions[::29])
    assert compare_motions("m", fine, coarse, Tolerance()).same
    rows = compare_items([correction("then")], [correction("now")], Tolerance())
    assert [row.same for row in rows] == [True]


@pytest.mark.parametrize(("now", "same"), [
    (correction(offset=0.019), True), (correction(offset=0.021), False),
    (correction(span=(1.04, 3.0)), True), (correction(span=(1.0, 3.06)), False)])
def test_differences_count_from_the_tolerance_on(now, same):
    (row,) = compare_items([correction()], [now], Tolerance(time=0.05, position=0.02))
    assert row.same is same


def test_what_only_one_side_has_is_not_the_same():
    shown = Demonstration(id="d", robot="r", context=CONTEXT, trajectory=motion())
    assert [(r.what, r.same) for r in compare_items([shown, correction()], [shown], Tolerance())] == [
        ("d", True), ("c", False)]
    assert [(r.what, r.same) for r in compare_items([], [replace(shown, id="new")], Tolerance())] == [("new", False)]
