from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.simulation.lesson import run_lesson
from unifeed_ros.simulation.tasks import TrueTask, measure

CONFIG = Path(__file__).parents[2] / "config"


@pytest.fixture(scope="module")
def yardstick(panda, scenes):
    return measure(panda, TrueTask(scene=scenes["table"]), starts=2)


@pytest.fixture(scope="module")
def lesson(panda, scenes, yardstick):
    return run_lesson(panda, scenes["table"], feedback="DCP", seed=1, yardstick=yardstick)


def test_every_way_of_teaching_is_captured(lesson):
    assert [step.letter for step in lesson.interactions] == ["D", "C", "P"]
    assert [[item.letter for item in step.taught][:1] for step in lesson.interactions] == [["D"], ["C"], ["P"]]
    assert [step.message for step in lesson.interactions] == ["", "", ""]


def test_one_demonstration_teaches_most_of_the_task(lesson):
    assert lesson.interactions[0].normalised_regret < 0.3


def test_the_arm_carries_out_what_was_planned(lesson):
    for step in lesson.interactions:
        assert step.normalised_regret == pytest.approx(step.planned_normalised_regret, abs=0.05)
        assert step.executed.duration == pytest.approx(step.planned.duration, abs=0.02)


def test_the_optimum_beats_the_straight_line_and_its_own_variations(panda, yardstick):
    assert yardstick.optimal_return > yardstick.straight_return + 5.0
    count = yardstick.waypoints
    best = yardstick.optimum.resampled(count)
    rng = np.random.default_rng(0)
    bump = np.sin(np.pi * np.linspace(0.0, 1.0, count))[:, None]
    worse = [yardstick.regret(best + bump * rng.normal(scale=0.1, size=panda.n)) > 0.0 for _ in range(20)]
    assert np.mean(worse) >= 0.9  # a variation may exceed the arm's limits, and then be better


def test_the_ur10_is_taught_as_well(scenes):
    ur10 = RobotModel(load_robot(CONFIG / "robots/ur10.yaml"))
    yardstick = measure(ur10, TrueTask(scene=scenes["table"]), starts=1)
    result = run_lesson(ur10, scenes["table"], feedback="D", seed=0, yardstick=yardstick)
    assert result.interactions[0].normalised_regret < 0.4


def test_unknown_letters_and_tasks_are_refused(panda, scenes, yardstick):
    with pytest.raises(ConfigError, match="letters D, C, P"):
        run_lesson(panda, scenes["table"], feedback="DX", yardstick=yardstick)
    with pytest.raises(ConfigError, match="unknown task"):
        run_lesson(panda, scenes["table"], "juggle")
