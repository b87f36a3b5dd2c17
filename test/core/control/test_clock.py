"""Stamps beside the steady clock: set clocks are told from busy machines and slow simulations."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.control.clock import ClockWatch

times = st.lists(st.floats(0.0, 0.3), min_size=1, max_size=30)


@given(times, st.floats(0.05, 1.0), st.floats(-1e6, 1e6))
def test_a_clock_that_runs_no_faster_is_no_fault_however_unevenly_messages_come(steps, speed, offset):
    watch, now = ClockWatch(0.5), 100.0
    for step in steps:
        now += step
        assert watch.fault_of(1e6 + offset + speed * now, now) is None


def test_a_clock_set_forward_or_back_is_a_fault_once():
    watch = ClockWatch(0.5)
    assert watch.fault_of(10.0, 1.0) is None
    assert "leapt ahead by 3599.99" in watch.fault_of(3610.0, 1.01)
    assert watch.fault_of(3610.01, 1.02) is None
    assert "went back by 0.010 s" in watch.fault_of(3610.0, 1.03)
    assert watch.fault_of(3610.01, 1.04) is None
