"""Messages and core types say the same thing in both directions."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from geometry_msgs.msg import Point, Vector3
from hypothesis import given
from hypothesis import strategies as st
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Cone, Feedback, Zone
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError, UnifeedError
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.nodes.conversions import (
    constrained,
    context_from_msg,
    context_to_msg,
    feedback_from_msg,
    feedback_to_msg,
    model_from_msg,
    model_to_msg,
    seconds,
    stamp,
    trajectory_from_msg,
    trajectory_to_msg,
)

NAMES = ("a", "b", "c")


def some_trajectory(seed=0, full=True):
    rng = np.random.default_rng(seed)
    extra = {"velocities": rng.normal(size=(5, 3)), "accelerations": rng.normal(size=(5, 3))} if full else {}
    return Trajectory(joint_names=NAMES, times=np.linspace(0, 1, 5), positions=rng.normal(size=(5, 3)), **extra)


def some_context():
    return Context(task="laptop", goal=[0.1, 0.2, 0.3], objects={"laptop": np.array([0.5, -0.35, 0.0])})


def assert_same(first, second):
    assert first.joint_names == second.joint_names
    for name in ("times", "positions", "velocities", "accelerations"):
        a, b = getattr(first, name), getattr(second, name)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_allclose(a, b, atol=1e-9)


@given(st.floats(0, 2e9))
def test_stamps_keep_the_nanosecond(time):
    assert seconds(stamp(time)) == pytest.approx(time, abs=1e-6)
    assert 0 <= stamp(time).nanosec < 1_000_000_000


@pytest.mark.parametrize("full", [True, False])
def test_a_trajectory_comes_back(full):
    trajectory = some_trajectory(full=full)
    assert_same(trajectory_from_msg(trajectory_to_msg(trajectory)), trajectory)


def test_joints_are_mapped_by_name_not_by_place():
    message = trajectory_to_msg(some_trajectory())
    swapped = trajectory_from_msg(message, ("c", "a", "b"))
    np.testing.assert_array_equal(swapped.positions, some_trajectory().positions[:, [2, 0, 1]])


def test_a_trajectory_without_points_or_joints_is_refused():
    with pytest.raises(InputError, match="without positions"):
        trajectory_from_msg(JointTrajectory(joint_names=list(NAMES)))
    with pytest.raises(InputError, match="without positions"):
        trajectory_from_msg(JointTrajectory(), NAMES)
    with pytest.raises(InputError, match="lack joints d"):
        trajectory_from_msg(trajectory_to_msg(some_trajectory()), ("a", "d"))


def test_a_context_comes_back():
    context = some_context()
    back = context_from_msg(context_to_msg(context))
    assert back.task == context.task and list(back.objects) == list(context.objects)
    np.testing.assert_array_equal(back.goal, context.goal)
    np.testing.assert_array_equal(back.objects["laptop"], context.objects["laptop"])


@pytest.mark.parametrize(
    "item",
    [
        Demonstration(id="d", robot="r", context=some_context(), trajectory=some_trajectory()),
        Correction(
            id="c",
            robot="r",
            context=some_context(),
            planned=some_trajectory(1),
            corrected=some_trajectory(2),
            span=(0.5, 1.5),
        ),
        Preference(
            id="p",
            robot="r",
            context=some_context(),
            options=(some_trajectory(3), some_trajectory(4)),
            ranks=(1, 0),
            query_id="query-1",
        ),
        Preference(
            id="n", robot="r", context=some_context(), options=(some_trajectory(3), some_trajectory(4)), ranks=()
        ),
    ],
    ids=["demonstration", "correction", "preference", "neither"],
)
def test_feedback_comes_back(item):
    back = feedback_from_msg(feedback_to_msg(item, 12.5, "base"), NAMES)
    assert type(back) is type(item) and (back.id, back.robot) == (item.id, item.robot)
    for name in ("trajectory", "planned", "corrected"):
        if hasattr(item, name):
            assert_same(getattr(back, name), getattr(item, name))
    if isinstance(item, Preference):
        assert back.ranks == item.ranks and back.query_id == item.query_id
        for option, other in zip(back.options, item.options, strict=True):
            assert_same(option, other)
    if isinstance(item, Correction):
        assert back.span == item.span


def test_feedback_of_no_kind_is_refused():
    with pytest.raises(InputError, match="kind of feedback"):
        feedback_from_msg(Feedback(id="x", kind=9))


def test_a_request_adds_to_the_scene_and_what_it_leaves_empty_stays():
    scene = Scene(task="t", start=[0.3, 0.0, 0.5], goal=[0.5, 0.0, 0.5], tool_speed=0.7, zones={
        "kept": {"shape": "sphere", "position": [1.0, 1.0, 1.0], "size": [0.1]},
        "moved": {"shape": "sphere", "position": [1.0, 1.0, 1.0], "size": [0.1]}})
    same = constrained(scene, OptimizeTrajectory.Goal())
    assert (same.zones, same.cones, same.workspace, same.tool_speed) == (scene.zones, {}, (), 0.7)
    asked = constrained(scene, OptimizeTrajectory.Goal(
        zones=[Zone(name="moved", shape="box", position=Point(x=2.0), size=[0.1, 0.2, 0.3], speed=0.4)],
        cones=[Cone(name="up", direction=Vector3(z=2.0), angle=0.5)], workspace=[-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]))
    assert set(asked.zones) == {"kept", "moved"} and asked.zones["kept"] is scene.zones["kept"]
    moved = asked.zones["moved"]
    assert (moved.shape, moved.speed, asked.tool_speed, asked.workspace[3]) == ("box", 0.4, 0.7, 1.0)
    np.testing.assert_array_equal(moved.position, [2.0, 0.0, 0.0])
    np.testing.assert_array_equal(moved.size, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(asked.cones["up"].direction, [0.0, 0.0, 1.0])
    for bad, text in (({"zones": [Zone(name="moved", shape="box", size=[1.0])]}, "size of a box"),
                      ({"zones": [Zone(shape="sphere", size=[1.0])]}, "names of the request's zones"),
                      ({"cones": [Cone(name="up", angle=0.5)]}, "direction of a cone")):
        with pytest.raises(UnifeedError, match=text):
            constrained(scene, OptimizeTrajectory.Goal(**bad))


def some_model():
    rng = np.random.default_rng(5)
    weights = rng.normal(size=3 * (9 * 4 + 4 + 4 + 1)).astype(np.float32)
    inputs = ("x", "y", "z", "axis_x", "axis_y", "axis_z", "goal_dx", "goal_dy", "goal_dz")
    return RewardEnsemble.from_flat(weights, members=3, layer_sizes=(9, 4, 1), inputs=inputs, version=3, robot="panda",
                                    frame="base", feedback_ids=("d", "c"), seed=7)


def test_a_reward_model_comes_back_to_the_last_bit():
    model = some_model()
    back = model_from_msg(model_to_msg(model, 1.0))
    assert (back.version, back.robot, back.frame, back.inputs, back.feedback_ids, back.seed) == (
        model.version, model.robot, model.frame, model.inputs, model.feedback_ids, model.seed)
    assert back.flat_weights().tobytes() == model.flat_weights().tobytes()
    states = np.random.default_rng(0).normal(size=(6, 6))
    context = Context(goal=[0.6, 0.0, 0.1])
    np.testing.assert_array_equal(back.member_rewards(states, context), model.member_rewards(states, context))


def test_a_reward_model_cut_short_is_refused():
    message = model_to_msg(some_model(), 1.0)
    message.weights = message.weights[:-1]
    with pytest.raises(ShapeError):
        model_from_msg(message)
    message.activation = "relu"
    with pytest.raises(ConfigError, match="activation"):
        model_from_msg(message)


def test_a_trajectory_with_a_point_of_another_length_is_refused():
    message = trajectory_to_msg(some_trajectory())
    message.points[1].velocities.append(0.0)
    with pytest.raises(InputError, match="number of velocities"):
        trajectory_from_msg(message)
