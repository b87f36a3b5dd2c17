import itertools
import time as clock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.contact_config import ContactConfig, ContactKind
from unifeed_ros.core.capture.touches import inside_any, judge_recording
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError

THRESHOLDS = np.array([2.0, 2.0, 2.0, 2.0, 1.5, 1.5, 1.0])
N = len(THRESHOLDS)


def pushes(spans, heights, *, duration=6.0, rate=250.0, rise=0.05, seed=0, noise=0.1):
    """Make torque of pushes (heights in thresholds) with noise: times, torque, velocities, truth."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, duration, 1.0 / rate)
    torque = noise * THRESHOLDS * rng.standard_normal((len(times), N))
    truth = np.zeros(len(times), dtype=bool)
    direction = rng.uniform(-1.0, 1.0, (len(spans), N))
    for (start, end), height, way in zip(spans, heights, direction, strict=True):
        shape = np.clip(np.minimum((times - start) / rise, (end - times) / rise), 0.0, 1.0)
        torque += height * THRESHOLDS * (way / np.abs(way).max()) * shape[:, None]
        truth |= (times >= start) & (times <= end)
    return times, torque, np.zeros_like(torque), truth


def detect(times, torque, velocities, **settings):
    return judge_recording(ContactDetector(THRESHOLDS, ContactConfig(**settings)), times, torque, velocities)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 4))
@settings(max_examples=8, deadline=None)
def test_pushes_with_known_times_are_found(seed, count):
    rng = np.random.default_rng(seed)
    starts = 0.6 + np.arange(count) * 1.35 + rng.uniform(0.0, 0.2, count)
    spans = [(s, s + d) for s, d in zip(starts, rng.uniform(0.4, 0.8, count), strict=True)]
    times, torque, velocities, truth = pushes(spans, rng.uniform(2.5, 8.0, count), seed=seed)
    _, touches = detect(times, torque, velocities)
    assert len(touches) == count and all(touch.meant for touch in touches)
    np.testing.assert_allclose([t.onset for t in touches], [s for s, _ in spans], atol=0.025)
    np.testing.assert_allclose([t.end for t in touches], [e for _, e in spans], atol=0.025)
    found = inside_any(times, touches)
    f1 = 2 * (found & truth).sum() / (found.sum() + truth.sum())
    assert f1 > 0.93


@given(shift=st.floats(-1e5, 1e6), bias=st.lists(st.floats(-20.0, 20.0), min_size=N, max_size=N))
@settings(max_examples=8, deadline=None)
def test_time_shift_and_constant_bias_change_nothing(shift, bias):
    times, torque, velocities, _ = pushes([(2.0, 2.6), (4.0, 4.5)], [3.0, 5.0], rate=100.0)
    _, touches = detect(times, torque, velocities)
    shifted, moved = detect(times + shift, torque + bias, velocities)
    assert len(moved) == len(touches) == 2
    np.testing.assert_allclose([t.onset - shift for t in moved], [t.onset for t in touches], atol=0.021)
    np.testing.assert_allclose([t.end - shift for t in moved], [t.end for t in touches], atol=0.021)
    np.testing.assert_allclose(shifted[-1].bias - bias, detect(times, torque, velocities)[0][-1].bias, atol=0.05)


@given(height=st.floats(0.0, 0.12), seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_push_below_the_threshold_is_nothing(height, seed):
    samples, touches = detect(*pushes([(2.0, 4.0)], [height], seed=seed, noise=0.05)[:3])  # 0.4 in one joint begins one
    assert touches == ()
    assert max(s.level for s in samples) < 1.0


def test_moving_arm_needs_more_torque_than_a_still_one():
    times, torque, velocities, _ = pushes([], [], noise=0.05)
    torque[500:750, 1] += 0.6 * THRESHOLDS[1]
    assert len(detect(times, torque, velocities)[1]) == 1
    assert detect(times, torque, velocities + 0.4)[1] == ()
    assert len(detect(times, torque, velocities + 0.4, moving_allowance=0.0)[1]) == 1


def test_spike_shorter_than_the_delay_is_nothing():
    times, torque, velocities, _ = pushes([], [], noise=0.05)
    torque[1000:1004] += 10.0  # 16 ms
    assert detect(times, torque, velocities)[1] == ()


def test_dips_within_a_push_do_not_split_it():
    times, torque, velocities, _ = pushes([(2.0, 4.0)], [3.0])
    torque[650:665] *= 0.05  # 60 ms
    assert len(detect(times, torque, velocities)[1]) == 1


def test_short_and_hard_is_a_collision_and_a_held_one_becomes_a_touch():
    hit = detect(*pushes([(2.0, 2.1)], [12.0], duration=4.0, rate=1000.0, rise=0.004)[:3])
    assert [t.meant for t in hit[1]] == [False]
    assert {s.kind for s in hit[0]} == {ContactKind.NONE, ContactKind.COLLISION}
    held = detect(*pushes([(2.0, 3.5)], [12.0], duration=4.0, rate=1000.0, rise=0.004)[:3])
    assert [t.meant for t in held[1]] == [True]
    soft = detect(*pushes([(2.0, 2.5)], [6.0], duration=4.0, rate=1000.0, rise=0.15)[:3])
    assert {s.kind for s in soft[0]} == {ContactKind.NONE, ContactKind.TOUCH}


def test_a_knock_that_is_not_hard_is_nothing_that_is_meant():
    _, touches = detect(*pushes([(2.0, 2.08)], [3.0], duration=4.0, rate=1000.0, rise=0.03)[:3])
    assert [t.meant for t in touches] == [False]
    _, touches = detect(*pushes([(2.0, 2.15)], [3.0], duration=4.0, rate=1000.0, rise=0.03)[:3])
    assert [t.meant for t in touches] == [True]


def test_outermost_joint_that_feels_a_push_gives_the_link():
    for joint in range(N):
        times, torque, velocities, _ = pushes([], [], noise=0.02)
        torque[500:750, :joint + 1] += 1.2 * THRESHOLDS[:joint + 1]
        samples, touches = detect(times, torque, velocities)
        assert [t.link for t in touches] == [joint + 1]
        assert {s.link for s in samples} == {0, joint + 1}


def test_residue_of_a_strong_push_does_not_keep_it_alive():
    times, torque, velocities, _ = pushes([(2.0, 2.5), (3.5, 4.0)], [10.0, 10.0], duration=6.0, noise=0.02)
    torque[times > 2.5, 4] += 0.35 * THRESHOLDS[4]  # dry friction holds what is left
    _, touches = detect(times, torque, velocities)
    assert len(touches) == 2
    np.testing.assert_allclose([t.end for t in touches], [2.5, 4.0], atol=0.04)


def test_bias_that_shifts_does_not_stay_a_contact():
    times, torque, velocities, _ = pushes([(16.0, 17.0)], [4.0], duration=20.0, rate=100.0)
    torque[times > 2.0, 3] -= 3.0
    samples, touches = detect(times, torque, velocities)
    assert len(touches) == 2
    assert touches[0].end == pytest.approx(2.0 + ContactConfig().steady_time, abs=0.5)
    assert touches[1].onset == pytest.approx(16.0, abs=0.06)
    assert samples[-1].bias[3] == pytest.approx(-3.0, abs=0.3)


def test_slow_drift_is_followed_as_bias():
    times, torque, velocities, _ = pushes([], [], duration=60.0, rate=50.0)
    torque += 0.05 * ContactConfig().share * times[:, None] * THRESHOLDS  # 3 times what begins a contact, in a minute
    assert detect(times, torque, velocities)[1] == ()


def test_nothing_is_said_before_the_bias_is_known():
    times, torque, _, _ = pushes([], [], rate=1000.0)
    detector = ContactDetector(THRESHOLDS)
    for time, row in itertools.islice(zip(times, torque, strict=True), 290):
        assert not detector.update(time, row + 50.0, np.zeros(N)).in_contact
    assert not detector.ready


def test_outliers_at_the_start_do_not_enter_the_bias():
    times, torque, velocities, _ = pushes([], [])
    torque[10:35] += 30.0  # a third of the start
    samples, touches = detect(times, torque, velocities)
    assert touches == ()
    assert np.abs(samples[-1].bias).max() < 0.2


def test_delays_are_not_counted_across_a_gap():
    times, torque, _, _ = pushes([], [])
    detector = ContactDetector(THRESHOLDS)
    for time, row in zip(times, torque, strict=True):
        detector.update(time, row, np.zeros(N))
    push = torque[0] + 5.0 * THRESHOLDS
    assert not detector.update(times[-1] + 0.004, push, np.zeros(N)).in_contact
    assert not detector.update(times[-1] + 2.0, push, np.zeros(N)).in_contact
    assert detector.update(times[-1] + 2.03, push, np.zeros(N)).onset == times[-1] + 2.0


def test_stamps_out_of_order_are_skipped():
    times, torque, _, _ = pushes([(2.0, 2.6)], [4.0])
    detector = ContactDetector(THRESHOLDS)
    for time, row in zip(times, torque, strict=True):
        sample = detector.update(time, row, np.zeros(N))
        assert detector.update(time, row + 99.0, np.zeros(N)) is sample
        assert detector.update(time - 0.1, row + 99.0, np.zeros(N)) is sample
    assert detector.update(0.0, torque[0], np.zeros(N)).time == 0.0
    assert not detector.ready


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused_and_harm_nothing(bad):
    times, torque, _, _ = pushes([(2.0, 2.6)], [4.0])
    detector, twin = ContactDetector(THRESHOLDS), ContactDetector(THRESHOLDS)
    row = np.where(np.arange(N) == 4, bad, 0.0)
    for k in range(600):
        with pytest.raises(InputError, match="not finite"):
            detector.update(times[k], row, np.zeros(N))
        with pytest.raises(InputError, match="not finite"):
            detector.update(times[k], torque[k], row)
        with pytest.raises(InputError, match="not finite"):
            detector.update(bad, torque[k], np.zeros(N))
        first, second = detector.update(times[k], torque[k], np.zeros(N)), twin.update(times[k], torque[k], np.zeros(N))
        assert (first.level, first.in_contact) == (second.level, second.in_contact)


def test_samples_do_not_change_later():
    times, torque, _, _ = pushes([(2.0, 2.6)], [4.0])
    detector = ContactDetector(THRESHOLDS)
    samples = [detector.update(t, row, np.zeros(N)) for t, row in zip(times[:500], torque, strict=False)]
    kept = [s.bias.copy() for s in samples]
    detector.update(times[550], torque[550], np.zeros(N))
    np.testing.assert_array_equal([s.bias for s in samples], kept)
    with pytest.raises(ValueError, match="read-only"):
        samples[-1].bias[0] = 1.0


def test_wrong_numbers_of_joints_and_settings_are_refused():
    with pytest.raises(ConfigError, match="thresholds"):
        ContactDetector([1.0, 0.0])
    with pytest.raises(ShapeError):
        ContactDetector(THRESHOLDS).update(0.0, np.zeros(6), np.zeros(7))
    with pytest.raises(ShapeError):
        ContactDetector(THRESHOLDS).update(0.0, np.zeros(7), np.zeros(6))
    for wrong in ({"release_level": 1.5}, {"startup": 0.0}, {"off_delay": -1.0}, {"gap": float("nan")}):
        with pytest.raises(ConfigError):
            ContactConfig(**wrong)


def test_inside_any_covers_the_ends():
    _, touches = detect(*pushes([(2.0, 2.6)], [4.0])[:3])
    ends = [touches[0].onset, touches[0].end]
    assert inside_any(ends, touches).all()
    assert not inside_any([ends[0] - 1e-3, ends[1] + 1e-3], touches).any()


@pytest.mark.benchmark
def test_one_update_fits_many_times_into_a_millisecond():
    times, torque, velocities, _ = pushes([(2.0, 2.6)], [4.0], rate=1000.0)
    detector, spent = ContactDetector(THRESHOLDS), []
    for row in zip(times.tolist(), torque, velocities, strict=True):
        begin = clock.perf_counter()
        detector.update(*row)
        spent.append(clock.perf_counter() - begin)
    assert np.median(spent) < 60e-6  # 10 microseconds on a quiet core
