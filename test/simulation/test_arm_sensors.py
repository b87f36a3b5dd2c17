"""What drives and wrist sensors of the simulated arm show, held against what the hand really does."""

from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.capture.external_torque import ExternalTorqueConfig, make_converter
from unifeed_ros.core.capture.momentum import MomentumConfig, MomentumObserver
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import RobotState
from unifeed_ros.simulation.arm import ArmConfig, SimulatedArm

CONFIGS = Path(__file__).parents[2] / "config" / "robots"
ROBOTS = {name: RobotModel(load_robot(CONFIGS / f"{name}.yaml")) for name in ("panda", "ur10")}
DRIVES = ArmConfig(torque_noise=0.0, torque_bias=0.0, friction_error=0.0)
PUSH = np.array([6.0, -8.0, 5.0, 0.0, 0.0, 0.0])


@pytest.fixture(params=sorted(ROBOTS))
def robot(request):
    return ROBOTS[request.param]


def observed(robot, arm, observer, seconds, command=None):
    """Run the arm and average what the observer and the arm's own estimate say at the end."""
    seen, own, count = [], [], round(seconds / 0.001)
    for k in range(count):
        if command is not None:
            arm.command(command(arm))
        arm.step()
        residual = observer.update(arm.state(), arm.measured_torque())
        if k > 0.7 * count:
            seen.append(residual)
            own.append(arm.external_torque())
    return np.mean(seen, axis=0), np.mean(own, axis=0)


def swing(arm):
    """Swing by torque around the seed posture."""
    robot = arm.robot
    wanted = np.array(robot.config.seed) + 0.3 * np.sin(2.0 * arm.time + np.arange(robot.n))
    rate = 0.6 * np.cos(2.0 * arm.time + np.arange(robot.n))
    return (robot.gravity(arm.true_positions) + np.array(robot.config.stiffness) * (wanted - arm.true_positions)
            + np.array(robot.config.damping) * (rate - arm.true_velocities))


def drive_model(robot, **more):
    return MomentumConfig(dry_friction=robot.config.friction, viscous_friction=(0.5,) * robot.n,
                          rotor_inertia=(0.1,) * robot.n, friction_speed=0.005, **more)


def test_observer_on_motor_torque_finds_the_hand_on_a_moving_arm(robot):
    arm = SimulatedArm(robot, seed=3, table_height=None, config=DRIVES)
    observer = MomentumObserver(robot, drive_model(robot))
    free, _ = observed(robot, arm, observer, 0.6, swing)
    arm.push(PUSH)
    pushed, own = observed(robot, arm, observer, 0.6, swing)
    dry = np.array(robot.config.friction)
    assert (np.abs(free) < 0.25 + 0.5 * dry).all()  # joints turn back within the average
    assert (np.abs(pushed - own) < 0.25 + 0.5 * dry).all()
    assert np.abs(own).max() > 4.0


@pytest.mark.parametrize("known", [False, True])
def test_payload_that_the_model_lacks_shows_as_its_weight(robot, known):
    arm = SimulatedArm(robot, seed=3, table_height=None, config=ArmConfig(
        torque_noise=0.0, torque_bias=0.0, friction_error=0.0, payload=0.5))
    observer = MomentumObserver(robot, drive_model(robot, payload_mass=0.5 if known else 0.0))
    seen, own = observed(robot, arm, observer, 0.6, swing)
    weight = robot.tool_jacobian(arm.true_positions)[:3].T @ np.array([0.0, 0.0, -0.5 * 9.81])
    np.testing.assert_allclose(own, weight, atol=0.6)  # the mean over a swing
    dry = np.array(robot.config.friction)
    assert (np.abs(seen - (0.0 if known else own)) < 0.25 + 0.5 * dry).all()
    assert np.abs(weight).max() > 2.0


def test_wrist_sensor_shows_the_hand_as_the_arms_own_estimate_does(robot):
    arm = SimulatedArm(robot, seed=3, table_height=None, config=DRIVES)
    to_torque = make_converter(robot, ExternalTorqueConfig(source="wrench"))
    torques = []
    for k in range(700):
        if k == 450:
            arm.push(PUSH)
        arm.step()
        state = RobotState(time=arm.time, positions=arm.true_positions, velocities=arm.true_velocities)
        torques.append(to_torque(state, arm.wrist_wrench()))
    assert torques[100] is None
    assert np.abs(np.mean(torques[350:450], axis=0)).max() < 0.2
    jacobian = robot.tool_jacobian(arm.true_positions)
    np.testing.assert_allclose(np.mean(torques[600:], axis=0), jacobian.T @ PUSH, atol=0.3)


def test_noise_of_these_sensors_leaves_the_others_bytes_alone(robot):
    first, second = (SimulatedArm(robot, seed=5) for _ in range(2))
    for _ in range(20):
        first.step()
        second.step()
        second.measured_torque(), second.wrist_wrench()
    np.testing.assert_array_equal(first.external_torque(), second.external_torque())
    np.testing.assert_array_equal(first.state().positions, second.state().positions)
