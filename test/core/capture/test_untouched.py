"""What an untouched arm shows is learned and told from a push, also for a payload that nobody told the driver of."""

import numpy as np
import pinocchio as pin
import pytest

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.momentum import MomentumConfig, _with_payload
from unifeed_ros.core.capture.untouched import UntouchedConfig, UntouchedModel
from unifeed_ros.core.errors import ConfigError

PAYLOAD = MomentumConfig(payload_mass=0.6, payload_center=(0.02, -0.01, 0.06))


def swing(robot, seconds, rate=250.0):
    """Swing around the seed posture: times, q, v, a."""
    times = np.arange(0.0, seconds, 1.0 / rate)
    angle = np.outer(times, np.linspace(1.1, 2.3, robot.n)) + np.arange(robot.n)
    size = np.where(times < 1.0, 0.5 - 0.5 * np.cos(np.pi * np.minimum(times, 1.0)), 1.0)[:, None]
    q = np.array(robot.config.seed) + 0.4 * size * (np.sin(angle) - np.sin(angle[0]))
    v = np.gradient(q, times, axis=0)
    return times, q, v, np.gradient(v, times, axis=0)


def shown_by_payload(robot, q, v, a):
    """Torque that the payload takes, which the arm's own model does not know: weight and inertia."""
    model = _with_payload(robot, PAYLOAD)
    return np.array([pin.rnea(robot.pin_model, robot.pin_model.createData(), *row)
                     - pin.rnea(model, model.createData(), *row) for row in zip(q, v, a, strict=True)])


def test_weight_and_inertia_of_a_payload_enter_as_pinocchio_has_them(panda):
    times, q, v, a = swing(panda, 2.0)
    model = UntouchedModel(np.array(panda.config.contact_thresholds), UntouchedConfig(), panda)
    w = np.concatenate([[0.6], 0.6 * np.array(PAYLOAD.payload_center)])
    for t, row, speed in zip(times, q, v, strict=True):
        columns = model._weight_columns(t, row, speed)
    wanted = shown_by_payload(panda, q[-1:], v[-1:], a[-1:])[0]
    np.testing.assert_allclose(columns @ w, wanted, atol=0.12)  # the acceleration is smoothed
    rest = np.zeros(panda.n)
    np.testing.assert_allclose(model._weight_columns(99.0, q[0], rest) @ w,
                               shown_by_payload(panda, q[:1], rest[None], rest[None])[0], atol=1e-9)


def test_payload_bias_and_friction_are_learned_without_a_contact_and_a_push_is_still_found(panda):
    rng = np.random.default_rng(0)
    times, q, v, a = swing(panda, 12.0)
    bias = np.array([0.3, -0.5, 0.2, 0.4, -0.2, 0.1, 0.1])
    torque = bias + shown_by_payload(panda, q, v, a) + 0.1 * np.tanh(v / 0.02) + 0.05 * rng.normal(size=q.shape)
    pushed = (times > 9.0) & (times < 10.0)
    for row in np.flatnonzero(pushed):
        torque[row] += panda.tool_jacobian(q[row])[:3].T @ np.array([0.0, 5.0, 3.0])
    detector = ContactDetector(panda.config.contact_thresholds, robot=panda)
    blind = ContactDetector(panda.config.contact_thresholds)
    rows = list(zip(times.tolist(), torque, v, q, strict=True))
    touched = np.array([detector.update(*row).in_contact for row in rows])
    assert detector.payload == pytest.approx(0.6, abs=0.1)
    assert not touched[times < 9.0].any()
    assert touched[(times > 9.1) & (times < 9.95)].all()
    assert not touched[times > 10.8].any()
    without = np.array([blind.update(*row[:3]).in_contact for row in rows])
    assert without[times < 9.0].any()  # what a constant bias makes of the same torque


def test_doubt_falls_where_the_arm_has_been_and_stays_elsewhere(panda):
    thresholds = np.array(panda.config.contact_thresholds)
    model = UntouchedModel(thresholds, UntouchedConfig(), panda)
    here, there = np.array(panda.config.seed), np.array(panda.config.seed) + 0.5
    still = np.zeros(panda.n)
    for k in range(300):
        model.look(0.01 * k, here, still)
        model.learn(np.zeros(panda.n), 0.01)
    model.look(3.0, here, still)
    known = model.doubt
    model.look(3.01, there, still)
    assert (known < 0.1 * thresholds).all()
    assert model.doubt.max() > 5.0 * known.max()


def test_settings_that_would_learn_nothing_are_refused():
    for wrong in ({"bias_time": 0.0}, {"clip": -1.0}, {"payload": float("nan")}):
        with pytest.raises(ConfigError):
            UntouchedConfig(**wrong)
