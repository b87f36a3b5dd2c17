"""Demonstrations from recordings of people who guide a real arm, and runs of an arm that nobody touches."""

import numpy as np
import pytest

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.correction import TrackedRun, extract_corrections
from unifeed_ros.core.capture.demonstration import DemonstrationConfig, extract_demonstration
from unifeed_ros.core.capture.feedback_capture import FeedbackCapture
from unifeed_ros.core.capture.motion import ordered_samples
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import RobotState, Trajectory

LILA = ("il_pick-banana", "il_pick-cereal", "il_pour-cereal", "lila_pick-banana", "lila_pour-cereal")
USERS = tuple(f"user_{k:02d}" for k in range(1, 9))
FREE = ("run_162545", "run_162853")


@pytest.mark.parametrize("name", LILA)
def test_every_guided_run_is_a_demonstration_that_covers_its_motion(recording, figures, name):
    data = recording("panda_kinesthetic_lila", f"{name}.npz")
    for demo in np.unique(data["demo_id"]):
        run = data["demo_id"] == demo
        found = figures.guided_figures(data["t"][run], data["q"][run])
        assert found["travel_covered"] > 0.99
        assert found["end_moved_rad"] < 0.02
        assert found["from_first_to_last_motion_s"] <= found["recorded_s"] + 1e-9
        moving = (np.abs(data["dq"][run]).max(axis=1) > 0.05).sum() * 0.1  # samples come at 10 Hz
        assert found["from_first_to_last_motion_s"] > 0.95 * moving
        assert found["demonstration_s"] < 0.5 * (found["pauses"] + 1) + 1.6 * moving + 1.0


def test_pauses_for_the_gripper_are_shortened(recording, figures):
    data = recording("panda_kinesthetic_lila", "il_pick-banana.npz")
    runs = [data["demo_id"] == demo for demo in np.unique(data["demo_id"])]
    found = [figures.guided_figures(data["t"][run], data["q"][run]) for run in runs]
    assert np.median([f["pauses"] for f in found]) >= 1
    assert sum(f["demonstration_s"] for f in found) < 0.75 * sum(f["from_first_to_last_motion_s"] for f in found)


@pytest.mark.parametrize("name", USERS)
def test_people_who_take_from_ten_seconds_to_two_minutes(recording, panda, figures, name):
    data = recording("panda_kinesthetic_users_hapticskin", f"{name}.npz")
    for condition in sorted({key.split("/")[0] for key in data}):
        times, positions = data[f"{condition}/t"], data[f"{condition}/q"].astype(float)
        found = figures.guided_figures(times, positions)
        assert found["travel_covered"] > 0.99
        assert found["end_moved_rad"] < 0.04
        demonstration = extract_demonstration(times, positions, panda.joint_names)
        assert np.diff(demonstration.times) == pytest.approx(0.02, rel=0.01)
        again = extract_demonstration(demonstration.times, demonstration.positions, panda.joint_names)
        assert again.duration == pytest.approx(demonstration.duration, rel=0.05)
        whole = extract_demonstration(times, positions, panda.joint_names, DemonstrationConfig(longest_pause=np.inf))
        for count in (10, 40):
            points = whole.resampled(count)
            np.testing.assert_array_equal(points[[0, -1]], whole.positions[[0, -1]])
            distance = np.abs(positions[:, None] - points[None]).max(axis=2).min(axis=0)
            assert distance.max() < 0.02  # every point lies on the recorded path


def free_run(recording, name):
    data = recording("fr3_follower_1khz", f"{name}.npz")
    times = (data["t_ns"] - data["t_ns"][0]) * 1e-9
    return times, data["q"].astype(float), data["dq"].astype(float), data["tau_ext"].astype(float)


def smoothed_plan(panda, times, positions):
    coarse = slice(0, None, 50)
    kept, rows = ordered_samples(times[coarse], positions[coarse])
    return Trajectory(joint_names=panda.joint_names, times=kept - kept[0], positions=rows)


@pytest.mark.parametrize("name", FREE)
@pytest.mark.parametrize("pushed", [False, True])
def test_live_capture_corrects_a_real_free_run_only_where_it_is_pushed(recording, panda, name, pushed):
    times, positions, velocities, torque = free_run(recording, name)
    plan = smoothed_plan(panda, times, positions)
    bump = np.clip((times - 1.5) / 0.5, 0.0, 1.0) * np.clip((3.0 - times) / 0.5, 0.0, 1.0)
    if pushed:
        positions[:, 0] += 0.25 * bump
        torque[:, 0] += 10.0 * np.clip(np.minimum((times - 1.5) / 0.1, (2.4 - times) / 0.1), 0.0, 1.0)
    capture = FeedbackCapture(panda)
    detector = ContactDetector([2.0, 2.0, 2.0, 2.0, 1.5, 1.5, 1.0])
    capture.observe_trajectory("m", plan)
    handed_out = []
    for k, time in enumerate(times.tolist()):
        capture.observe_state(RobotState(time=time, positions=positions[k], velocities=velocities[k]))
        capture.observe_contact(detector.update(time, torque[k], velocities[k]))
        handed_out += capture.observe_teaching(time, TeachingMode.TRACK, "m", time)
    [captured] = capture.observe_teaching(times[-1] + 0.001, TeachingMode.HOLD, "", 0.0)
    assert captured.touched is pushed
    assert len(captured.corrections) == captured.known == len(handed_out) == int(pushed)
    if pushed:
        assert captured.corrections[0].span == pytest.approx((1.45, 2.5), abs=0.15)
        assert 0.05 < captured.corrections[0].deviation_m < 0.25


@pytest.mark.parametrize("name", FREE)
def test_touch_without_deviation_of_a_real_run_is_no_correction(recording, panda, name):
    times, positions, _, _ = free_run(recording, name)
    run = TrackedRun(times=times, positions=positions, motion_times=times, in_contact=(times > 1.0) & (times < 3.0))
    assert extract_corrections(run, smoothed_plan(panda, times, positions), panda) == []
