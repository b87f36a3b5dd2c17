"""Who leads: a share in [0, 1] that never rises with the push, falls fast and comes back slowly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.control.arbitration import Arbitration, share_of_level
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import ConfigError

CONFIG = ControlConfig()
THRESHOLDS = (3.0, 3.0, 1.0)
levels = st.floats(0.0, 1e3)


@given(levels, levels)
def test_share_is_in_the_unit_interval_and_never_rises_with_the_level(one, other):
    low, high = sorted((one, other))
    assert 0.0 <= share_of_level(high, CONFIG) <= share_of_level(low, CONFIG) <= 1.0


def test_share_is_whole_below_a_touch_and_gone_above():
    assert share_of_level(CONFIG.yield_start, CONFIG) == 1.0
    assert share_of_level(CONFIG.yield_full, CONFIG) == 0.0


@given(st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=60), st.floats(0.0, 2.0))
def test_share_over_time_stays_in_the_unit_interval_and_rises_no_faster_than_set(pushes, speed):
    arbitration, before = Arbitration(THRESHOLDS, CONFIG), 1.0
    for push in pushes:
        share = arbitration.step(np.array([push, 0.0, 0.0]), speed, 0.002)
        assert 0.0 <= share <= min(1.0, before + 0.002 / CONFIG.rise_time + 1e-12)
        before = share


def push_for(arbitration, torque, seconds, speed=0.0):
    for _ in range(round(seconds / 0.002)):
        arbitration.step(np.array([torque, 0.0, 0.0]), speed, 0.002)
    return arbitration.authority


def test_falls_within_a_fifth_of_a_second_and_returns_in_about_half_a_second():
    arbitration = Arbitration(THRESHOLDS, CONFIG)
    assert push_for(arbitration, 10.0, 0.2) < 0.05
    assert arbitration.person_leads
    assert push_for(arbitration, 0.0, 0.25) < 0.7
    assert push_for(arbitration, 0.0, 0.4) == 1.0
    assert not arbitration.person_leads


def test_a_light_hand_keeps_the_arm_but_does_not_take_it():
    light = 0.75 * THRESHOLDS[0]
    taken, free = Arbitration(THRESHOLDS, CONFIG), Arbitration(THRESHOLDS, CONFIG)
    push_for(taken, 10.0, 0.2)
    push_for(taken, light, 1.0)
    push_for(free, light, 1.0)
    assert taken.person_leads and taken.authority < 0.1
    assert not free.person_leads and free.authority > 0.8


def test_more_push_is_needed_while_the_arm_moves():
    push = 1.0 * THRESHOLDS[0]
    assert push_for(Arbitration(THRESHOLDS, CONFIG), push, 0.5, speed=1.0) > push_for(
        Arbitration(THRESHOLDS, CONFIG), push, 0.5)


@pytest.mark.parametrize("bad", [
    {"yield_start": 2.0}, {"rise_time": 0.0}, {"torque_rate": float("nan")}, {"held_gain": 0.5}])
def test_settings_that_cannot_work_are_refused(bad):
    with pytest.raises(ConfigError):
        ControlConfig(**bad)
