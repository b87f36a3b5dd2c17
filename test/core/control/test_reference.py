"""The reference: continuous whatever the hand does, monotone in time, back on the plan after the release."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.control.reference import Reference
from unifeed_ros.core.control.sampled_motion import SampledMotion, Setpoint, require_motion
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Trajectory

ROBOT = RobotModel(load_robot(Path(__file__).parents[3] / "config" / "robots" / "ur10.yaml"))
CONFIG = ControlConfig()
START = np.array(ROBOT.config.seed)
REST = Setpoint(START, np.zeros(ROBOT.n), np.zeros(ROBOT.n))
DT = 0.002


def motion(duration=2.0, reach=0.5, count=201, derivatives=True):
    """Make a minimum-jerk motion of all joints."""
    t = np.linspace(0.0, duration, count)
    s = t / duration
    shape = np.stack([10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
                      (60 * s - 180 * s**2 + 120 * s**3) / duration**2])[:, :, None] * np.full(ROBOT.n, reach)
    extra = {"velocities": shape[1], "accelerations": shape[2]} if derivatives else {}
    return Trajectory(joint_names=ROBOT.joint_names, times=t + 5.0, positions=START + shape[0], **extra)


@pytest.mark.parametrize("derivatives", [True, False])
def test_sampling_passes_through_the_points_and_agrees_with_its_derivatives(derivatives):
    trajectory = motion(derivatives=derivatives)
    sampled = SampledMotion(trajectory)
    for k in (0, 37, 100, 200):
        np.testing.assert_allclose(sampled.at(trajectory.times[k] - 5.0).positions, trajectory.positions[k], atol=1e-6)
    for t in np.linspace(0.01, 1.99, 23):
        before, here, after = (sampled.at(t + h) for h in (-DT, 0.0, DT))
        np.testing.assert_allclose((after.positions - before.positions) / (2 * DT), here.velocities, atol=2e-3)
        np.testing.assert_allclose((after.velocities - before.velocities) / (2 * DT), here.accelerations, atol=4e-2)
    assert not sampled.at(0.0).velocities.any()
    np.testing.assert_array_equal(sampled.at(99.0).positions, sampled.at(sampled.duration).positions)


@settings(max_examples=30, deadline=None)
@given(time=st.floats(0.0, 2.0), other=st.floats(0.0, 2.0))
def test_nearest_point_is_never_behind_and_finds_points_of_the_motion(time, other):
    sampled = SampledMotion(motion())
    found = sampled.nearest(sampled.at(other).positions, time)
    assert time <= found <= max(time, 2.0) + 1e-9
    if time <= other < time + 0.5:
        distance = np.abs(sampled.at(found).positions - sampled.at(other).positions).max()
        assert distance < 0.01


def test_untouched_it_is_the_motion_itself():
    sampled = SampledMotion(motion())
    reference = Reference(REST, sampled, ROBOT, CONFIG)
    for k in range(1, 1001):
        setpoint = reference.step(reference.setpoint.positions, 1.0, DT)
        np.testing.assert_allclose(setpoint.positions, sampled.at(k * DT).positions, atol=1e-5)
    assert reference.at_end
    assert not setpoint.velocities.any()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), hold=st.booleans())
def test_continuous_and_monotone_whatever_hand_and_share_do(seed, hold):
    rng = np.random.default_rng(seed)
    reference = Reference(REST, None if hold else SampledMotion(motion()), ROBOT, CONFIG)
    positions, share = START.copy(), 1.0
    last, last_time = reference.setpoint.positions, 0.0
    velocity = np.zeros(ROBOT.n)
    for k in range(1500):
        if k % 100 == 0:
            target, velocity = rng.uniform(), rng.normal(size=ROBOT.n) * 0.5
        share = float(np.clip(share + np.clip(target - share, -0.05, 0.004), 0.0, 1.0))
        positions = share * last + (1 - share) * (positions + velocity * DT)
        setpoint = reference.step(positions, share, DT)
        assert np.abs(setpoint.positions - last).max() < 0.03
        assert reference.time >= last_time
        last, last_time = setpoint.positions, reference.time


def test_after_the_release_the_offset_decays_within_the_limits():
    sampled = SampledMotion(motion(duration=4.0))
    reference = Reference(REST, sampled, ROBOT, CONFIG)
    away = START + 0.2
    for _ in range(500):
        reference.step(away, 0.0, DT)
    np.testing.assert_allclose(reference.setpoint.positions, away, atol=0.02)
    speeds, share = [], 0.0
    for _ in range(750):
        share = min(1.0, share + DT / CONFIG.rise_time)
        before = reference.offset.copy()
        reference.step(reference.setpoint.positions, share, DT)
        speeds.append(np.abs(reference.offset - before) / DT)
    assert np.abs(reference.offset).max() < 0.01
    assert (np.max(speeds, axis=0) <= ROBOT.velocity_limits).all()


def test_a_hold_stays_where_the_person_leaves_it():
    reference = Reference(REST, None, ROBOT, CONFIG)
    for _ in range(500):
        reference.step(START + 0.3, 0.0, DT)
    for _ in range(1000):
        setpoint = reference.step(START + 0.3, 1.0, DT)
    np.testing.assert_allclose(setpoint.positions, START + 0.3, atol=1e-3)


def test_a_hold_in_motion_comes_to_rest_within_the_limits():
    reference = Reference(Setpoint(START, np.full(ROBOT.n, 0.5), REST.accelerations), None, ROBOT, CONFIG)
    speeds = [0.5]
    for _ in range(1000):
        setpoint = reference.step(reference.setpoint.positions, 1.0, DT)
        assert (np.abs(setpoint.velocities - speeds[-1]) <= ROBOT.acceleration_limits * DT).all()
        speeds.append(setpoint.velocities)
    assert np.abs(setpoint.velocities).max() < 1e-4
    assert np.abs(setpoint.positions - START).max() < 0.15


def test_motions_of_other_arms_beyond_limits_or_too_fast_are_refused():
    def check(trajectory, names=ROBOT.joint_names):
        require_motion(trajectory, names, ROBOT.lower, ROBOT.upper, ROBOT.velocity_limits)

    check(motion())
    with pytest.raises(InputError, match="joints"):
        check(motion(), names=("a", "b"))
    with pytest.raises(InputError, match="limits"):
        check(motion(reach=20.0, duration=200.0))
    with pytest.raises(InputError, match="fast"):
        check(motion(duration=0.5))


def led(config, *, seconds=0.6, offset=0.3):
    """Carry a motion out; a person leads it away from 0.5 s on, and lets go. Gives time and set-point every tick."""
    reference, rows = Reference(REST, SampledMotion(motion()), ROBOT, config), []
    for k in range(3000):
        t = k * DT
        leads = 0.5 <= t < 0.5 + seconds
        place = reference.setpoint.positions + (offset - reference.offset if leads else 0.0)
        share = 0.0 if leads else min(1.0, max(0.0, (t - 0.5 - seconds) / 0.5)) if t > 0.5 else 1.0
        rows.append((t, reference.time, reference.step(place, share, DT).positions))
    return reference, rows


@pytest.mark.parametrize("during", ["wait", "follow", "retime"])
@pytest.mark.parametrize("after", ["rejoin", "continue"])
def test_every_choice_is_continuous_and_ends_at_the_goal(during, after):
    reference, rows = led(ControlConfig(during_contact=during, after_contact=after))
    places = np.array([row[2] for row in rows])
    assert np.abs(np.diff(places, axis=0)).max() < 0.3 * 20.0 * DT + 2.0 * ROBOT.velocity_limits.max() * DT
    times = np.array([row[1] for row in rows])
    assert (np.diff(times) >= 0.0).all() and reference.at_end
    np.testing.assert_allclose(places[-1], START + 0.5, atol=5e-3)


def test_a_motion_that_waits_stands_still_and_one_that_re_times_makes_up_for_it():
    ends = {}
    for during in ("wait", "retime"):
        _, rows = led(ControlConfig(during_contact=during))
        times = {round(row[0], 3): row[1] for row in rows}
        assert times[1.1] - times[0.8] < 0.01
        ends[during] = next(row[0] for row in rows if row[1] >= 2.0)
    assert ends["retime"] < ends["wait"] - 0.1


def test_a_motion_that_continues_stays_aside_longer_than_one_that_rejoins():
    aside = {}
    for after in ("rejoin", "continue"):
        reference = Reference(REST, SampledMotion(motion(duration=4.0)), ROBOT, ControlConfig(after_contact=after))
        for k in range(1000):
            leads = 250 <= k < 400
            place = reference.setpoint.positions + (0.3 - reference.offset if leads else 0.0)
            reference.step(place, 0.0 if leads else 1.0, DT)
        aside[after] = np.abs(reference.offset).max()
    assert aside["rejoin"] < 0.05 < 0.15 < aside["continue"]
