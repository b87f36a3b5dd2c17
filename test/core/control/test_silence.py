from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.control.silence import Silence

GAPS = st.lists(st.floats(0.0, 2.0), min_size=1, max_size=50)


def looked(gaps, period=0.02):
    silence = Silence(period)
    return silence, [silence.look(now) for now in np.cumsum([0.0, *gaps])]


@given(GAPS)
def test_silence_only_grows_and_never_beyond_the_clock(gaps):
    _, seconds = looked(gaps)
    assert seconds[0] == 0.0
    assert all(0.0 <= step <= gap + 1e-9 for step, gap in zip(np.diff(seconds), gaps, strict=True))


def test_regular_looks_count_in_full():
    _, seconds = looked([0.02] * 10)
    assert seconds[-1] == pytest.approx(0.2)


def test_what_was_paused_has_time_to_take_what_waited_before_it_is_alarmed():
    """A late look and a punctual one may come at once; then the sender may itself have waited for this process."""
    _, seconds = looked([0.02, 0.3, 0.0001, 0.02, 0.02])
    assert seconds[-1] < 0.1 - 1e-3


def test_news_ends_it():
    silence, _ = looked([0.02] * 10)
    silence.end()
    assert silence.look(0.22) == pytest.approx(0.02)


def test_a_sender_that_is_dead_is_noticed_also_by_a_process_that_is_often_paused():
    _, seconds = looked([0.3] * 6)
    assert seconds[-1] > 0.1
