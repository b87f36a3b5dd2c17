"""Whole plans: followable, as good as they can be, honest about what went wrong."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError, InputError, PlanningError, ShapeError
from unifeed_ros.core.planning.check import check_motion, motion_bounds
from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.robot import RobotModel

CONFIG = PlannerConfig(time_budget=30.0)


def plan(case, reward, *, start=None, goal="task", duration=3.0, config=CONFIG, **options):
    return plan_motion(case.robot, reward, case.start if start is None else start,
                       case.goal if isinstance(goal, str) else goal, duration=duration, scene=case.scene, config=config,
                       **options)


@pytest.mark.parametrize("seed", range(3))
def test_motion_for_a_learned_like_reward_is_followable(case, rewards, seed):
    result = plan(case, rewards["network"](seed))
    assert result.success and result.status == "solved", result.message
    motion = result.trajectory
    assert motion.duration == pytest.approx(3.0)
    np.testing.assert_allclose(motion.positions[[0, -1]], [case.start, case.goal], atol=1e-9)
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.resampled(CONFIG.waypoints), result.waypoints, atol=2e-3)
    bounds = motion_bounds(case.robot, case.scene, case.start, case.goal, CONFIG)
    assert check_motion(motion, bounds).ok


def test_motion_is_better_than_the_straight_line(case, rewards):
    for seed in range(3):
        reward = rewards["network"](seed)
        line = case.start + np.linspace(0, 1, CONFIG.waypoints)[:, None] * (case.goal - case.start)
        returns = [reward.value_and_gradient(case.robot.tool_states(q))[0].sum()
                   for q in (plan(case, reward).waypoints, line)]
        assert returns[0] > returns[1]


def test_without_a_goal_a_concave_reward_leads_to_its_optimum(case, rewards):
    target = np.array([0.45, -0.1, 0.4])
    result = plan(case, rewards["near"](target), goal=None, duration=4.0, config=replace(CONFIG, smoothness=1e-4))
    assert result.success
    np.testing.assert_allclose(case.robot.tool_states(result.waypoints[-1:])[0, :3], target, atol=5e-3)


def test_the_tool_stays_above_the_table_where_the_reward_pulls_it_down(case, rewards):
    result = plan(case, rewards["down"]())
    assert result.success, result.message
    heights = case.robot.tool_states(result.trajectory.positions)[:, 2]
    assert case.scene.floor - 2e-3 <= heights.min() < case.scene.floor + 0.01


def test_the_optimum_does_not_depend_on_the_rewards_unit(panda, rewards):
    one, many = (plan(panda, rewards["near"](panda.scene.goal, gain)) for gain in (1.0, 64.0))
    np.testing.assert_allclose(one.waypoints, many.waypoints, atol=1e-6)
    assert many.objective == pytest.approx(64.0 * one.objective)


def test_same_inputs_and_seed_give_the_same_bytes(panda, rewards):
    config = replace(CONFIG, starts=3, seed=5)
    one, two = (plan(panda, rewards["network"](0), config=config).trajectory for _ in range(2))
    assert one.positions.tobytes() == two.positions.tobytes()


def test_more_starts_are_never_worse(case, rewards):
    reward = rewards["network"](2)
    few, many = (plan(case, reward, config=replace(CONFIG, starts=starts)).objective for starts in (1, 4))
    assert many >= few


def test_a_good_seed_is_used(panda, rewards):
    best = plan(panda, rewards["network"](2), config=replace(CONFIG, starts=4))
    seeded = plan(panda, rewards["network"](2), config=replace(CONFIG, starts=1), seeds=[best.waypoints + 0.01])
    assert seeded.objective >= best.objective - 0.01
    with pytest.raises(ShapeError, match="seed"):
        plan(panda, None, seeds=[best.waypoints[:-1]])


def test_without_reward_it_is_the_smoothest_motion_at_a_duration_of_its_own(case):
    result = plan(case, None, duration=0.0)
    assert result.success
    assert 1.5 < result.trajectory.duration < 5.0
    assert plan(case, None, goal=case.start, duration=0.0).success  # already there


def test_too_short_a_duration_is_lengthened_and_said(case):
    result = plan(case, None, duration=1.6)
    assert result.success and "slowed down from 1.60 s" in result.message
    assert result.trajectory.duration > 1.8


@pytest.mark.parametrize(("changes", "error", "text"), [
    ({"duration": 0.3}, PlanningError, r"too far apart.*s or more, got 0\.30 s"),
    ({"duration": -1.0}, PlanningError, "duration"),
    ({"duration": float("nan")}, PlanningError, "duration"),
    ({"duration": 0.0, "goal": None}, PlanningError, "without a goal"),
    ({"start": np.zeros(3)}, ShapeError, "start of the motion"),
    ({"start": np.full(7, np.inf)}, InputError, "not finite"),
    ({"start": np.full(7, 9.0)}, InputError, "outside its limits"),
])
def test_contradictions_are_refused(panda, changes, error, text):
    with pytest.raises(error, match=text):
        plan(panda, None, **changes)


def test_an_arm_without_acceleration_says_that_there_is_no_motion(panda):
    weak = RobotModel(replace(panda.robot.config, acceleration_limits=(0.01,) * 7))
    with pytest.raises(PlanningError, match="too far apart"):
        plan(replace(panda, robot=weak), None)


def test_what_cannot_be_solved_is_called_infeasible(panda):
    """The straight line between two low ends dips below the floor; steps too small to mend that are not enough."""
    low = [panda.robot.inverse_kinematics(p, seed=panda.start) for p in ((0.35, 0.3, 0.051), (0.65, -0.3, 0.051))]
    result = plan(panda, None, start=low[0], goal=low[1], duration=4.0,
                  config=replace(CONFIG, max_iterations=1, starts=1, trust_radius=1e-4))
    assert not result.success and result.status == "infeasible"
    assert "comes down to" in result.message and result.violation > 0
    assert plan(panda, None, start=low[0], goal=low[1], duration=4.0).success


def test_cancel_is_followed_at_once(case, rewards):
    polled = []

    def should_stop():
        polled.append(time.thread_time())
        return len(polled) > 5

    config = replace(CONFIG, starts=50, max_iterations=1000)
    result = plan(case, rewards["network"](0), config=config, should_stop=should_stop)
    late = time.thread_time() - polled[5]
    assert result.status == "canceled" and not result.success and result.iterations == 5
    assert max(late, np.diff(polled).max()) < 0.05


def test_time_budget_ends_the_search_with_the_best_so_far(case, rewards):
    config = replace(CONFIG, starts=1000, time_budget=0.3)
    result = plan(case, rewards["network"](0), config=config)
    assert result.status == "time_budget" and result.success and "time budget" in result.message
    assert result.seconds < 0.3 + 1.0


def test_progress_is_reported_after_each_iteration(panda, rewards):
    log = []
    result = plan(panda, rewards["network"](1), on_iteration=log.append)
    assert [entry.iteration for entry in log] == list(range(1, result.iterations + 1))
    assert (np.diff([entry.best for entry in log if np.isfinite(entry.best)]) >= 0).all()
    assert log[-1].best == pytest.approx(result.objective)


def test_a_reward_that_breaks_on_the_way_is_a_planning_error(panda, rewards):
    class Breaking:
        calls = 0

        def value_and_gradient(self, tool_states):
            self.calls += 1
            values, gradients = rewards["network"](0).value_and_gradient(tool_states)
            return values * (np.nan if self.calls > 5 else 1.0), gradients

    with pytest.raises(PlanningError, match="reward is not finite"):
        plan(panda, Breaking())


@pytest.mark.parametrize("setting", [{"waypoints": 4}, {"starts": 0}, {"time_budget": 0.0}, {"smoothness": -1.0},
                                     {"margin": 0.9}, {"max_slowdown": 0.5}, {"tolerance": float("nan")}])
def test_settings_that_cannot_work_are_refused(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        PlannerConfig(**setting)


def test_adjusted_settings_keep_what_is_zero():
    assert PlannerConfig().adjusted() == PlannerConfig()
    assert PlannerConfig().adjusted(waypoints=30, time_budget=0.5) == PlannerConfig(waypoints=30, time_budget=0.5)
