"""The search from one start: curvature, descent, and its optimum against an independent solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.baselines.slsqp import solve_with_slsqp
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.planning.sqp import first_curvature, iterations, merit, updated_curvature
from unifeed_ros.core.planning.starts import StartRepair, straight_line
from unifeed_ros.core.planning.subproblem import Subproblem


def make_problem(case, reward, config, duration=3.0):
    bounds = motion_bounds(case.robot, case.scene, case.start, case.goal, config)
    return PlanningProblem(case.robot, reward, case.start, case.goal, duration, bounds, config)


def _search(problem, config):
    first = problem.evaluate(StartRepair(problem).line)
    return [first, *iterations(problem, Subproblem(problem), first, first_curvature(problem, first), config)]


@given(seed=st.integers(0, 10_000), bend=st.floats(-5.0, 5.0))
def test_curvature_stays_positive_definite(seed, bend):
    rng = np.random.default_rng(seed)
    blocks = np.tile(np.eye(3), (4, 1, 1))
    for _ in range(5):
        change = rng.normal(scale=0.1, size=(4, 3))
        blocks = updated_curvature(blocks, change, bend * change + rng.normal(scale=0.1, size=(4, 3)))
        assert np.linalg.eigvalsh(blocks).min() > 0


def test_first_curvature_is_that_of_a_quadratic_cost(panda, rewards):
    problem = make_problem(panda, rewards["near"](np.array([0.5, 0.0, 0.4])), PlannerConfig())
    at = problem.evaluate(StartRepair(problem).line)
    measured = problem.reward_curvature(at, 1e-4)
    for k in (0, 7, len(problem.free) - 1):
        for joint in range(problem.joints):
            gradients = []
            for sign in (1.0, -1.0):
                moved = at.waypoints.copy()
                moved[problem.free[k], joint] += sign * 1e-4
                gradients.append(problem.evaluate(moved).reward_gradients[k])
            expected = (gradients[0] - gradients[1]) / 2e-4
            np.testing.assert_allclose(measured[k, joint], expected, atol=2e-3 * np.abs(measured[k]).max())
    blocks = first_curvature(problem, at)
    np.testing.assert_allclose(blocks, blocks.transpose(0, 2, 1), atol=1e-12)
    assert np.linalg.eigvalsh(blocks).min() >= 0.05 - 1e-9


def test_curvature_meets_the_secant_where_the_cost_is_convex():
    rng = np.random.default_rng(0)
    change = rng.normal(size=(4, 3))
    change[0] = 0.0  # did not move: keeps its curvature
    blocks = updated_curvature(np.tile(np.eye(3), (4, 1, 1)), change, 3.0 * change)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", blocks, change), 3.0 * change, atol=1e-9)
    np.testing.assert_array_equal(blocks[0], np.eye(3))


def test_merit_never_rises_and_linear_limits_hold(case, rewards):
    config = PlannerConfig()
    problem = make_problem(case, rewards["network"](3), config)
    search = _search(problem, config)
    merits = [merit(at) for at in search]
    assert (np.diff(merits) <= 0).all() and merits[-1] < merits[0]
    assert all(np.abs(problem.rate_shares(at.waypoints)).max() < 1.006 for at in search)
    assert all((at.waypoints >= case.robot.lower - 1e-9).all() for at in search)
    assert search[-1].violation < 1e-4


def test_smoothest_motion_is_the_linear_systems_solution(case):
    """Without a reward and with time enough, no limit is active and the optimum of the quadratic cost is known."""
    config = PlannerConfig()
    problem = make_problem(case, None, config, duration=6.0)
    hessian = np.kron(problem.roughness_hessian, np.diag(problem.roughness_weights))
    zero = problem.complete(np.zeros((len(problem.free), case.robot.n)))
    exact = np.linalg.solve(hessian, -problem.evaluate(zero).roughness_gradient.ravel())
    found = _search(problem, config)[-1]
    optimal = problem.evaluate(problem.complete(exact.reshape(len(problem.free), -1)))
    assert np.abs(problem.rate_shares(optimal.waypoints)).max() < 1.0
    assert optimal.violation == 0.0
    assert found.cost == pytest.approx(optimal.cost, abs=config.tolerance)
    np.testing.assert_allclose(found.waypoints, optimal.waypoints, atol=0.02)


@dataclass(frozen=True)
class _Raised:
    """A reward with a constant added, which moves the objective's zero and no optimum."""

    reward: Any
    constant: float

    def value_and_gradient(self, tool_states):
        values, gradients = self.reward.value_and_gradient(tool_states)
        return values + self.constant, gradients


def test_what_a_search_leaves_is_a_small_share_of_the_objective(case, rewards):
    """Half a per cent, wherever the reward's zero is; where that allows more, the search ends sooner."""
    config, reward, lengths = PlannerConfig(), rewards["near"](np.array([0.5, 0.0, 0.4])), {}
    thorough = replace(config, tolerance=1e-6, max_iterations=200)
    problem = make_problem(case, reward, config)
    optimum = _search(problem, thorough)[-1].cost
    for objective in (-0.2, 3.0):
        constant = problem.scale * (objective + optimum) / problem.count
        raised = make_problem(case, _Raised(reward, constant), config)
        search, best = _search(raised, config), _search(raised, thorough)[-1].cost
        assert best == pytest.approx(-objective, abs=0.01)
        assert search[-1].cost - best < 5e-3 * abs(best)
        lengths[objective] = len(search)
    assert lengths[3.0] < lengths[-0.2]


@pytest.mark.parametrize("seed", [0, 1])
def test_optimum_is_as_good_as_slsqps(panda, rewards, seed):
    config = PlannerConfig(waypoints=9, tolerance=1e-5, max_iterations=150)
    problem = make_problem(panda, rewards["network"](seed), config)
    found = _search(problem, config)[-1]
    peer = solve_with_slsqp(problem, straight_line(problem), exact=True)
    reference = problem.evaluate(peer.waypoints)
    assert peer.converged and reference.violation < 1e-5
    assert found.violation < 1e-5
    assert found.cost <= reference.cost + 2e-3 * abs(reference.cost)


def test_slsqps_are_ended_in_time_with_the_best_so_far(panda, rewards):
    problem = make_problem(panda, rewards["network"](0), PlannerConfig(waypoints=9))
    line = straight_line(problem)
    ended = solve_with_slsqp(problem, line, exact=False, limit=0.3)
    assert not ended.converged and ended.seconds < 3.0
    assert merit(problem.evaluate(ended.waypoints)) <= merit(problem.evaluate(line))
