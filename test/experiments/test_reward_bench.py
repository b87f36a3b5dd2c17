"""The benchmark of the reward's training measures what it says, and judges rewards by what is true."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import pytest

from unifeed_ros.baselines.paper_reward import PaperTraining
from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.bench_reward import measure_reward, reward_table
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.experiments.reward_bench import bench_reward
from unifeed_ros.experiments.reward_quality import (
    PLACES,
    dead_members,
    order_accuracy,
    planned_regret,
    taught_places,
    teach,
    unseen_motions,
)
from unifeed_ros.simulation.tasks import TrueTask

H = 8


@pytest.fixture(scope="module")
def places(robot, scene):
    return taught_places(robot, scene, H)


@dataclass
class TrueReward:
    """Stands where an ensemble stands, and knows the truth, or its opposite."""

    scene: object
    sign: float = 1.0

    def member_rewards(self, states, context):
        from dataclasses import replace
        task = TrueTask(scene=replace(self.scene, goal=context.goal))
        return self.sign * np.stack([task.rewards(states)] * 2)

    def bind(self, context):
        return TrueTask(scene=self.scene)


def test_the_truth_orders_all_motions_rightly_and_its_opposite_none(places, scene):
    unseen = unseen_motions(places[0], H)
    assert len(unseen) == PLACES
    assert order_accuracy(TrueReward(scene), unseen) == 1.0
    assert order_accuracy(TrueReward(scene, -1.0), unseen) == 0.0
    assert dead_members(TrueReward(scene), unseen) == 0
    assert dead_members(TrueReward(scene, 0.0), unseen) == 2


def test_planning_with_the_truth_leaves_hardly_any_regret(places, scene):
    assert planned_regret(TrueReward(scene), places[0]) < 0.03


def test_people_teach_at_two_goals_and_each_in_their_own_way(places):
    dataset, other = teach(places, 0), teach(places, 1)
    assert [item.letter for item in dataset.items] == list("DCPDCP")
    assert len({tuple(item.context.goal) for item in dataset.items}) == 2
    assert not np.array_equal(dataset.items[0].trajectory.positions, other.items[0].trajectory.positions)


def test_the_benchmark_fills_in_every_figure(robot, scene):
    told = []
    figures = bench_reward(robot, [scene], horizons=[H], people=1, repeats=1, on_row=told.append,
                           config=TrainingConfig(steps=20, hidden=(16, 16)),
                           peer=PaperTraining(epochs=10, slow_epochs=2))
    row = figures["summary"][str(H)]
    assert {"cold_s", "warm_s", "peer_s", "cold_ratio", "warm_ratio", "floor_s", "accuracy", "peer_accuracy", "regret",
            "peer_regret", "dead_members"} <= set(row)
    assert row["cold_ratio"] == pytest.approx(row["peer_s"] / row["cold_s"])
    assert 0.0 < row["floor_s"] < row["cold_s"]
    assert row["dead_members"] == 0
    assert len(told) == 3
    assert "| peer_s |" in reward_table(figures)


@pytest.mark.parametrize("mistake", [{"people": 0}, {"repeats": 0}, {"horizons": [4]}])
def test_counts_that_measure_nothing_are_refused(mistake):
    with pytest.raises(UserMistake, match=next(iter(mistake))):
        measure_reward(argparse.Namespace(**{"people": 1, "repeats": 1, "horizons": [10], **mistake}))
