"""Starts keep all linear limits, whatever they are made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import InputError, PlanningError
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.planning.starts import StartRepair, start_motions, straight_line


def make_problem(case, *, goal=True, duration=3.0, waypoints=20):
    config, end = PlannerConfig(waypoints=waypoints), case.goal if goal else None
    bounds = motion_bounds(case.robot, case.scene, case.start, end, config)
    return PlanningProblem(case.robot, None, case.start, end, duration, bounds, config)


def _keeps_limits(problem, waypoints):
    inside = (waypoints >= problem.bounds.lower - 1e-9).all() and (waypoints <= problem.bounds.upper + 1e-9).all()
    return inside and np.abs(problem.rate_shares(waypoints)).max() < 1.005


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.sampled_from([0.01, 0.3, 3.0, 30.0]), count=st.sampled_from([8, 20, 40]))
def test_any_waypoints_become_feasible(panda, seed, size, count):
    problem = make_problem(panda, waypoints=count)
    wanted = straight_line(problem)
    wanted[problem.free] += np.random.default_rng(seed).normal(scale=size, size=wanted[problem.free].shape)
    assert _keeps_limits(problem, StartRepair(problem)(wanted))


def test_feasible_waypoints_stay_as_they_are(case):
    problem = make_problem(case, duration=6.0)
    bent = straight_line(problem) + 0.05 * np.sin(np.linspace(0, np.pi, 20))[:, None] ** 2
    assert _keeps_limits(problem, bent)
    np.testing.assert_allclose(StartRepair(problem)(bent), bent, atol=1e-4)


@pytest.mark.parametrize("goal", [True, False])
def test_starts_have_the_right_ends_and_differ(case, goal):
    problem = make_problem(case, goal=goal)
    repair = StartRepair(problem)
    seed = case.goal - 0.3 * np.sin(np.linspace(0, np.pi, 20))[:, None] ** 2  # bent to the right start
    starts = list(start_motions(problem, repair, [seed], PlannerConfig(starts=4)))
    assert len(starts) == 4
    np.testing.assert_array_equal(starts[0], repair.line)
    for start in starts:
        np.testing.assert_allclose(start[0], case.start, atol=1e-9)
        if goal:
            np.testing.assert_allclose(start[-1], case.goal, atol=1e-9)
        assert _keeps_limits(problem, start)
    assert all(np.abs(a - b).max() > 0.02 for i, a in enumerate(starts) for b in starts[:i])


def test_a_seed_that_is_not_finite_is_refused(panda):
    problem = make_problem(panda)
    with pytest.raises(InputError, match="seed"):
        list(start_motions(problem, StartRepair(problem), [np.full((20, 7), np.nan)], PlannerConfig()))


def test_too_little_time_is_noticed(case):
    with pytest.raises(PlanningError, match="no motion in this time"):
        StartRepair(make_problem(case, duration=1.0))
