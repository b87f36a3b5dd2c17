import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.capture.edges import EdgeFinder


def filled(levels, rate=1000.0, start=0.0):
    """Fill a finder with a level over time; gives it with the stamps."""
    finder = EdgeFinder()
    times = start + np.arange(len(levels)) / rate
    for time, level in zip(times.tolist(), levels, strict=True):
        finder.add(time, float(level))
    return finder, times


@given(height=st.floats(1.5, 40.0), calm=st.floats(0.0, 0.6), late=st.floats(0.005, 0.1), seed=st.integers(0, 1000),
       start=st.floats(-1e3, 1e6))
def test_edges_of_a_push_are_found_whatever_its_height_and_the_calm_around_it(height, calm, late, seed, start):
    rng = np.random.default_rng(seed)
    level = np.full(800, calm)
    level[300:600] += height
    level = np.abs(level + 0.05 * rng.normal(size=800))
    finder, times = filled(level[:300 + round(1000 * late) + 1], start=start)
    assert finder.rise(times[-1]) == pytest.approx(start + 0.3, abs=0.003)
    finder, times = filled(level[:600 + round(1000 * late) + 101], start=start)
    assert finder.fall(start + 0.3, times[-101]) == pytest.approx(start + 0.6, abs=0.003)


def test_a_ramp_is_cut_at_a_quarter():
    ramp = np.concatenate([np.zeros(200), np.linspace(0.0, 4.0, 101), np.full(50, 4.0)])
    finder, _ = filled(ramp)
    assert finder.rise(0.26) == pytest.approx(0.225, abs=0.002)
    finder, _ = filled(np.concatenate([ramp[::-1], np.zeros(50)]))
    assert finder.fall(0.0, 0.2) == pytest.approx(0.125, abs=0.003)


def test_what_was_before_a_gap_is_forgotten():
    finder, _ = filled([5.0] * 100)
    finder.add(10.0, 0.0)
    finder.add(10.1, 3.0)
    assert finder.rise(10.1) == pytest.approx(10.1)


def test_a_push_older_than_the_buffer_begins_where_the_buffer_does():
    finder, times = filled([3.0] * 2000)
    assert finder.rise(times[-1]) == pytest.approx(times[-1] - 0.5, abs=0.002)
