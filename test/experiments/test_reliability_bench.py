"""People who are biased in one kind of feedback are found out by the others; the benchmark tells what that gains."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.bench_reliability import measure_reliability, reliability_table
from unifeed_ros.core.reward.buffer import build_buffer
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.reliability import estimate_reliability
from unifeed_ros.experiments.biased_people import SHORT, teach_with_bias
from unifeed_ros.experiments.reliability_bench import bench_reliability
from unifeed_ros.experiments.reward_quality import taught_places

H = 12


@pytest.fixture(scope="module")
def places(robot, scene):
    return taught_places(robot, scene, H)


def weights(robot, places, biased):
    """Weights of three people who are biased in this kind, shape (3, 3)."""
    return np.array([estimate_reliability(build_buffer(
        teach_with_bias(places, seed, biased), robot, waypoints=H, demonstration_alternatives=240,
        correction_alternatives=240, config=TrainingConfig().alternatives, rng=np.random.default_rng(seed)))
        for seed in range(3)])


def test_sound_people_are_trusted_in_everything(robot, places):
    assert weights(robot, places, "").mean(axis=0).min() > 0.8


@pytest.mark.parametrize("biased", list("DCP"))
def test_a_biased_kind_weighs_less_than_the_sound_ones(biased, robot, places):
    mean = dict(zip("DCP", weights(robot, places, biased).mean(axis=0), strict=True))
    assert mean.pop(biased) < min(mean.values())


def test_biased_demonstrations_stop_short_and_sound_ones_do_not(robot, places):
    for biased, least, most in (("D", 0.8 * SHORT, 1.5 * SHORT), ("", 0.0, 0.03)):
        for item in teach_with_bias(places, 0, biased, letters="DD").items:
            end = robot.tool_states(item.trajectory.positions[-1:])[0, :3]
            assert least <= np.linalg.norm(end - item.context.goal) <= most


def test_the_benchmark_fills_in_every_figure(robot, scene):
    told = []
    figures = bench_reliability(robot, [scene], people=["careless rankings"], seeds=2, on_row=told.append,
                                config=TrainingConfig(steps=20, members=2, hidden=(16, 16), waypoints=H))
    row = figures["summary"]["table: careless rankings"]
    judged = figures["people"]
    assert row["ratio"] == pytest.approx(np.median([p["weighted"] for p in judged])
                                         / np.median([p["unweighted"] for p in judged]))
    assert row["P"] == pytest.approx(np.mean([p["P"] for p in judged]))
    assert len(told) == 1
    assert "careless rankings |" in reliability_table(figures)


@pytest.mark.parametrize("mistake", [{"seeds": 0}, {"people": ["saints"]}])
def test_requests_that_measure_nothing_are_refused(mistake):
    with pytest.raises(UserMistake, match=next(iter(mistake))):
        measure_reliability(argparse.Namespace(**{"people": None, "task": None, "seeds": 1, **mistake}))
