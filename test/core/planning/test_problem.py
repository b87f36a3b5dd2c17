"""Costs, constraints and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.kinematics import Kinematics
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.planning.sampling import sample_spline
from unifeed_ros.core.planning.starts import straight_line


def make_problem(case, reward, *, goal=True, **settings):
    config = PlannerConfig(**{"waypoints": 8, **settings})
    end = case.goal if goal else None
    bounds = motion_bounds(case.robot, case.scene, case.start, end, config)
    return PlanningProblem(case.robot, reward, case.start, end, 3.0, bounds, config)


def _nearby(problem, seed):
    waypoints = straight_line(problem)
    waypoints[problem.free] += np.random.default_rng(seed).normal(scale=0.2, size=waypoints[problem.free].shape)
    return waypoints


def _differences(function, waypoints, free, step=1e-6):
    """Central differences by each free joint; the function's value in front."""
    columns = []
    for k in free:
        for j in range(waypoints.shape[1]):
            values = []
            for sign in (1, -1):
                moved = waypoints.copy()
                moved[k, j] += sign * step
                values.append(np.asarray(function(moved)))
            columns.append((values[0] - values[1]) / (2 * step))
    return np.stack(columns, axis=-1)


def test_tool_states_are_the_robots(case):
    postures = case.start + np.random.default_rng(0).normal(scale=0.4, size=(10, case.robot.n))
    pose = Kinematics(case.robot).evaluate(postures)
    states, jacobians = case.robot.tool_states_and_jacobians(postures)
    np.testing.assert_allclose(pose.states, states, atol=1e-12)
    np.testing.assert_allclose(pose.state_jacobians, jacobians, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), goal=st.booleans())
def test_cost_gradient_matches_differences(panda, rewards, seed, goal):
    problem = make_problem(panda, rewards["network"](1), goal=goal, smoothness=0.3)
    waypoints = _nearby(problem, seed)
    at = problem.evaluate(waypoints)
    numeric = _differences(lambda q: problem.evaluate(q).cost, waypoints, problem.free)
    np.testing.assert_allclose((at.reward_gradients + at.roughness_gradient).ravel(), numeric, atol=1e-6)


def test_roughness_hessian_is_exact(case):
    problem = make_problem(case, None)
    waypoints = _nearby(problem, 3)
    numeric = _differences(lambda q: problem.evaluate(q).roughness_gradient.ravel(), waypoints, problem.free, 1e-3)
    exact = np.kron(problem.roughness_hessian, np.diag(problem.roughness_weights))
    np.testing.assert_allclose(numeric, exact, atol=1e-5 * np.abs(exact).max())


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(0.01, 0.5))
def test_rates_bound_the_spline_everywhere(panda, seed, scale):
    problem = make_problem(panda, None, waypoints=12)
    waypoints = straight_line(problem)
    waypoints[problem.free] += np.random.default_rng(seed).normal(scale=scale, size=waypoints[problem.free].shape)
    motion = sample_spline(waypoints, problem.duration, panda.robot.joint_names, 500.0)
    shares = np.abs(problem.rate_shares(waypoints)) * (1.0 - 0.02)
    accelerations, velocities = shares[:12].max(axis=0), shares[12:].max(axis=0)
    tolerance = 1e-3 * shares.max() + 1e-9
    fastest, hardest = np.abs(motion.velocities).max(axis=0), np.abs(motion.accelerations).max(axis=0)
    assert (hardest / panda.robot.acceleration_limits <= accelerations + tolerance).all()
    assert (fastest / panda.robot.velocity_limits <= velocities + tolerance).all()


def test_roughness_costs_at_most_its_weight_at_full_acceleration(case):
    problem = make_problem(case, None)
    line = straight_line(problem)
    full = np.abs(problem.rate_shares(line)[: problem.count]).max()
    cost = problem.evaluate(case.start + (line - case.start) / full).cost
    assert 0 < cost <= problem.smoothness * problem.count


def test_cost_does_not_depend_on_the_rewards_unit(panda, rewards):
    one, many = (make_problem(panda, rewards["near"](panda.scene.goal, gain)) for gain in (1.0, 40.0))
    waypoints = _nearby(one, 0)
    assert many.scale == pytest.approx(40.0 * one.scale)
    assert many.evaluate(waypoints).cost == pytest.approx(one.evaluate(waypoints).cost)


def test_a_reward_that_is_not_finite_is_refused(panda):
    class Broken:
        def value_and_gradient(self, tool_states):
            return np.full(len(tool_states), np.nan), np.zeros_like(tool_states)

    with pytest.raises(PlanningError, match="reward is not finite"):
        make_problem(panda, Broken())


def test_way_points_beside_a_miss_have_to_come_farther_than_they_are(case):
    """Also where they are well away: a tool that hurries past a corner misses it between them."""
    problem = make_problem(case, None)
    waypoints = straight_line(problem)
    tool = len(problem.bounds.constraints[0].names) - 1  # its height over the table
    shortfalls = np.zeros((70, problem.evaluate(waypoints).clearances.shape[1]))
    shortfalls[66, tool] = 1e-5  # between the last two
    raised = problem.raised(waypoints, shortfalls, np.zeros(problem.joints)).evaluate(waypoints)
    before = problem.evaluate(waypoints)
    assert before.clearances[-1, tool] > 0.03 and before.violation == 0.0
    np.testing.assert_array_equal(raised.shortfalls > 3e-4, problem.free == 6)
