from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, ShapeError
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Trajectory
from unifeed_ros.simulation.tasks import TASKS, TrueTask, endpoints, straight_line

SCENE = Scene(task="table", start=(0.2, 0.2, 0.6), goal=(0.65, -0.4, 0.1),
              objects={"laptop": (0.5, -0.35, 0.0), "person": (0.2, -0.3, 0.0)})


def random_states(seed, count=30):
    rng = np.random.default_rng(seed)
    axes = rng.normal(loc=(0.0, 0.0, -2.0), size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.concatenate([rng.uniform((-0.1, -0.6, 0.02), (0.8, 0.6, 0.7), size=(count, 3)), axes], axis=1)


@given(seed=st.integers(0, 2**32), name=st.sampled_from(TASKS))
def test_gradients_match_finite_differences(seed, name):
    task, states = TrueTask(scene=SCENE, name=name), random_states(seed)
    _, gradient = task.value_and_gradient(states)
    numeric = np.stack([(task.rewards(states + d) - task.rewards(states - d)) / 2e-6 for d in 1e-6 * np.eye(6)], axis=1)
    smooth = np.abs(numeric - gradient).max(axis=1) < 1e-4
    assert smooth.mean() > 0.9  # the rest lies on a kink, within the step of the difference


@pytest.mark.parametrize("name", TASKS)
def test_gradient_is_finite_at_the_goal(name):
    state = np.concatenate([SCENE.goal, SCENE.axis])[None]
    value, gradient = TrueTask(scene=SCENE, name=name).value_and_gradient(state)
    assert np.isfinite(value).all() and np.isfinite(gradient).all()


def test_rewards_by_hand():
    state = np.array([[0.65, -0.4, 0.6, 0.0, 1.0, 0.0]])  # half a metre above the goal, tilted by 90 degrees
    near_laptop = 1.0 - np.hypot(0.15, 0.05)
    assert TrueTask(scene=SCENE, name="table").rewards(state) == pytest.approx([-2.0 * 0.5 - 1.2 * 0.6])
    assert TrueTask(scene=SCENE, name="laptop").rewards(state) == pytest.approx([-0.5 - near_laptop])
    assert TrueTask(scene=SCENE, name="cup").rewards(state) == pytest.approx([-0.5 - 0.75 * np.pi / 2])
    assert TrueTask(scene=SCENE, name="proximity").rewards(state) == pytest.approx([-0.5])
    state[0, :2] = (0.2, -0.2)  # 0.1 m from the person
    expected = -np.linalg.norm(state[0, :3] - SCENE.goal) - 3.0 * 0.3
    assert TrueTask(scene=SCENE, name="proximity").rewards(state) == pytest.approx([expected])


def test_the_task_is_the_scenes_unless_named():
    assert TrueTask(scene=SCENE).name == "table"
    with pytest.raises(ConfigError, match="table, laptop, cup, proximity"):
        TrueTask(scene=SCENE, name="juggle")
    with pytest.raises(ConfigError, match="laptop"):
        TrueTask(scene=replace(SCENE, objects={}), name="laptop")
    with pytest.raises(ShapeError):
        TrueTask(scene=SCENE).rewards(np.zeros((3, 3)))


def test_returns_do_not_depend_on_the_pace_or_on_the_form(panda, scenes):
    task = TrueTask(scene=scenes["table"])
    line = straight_line(panda, task.scene, 20)
    slower = Trajectory(joint_names=line.joint_names, times=line.times * 3.0 + 7.0, positions=line.positions)
    expected = task.rewards(panda.tool_states(line.positions)).sum()
    for motion in (line, slower, line.positions):
        assert task.returns(panda, motion, 20) == pytest.approx(expected)


def test_endpoints_are_at_start_and_goal(panda, scenes):
    start, goal = endpoints(panda, scenes["table"])
    states = panda.tool_states(np.stack([start, goal]))
    np.testing.assert_allclose(states[:, :3], [scenes["table"].start, scenes["table"].goal], atol=1e-3)
    np.testing.assert_allclose(states[:, 3:], [[0, 0, -1]] * 2, atol=2e-3)


def test_straight_line_has_normalised_regret_one(quick_yardstick, panda):
    line = straight_line(panda, quick_yardstick.task.scene, 20)
    assert quick_yardstick.normalised_regret(line) == pytest.approx(1.0)
    assert quick_yardstick.normalised_regret(quick_yardstick.optimum) == pytest.approx(0.0)
