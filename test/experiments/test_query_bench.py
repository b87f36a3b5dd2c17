"""The benchmark of questions counts rightly, and asks about what it says."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.bench_queries import measure_queries, query_table
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.experiments.query_bench import START, QueryBench, bench_queries, compare_curves, draw_motions


def test_who_asks_alike_needs_as_many_questions():
    curves = np.random.default_rng(0).uniform(size=(7, 9))
    compared = compare_curves(curves, curves)
    assert compared["best_ratio"] == 1.0
    assert all(number <= k for k, number in enumerate(compared["matched"], start=1))


def test_who_learns_twice_as_fast_needs_half_the_questions():
    passive = 1.0 - 0.1 * np.arange(1, 9)
    active = 1.0 - 0.2 * np.arange(1, 9)
    compared = compare_curves([active] * 3, [passive] * 3)
    assert compared["matched"] == [1, 1, 2, 2, 3, 3, 4, 4]
    assert (compared["ratio"], compared["best_ratio"]) == (0.5, 0.5)


def test_who_never_gets_there_has_no_ratio():
    assert compare_curves([[0.9, 0.8]], [[0.5, 0.4]])["best_ratio"] is None


def test_motions_begin_together_and_end_apart(robot):
    motions = draw_motions(robot, 6, 5, 0)
    assert motions.states.shape == (6, 5, 6)
    np.testing.assert_allclose(motions.states[:, 0, :3], np.tile(START, (6, 1)), atol=1e-3)
    assert len({tuple(np.round(e, 3)) for e in motions.states[:, -1, :3]}) == 3
    np.testing.assert_array_equal(motions.states, draw_motions(robot, 6, 5, 0).states)


@pytest.mark.parametrize("demonstrated", [False, True])
def test_the_benchmark_fills_in_every_figure(demonstrated, robot):
    told = []
    bench = QueryBench(people=1, questions=3, candidates=12, judged=10, demonstrated=demonstrated,
                       training=TrainingConfig(waypoints=5, hidden=(8,), members=2, steps=10, pool=10))
    figures = bench_queries(robot, bench, on_row=told.append)
    for name in ("active", "passive"):
        (regrets,) = figures["people"][name]
        assert figures["summary"][name] == regrets
        assert len(regrets) == 3
        assert min(regrets) >= 0.0
    assert len(told) == 1
    assert "| 3 | " in query_table(figures)


@pytest.mark.parametrize("mistake", [{"people": 0}, {"questions": 0}])
def test_counts_that_measure_nothing_are_refused(mistake):
    with pytest.raises(UserMistake, match=next(iter(mistake))):
        measure_queries(argparse.Namespace(**{"people": 1, "questions": 1, "demonstrated": False, **mistake}))
