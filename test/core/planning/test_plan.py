"""Whole plans: followable, as good as they can be, honest about what went wrong."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from unifeed_ros.core.errors import ConfigError, InputError, PlanningError, ShapeError, UnreachableError
from unifeed_ros.core.planning.check import TOLERANCE, check_motion, motion_bounds
from unifeed_ros.core.planning.plan import PlannerConfig, ToolGoal, plan_motion
from unifeed_ros.core.planning.sampling import rest_to_rest, sample_spline
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.zones import Cone, Zone

CONFIG = PlannerConfig(time_budget=30.0)


def plan(case, reward, *, start=None, goal="task", duration=3.0, config=CONFIG, scene=None, **options):
    return plan_motion(case.robot, reward, case.start if start is None else start,
                       case.goal if isinstance(goal, str) else goal, duration=duration, scene=scene or case.scene,
                       config=config, **options)


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
    assert case.scene.floor - TOLERANCE <= heights.min() < case.scene.floor + 0.01


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
    few, many = (plan(case, reward, config=replace(CONFIG, starts=starts, halving=0)).objective for starts in (1, 4))
    assert many >= few


def test_halving_gives_up_starts_early_and_keeps_the_best(case, rewards):
    reward = rewards["network"](2)
    all_of_them, halved = (plan(case, reward, config=replace(CONFIG, starts=4, halving=n)) for n in (0, 4))
    assert halved.iterations < 0.8 * all_of_them.iterations
    assert halved.objective == pytest.approx(all_of_them.objective, rel=0.01)
    alone, heats = (plan(case, reward, config=replace(CONFIG, starts=1, halving=n)) for n in (0, 4))
    assert heats.waypoints.tobytes() == alone.waypoints.tobytes()


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


def test_what_way_points_cannot_keep_is_slowed_down_first(case):
    """The tool would have to cover the way in less time than its speed allows."""
    scene = replace(case.scene, tool_speed=0.25)
    result = plan(case, None, scene=scene)
    assert result.success and "slowed down from 3.00 s" in result.message
    assert 3.0 < result.trajectory.duration <= 3.0 * CONFIG.max_slowdown
    assert 0.2 < _dense(case, result)[1].max() <= 0.25 + 1e-5


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


def test_what_cannot_be_solved_is_called_infeasible_with_the_numbers(panda):
    """Slower than the largest slowdown allows: no motion of that duration."""
    result = plan(panda, None, scene=replace(panda.scene, tool_speed=0.05))
    assert not result.success and result.status == "infeasible" and result.violation > 0
    assert re.search(r"the tool reaches 0\.\d+ m/s of 0\.0500 at \d\.\d\d s", result.message)
    assert np.isnan(result.first_feasible)


def test_a_line_that_dips_below_the_floor_is_mended(panda):
    low = [panda.robot.inverse_kinematics(p, seed=panda.start) for p in ((0.35, 0.3, 0.051), (0.65, -0.3, 0.051))]
    result = plan(panda, None, start=low[0], goal=low[1], duration=4.0)
    assert result.success and result.violation <= TOLERANCE
    line = low[0] + np.linspace(0, 1, 50)[:, None] * (low[1] - low[0])
    assert panda.robot.tool_states(line)[:, 2].min() < panda.scene.floor


def _dense(case, result, count=3001):
    """Tool states and speeds of a motion, from a spline of our own."""
    times = np.linspace(0.0, result.trajectory.duration, len(result.waypoints))
    spline = CubicSpline(times, result.waypoints, bc_type="clamped")
    fine = np.linspace(0.0, times[-1], count)
    states, jacobians = case.robot.tool_states_and_jacobians(spline(fine))
    return states, np.linalg.norm(np.einsum("kij,kj->ki", jacobians[:, :3], spline(fine, 1)), axis=1)


@pytest.mark.parametrize("waypoints", [20, 40])
def test_a_sphere_on_the_straight_line_is_avoided(case, rewards, waypoints):
    middle = case.robot.tool_pose(0.5 * (case.start + case.goal))[0]
    scene = replace(case.scene, zones={"ball": Zone(shape="sphere", position=middle, size=(0.08,))})
    config = replace(CONFIG, waypoints=waypoints)
    result = plan(case, rewards["network"](0), scene=scene, config=config)
    assert result.success and 0 < result.first_feasible <= result.seconds, result.message
    assert np.linalg.norm(_dense(case, result)[0][:, :3] - middle, axis=1).min() > 0.08 + config.body_clearance
    bounds = motion_bounds(case.robot, scene, case.start, case.goal, config)
    fine = sample_spline(result.waypoints, result.trajectory.duration, case.robot.joint_names, 1000.0)
    assert check_motion(fine, bounds).ok
    line = sample_spline(straight_line(case, waypoints), 6.0, case.robot.joint_names, 100.0)
    assert any("zone ball" in problem for problem in check_motion(line, bounds).problems)


def straight_line(case, count):
    return case.start + rest_to_rest(count)[:, None] * (case.goal - case.start)


def test_slow_zones_are_slow_and_elsewhere_is_not(case):
    middle = case.robot.tool_pose(0.5 * (case.start + case.goal))[0]
    zone = Zone(shape="sphere", position=middle, size=(0.1,), speed=0.15)
    result = plan(case, None, scene=replace(case.scene, zones={"careful": zone}), duration=4.0)
    assert result.success, result.message
    states, speeds = _dense(case, result)
    inside = zone.distance(states[:, :3])[0] < -1e-5
    assert speeds[inside].max(initial=0.0) <= 0.15 + 1e-5
    assert speeds.max() > 0.3


@pytest.mark.parametrize(("changes", "quantity"), [
    ({"tool_speed": 0.5}, lambda states, speeds: 0.5 - speeds.max()),
    ({"cones": {"upright": Cone(angle=0.2)}}, lambda states, speeds: (-states[:, 5]).min() - np.cos(0.2)),
    ({"workspace": (0.1, -0.5, 0.0, 0.66, 0.3, 0.61)}, lambda states, speeds: 0.66 - states[:, 0].max()),
])
def test_limits_of_the_tool_hold_between_way_points(case, rewards, changes, quantity):
    result = plan(case, rewards["network"](0), scene=replace(case.scene, **changes))
    assert result.success, result.message
    assert quantity(*_dense(case, result)) > -1e-5


def test_the_motion_hardly_depends_on_the_number_of_way_points(panda, rewards):
    thorough = replace(CONFIG, starts=4, halving=0)  # this reward has several local optima
    few, many = (plan(panda, rewards["network"](1), config=replace(thorough, waypoints=count)) for count in (20, 39))
    times = np.linspace(0.0, 3.0, 50)
    apart = panda.robot.tool_states(few.trajectory.positions_at(times)) - panda.robot.tool_states(
        many.trajectory.positions_at(times))
    assert np.abs(apart[:, :3]).max() < 0.03
    assert few.objective / 20 == pytest.approx(many.objective / 39, rel=0.05)


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, -1.0)])
def test_goals_of_the_tool_leave_the_posture_free(case, rewards, axis):
    goal = ToolGoal(position=case.scene.goal, axis=axis)
    result = plan(case, rewards["network"](2), goal=goal)
    assert result.success, result.message
    end = case.robot.tool_states(result.waypoints[-1:])[0]
    np.testing.assert_allclose(end[:3], case.scene.goal, atol=CONFIG.goal_tolerance + 1e-6)
    if axis is not None:
        np.testing.assert_allclose(end[3:], axis, atol=CONFIG.goal_tolerance + 1e-6)
    assert result.objective > plan(case, rewards["network"](2)).objective - 0.05
    with pytest.raises(UnreachableError):
        plan(case, None, goal=ToolGoal(position=(3.0, 0.0, 0.5), axis=axis))


def test_jerk_is_limited_on_request(case, rewards):
    free = plan(case, rewards["network"](0))
    result = plan(case, rewards["network"](0), config=replace(CONFIG, jerk_limit=20.0))
    assert result.success, result.message
    jerks = [np.abs(np.diff(r.trajectory.accelerations, axis=0) / np.diff(r.trajectory.times)[:, None]).max()
             for r in (result, free)]
    assert jerks[0] <= 20.0 * (1 + 1e-5) < jerks[1]


def test_cancel_is_followed_at_once(case, rewards):
    polled = []

    def should_stop():
        polled.append(None)
        return len(polled) > 5

    config = replace(CONFIG, starts=50, max_iterations=1000)
    result = plan(case, rewards["network"](0), config=config, should_stop=should_stop)
    assert result.status == "canceled" and not result.success and result.iterations == 4  # and the first start
    assert len(polled) == 6


def test_time_budget_ends_the_search_with_the_best_so_far(case, rewards):
    config = replace(CONFIG, starts=1000, time_budget=0.3)
    result = plan(case, rewards["network"](0), config=config)
    assert result.status == "time_budget" and result.success and "time budget" in result.message


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
                                     {"margin": 0.9}, {"max_slowdown": 0.5}, {"tolerance": float("nan")},
                                     {"goal": "near"}, {"body_clearance": -1.0}, {"jerk_limit": -1.0}])
def test_settings_that_cannot_work_are_refused(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        PlannerConfig(**setting)


def test_adjusted_settings_keep_what_is_zero():
    assert PlannerConfig().adjusted() == PlannerConfig()
    assert PlannerConfig().adjusted(waypoints=30, time_budget=0.5) == PlannerConfig(waypoints=30, time_budget=0.5)
    wary = PlannerConfig(kappa=1.0, jerk_limit=50.0, goal="free")
    assert wary.adjusted() == wary
    assert wary.adjusted(kappa=[0.0], jerk_limit=20.0, goal="pose") == PlannerConfig(jerk_limit=20.0, goal="pose")
