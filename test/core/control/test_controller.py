"""The shared controller on the simulated arm, 500 Hz, with the delay that middleware adds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from control_loop import PERIOD, ROBOTS, Loop, minimum_jerk

from unifeed_ros.core.control.controller import SharedController
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.types import RobotState


@pytest.fixture(params=sorted(ROBOTS))
def robot(request):
    return ROBOTS[request.param]


@pytest.mark.parametrize(("delay", "seed", "impedance"), [
    (0, 1, "joint"), (3, 2, "joint"), (6, 3, "joint"), (3, 2, "tool"), (6, 3, "tool")])
def test_tracks_closely_in_spite_of_friction_noise_and_delay(robot, delay, seed, impedance):
    loop = Loop(robot, delay=delay, seed=seed, impedance=impedance)
    motion = loop.start_tracking()
    first = len(loop.commands)
    joint_errors, tool_errors, start = [], [], loop.arm.time
    while loop.arm.time < start + motion.duration:
        loop.run(0.01)
        wanted = motion.positions_at([loop.arm.time - start])[0]
        joint_errors.append(loop.arm.true_positions - wanted)
        tool_errors.append(loop.arm.tool_position - robot.tool_pose(wanted)[0])
    loop.run(0.3)
    tool = np.array(loop.tool[first:])
    assert np.linalg.norm(np.diff(tool, axis=0), axis=1).max() / PERIOD > 0.5
    assert np.sqrt(np.mean(np.square(joint_errors))) < (5e-3 if impedance == "joint" else 15e-3)
    assert np.linalg.norm(tool_errors, axis=1).max() < 5e-3
    assert min(c.authority for c in loop.commands[first:]) == 1.0
    assert loop.commands[-1].finished
    assert loop.commands[-1].control is Control.ROBOT


@pytest.mark.parametrize(("push", "impedance"), [
    ((0.0, 0.0, 20.0), "joint"), ((0.0, 20.0, 0.0), "joint"), ((0.0, 20.0, 0.0), "tool")])
def test_yields_to_the_hand_and_comes_back_to_the_plan(robot, push, impedance):
    loop = Loop(robot, impedance=impedance)
    motion = loop.start_tracking(duration=5.0)
    loop.run(1.2)
    path = robot.tool_states(motion.resampled(500))[:, :3]

    def off_path():
        return np.linalg.norm(path - loop.arm.tool_position, axis=1).min()

    before = loop.arm.tool_position
    assert off_path() < 5e-3
    loop.run(0.5, push)
    assert loop.commands[-1].control is Control.PERSON
    assert loop.commands[-1].authority < 0.05
    assert loop.commands[-1].force == pytest.approx(20.0, rel=0.3)
    held = loop.run(0.3, push).commands[-1].motion_time
    assert (loop.arm.tool_position - before) @ np.array(push) / 20.0 > 0.1
    loop.run(1.5)
    assert off_path() < 0.02
    assert loop.commands[-1].control is Control.ROBOT
    assert loop.commands[-1].motion_time >= held
    times = [c.motion_time for c in loop.commands if c.motion_id]
    assert (np.diff(times) >= 0).all()
    assert loop.largest_torque_step <= loop.controller.config.torque_rate * PERIOD + 1e-9
    loop.run(4.5)
    assert loop.commands[-1].finished
    assert np.linalg.norm(loop.arm.tool_position - path[-1]) < 5e-3


@pytest.mark.parametrize("push", [(0.0, 0.0, 20.0), (0.0, -20.0, 0.0)])
def test_the_arm_is_back_on_the_plan_within_a_second_and_a_half(push):
    robot = ROBOTS["panda"]
    loop = Loop(robot)
    path = robot.tool_states(loop.start_tracking(duration=6.0).resampled(600))[:, :3]
    loop.run(1.5).run(0.8, push)
    assert np.linalg.norm(path - loop.arm.tool_position, axis=1).min() > 0.1
    loop.run(1.5)
    assert np.linalg.norm(path - loop.arm.tool_position, axis=1).min() < 0.02


@pytest.mark.parametrize("where", [(0.0, 20.0, 0.0), (0.0, 0.0, 20.0)])
def test_a_hand_that_keeps_holding_feels_no_jolt(where):
    """The hand stays where it has pushed the tool to, with 300 N/m, and feels authority come and go."""
    loop = Loop(ROBOTS["panda"])
    loop.start_tracking(duration=6.0)
    loop.run(1.5)
    loop.run(0.8, where)
    held, felt = loop.arm.tool_position, []
    for _ in range(3000):
        jacobian = loop.robot.tool_jacobian(loop.arm.true_positions)[:3]
        force = 300.0 * (held - loop.arm.tool_position) - 40.0 * jacobian @ loop.arm.true_velocities
        felt.append(force)
        loop.arm.push([*force, 0.0, 0.0, 0.0])
        loop.step()
    felt = np.array(felt)[300:]  # the hand that pushed has become one that holds
    assert np.linalg.norm(felt, axis=1).max() > 1.0
    assert np.linalg.norm(felt[100:] - felt[:-100], axis=1).max() < 10.0


def test_a_weightless_arm_follows_a_pull_and_stays_when_nobody_touches(robot):
    loop = Loop(robot)
    loop.controller.guide(loop.arm.state())
    start = loop.arm.tool_position
    loop.run(2.0)
    assert np.linalg.norm(loop.arm.tool_position - start) < 0.01
    assert loop.commands[-1].control is Control.NOBODY
    loop.run(1.0, (0.0, 0.0, -10.0))
    assert start[2] - loop.arm.tool_position[2] > 0.05
    loop.run(1.0)
    left = loop.arm.tool_position
    loop.run(1.0)
    assert np.linalg.norm(loop.arm.tool_position - left) < 0.01


def test_a_hold_gives_way_and_stays_where_it_is_left(robot):
    loop = Loop(robot)
    loop.controller.hold(loop.arm.state())
    start = loop.run(1.0).arm.tool_position
    left = loop.run(1.0, (0.0, 20.0, 0.0)).arm.tool_position
    assert left[1] - start[1] > 0.1
    loop.run(1.5)
    assert np.linalg.norm(loop.arm.tool_position - left) < 0.06
    assert loop.commands[-1].authority == 1.0


def test_a_stop_in_full_motion_brakes_holds_softly_and_lasts(robot):
    loop = Loop(robot)
    motion = loop.start_tracking()
    loop.run(1.5)
    loop.controller.stop("tested")
    loop.run(0.5)
    stopped = loop.arm.tool_position
    assert np.abs(loop.arm.true_velocities).max() < 0.1
    loop.run(1.0)
    assert np.abs(loop.arm.true_velocities).max() < 0.01
    command = loop.commands[-1]
    assert np.linalg.norm(loop.arm.tool_position - stopped) < 0.01
    assert command.mode is TeachingMode.STOPPED and command.message == "stopped: tested"
    assert loop.largest_torque_step <= loop.controller.config.torque_rate * PERIOD + 1e-9
    loop.controller.stop("again")
    assert loop.run(0.01).commands[-1].message == "stopped: tested"
    with pytest.raises(InputError, match="stopped"):
        loop.controller.track(motion, "m2", loop.arm.state())
    loop.controller.hold(loop.arm.state())
    assert loop.run(0.1).commands[-1].mode is TeachingMode.HOLD


def test_a_hold_in_full_motion_brakes_gently(robot):
    loop = Loop(robot)
    loop.start_tracking()
    loop.run(1.5)
    moving = loop.arm.tool_position
    loop.controller.hold(loop.arm.state())
    loop.run(1.2)
    assert np.abs(loop.arm.true_velocities).max() < 0.02
    assert np.linalg.norm(loop.arm.tool_position - moving) < 0.25
    assert loop.largest_torque_step <= loop.controller.config.torque_rate * PERIOD + 1e-9


def test_switching_between_modes_in_motion_keeps_the_torque_continuous(robot):
    loop = Loop(robot)
    loop.start_tracking()
    loop.run(1.0)
    for choose in (loop.controller.guide, loop.controller.hold, loop.controller.guide, loop.controller.hold):
        choose(loop.arm.state())
        loop.run(0.4)
    assert loop.largest_torque_step <= loop.controller.config.torque_rate * PERIOD + 1e-9
    assert np.abs(loop.arm.true_velocities).max() < 0.5


def test_a_pause_of_the_middleware_is_survived(robot):
    loop = Loop(robot)
    motion = loop.start_tracking()
    loop.run(1.0)
    for _ in range(40):
        loop.arm.step()
    loop.run(motion.duration)
    assert loop.commands[-1].finished


def tracking_controller(robot):
    state = RobotState(time=0.0, positions=np.array(robot.config.seed), velocities=np.zeros(robot.n))
    controller = SharedController(robot)
    controller.hold(state)
    controller.step(state, np.zeros(robot.n))
    goal = state.positions + 0.1
    controller.track(minimum_jerk(robot, state.positions, goal, 2.0), "m1", state)
    return controller, state


def at(state, time, **changes):
    return RobotState(**({"time": time, "positions": state.positions, "velocities": state.velocities} | changes))


@pytest.mark.parametrize(("what", "word"), [
    ({"positions": np.full(3, 0.0)}, "positions"), ({"velocities": np.full(3, 0.0)}, "velocities"),
    ({"positions": "nan"}, "finite"), ({"velocities": "fast"}, "moves at")])
def test_a_bad_state_stops_and_the_last_good_one_holds_the_weight(robot, what, word):
    controller, state = tracking_controller(robot)
    values = {"nan": np.full(robot.n, np.nan), "fast": np.full(robot.n, 50.0)}
    bad = at(state, 0.002, **{k: values.get(v, v) if isinstance(v, str) else v for k, v in what.items()})
    command = controller.step(bad, np.zeros(robot.n))
    assert command.mode is TeachingMode.STOPPED
    assert word in command.message
    assert np.isfinite(command.torque).all()
    with pytest.raises(InputError):
        controller.hold(bad)


def test_an_arm_whose_joints_are_swapped_is_braked_and_left_to_its_driver(robot):
    """Torques for a posture that it is not in would throw it; after a moment it is left to its driver."""
    loop = Loop(robot)
    loop.start_tracking()
    loop.run(1.0)
    before = loop.arm.true_positions
    true_state, swapped = loop.arm.state, np.roll(np.arange(robot.n), 1)

    def swap():
        state = true_state()
        return RobotState(time=state.time, positions=state.positions[swapped], velocities=state.velocities[swapped])

    loop.arm.state = swap
    loop.run(1.0)
    assert loop.commands[-1].mode is TeachingMode.STOPPED and "jumped" in loop.commands[-1].message
    assert np.abs(loop.arm.true_positions - before).max() < 0.15
    assert loop.commands[-1].torque is None
    stopped = [command for command in loop.commands if command.mode is TeachingMode.STOPPED]
    assert 0.08 < PERIOD * sum(command.torque is not None for command in stopped) < 0.12
    loop.arm.state = true_state
    loop.controller.hold(loop.arm.state())
    loop.run(1.0)
    assert loop.commands[-1].mode is TeachingMode.HOLD


def test_an_arm_whose_states_freeze_is_left_to_its_driver_until_they_change(robot):
    loop = Loop(robot)
    loop.start_tracking()
    loop.run(1.0)
    before, true_state, last = loop.arm.true_positions, loop.arm.state, loop.arm.state()
    loop.arm.state = lambda: RobotState(time=true_state().time, positions=last.positions, velocities=last.velocities)
    loop.run(1.0)
    assert loop.commands[-1].mode is TeachingMode.STOPPED and "have not changed" in loop.commands[-1].message
    assert loop.commands[-1].torque is None
    assert np.abs(loop.arm.true_positions - before).max() < 0.3
    loop.arm.state = true_state
    loop.run(0.5)
    loop.controller.hold(loop.arm.state())
    loop.run(0.5)
    assert loop.commands[-1].mode is TeachingMode.HOLD and loop.commands[-1].torque is not None


@pytest.mark.parametrize("torque", [np.zeros(2), np.full(7, np.nan), np.full(6, np.inf)])
def test_a_bad_external_torque_stops(robot, torque):
    controller, state = tracking_controller(robot)
    assert controller.step(at(state, 0.002), torque).mode is TeachingMode.STOPPED


def test_stale_input_stops_within_a_tenth_of_a_second(robot):
    controller, state = tracking_controller(robot)
    torque = np.zeros(robot.n)
    assert controller.step(state, torque, now=0.09).mode is TeachingMode.TRACK
    command = controller.step(state, torque, now=0.11)
    assert command.mode is TeachingMode.STOPPED
    assert "no joint state" in command.message
    controller, state = tracking_controller(robot)
    modes = [controller.step(at(state, k * 0.01), None).mode for k in range(1, 13)]
    assert modes[8] is TeachingMode.TRACK and modes[-1] is TeachingMode.STOPPED


def test_a_leap_of_the_clock_is_not_taken_for_a_dead_torque_sensor(robot):
    controller, state = tracking_controller(robot)
    controller.step(at(state, 0.002), np.zeros(robot.n))
    assert controller.step(at(state, 0.4), None).mode is TeachingMode.TRACK
    assert controller.step(at(state, 0.402), np.zeros(robot.n)).mode is TeachingMode.TRACK


def test_nothing_is_sent_before_a_mode_is_chosen_and_after_deactivation(robot):
    controller = SharedController(robot)
    state = RobotState(time=0.0, positions=np.array(robot.config.seed), velocities=np.zeros(robot.n))
    assert controller.step(state, None).torque is None
    controller.hold(state)
    command = controller.step(at(state, 0.002), None)
    weight = np.zeros(robot.n) if robot.config.compensates_gravity else robot.gravity(state.positions)
    np.testing.assert_allclose(command.torque, weight, atol=2.1)
    controller.deactivate()
    assert controller.step(at(state, 0.004), None).torque is None
    controller.stop("tested")
    assert controller.step(at(state, 0.006), None).torque is not None


def test_a_motion_that_starts_elsewhere_is_refused_and_nothing_changes(robot):
    controller, state = tracking_controller(robot)
    controller.hold(state)
    elsewhere = minimum_jerk(robot, state.positions + 0.2, state.positions + 0.3, 2.0)
    with pytest.raises(InputError, match="starts elsewhere"):
        controller.track(elsewhere, "m2", state)
    assert controller.step(at(state, 0.002), np.zeros(robot.n)).mode is TeachingMode.HOLD


def pushed_aside(robot, push=(0.0, 25.0, 0.0), patience=1.0):
    """An arm that a person has pushed off a motion of six seconds, as they let go; gives loop and motion."""
    loop = Loop(robot)
    loop.controller.hold(loop.arm.state())
    loop.run(1.0)
    motion = loop.straight_motion(duration=6.0)
    loop.controller.track(motion, "m1", loop.arm.state(), patience)
    loop.run(1.5).run(0.8, push)
    return loop, motion


def test_an_arm_that_was_pushed_aside_waits_for_another_motion_and_then_comes_back(robot):
    loop, motion = pushed_aside(robot)
    loop.run(0.5)
    left, time = loop.arm.tool_position, loop.commands[-1].motion_time
    loop.run(0.6)
    assert np.linalg.norm(loop.arm.tool_position - left) < 0.02
    assert loop.commands[-1].motion_time - time < 0.02
    path = robot.tool_states(motion.resampled(600))[:, :3]
    assert np.linalg.norm(path - loop.arm.tool_position, axis=1).min() > 0.1
    loop.run(2.5)
    assert np.linalg.norm(path - loop.arm.tool_position, axis=1).min() < 0.02
    loop.run(6.0)
    assert any(command.finished for command in loop.commands)


def test_a_touch_that_leaves_the_arm_on_its_motion_makes_it_wait_for_nothing(robot):
    times = []
    for patience in (0.0, 5.0):
        loop, _ = pushed_aside(robot, (0.0, 0.0, 0.0), patience)
        loop.run(0.05, (0.0, 25.0, 0.0)).run(2.0)
        times.append(loop.commands[-1].motion_time)
    assert times[0] == times[1] > 3.5


def test_a_motion_is_replaced_on_its_way_without_a_jump_but_never_under_the_hand(robot):
    loop, motion = pushed_aside(robot)
    goal = motion.positions[-1]
    with pytest.raises(InputError, match="a person pushes"):
        loop.controller.track(minimum_jerk(robot, loop.arm.true_positions, goal, 3.0), "m2", loop.arm.state())
    assert loop.commands[-1].motion_id == "m1"
    loop.run(0.35)
    loop.commands.clear()
    rest = minimum_jerk(robot, loop.arm.true_positions, goal, 4.0)
    loop.controller.track(rest, "m2", loop.arm.state())
    loop.run(4.6)
    assert {command.motion_id for command in loop.commands} <= {"m2", ""}
    assert any(command.finished for command in loop.commands)
    assert loop.largest_torque_step <= 1.01 * loop.controller.config.torque_rate * PERIOD
    steps = np.linalg.norm(np.diff(loop.tool[-len(loop.commands):], axis=0), axis=1)
    planned = np.linalg.norm(np.diff(robot.tool_states(rest.positions)[:, :3], axis=0), axis=1)[:-1]
    assert steps.max() / PERIOD < 1.1 * planned.max() / 0.01
    np.testing.assert_allclose(loop.arm.true_positions, goal, atol=0.03)


def test_same_input_same_bytes(robot):
    def run():
        loop = Loop(robot)
        loop.start_tracking()
        loop.run(0.5).run(0.5, (0.0, 15.0, 0.0))
        return np.array([c.torque for c in loop.commands]).tobytes()

    assert run() == run()


@pytest.mark.parametrize(("category", "largest"), [("hold", None), ("gravity_compensation", None), ("zero", 0.0)])
def test_a_stop_ends_as_its_category_says(category, largest):
    robot = ROBOTS["panda"]
    loop = Loop(robot, stop_category=category)
    loop.start_tracking()
    loop.run(1.0)
    loop.controller.stop("tested")
    loop.run(0.6)
    assert loop.largest_torque_step <= loop.controller.config.torque_rate * PERIOD + 1e-9
    if largest is not None:
        np.testing.assert_array_equal(loop.commands[-1].torque, np.zeros(robot.n))
        return
    assert np.abs(loop.arm.true_velocities).max() < 0.1
    place = loop.arm.tool_position
    loop.run(0.5, (0.0, 0.0, 10.0))
    moved = loop.arm.tool_position[2] - place[2]
    assert moved > 0.05 if category == "gravity_compensation" else moved < 0.03
    assert loop.commands[-1].mode is TeachingMode.STOPPED


@pytest.mark.parametrize("limits", [
    {"tool_speed": 0.3}, {"tool_force": 8.0}, {"workspace": (0.0, -0.3, 0.0, 1.0, 1.0, 1.0)}])
def test_limits_at_the_tool_stop_a_motion_that_a_hand_drives_beyond_them(limits):
    loop = Loop(ROBOTS["panda"], **limits)
    loop.controller.guide(loop.arm.state())
    loop.run(0.3)
    assert loop.commands[-1].mode is TeachingMode.GUIDE
    loop.run(0.9, (0.0, -20.0, 0.0))
    assert loop.commands[-1].mode is TeachingMode.STOPPED
    assert any(word in loop.commands[-1].message for word in ("m/s", " N,", "workspace"))
    loop.run(1.0)
    loop.controller.guide(loop.arm.state())
    assert loop.run(0.2).commands[-1].mode is TeachingMode.GUIDE


@pytest.mark.parametrize("limits", [{"tool_speed": 0.3}, {"workspace": (0.0, -0.2, 0.0, 1.0, 1.0, 1.0)}])
def test_a_motion_beyond_the_limits_at_the_tool_is_refused(limits):
    loop = Loop(ROBOTS["panda"], **limits)
    with pytest.raises(InputError, match=r"too fast for the tool|leaves the workspace"):
        loop.start_tracking()


@pytest.mark.parametrize("output", ["setpoint", "trajectory"])
def test_an_arm_with_a_controller_of_its_own_tracks_yields_and_comes_back(output):
    """A stiff servo does not move under the hand: with "trajectory" the set-point goes where the torque moves it."""
    robot = ROBOTS["panda"]
    loop = Loop(robot, output=output)
    motion = loop.start_tracking(duration=5.0)
    loop.run(1.5)
    place, push = loop.arm.tool_position, np.array([0.0, 0.0, 12.0])
    assert np.abs(loop.arm.true_positions - motion.positions_at([1.5])[0]).max() < 0.05
    loop.run(0.8, push)
    assert loop.arm.tool_position[2] - place[2] > 0.1
    assert loop.commands[-1].stiffness.max() < 20.0
    loop.run(6.0)
    assert loop.commands[-1].finished
    assert np.linalg.norm(loop.arm.tool_position - robot.tool_pose(motion.positions[-1])[0]) < 0.01
    targets = np.array([c.setpoint.positions for c in loop.commands])
    assert (np.abs(np.diff(targets, axis=0)) <= 1.5 * PERIOD * robot.velocity_limits + 1e-9).all()


def test_an_arm_that_does_not_obey_is_noticed_and_not_pulled_at():
    robot = ROBOTS["panda"]
    loop = Loop(robot)
    loop.start_tracking()
    loop.run(1.0)
    loop.arm.command(None)
    loop.arm.command = lambda torque: None
    loop.run(1.5)
    stopped = next(c for c in loop.commands if c.mode is TeachingMode.STOPPED)
    assert "check that the robot's driver obeys" in stopped.message
    loop.run(1.0)
    assert np.abs(loop.arm.true_velocities).max() < 0.05
