import numpy as np
import pytest

from unifeed_ros.core.capture.contact import ContactSample
from unifeed_ros.core.capture.contact_config import ContactKind
from unifeed_ros.core.capture.feedback_capture import (
    CaptureConfig,
    CapturedCorrections,
    CapturedDemonstration,
    FeedbackCapture,
)
from unifeed_ros.core.capture.record import JointRecord
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import RobotState, Trajectory

RATE = 500.0


class Session:
    """Play an arm, a controller and a contact detector to a capture, one sample after the other."""

    def __init__(self, robot, config=None):
        self.robot = robot
        self.capture = FeedbackCapture(robot, config)
        self.time = 100.0
        self.q = np.array(robot.config.seed)
        self.captured = []

    def play(self, mode, duration, *, motion_id="", motion=None, pushes=(), kind=ContactKind.TOUCH, size=0.3,
             displacement=None):
        """Run one mode: a displacement moves the arm by hand, a motion is tracked and pushed sideways."""
        begin, start = self.time, self.q
        for k in range(round(duration * RATE)):
            self.time, moment = begin + k / RATE, k / RATE
            if displacement is not None:
                self.q = start + (0.5 - 0.5 * np.cos(np.pi * moment / duration)) * np.asarray(displacement)
            push = next((p for p in pushes if p[0] <= moment <= p[1]), None)
            if motion is not None:
                self.q = motion.positions_at([moment])[0]
                if push:
                    self.q = self.q + size * (moment - push[0]) * np.eye(self.robot.n)[1]
            self.sample(mode, motion_id, moment if motion is not None else 0.0, push and (begin + push[0], kind))
        return self

    def sample(self, mode, motion_id, motion_time, contact):
        onset, kind = contact or (None, ContactKind.NONE)
        zeros = np.zeros(self.robot.n)
        self.capture.observe_state(RobotState(time=self.time, positions=self.q, velocities=zeros))
        self.capture.observe_contact(ContactSample(time=self.time, in_contact=onset is not None, kind=kind, onset=onset,
                                                   level=0.0, torque=zeros, bias=zeros))
        self.captured += self.capture.observe_teaching(self.time, mode, motion_id, motion_time)


@pytest.fixture
def session(panda):
    return Session(panda)


@pytest.fixture
def motion(panda):
    start, way = np.array(panda.config.seed), np.array([-0.8, 0.2, 0.0, -0.2, 0.0, 0.0, 0.0])
    return Trajectory(joint_names=panda.joint_names, times=[0.0, 3.0], positions=[start, start + way])


def play_tracked(session, motion, **push):
    session.capture.observe_trajectory("m", motion)
    session.play(TeachingMode.HOLD, 0.2)
    session.play(TeachingMode.TRACK, 3.0, motion_id="m", motion=motion, **push)
    session.play(TeachingMode.HOLD, 0.2)
    *pushes, captured = session.captured
    assert isinstance(captured, CapturedCorrections) and not captured.goes_on
    assert all(push.goes_on and push.run is None for push in pushes)
    assert captured.motion_id == "m"
    return captured


def test_guided_run_becomes_a_demonstration(session):
    way = np.array([0.5, -0.2, 0.0, 0.3, 0.0, 0.0, 0.1])
    start = session.q
    session.play(TeachingMode.HOLD, 1.0).play(TeachingMode.GUIDE, 0.7).play(TeachingMode.GUIDE, 2.0, displacement=way)
    session.play(TeachingMode.GUIDE, 1.0).play(TeachingMode.HOLD, 0.5)
    [captured] = session.captured
    assert isinstance(captured, CapturedDemonstration)
    assert captured.reason == ""
    assert captured.trajectory.duration == pytest.approx(2.0, abs=0.2)
    np.testing.assert_allclose(captured.trajectory.positions[[0, -1]], [start, start + way], atol=0.01)


def test_first_moment_before_guiding_is_kept(session):
    session.play(TeachingMode.HOLD, 1.0).play(TeachingMode.HOLD, 0.3, displacement=np.full(7, 0.1))
    session.play(TeachingMode.GUIDE, 1.0, displacement=np.full(7, 0.3)).play(TeachingMode.HOLD, 0.1)
    assert session.captured[0].trajectory.duration == pytest.approx(1.3, abs=0.1)


def test_motion_of_the_robot_before_guiding_is_not_its_demonstration(session, motion):
    session.play(TeachingMode.TRACK, 2.0, motion_id="m", motion=motion)
    session.play(TeachingMode.GUIDE, 1.0).play(TeachingMode.HOLD, 0.1)
    assert [c.time for c in session.captured] == pytest.approx([102.0, 103.0], abs=0.01)
    assert session.captured[1].trajectory is None
    assert "did not move" in session.captured[1].reason


@pytest.mark.parametrize(("mode", "word"), [(TeachingMode.STOPPED, "stopped"), (TeachingMode.HOLD, "did not move")])
def test_guiding_that_showed_nothing_whole_is_rejected_with_its_reason(session, mode, word):
    way = np.full(7, 0.3) if mode is TeachingMode.STOPPED else None
    session.play(TeachingMode.GUIDE, 1.5, displacement=way).play(mode, 0.1)
    [captured] = session.captured
    assert captured.trajectory is None
    assert word in captured.reason


def test_guiding_for_too_long_or_without_states_is_rejected(panda):
    session = Session(panda, CaptureConfig(longest=1.0))
    session.play(TeachingMode.GUIDE, 1.5, displacement=np.full(7, 0.3)).play(TeachingMode.HOLD, 0.1)
    assert "longer than 1 s" in session.captured[0].reason
    silent = FeedbackCapture(panda)
    silent.observe_teaching(0.0, TeachingMode.GUIDE, "", 0.0)
    [captured] = silent.observe_teaching(1.0, TeachingMode.HOLD, "", 0.0)
    assert "two samples" in captured.reason


def test_pushed_run_gives_corrections(session, motion):
    captured = play_tracked(session, motion, pushes=[(0.5, 1.2), (2.0, 2.5)])
    assert captured.touched
    assert captured.reason == ""
    expected = [pytest.approx((0.4, 1.2), abs=0.02), pytest.approx((1.9, 2.5), abs=0.02)]
    assert [c.span for c in captured.corrections] == expected


def test_a_push_is_handed_out_as_soon_as_it_has_ended(session, motion):
    end = play_tracked(session, motion, pushes=[(0.5, 1.2), (2.0, 2.5)])
    first, second, _ = session.captured
    assert (first.known, second.known, end.known) == (0, 1, 2)
    for push, count in ((first, 1), (second, 2)):
        assert push.touched and push.reason == "" and push.time == push.corrections[-1].interval[1]
        assert len(push.corrections) == count
    for early, late in zip(second.corrections, end.corrections, strict=True):
        assert (early.span, early.interval, early.deviation_m) == (late.span, late.interval, late.deviation_m)
        np.testing.assert_array_equal(early.corrected.positions, late.corrected.positions)


def test_a_push_held_to_the_end_is_handed_out_there_and_the_one_before_it_is_known(session, motion):
    end = play_tracked(session, motion, pushes=[(0.5, 1.2), (2.0, 9.9)])
    assert len(session.captured) == 2
    assert (len(end.corrections), end.known) == (2, 1)


def test_untouched_run_gives_nothing(session, motion):
    captured = play_tracked(session, motion)
    assert (captured.touched, captured.corrections, captured.reason) == (False, (), "")


def test_whole_run_is_kept_with_its_spans_inside(panda, session, motion):
    captured = play_tracked(session, motion, pushes=[(0.5, 1.2), (2.0, 2.5)])
    run = captured.run
    assert run.times[-1] - run.times[0] == pytest.approx(motion.duration, abs=0.05)
    began = run.times[0]
    tagged = np.zeros(len(run.times), dtype=bool)
    for span, push in zip(captured.corrections, ((0.5, 1.2), (2.0, 2.5)), strict=True):
        assert span.interval == pytest.approx((began + push[0] - 0.1, began + push[1]), abs=0.02)
        tagged |= (run.times >= span.interval[0]) & (run.times <= span.interval[1])
    assert tagged[run.in_contact].all()
    thin = run.thinned(50.0)
    assert len(thin.times) == pytest.approx(50.0 * motion.duration, abs=3)
    np.testing.assert_array_equal(thin.times[[0, -1]], run.times[[0, -1]])
    assert thin.in_contact.mean() == pytest.approx(run.in_contact.mean(), abs=0.03)
    untouched = play_tracked(Session(panda), motion)
    assert untouched.run is not None and not untouched.run.in_contact.any()


def test_touch_that_changed_nothing_says_so(session, motion):
    captured = play_tracked(session, motion, pushes=[(0.5, 1.0)], size=0.02)
    assert captured.touched
    assert captured.corrections == ()
    assert "changed the motion by" in captured.reason


def test_collision_teaches_nothing(session, motion):
    captured = play_tracked(session, motion, pushes=[(0.5, 0.7)], kind=ContactKind.COLLISION)
    assert (captured.touched, captured.corrections) == (False, ())


def test_touch_during_which_the_arm_stopped_teaches_nothing_but_earlier_ones_do(session, motion):
    session.capture.observe_trajectory("m", motion)
    session.play(TeachingMode.TRACK, 2.5, motion_id="m", motion=motion, pushes=[(0.5, 1.2), (2.0, 9.9)])
    session.play(TeachingMode.STOPPED, 0.1)
    handed_out, captured = session.captured
    assert [c.span for c in captured.corrections] == [pytest.approx((0.4, 1.2), abs=0.02)]
    assert len(handed_out.corrections) == captured.known == 1
    assert not captured.run.in_contact[captured.run.times > captured.run.times[0] + 1.9].any()


def test_push_held_to_the_end_ends_with_the_run(session, motion):
    [correction] = play_tracked(session, motion, pushes=[(2.0, 9.9)]).corrections
    assert correction.span == pytest.approx((1.9, 3.0), abs=0.02)


def test_touch_of_an_unknown_motion_is_told(session, motion):
    session.play(TeachingMode.TRACK, 2.0, motion_id="lost", motion=motion, pushes=[(0.5, 1.0)])
    session.play(TeachingMode.HOLD, 0.1)
    assert "lost, whose trajectory is unknown" in session.captured[0].reason


def test_motion_that_follows_at_once_is_a_run_of_its_own(session, motion):
    session.capture.observe_trajectory("m", motion)
    session.play(TeachingMode.TRACK, 2.0, motion_id="m", motion=motion, pushes=[(0.5, 1.0)])
    session.play(TeachingMode.TRACK, 2.0, motion_id="m", motion=motion)
    session.play(TeachingMode.TRACK, 1.0, motion_id="other", motion=motion).play(TeachingMode.STOPPED, 0.1)
    assert [(c.motion_id, len(c.corrections), c.known, c.touched) for c in session.captured] == [
        ("m", 1, 0, True), ("m", 1, 1, True), ("m", 0, 0, False), ("other", 0, 0, False)]


def test_clock_that_begins_anew_begins_a_session_anew(session):
    session.play(TeachingMode.GUIDE, 1.0, displacement=np.full(7, 0.3))
    session.time = 0.0
    session.play(TeachingMode.HOLD, 0.2)
    session.play(TeachingMode.GUIDE, 2.0, displacement=np.full(7, 0.3)).play(TeachingMode.HOLD, 0.1)
    assert [c.reason for c in session.captured] == [""]
    assert session.captured[0].trajectory.duration == pytest.approx(2.0, abs=0.15)


def test_states_later_than_the_end_of_the_run_do_not_belong_to_it(session):
    session.play(TeachingMode.GUIDE, 2.0, displacement=np.full(7, 0.3))
    end, zeros = session.time, np.zeros(7)
    for k in range(1, 200):
        later = session.q + 0.3 * k / 200
        session.capture.observe_state(RobotState(time=end + k / RATE, positions=later, velocities=zeros))
    [captured] = session.capture.observe_teaching(end, TeachingMode.HOLD, "", 0.0)
    np.testing.assert_allclose(captured.trajectory.positions[-1], session.q, atol=0.01)


def test_input_that_cannot_be_used_is_refused(session, motion):
    bad = np.where(np.arange(7) == 2, np.nan, 0.0)
    with pytest.raises(InputError, match="joint state is not finite"):
        session.capture.observe_state(RobotState(time=0.0, positions=bad, velocities=np.zeros(7)))
    with pytest.raises(InputError, match="teaching mode"):
        session.capture.observe_teaching(0.0, 9, "", 0.0)
    with pytest.raises(InputError, match="teaching state"):
        session.capture.observe_teaching(0.0, 1, "", float("nan"))
    with pytest.raises(ConfigError):
        CaptureConfig(rate=0.0)


def test_record_keeps_the_pre_roll_and_thins_out():
    record = JointRecord(pre_roll=0.5, rate=100.0, longest=10.0)
    stamps = np.arange(0.0, 3.0, 0.001)
    for time in stamps[:2000]:
        record.append(time, np.zeros(2))
    record.start()
    for time in stamps[2000:]:
        record.append(time, np.ones(2))
    times, positions = record.stop()
    assert times[0] == pytest.approx(1.5, abs=0.02)
    assert times[-1] == pytest.approx(3.0, abs=0.02)
    assert np.diff(times).min() >= 0.01 - 1e-6
    assert positions.shape == (len(times), 2)
    assert len(record.stop()[0]) == 0
