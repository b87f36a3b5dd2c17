from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.types import Trajectory
from unifeed_ros.simulation.arm import SimulatedArm
from unifeed_ros.simulation.person import PersonConfig, SimulatedPerson, worst_spans
from unifeed_ros.simulation.tasks import endpoints, straight_line
from unifeed_ros.simulation.wish import smooth_deviation, wish_along


def guide(robot, person, start, seed, limit_s=10.0):
    """Let the person guide a weightless arm; returns the tool's path and the wrenches."""
    arm = SimulatedArm(robot, seed=seed)
    arm.reset(start)
    person.begin_demonstration(start)
    tool, wrenches = [], []
    while not person.finished and arm.time < limit_s:
        state = arm.state()
        wrench = person.hand_wrench(state.time, state.positions, state.velocities)
        arm.push(wrench)
        arm.command(np.zeros(robot.n) if robot.config.compensates_gravity else robot.gravity(state.positions))
        arm.step()
        tool.append(robot.tool_pose(state.positions)[0])
        wrenches.append(wrench)
    return np.array(tool), np.array(wrenches)


@pytest.fixture(scope="module")
def demonstration(panda, quick_yardstick):
    start, _ = endpoints(panda, quick_yardstick.task.scene)
    person = SimulatedPerson(quick_yardstick, seed=1)
    tool, wrenches = guide(panda, person, start, seed=1)
    assert person.finished
    return tool, wrenches


def test_a_demonstration_reaches_the_goal(demonstration, quick_yardstick):
    tool, _ = demonstration
    assert np.linalg.norm(tool[-1] - quick_yardstick.task.scene.goal) < 0.03
    assert 2.0 < 0.001 * len(tool) < 6.0


def test_the_hand_stays_within_a_persons_strength_and_starts_and_ends_softly(demonstration):
    _, wrenches = demonstration
    force, torque = np.linalg.norm(wrenches[:, :3], axis=1), np.linalg.norm(wrenches[:, 3:], axis=1)
    assert force.max() <= 30.0 + 1e-9 and torque.max() <= 5.0 + 1e-9
    assert force[:5].max() < 1.0 and force[-5:].max() < 1.0


def test_a_demonstration_deviates_by_centimetres(demonstration, panda, quick_yardstick):
    tool, _ = demonstration
    best = wish_along(panda, quick_yardstick.optimum, (0.0, 0.0, -1.0)).positions
    off = np.array([np.linalg.norm(best - x, axis=1).min() for x in tool])
    assert 0.003 < off.max() < 0.12


def test_the_same_seed_is_the_same_person(panda, quick_yardstick):
    start, _ = endpoints(panda, quick_yardstick.task.scene)
    (first, _), (second, _) = (guide(panda, SimulatedPerson(quick_yardstick, seed=4), start, seed=0, limit_s=1.0)
                               for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_hand_that_pulls_on_a_fixed_arm_stays_within_limits_and_waits(panda, quick_yardstick):
    start, _ = endpoints(panda, quick_yardstick.task.scene)
    person = SimulatedPerson(quick_yardstick, seed=2)
    person.begin_demonstration(start)
    forces = [np.linalg.norm(person.hand_wrench(t, start, np.zeros(7))[:3]) for t in np.arange(0.0, 5.0, 0.002)]
    assert 20.0 < max(forces) <= 30.0 + 1e-9
    assert not person.finished


def late_line(robot, yardstick):
    line = straight_line(robot, yardstick.task.scene, 50)
    share = np.linspace(0.0, 1.0, 50)[:, None] ** 3
    return replace(line, positions=line.positions[0] + share * (line.positions[-1] - line.positions[0]))


def test_a_correction_pulls_towards_the_wish_only_within_its_span(panda, quick_yardstick):
    planned = late_line(panda, quick_yardstick)
    person = SimulatedPerson(quick_yardstick, seed=3)
    person.begin_correction(planned)
    best = wish_along(panda, quick_yardstick.optimum, (0.0, 0.0, -1.0))
    touched = []
    for t in np.arange(0.0, planned.duration, 0.002):
        q = quick_yardstick.optimum.positions_at([t])[0] if touched else planned.positions_at([t])[0]
        wrench = person.hand_wrench(t, q, np.zeros(7), t)
        if np.linalg.norm(wrench) > 5.0 and not touched:
            wanted = best.states_at([t])[0, :3] - panda.tool_pose(q)[0]
            assert wrench[:3] @ wanted > 0.0
        if wrench.any():
            touched.append(t)
        assert np.linalg.norm(wrench[:3]) <= 30.0 + 1e-9
    assert 0.8 < touched[-1] - touched[0] <= 3.0 * PersonConfig().correction_span + PersonConfig().ramp + 0.01


def test_a_robot_that_stands_still_is_let_go(panda, quick_yardstick):
    planned = late_line(panda, quick_yardstick)
    person = SimulatedPerson(quick_yardstick, seed=3)
    person.begin_correction(planned)
    for t in np.arange(0.0, 8.0, 0.005):
        q = planned.positions_at([min(t, 1.5)])[0]
        person.hand_wrench(t, q, np.zeros(7), min(t, 1.5))
    assert person.finished


def test_a_good_motion_is_left_alone_unless_a_push_is_asked_for(panda, quick_yardstick):
    wish = wish_along(panda, quick_yardstick.optimum, (0.0, 0.0, -1.0))
    choosy = PersonConfig(corrections=2)
    assert worst_spans(quick_yardstick, wish, quick_yardstick.optimum, choosy) == []
    assert not SimulatedPerson(quick_yardstick, seed=0).begin_correction(quick_yardstick.optimum)
    assert len(worst_spans(quick_yardstick, wish, quick_yardstick.optimum, PersonConfig(always_correct=True))) == 1
    spans = worst_spans(quick_yardstick, wish, late_line(panda, quick_yardstick), replace(choosy, correction_span=1.0))
    assert len(spans) == 2
    assert all(first[1] <= second[0] + 1e-9 for first, second in pairwise(spans))


def options(robot, yardstick, shares):
    """Motions between the straight line and the best one."""
    line = straight_line(robot, yardstick.task.scene, 301)
    return [Trajectory(joint_names=line.joint_names, times=line.times,
                       positions=line.positions + share * (yardstick.optimum.positions - line.positions))
            for share in shares]


def test_rankings_follow_the_luce_rule(panda, quick_yardstick):
    pair = options(panda, quick_yardstick, (0.5, 0.53))
    returns = [quick_yardstick.task.returns(panda, motion, 20) for motion in pair]
    assert 0.1 < returns[1] - returns[0] < 0.5
    person = SimulatedPerson(quick_yardstick, seed=0)
    wins = np.mean([person.rank(pair) == (1, 0) for _ in range(300)])
    expected = 1.0 / (1.0 + np.exp(-person.config.rationality * (returns[1] - returns[0])))
    assert wins == pytest.approx(expected, abs=0.08)


def test_clear_differences_are_ranked_right_and_equal_motions_tie(panda, quick_yardstick):
    person = SimulatedPerson(quick_yardstick, seed=0)
    assert person.rank(options(panda, quick_yardstick, (0.5, 1.0, 0.0))) == (1, 0, 2)
    assert person.rank([quick_yardstick.optimum] * 2) == (0, 0)
    with pytest.raises(InputError):
        person.rank([quick_yardstick.optimum])


def test_deviations_keep_the_ends_they_are_given():
    rng = np.random.default_rng(0)
    offsets = smooth_deviation(rng, 0.02, start=(0.1, 0.0, 0.0), end=(0.0, 0.0, 0.05))(np.linspace(0.0, 1.0, 50))
    np.testing.assert_allclose(offsets[0], (0.1, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(offsets[-1], (0.0, 0.0, 0.05), atol=1e-12)
    assert np.abs(np.diff(offsets, axis=0)).max() < 0.02


def test_nobody_is_that_impatient():
    with pytest.raises(ConfigError, match="pace"):
        PersonConfig(pace=0.0)
