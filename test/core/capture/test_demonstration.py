import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.capture.demonstration import DemonstrationConfig, extract_demonstration
from unifeed_ros.core.capture.motion import MotionConfig, fastest_joint_speed, moving_segments, ordered_samples
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError

NAMES = ("a", "b", "c")


def moves(legs, *, rate=200.0, seed=0, noise=0.0):
    """Chain rests and smooth moves: legs of (duration, displacement (3,) or None)."""
    rng = np.random.default_rng(seed)
    q, rows = np.zeros(3), []
    for duration, displacement in legs:
        s = np.linspace(0.0, 1.0, max(2, round(duration * rate)), endpoint=False)
        step = np.zeros(3) if displacement is None else np.asarray(displacement)
        rows.append(q + np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, step))
        q = q + step
    positions = np.vstack([*rows, q])
    times = np.arange(len(positions)) / rate
    return times, positions + noise * rng.standard_normal(positions.shape)


GUIDED = [(1.5, None), (2.0, (0.6, -0.3, 0.1)), (2.5, None), (1.5, (-0.2, 0.5, 0.0)), (2.0, None)]


def test_rests_at_the_ends_are_cut_and_the_pause_is_shortened():
    times, positions = moves(GUIDED)
    whole = extract_demonstration(times, positions, NAMES, DemonstrationConfig(longest_pause=np.inf))
    assert whole.duration == pytest.approx(6.0, abs=0.5)
    short = extract_demonstration(times, positions, NAMES)
    assert short.duration == pytest.approx(4.0, abs=0.5)
    assert short.times[0] == 0.0
    assert np.diff(short.times).mean() == pytest.approx(0.02, rel=0.05)
    for demonstration in (whole, short):
        np.testing.assert_allclose(demonstration.positions[0], positions[0], atol=0.01)
        np.testing.assert_allclose(demonstration.positions[-1], positions[-1], atol=0.01)


def test_points_on_arc_length_go_through_the_same_path_at_one_speed():
    times, positions = moves(GUIDED)
    timed = extract_demonstration(times, positions, NAMES)
    arc = extract_demonstration(times, positions, NAMES, DemonstrationConfig(spacing="arc"))
    steps = np.linalg.norm(np.diff(arc.positions, axis=0), axis=1)
    assert steps.max() < 1.02 * np.median(steps)
    assert np.linalg.norm(np.diff(timed.positions, axis=0), axis=1).max() > 1.5 * np.median(steps)
    assert arc.duration == pytest.approx(timed.duration)
    np.testing.assert_allclose(arc.positions[[0, -1]], timed.positions[[0, -1]], atol=1e-12)
    apart = np.linalg.norm(arc.positions[:, None] - timed.positions[None], axis=2).min(axis=1)
    assert apart.max() < 0.01
    with pytest.raises(ConfigError, match="spacing"):
        DemonstrationConfig(spacing="path")


@given(seed=st.integers(0, 1000), noise=st.floats(0.0, 2e-4), shift=st.floats(-1e4, 1e6))
@settings(max_examples=20, deadline=None)
def test_time_shift_and_encoder_noise_change_nothing(seed, noise, shift):
    clean = extract_demonstration(*moves(GUIDED), NAMES)
    times, positions = moves(GUIDED, noise=noise, seed=seed)
    noisy = extract_demonstration(times + shift, positions, NAMES)
    assert noisy.duration == pytest.approx(clean.duration, abs=0.25)
    np.testing.assert_allclose(noisy.resampled(40), clean.resampled(40), atol=0.08)


@given(legs=st.lists(st.tuples(st.floats(0.3, 2.0), st.tuples(*[st.floats(-0.8, 0.8)] * 3)), min_size=1, max_size=4),
       rests=st.lists(st.floats(0.0, 3.0), min_size=5, max_size=5))
@settings(max_examples=30, deadline=None)
def test_extracting_again_changes_nothing(legs, rests):
    chain = [(rests[0] + 0.3, None)]
    for (duration, way), rest in zip(legs, rests[1:], strict=False):
        if np.abs(way).max() < 0.15:
            way = (0.3, 0.2, 0.1)
        chain += [(duration, way), (rest + 0.3, None)]
    times, positions = moves(chain)
    try:
        once = extract_demonstration(times, positions, NAMES)
    except InputError as error:
        assert "too short" in str(error)
        return
    again = extract_demonstration(once.times, once.positions, NAMES)
    assert again.duration == pytest.approx(once.duration, abs=0.05 * once.duration + 0.1)
    np.testing.assert_allclose(again.positions[[0, -1]], once.positions[[0, -1]], atol=0.01)


@given(rate=st.floats(5.0, 500.0), repeats=st.integers(0, 3))
@settings(max_examples=20, deadline=None)
def test_resampling_keeps_the_ends_and_the_path(rate, repeats):
    times, positions = moves([(1.0, None), (3.0, (1.0, -0.5, 0.3)), (1.0, None)])
    held = np.repeat(positions[::repeats + 1], repeats + 1, axis=0)[:len(positions)]  # a log faster than its source
    demonstration = extract_demonstration(times, held, NAMES, DemonstrationConfig(rate=rate))
    assert (held == demonstration.positions[0]).all(axis=1).any()
    assert (held == demonstration.positions[-1]).all(axis=1).any()
    line = np.array([1.0, -0.5, 0.3])
    np.testing.assert_allclose(demonstration.positions, demonstration.positions[:, :1] * line, atol=1e-9)


def test_taking_hold_of_the_arm_is_not_its_motion():
    times, positions = moves([(1.0, None), (0.2, (0.012, 0.0, 0.0)), (2.0, None), (2.0, (0.8, 0.0, 0.0)), (1.0, None)])
    assert extract_demonstration(times, positions, NAMES).duration < 2.2


def test_short_rest_is_part_of_the_motion_around_it():
    for rest, segments in ((0.05, 1), (1.0, 2)):
        move = (1.0, (0.5, 0.0, 0.0))
        times, positions = moves([(1.0, None), move, (rest, None), move, (1.0, None)])
        assert len(moving_segments(times, positions, MotionConfig())) == segments


def test_creeping_in_a_pause_stays_slow():
    times, positions = moves([(0.5, None), (1.0, (0.5, 0.0, 0.0)), (8.0, (0.0, 0.06, 0.0)), (1.0, (0.5, 0.0, 0.0))])
    demonstration = extract_demonstration(times, positions, NAMES)
    assert demonstration.duration == pytest.approx(1.8 + 3.0, abs=0.5)
    assert np.abs(np.gradient(demonstration.positions[:, 1], demonstration.times)).max() < 0.05


def test_arm_that_did_not_move_is_refused_with_numbers():
    times, positions = moves([(3.0, None)], noise=1e-4)
    with pytest.raises(InputError, match=r"did not move.*0\.0\d\d rad/s, 0\.00\d rad in 3\.0 s"):
        extract_demonstration(times, positions, NAMES)
    with pytest.raises(InputError, match="too short"):
        extract_demonstration(*moves([(1.0, None), (0.2, (0.2, 0.0, 0.0)), (1.0, None)]), NAMES,
                              DemonstrationConfig(shortest=1.0))


def test_samples_that_cannot_be_used_are_refused_and_disordered_ones_left_out():
    times, positions = moves(GUIDED)
    with pytest.raises(InputError, match="finite"):
        extract_demonstration(times, np.where(positions > 0.5, np.nan, positions), NAMES)
    with pytest.raises(ShapeError):
        extract_demonstration(times[:-1], positions, NAMES)
    with pytest.raises(ShapeError):
        extract_demonstration(times, positions, NAMES[:2])
    with pytest.raises(InputError, match="two samples"):
        ordered_samples([1.0, 1.0, 0.5], np.zeros((3, 3)))
    shuffled = times.copy()
    shuffled[100:110] -= 0.3
    kept, _ = ordered_samples(shuffled, positions)
    assert (np.diff(kept) > 0).all()
    assert len(kept) >= len(times) - 70
    with pytest.raises(ConfigError):
        MotionConfig(start_speed=0.01)
    with pytest.raises(ConfigError):
        DemonstrationConfig(longest_pause=0.1)


def test_speed_of_a_ramp_is_its_slope():
    times = np.linspace(0.0, 2.0, 401)
    speed = fastest_joint_speed(times, np.outer(times, [0.1, -0.7, 0.2]), 0.1)
    np.testing.assert_allclose(speed, 0.7, rtol=1e-9)
    assert moving_segments(times, np.outer(times, [0.1, -0.7, 0.2]), MotionConfig()) == [(0, 400)]
