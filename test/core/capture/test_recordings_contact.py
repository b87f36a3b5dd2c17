"""Contact in recordings of real arms, compared with what each recording's page says happened."""

import numpy as np
import pytest

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.contact_config import ContactConfig
from unifeed_ros.core.capture.external import by_name
from unifeed_ros.core.capture.touches import inside_any, judge_recording
from unifeed_ros.core.errors import InputError

LINKS_4_TO_7 = ("a4", "a5", "b6", "b8", "c2", "c3", "c6", "d3")
UR_JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
             "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")


@pytest.mark.parametrize("name", LINKS_4_TO_7)
def test_every_press_on_links_4_to_7_is_one_touch(recording, figures, name):
    found = figures.press_figures(recording("panda_push_labels_mindlab", f"{name}.npz"))
    assert found.presses in (15, 16)
    assert (found.found, found.touches, found.false_touches) == (found.presses, found.presses, 0)
    assert found.true_rate > 0.82
    assert found.false_rate < 0.12  # torque fades for 0.1 to 0.2 s after the label
    assert found.false_rate_beyond_tail < 0.01
    assert found.median_delay_s < 0.085


def test_these_are_the_thresholds_of_the_shipped_panda(figures, panda):
    assert tuple(panda.config.contact_thresholds) == figures.PANDA_THRESHOLDS


@pytest.mark.parametrize(("name", "links"), [("f2", {2}), ("d3", {3, 4}), ("c6", {3, 4, 5}), ("b8", {4, 5, 6})])
def test_link_that_felt_a_press_is_never_beyond_the_one_that_was_pressed(recording, name, links):
    data = recording("panda_push_labels_mindlab", f"{name}.npz")
    _, touches = judge_recording(ContactDetector((3.0, 3.0, 3.0, 2.5, 1.5, 1.5, 1.0)), data["t"] - data["t"][0],
                                 data["tau_ext"], data["dq"])
    assert {t.link for t in touches} <= links


def test_presses_on_link_2_show_in_one_joint_and_are_found(recording, figures):
    found = figures.press_figures(recording("panda_push_labels_mindlab", "f2.npz"))
    assert (found.presses, found.found, found.false_touches) == (16, 16, 0)
    assert found.true_rate > 0.75
    assert found.false_rate_beyond_tail < 0.01


@pytest.mark.parametrize("name", ["b6", "f2"])
def test_touches_do_not_depend_on_the_sensors_offset(recording, name):
    data = recording("panda_push_labels_mindlab", f"{name}.npz")
    times = data["t"] - data["t"][0]
    offset = np.array([3.0, -5.0, 2.0, -3.0, 1.0, 0.5, -0.7])
    found = [judge_recording(ContactDetector([2.0] * 7), times, data["tau_ext"] + bias, data["dq"])[1]
             for bias in (np.zeros(7), offset)]
    np.testing.assert_allclose([t.onset for t in found[0]], [t.onset for t in found[1]], atol=0.02)


@pytest.mark.parametrize("name", ["run_162545", "run_162853"])
def test_free_motion_is_no_touch_and_the_moving_allowance_helps(recording, figures, name):
    data = recording("fr3_follower_1khz", f"{name}.npz")
    touches, level, fixed = figures.free_figures(data)
    assert touches == 0
    assert level < 0.85
    assert fixed > 1.1 * level


@pytest.mark.parametrize("name", ["run_162545", "run_162853"])
def test_free_motion_with_a_push_added_is_a_touch_where_the_push_is(recording, figures, name):
    data = recording("fr3_follower_1khz", f"{name}.npz")
    times = (data["t_ns"] - data["t_ns"][0]) * 1e-9
    torque = data["tau_ext"].astype(float).copy()
    torque[:, 1] += 8.0 * np.clip(np.minimum((times - 2.0) / 0.1, (2.8 - times) / 0.1), 0.0, 1.0)
    _, touches = judge_recording(ContactDetector(figures.PANDA_THRESHOLDS), times, torque, data["dq"])
    assert len(touches) == 1
    assert (touches[0].onset, touches[0].end) == pytest.approx((2.0, 2.8), abs=0.06)


@pytest.mark.parametrize("person", [f"P{k}" for k in range(6)])
def test_pushes_logged_with_the_jaco_are_found(recording, figures, person):
    data = recording("jaco2_corrections_iact__nolicence", f"{person}.npz")
    trials = sorted({key.rsplit("/", 1)[0] for key in data})
    held = [t for t in trials if len(data[f"{t}/tau_t"]) > 10]
    touched = {trial: figures.jaco_touches(data, trial)[2] for trial in held}
    assert len(held) >= 8
    assert all(touched.values())
    inside = np.concatenate([inside_any(data[f"{t}/tau_t"], touched[t]) for t in held])
    assert inside.mean() > 0.8  # the rest: single samples at 10 Hz, shorter than the delay
    silent = [t for t in trials if len(data[f"{t}/tau_t"]) == 0]
    assert not any(figures.jaco_touches(data, trial)[2] for trial in silent)


def test_joint_that_reads_minus_3_nm_is_no_constant_correction(recording, figures):
    data, trial = recording("jaco2_corrections_iact__nolicence", "P0.npz"), "task0_A_trial1"
    times, torque, touches = figures.jaco_touches(data, trial)
    assert (torque[:, 3] < -2.0).sum() > 30
    touched = inside_any(times, touches)
    assert touched.mean() < 0.4
    assert max(t.end - t.onset for t in touches) < 4.5
    biased = torque + np.array([0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    detector = ContactDetector(figures.JACO_THRESHOLDS, figures.JACO_CONFIG)
    assert judge_recording(detector, times, biased, np.zeros_like(torque))[1] == touches


def test_minus_3_nm_that_stays_is_learned_as_bias_within_seconds(recording, figures):
    data, trial = recording("jaco2_corrections_iact__nolicence", "P0.npz"), "task0_A_trial1"
    _, torque, _ = figures.jaco_touches(data, trial)
    steady = np.tile(torque[np.argmax(torque[:, 3] < -2.0)], (200, 1))
    steady[:10] = 0.0
    times = 0.1 * np.arange(200)
    _, touches = judge_recording(ContactDetector(figures.JACO_THRESHOLDS, figures.JACO_CONFIG), times, steady,
                                 np.zeros_like(steady))
    assert [t.end - t.onset < ContactConfig().steady_time + 0.5 for t in touches] == [True]


def read_wrench(recording_path, figures, name):
    pytest.importorskip("rosbags")
    return figures.read_wrench(recording_path("ur10e_wrench_bags__nolicence", name))


@pytest.mark.parametrize("form", ["wrench_pushes_ros2", "wrench_pushes.bag"])
def test_pushes_of_the_ur10e_tool_are_touches_and_taps_are_not(recording_path, figures, form):
    times, wrench = read_wrench(recording_path, figures, form)
    touches = figures.wrench_touches(times, wrench)
    meant = [t.onset for t in touches if t.meant]
    np.testing.assert_allclose(meant, [2.2, 5.8, 8.5, 12.4], atol=0.15)


def test_taps_of_the_ur10e_tool_show_where_the_delay_is_short(recording_path, figures):
    touches = figures.wrench_touches(*read_wrench(recording_path, figures, "wrench_pushes_ros2"), on_delay=0.002,
                                    smooth_time=0.002)
    late = np.array([t.onset for t in touches if t.onset > 13.0])
    for tap in (15.8, 21.1, 24.3, 27.4, 31.7):
        assert np.abs(late - tap).min() < 0.1
    assert len(late) <= 10
    assert sum(not t.meant for t in touches) >= 4


def test_twists_of_the_ur10e_tool_are_found(recording_path, figures):
    touches = figures.wrench_touches(*read_wrench(recording_path, figures, "wrench_twist_ros2"))
    early = np.array([3.2, 6.1, 9.4, 11.7]) - [t.onset for t in touches]  # the page's times: when 1 Nm is passed
    assert (early > -0.05).all() and (early < 0.3).all()


def test_two_publishers_on_one_topic_are_told_apart_by_name(recording_path, figures):
    pytest.importorskip("rosbags")
    path = recording_path("ur10e_wrench_bags__nolicence", "traj_real_30_ros2")
    times, positions, velocities, refused = [], [], [], 0
    for stamp, message in figures.read_bag(path, "/joint_states"):
        try:
            positions.append(by_name(message.name, message.position, UR_JOINTS, "positions"))
            velocities.append(by_name(message.name, message.velocity, UR_JOINTS, "velocities"))
            times.append(stamp)
        except InputError as error:
            refused += 1
            assert "lack joints" in str(error) or "number of" in str(error)
    assert refused > 300  # the gripper, 50 Hz
    assert len(times) > 3500
    assert len(positions) == len(times)
    moved = np.diff(np.array(positions)[[0, -1]], axis=0)[0]
    integrated = np.trapezoid(np.array(velocities), np.array(times), axis=0)
    np.testing.assert_allclose(integrated, moved, atol=0.05)  # names and columns belong together
    assert np.abs(moved).max() > 0.3
