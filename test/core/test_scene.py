"""The tasks that come with the package, and task files that cannot be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.planning.sampling import shortest_duration
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene, load_scene

CONFIG = Path(__file__).parents[2] / "config"
TASKS = sorted(path.stem for path in (CONFIG / "tasks").glob("*.yaml"))


def test_every_task_of_the_paper_is_there():
    assert TASKS == ["cup", "laptop", "proximity", "table"]


@pytest.mark.parametrize("name", TASKS)
def test_context_is_what_the_file_says(name):
    scene = load_scene(CONFIG / f"tasks/{name}.yaml")
    context = scene.context()
    assert scene.task == context.task == name
    np.testing.assert_array_equal(context.goal, scene.goal)
    assert set(context.objects) == {"laptop": {"laptop"}, "proximity": {"person"}}.get(name, set())
    assert scene.floor == pytest.approx(scene.table_height + scene.clearance)


@pytest.mark.parametrize("name", ["panda", "ur10"])
@pytest.mark.parametrize("task", TASKS)
def test_both_arms_reach_both_ends_without_a_flip_and_with_modest_slack(name, task):
    robot, scene = RobotModel(load_robot(CONFIG / f"robots/{name}.yaml")), load_scene(CONFIG / f"tasks/{task}.yaml")
    start = robot.inverse_kinematics(scene.start, scene.axis)
    goal = robot.inverse_kinematics(scene.goal, scene.axis, seed=start)
    assert np.abs(goal - start).max() < 2.0
    line = start + np.linspace(0.0, 1.0, 50)[:, None] * (goal - start)
    assert robot.tool_states(line)[:, 2].min() > scene.floor
    slack = scene.duration / shortest_duration(goal - start, robot.velocity_limits, robot.acceleration_limits)
    assert 1.25 < slack < 1.7


def test_the_straight_motion_passes_the_person():
    scene, robot = load_scene(CONFIG / "tasks/proximity.yaml"), RobotModel(load_robot(CONFIG / "robots/panda.yaml"))
    start = robot.inverse_kinematics(scene.start, scene.axis)
    goal = robot.inverse_kinematics(scene.goal, scene.axis, seed=start)
    line = start + np.linspace(0, 1, 50)[:, None] * (goal - start)
    distances = np.linalg.norm(robot.tool_states(line)[:, :2] - scene.objects["person"][:2], axis=1)
    assert distances.min() < 0.3
    assert min(distances[0], distances[-1]) > 0.5


def test_axis_becomes_a_unit_vector_and_arrays_are_read_only():
    scene = Scene(task="t", start=(0.3, 0.0, 0.5), goal=(0.5, 0.0, 0.5), axis=(0.0, 3.0, -4.0))
    np.testing.assert_allclose(scene.axis, (0.0, 0.6, -0.8))
    for values in (scene.start, scene.goal, scene.axis):
        assert not values.flags.writeable


@pytest.mark.parametrize(("changes", "error", "text"), [
    ({"goal": (0.5, 0.0)}, ShapeError, "goal"), ({"start": (0.5, 0.0, float("nan"))}, InputError, "start"),
    ({"axis": (0.0, 0.0, 0.0)}, ConfigError, "axis"), ({"duration": 0.0}, ConfigError, "duration"),
    ({"clearance": -0.1}, ConfigError, "clearance"), ({"goal": (0.5, 0.0, 0.01)}, ConfigError, r"too low.*0\.050"),
    ({"objects": {"cup": (1.0, 2.0)}}, ShapeError, "cup"),
])
def test_scenes_that_cannot_be_are_refused(changes, error, text):
    with pytest.raises(error, match=text):
        Scene(**{"task": "t", "start": (0.3, 0.0, 0.5), "goal": (0.5, 0.0, 0.5), **changes})


@pytest.mark.parametrize(("content", "text"), [
    (None, "No such file"), ("/**: {ros__parameters: {task: {}}}", "a group named scene"),
    ("/**: {ros__parameters: {scene: {task: t}}}", "lacks settings.*goal"),
    ("/**: {ros__parameters: {scene: {task: t, start: [1.0], goal: [0.5, 0.0, 0.5]}}}", "start"),
    ("/**: {ros__parameters: {scene: {task: t, start: [0.5, 0.0, 0.5], goal: [0.5, 0.0, 0.5], colour: red}}}",
     "unknown settings.*colour"),
    ("/**: {ros__parameters: {scene: {task: t, start: [0.5, 0.0, 0.5], goal: [0.5, 0.0, 0.5], duration: long}}}",
     "duration|real number|ufunc"),
])
def test_files_that_cannot_be_used_are_named(tmp_path, content, text):
    path = tmp_path / "task.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=text) as caught:
        load_scene(path)
    assert "task.yaml" in str(caught.value)


def test_a_scene_is_limited_to_what_the_controller_takes():
    scene = Scene(task="t", start=(0.3, 0.0, 0.5), goal=(0.5, 0.0, 0.5))
    box = (0.0, -1.0, 0.0, 1.0, 1.0, 1.0)
    limited = scene.limited(1.5, box)
    assert limited.tool_speed == pytest.approx(1.35) and limited.workspace == box
    slow = replace(scene, tool_speed=0.5, workspace=(0.2, -1.0, 0.0, 1.0, 1.0, 1.0)).limited(1.5, box)
    assert slow.tool_speed == 0.5 and slow.workspace[0] == 0.2
    assert replace(scene, tool_speed=1.45).limited(1.5, ()).tool_speed == pytest.approx(1.35)
