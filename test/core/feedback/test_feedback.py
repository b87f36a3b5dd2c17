"""Items and the dataset: what they refuse, and that nothing is ever lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.types import Context, Trajectory

CONTEXT = Context(goal=[0.6, -0.4, 0.1])
JOINTS = ("a", "b")


def motion(duration: float = 1.0, joints: tuple[str, ...] = JOINTS) -> Trajectory:
    return Trajectory(joint_names=joints, times=[0.0, duration], positions=np.zeros((2, len(joints))))


def demonstration(name: str = "d", robot: str = "arm", joints: tuple[str, ...] = JOINTS) -> Demonstration:
    return Demonstration(id=name, robot=robot, context=CONTEXT, trajectory=motion(joints=joints))


def correction(name: str = "c", **changes: object) -> Correction:
    fields = {"planned": motion(), "corrected": motion(), "span": (0.5, 1.5)} | changes
    return Correction(id=name, robot="arm", context=CONTEXT, **fields)


def preference(ranks: tuple[int, ...], options: int = 2, name: str = "p") -> Preference:
    return Preference(id=name, robot="arm", context=CONTEXT, options=(motion(),) * options, ranks=ranks)


def test_items_say_what_they_are():
    items = (demonstration(), correction(), preference((0, 1)))
    assert [item.kind for item in items] == ["demonstration", "correction", "preference"]
    assert "".join(item.letter for item in items) == "DCP"
    assert {item.joint_names for item in items} == {JOINTS}


@given(ranks=st.lists(st.integers(0, 3), min_size=2, max_size=6))
def test_ranked_pairs_are_an_order(ranks):
    pairs = set(preference(tuple(ranks), options=len(ranks)).ranked_pairs)
    assert all((j, i) not in pairs for i, j in pairs)
    assert all((i, k) in pairs for i, j in pairs for j2, k in pairs if j == j2)
    assert len(pairs) == sum(a < b for a in ranks for b in ranks)


def test_ties_and_neither_rank_nothing():
    assert preference((0, 0)).ranked_pairs == ()
    assert preference(()).ranked_pairs == ()


@pytest.mark.parametrize(("build", "complaint"), [
    (lambda: demonstration(""), "a name"),
    (lambda: correction(corrected=motion(2.0)), "durations"),
    (lambda: correction(corrected=motion(joints=("x", "y"))), "joints"),
    (lambda: correction(span=(1.0, 1.0)), "start before end"),
    (lambda: correction(span=(0.0, np.nan)), "start before end"),
    (lambda: preference((0,), options=1), "at least two"),
    (lambda: preference((0, 1, 2)), "ranks"),
    (lambda: preference((0, -1)), "ranks"),
])
def test_items_refuse_nonsense(build, complaint):
    with pytest.raises(InputError, match=complaint):
        build()


def test_the_dataset_counts_and_keeps_order():
    dataset = FeedbackDataset("arm", JOINTS)
    items = [demonstration("1"), preference((0, 1), name="2"), correction("3"), demonstration("4")]
    for item in items:
        dataset.add(item)
    assert list(dataset.items) == items
    assert dataset.counts == (2, 1, 1)


def test_undo_takes_the_last_or_the_named_and_adding_gives_it_back():
    dataset = FeedbackDataset("arm", JOINTS)
    for name in "abc":
        dataset.add(demonstration(name))
    assert dataset.undo("a").id == "a"
    assert dataset.undo().id == "c"
    assert [item.id for item in dataset.items] == ["b"]
    with pytest.raises(InputError, match="expected b, got zebra"):
        dataset.undo("zebra")
    dataset.add(demonstration("a"))
    assert [item.id for item in dataset.items] == ["a", "b"]
    with pytest.raises(InputError, match="already there"):
        dataset.add(demonstration("a"))
    dataset.undo()
    dataset.undo()
    with pytest.raises(InputError, match="nothing to undo"):
        dataset.undo()


@pytest.mark.parametrize(("item", "complaint"), [
    (demonstration(robot="other"), "robot"), (demonstration(joints=("b", "a")), "joints")])
def test_the_dataset_refuses_what_is_not_its_own(item, complaint):
    with pytest.raises(InputError, match=complaint):
        FeedbackDataset("arm", JOINTS).add(item)
