"""Laws of the momentum observer, on motions whose torques pinocchio computes exactly."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.capture.momentum import MomentumConfig, MomentumObserver, _with_payload
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.types import RobotState

RATE = 1000.0


def motion(robot, seconds, seed=0, speed=1.0, rate=RATE):
    """Make a smooth motion near the seed posture: times, q, v, a."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 1.0 / rate)
    frequency, phase = rng.uniform(0.3, 0.8, (2, robot.n)) * speed, rng.uniform(0.0, 6.0, (2, robot.n))
    size = rng.uniform(0.1, 0.3, (2, robot.n))
    angle = 2 * np.pi * frequency[:, None] * times[:, None] + phase[:, None]
    w = 2 * np.pi * frequency[:, None]
    q = np.array(robot.config.seed) + (size[:, None] * np.sin(angle)).sum(axis=0)
    v, a = size[:, None] * w * np.cos(angle), -size[:, None] * w**2 * np.sin(angle)
    return times, q, v.sum(axis=0), a.sum(axis=0)


def torques(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def observe(observer, times, q, v, torque):
    return np.array([observer.update(RobotState(time=t, positions=p, velocities=s), tau)
                     for t, p, s, tau in zip(times, q, v, torque, strict=True)])


def test_motion_alone_shows_no_external_torque(panda):
    times, q, v, a = motion(panda, 3.0)
    tau = torques(panda.pin_model, q, v, a)
    residual = observe(MomentumObserver(panda), times, q, v, tau)
    assert np.abs(tau - tau.mean(axis=0)).max() > 5.0  # the motion does need torque
    assert np.abs(residual).max() < 2e-3


def test_residual_of_motion_vanishes_with_the_square_of_the_step(panda):
    worst = []
    for rate in (250.0, 500.0, 1000.0):
        times, q, v, a = motion(panda, 1.0, speed=2.0, rate=rate)
        residual = observe(MomentumObserver(panda), times, q, v, torques(panda.pin_model, q, v, a))
        worst.append(np.abs(residual).max())
    assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.3)
    assert worst[1] / worst[2] == pytest.approx(4.0, rel=0.3)


@given(gain=st.floats(1.0, 1e5), rate=st.floats(25.0, 2000.0), seed=st.integers(0, 100))
def test_constant_external_torque_is_converged_to_without_overshoot_for_every_gain_and_rate(panda, gain, rate, seed):
    outside = np.random.default_rng(seed).normal(size=panda.n)
    q = np.array(panda.config.seed)
    gravity = pin.computeGeneralizedGravity(panda.pin_model, panda.pin_model.createData(), q)
    observer = MomentumObserver(panda, MomentumConfig(gain=gain))
    times = np.arange(60) / rate
    residual = observe(observer, times, np.tile(q, (60, 1)), np.zeros((60, 7)), np.tile(gravity - outside, (60, 1)))
    expected = outside * (1.0 - np.exp(-gain * times))[:, None]
    np.testing.assert_allclose(residual, expected, atol=1e-9)


def test_external_torque_is_followed_while_the_arm_moves(panda):
    times, q, v, a = motion(panda, 2.0)
    outside = np.outer(np.where(times > 1.0, 1.0, 0.0), np.array([2.0, -3.0, 1.0, 2.0, 0.5, -0.5, 0.3]))
    residual = observe(MomentumObserver(panda), times, q, v, torques(panda.pin_model, q, v, a) - outside)
    np.testing.assert_allclose(residual[-1], outside[-1], atol=2e-3)
    rise = residual[times > 1.0][int(RATE / 60.0) - 1] / outside[-1]
    np.testing.assert_allclose(rise, 1.0 - np.exp(-1.0), atol=0.03)  # the time constant is 1 / gain


def test_power_of_the_residual_is_the_energy_that_the_outside_gives(panda):
    times, q, v, a = motion(panda, 4.0)
    push = np.outer(np.sin(2 * np.pi * 0.5 * times) ** 2, np.array([2.0, -3.0, 1.0, 2.0, 0.5, -0.5, 0.3]))
    tau = torques(panda.pin_model, q, v, a) - push
    residual = observe(MomentumObserver(panda, MomentumConfig(gain=500.0)), times, q, v, tau)
    model, data = panda.pin_model, panda.pin_model.createData()
    energy = np.array([pin.computeKineticEnergy(model, data, x, y) + pin.computePotentialEnergy(model, data, x)
                       for x, y in ((q[0], v[0]), (q[-1], v[-1]))])
    motors = np.trapezoid((tau * v).sum(axis=1), times)
    outside = np.trapezoid((residual * v).sum(axis=1), times)
    assert motors + outside == pytest.approx(energy[1] - energy[0], abs=0.02)
    assert abs(motors - (energy[1] - energy[0])) > 0.3  # the motors alone do not explain it


def test_wrong_payload_is_a_constant_at_rest_and_the_right_one_nothing(panda):
    carried = MomentumConfig(payload_mass=0.5, payload_center=(0.0, 0.02, 0.05))
    model = _with_payload(panda, carried)
    q = np.tile(panda.config.seed, (800, 1))
    zero, times = np.zeros((800, 7)), np.arange(800) / RATE
    tau = torques(model, q, zero, zero)
    without = observe(MomentumObserver(panda), times, q, zero, tau)
    weight = panda.gravity(panda.config.seed) - tau[0]
    np.testing.assert_allclose(without[-1], weight, atol=1e-6)
    assert np.abs(weight).max() > 1.0
    np.testing.assert_allclose(observe(MomentumObserver(panda, carried), times, q, zero, tau)[-1], 0.0, atol=1e-9)
    times, q, v, a = motion(panda, 2.0)
    moving = observe(MomentumObserver(panda, carried), times, q, v, torques(model, q, v, a))
    assert np.abs(moving).max() < 2e-3


def test_friction_and_rotors_of_a_motor_side_sensor_are_taken_off(panda):
    friction = {"dry_friction": (0.4,) * 7, "viscous_friction": (0.5,) * 7, "rotor_inertia": (0.1,) * 7}
    times, q, v, a = motion(panda, 2.0)
    tau = torques(panda.pin_model, q, v, a) + 0.4 * np.tanh(v / 0.02) + 0.5 * v + 0.1 * a
    known = observe(MomentumObserver(panda, MomentumConfig(**friction)), times, q, v, tau)
    unknown = observe(MomentumObserver(panda), times, q, v, tau)
    assert np.abs(known).max() < 0.02  # dry friction turns over within milliseconds where a joint turns back
    assert np.abs(unknown).max() > 0.5


def test_driver_without_gravity_and_gaps_and_repeats(panda):
    times, q, v, a = motion(panda, 1.0)
    tau = torques(panda.pin_model, q, v, a) - np.array([panda.gravity(row) for row in q])
    observer = MomentumObserver(panda, MomentumConfig(without_gravity=True))
    assert np.abs(observe(observer, times, q, v, tau)).max() < 2e-3
    kept = observer.update(RobotState(time=times[-1], positions=q[0], velocities=v[0]), tau[0] + 99.0)
    later = observer.update(RobotState(time=times[-1] + 3.0, positions=q[0], velocities=v[0]), tau[0] + 99.0)
    np.testing.assert_array_equal(kept, later)  # nothing is known of the gap
    assert not observer.update(RobotState(time=0.0, positions=q[0], velocities=v[0]), tau[0]).any()


def test_settings_of_another_arm_are_refused(panda):
    with pytest.raises(ConfigError, match="dry_friction"):
        MomentumObserver(panda, MomentumConfig(dry_friction=(0.1,) * 6))
    for wrong in ({"gain": 0.0}, {"payload_mass": -1.0}, {"viscous_friction": (-1.0,)}):
        with pytest.raises(ConfigError):
            MomentumConfig(**wrong)
