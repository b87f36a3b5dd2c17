import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.capture.correction import CorrectionConfig, TrackedRun, contact_spans, extract_corrections
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.types import Trajectory

DURATION = 4.0
DIRECTION = np.array([0.0, 1.0, 0.0, -0.3, 0.0, 0.2, 0.0])


@pytest.fixture(scope="session")
def plan(panda):
    times = np.linspace(0.0, DURATION, 101)
    s = 0.5 - 0.5 * np.cos(np.pi * times / DURATION)
    start = np.array(panda.config.seed)
    positions = start + np.outer(s, [-0.8, 0.3, 0.0, -0.2, 0.0, 0.1, 0.0])
    return Trajectory(joint_names=panda.joint_names, times=times, positions=positions)


def pushed(plan, spans, size, *, rate=200.0, slow=1.0, shift=0.0):
    """Make a run in which the arm leaves its plan while it is pushed and decays back over a second."""
    times = np.arange(0.0, DURATION / slow, 1.0 / rate)
    offset = np.zeros(len(times))
    touched = np.zeros(len(times), dtype=bool)
    for start, end in spans:
        grown = np.clip((times - start) / (end - start), 0.0, 1.0)
        offset += size * grown * np.exp(-np.maximum(times - end, 0.0) / 0.4)
        touched |= (times >= start) & (times <= end)
    progress = slow * times
    positions = plan.positions_at(progress) + np.outer(offset, DIRECTION)
    return TrackedRun(times=times + shift, positions=positions, motion_times=progress, in_contact=touched)


def tool_deviation(robot, plan, run, interval):
    inside = (run.times >= interval[0]) & (run.times <= interval[1])
    meant = robot.tool_states(plan.positions_at(run.motion_times[inside]))[:, :3]
    return np.linalg.norm(robot.tool_states(run.positions[inside])[:, :3] - meant, axis=1).max()


def test_untouched_run_has_no_correction(panda, plan):
    assert extract_corrections(pushed(plan, [], 0.0), plan, panda) == []


@given(start=st.floats(0.3, 2.0), length=st.floats(0.4, 1.5), size=st.floats(0.15, 0.4), shift=st.floats(-1e4, 1e6))
@settings(max_examples=15, deadline=None)
def test_push_becomes_one_correction_from_its_onset_to_its_release(panda, plan, start, length, size, shift):
    run = pushed(plan, [(start, start + length)], size, shift=shift)
    [correction] = extract_corrections(run, plan, panda)
    assert correction.span == pytest.approx((start - 0.1, start + length), abs=0.011)
    assert correction.deviation_m == pytest.approx(
        tool_deviation(panda, plan, run, (start + shift, start + length + shift)), rel=0.03)
    np.testing.assert_array_equal(correction.planned.times, correction.corrected.times)
    assert correction.planned.times[0] == 0.0
    moments = correction.span[0] + correction.planned.times
    np.testing.assert_allclose(correction.planned.positions, plan.positions_at(moments), atol=2e-3)
    np.testing.assert_allclose(correction.corrected.positions,
                               Trajectory(joint_names=plan.joint_names, times=run.times - shift,
                                          positions=run.positions).positions_at(moments), atol=2e-3)
    np.testing.assert_allclose(correction.corrected.positions[0], correction.planned.positions[0], atol=1e-6)


def test_several_pushes_give_several_corrections_and_close_ones_one(panda, plan):
    apart = extract_corrections(pushed(plan, [(0.5, 1.0), (2.0, 2.6)], 0.3), plan, panda)
    assert [c.span for c in apart] == [pytest.approx((0.4, 1.0), abs=0.011), pytest.approx((1.9, 2.6), abs=0.011)]
    close = extract_corrections(pushed(plan, [(0.5, 1.0), (1.06, 1.6)], 0.3), plan, panda)
    assert [c.span for c in close] == [pytest.approx((0.4, 1.6), abs=0.011)]


def test_pre_roll_does_not_reach_into_the_push_before_or_before_the_start(panda, plan):
    run = pushed(plan, [(0.0, 0.5), (0.9, 1.5)], 0.3)
    spans = contact_spans(run, plan, panda, CorrectionConfig(pre_roll=2.0))
    assert spans[0].span[0] == 0.0
    assert spans[1].span[0] == pytest.approx(spans[0].span[1])


def test_push_that_changed_nothing_is_no_correction(panda, plan):
    run = pushed(plan, [(1.0, 1.5)], 0.02)
    assert extract_corrections(run, plan, panda) == []
    [span] = contact_spans(run, plan, panda)
    assert 0.0 < span.deviation_m < 0.02
    assert len(extract_corrections(run, plan, panda, CorrectionConfig(smallest_deviation=0.0))) == 1


def test_plan_is_read_at_the_time_that_the_controller_had(panda, plan):
    slow = pushed(plan, [(2.0, 3.0)], 0.0, slow=0.5)
    [span] = contact_spans(slow, plan, panda)
    assert span.span == pytest.approx((0.95, 1.5), abs=0.011)
    assert span.planned.duration == pytest.approx(1.1, abs=0.011)
    assert span.deviation_m < 1e-6
    later = Trajectory(joint_names=plan.joint_names, times=plan.times + 7.0, positions=plan.positions)
    assert contact_spans(slow, later, panda)[0].deviation_m < 1e-6


def test_push_while_motion_time_stands_still_is_left_out(panda, plan):
    times = np.linspace(0.0, 2.0, 401)
    run = TrackedRun(times=times, positions=np.repeat(plan.positions[-1:], 401, axis=0),
                     motion_times=np.full(401, DURATION), in_contact=times > 1.0)
    assert contact_spans(run, plan, panda) == []


def test_runs_that_cannot_be_used_are_refused(panda, plan):
    run = pushed(plan, [(1.0, 1.5)], 0.2)
    other = Trajectory(joint_names=tuple("abcdefg"), times=plan.times, positions=plan.positions)
    with pytest.raises(InputError, match="joints of the tracked motion"):
        extract_corrections(run, other, panda)
    fewer = TrackedRun(times=run.times, positions=run.positions[:, :6], motion_times=run.motion_times,
                       in_contact=run.in_contact)
    with pytest.raises(ShapeError):
        extract_corrections(fewer, plan, panda)
    with pytest.raises(ShapeError):
        TrackedRun(times=run.times, positions=run.positions, motion_times=run.motion_times, in_contact=[True])
    with pytest.raises(InputError):
        TrackedRun(times=run.times[::-1], positions=run.positions, motion_times=run.motion_times,
                   in_contact=run.in_contact)
    with pytest.raises(ConfigError):
        CorrectionConfig(rate=0.0)
