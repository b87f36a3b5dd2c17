"""The benchmark of new goals runs whole, and refuses what measures nothing."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.bench_context import context_table, measure_context
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.experiments.context_bench import NEW_OBJECT_PLACES, bench_context, taught_and_tested
from unifeed_ros.experiments.reward_quality import planned_regret, teach
from unifeed_ros.resources import config_path

OPTIONS = {"robot": "panda", "task": None, "people": 1, "goals": 2, "feedback": "DC", "json": False}


@pytest.fixture(scope="module")
def panda():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def scene():
    return load_scene(config_path("tasks", "proximity"))


def test_the_test_is_where_nothing_was_taught(panda, scene):
    places, tests = taught_and_tested(panda, scene, PlannerConfig(waypoints=10), goals=2)
    assert len({tuple(p.task.scene.goal) for p in (*places, *tests)}) == 4
    assert {tuple(p.task.scene.objects["person"]) for p in places} == {tuple(scene.objects["person"])}
    assert {tuple(t.task.scene.objects["person"]) for t in tests} == set(NEW_OBJECT_PLACES)


def test_one_demonstration_with_the_right_features_holds_at_a_new_place(panda, scene):
    places, tests = taught_and_tested(panda, scene, PlannerConfig(), goals=1)
    dataset = teach(places, 0, "D")
    scratch, known = (train_reward(dataset, panda, TrainingConfig(features=f), version=1, seed=0).ensemble
                      for f in ((), ("distance(goal)", "near_xy(person, 0.4)")))
    assert planned_regret(known, places[0]) < 0.05
    assert planned_regret(known, tests[0]) < min(0.2, planned_regret(scratch, tests[0]))


def test_every_motion_is_judged(panda, scene):
    quick = TrainingConfig(members=2, hidden=(16,), steps=20, pool=50)
    figures = bench_context(panda, [scene], {"way": lambda task: quick}, people=1, letters="DC", goals=2,
                            on_row=lambda row: None)
    assert figures["summary"]["way"]["proximity"] == figures["summary"]["way"]["all"]
    assert figures["summary"]["way"]["all"]["motions"] == 2
    assert np.isfinite(figures["people"][0]["new"]).all()
    assert "| way | all | 2 |" in context_table(figures)


@pytest.mark.parametrize("mistake", [{"people": 0}, {"goals": 0}, {"feedback": "DX"}, {"task": ["tea"]}])
def test_what_measures_nothing_is_refused(mistake):
    with pytest.raises(UserMistake, match=next(iter(mistake))):
        measure_context(argparse.Namespace(**(OPTIONS | mistake)))
