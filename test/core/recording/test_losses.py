from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.recording.losses import LossCounter


@given(order=st.lists(st.integers(0, 3), max_size=100), late=st.lists(st.integers(0, 20), min_size=4, max_size=4))
def test_nothing_is_lost_from_publishers_that_are_heard_completely(order, late):
    counter, sequences, seen = LossCounter(), list(late), set()
    for publisher in order:
        seen.add(publisher)
        sequences[publisher] += 1
        counter.note(sequences[publisher], lambda: len(seen))
    assert counter.lost == 0


@given(heard=st.sets(st.integers(1, 200), min_size=1))
def test_with_one_publisher_every_gap_counts(heard):
    counter = LossCounter()
    found = sum(counter.note(sequence, lambda: 1) for sequence in sorted(heard))
    assert found == counter.lost == max(heard) - min(heard) + 1 - len(heard)


def test_a_restarted_publisher_is_not_a_loss():
    counter = LossCounter()
    for sequence in (1, 2, 3, 1, 2, 3, 4):
        counter.note(sequence, lambda: 1)
    assert counter.lost == 0
