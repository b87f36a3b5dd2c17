"""The optimizer's node alone: what a request asks of its motion holds, and bad requests and models are refused."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Vector3
from rclpy.action import ActionClient
from session_helpers import session_files

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Cone, RewardModel, TaskContext, Zone
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.inputs import input_names
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.conversions import model_to_msg, trajectory_from_msg
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.simulation.touching import MeshScene

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture
def files():
    return session_files()


@pytest.fixture
def plan(start_node, ros_node, spin_until, files):
    """Start the node; plan(cancel=0, **request) gives the result and its status, canceled after so many iterations."""
    start_node("trajectory_optimizer", parameter_files=files)
    client = ActionClient(ros_node, OptimizeTrajectory, "optimize_trajectory")
    spin_until(client.server_is_ready, 60.0)

    def act(*, cancel=0, **request):
        seen = []
        sent = client.send_goal_async(OptimizeTrajectory.Goal(**request), lambda said: seen.append(said.feedback))
        spin_until(sent.done, 60.0)
        answer = sent.result().get_result_async()
        if cancel:
            spin_until(lambda: answer.done() or len(seen) >= cancel, 60.0)
            sent.result().cancel_goal_async()
        spin_until(answer.done, 60.0)
        return answer.result().result, answer.result().status

    yield act
    client.destroy()


def some_model(files, seed=0):
    scene = load_scene(files[1])
    inputs, rng = input_names([scene.context()]), np.random.default_rng(seed)
    return RewardEnsemble(
        layer_sizes=(len(inputs), 8, 1), weights=(rng.normal(size=(3, len(inputs), 8)), rng.normal(size=(3, 8, 1))),
        biases=(rng.normal(size=(3, 8)), rng.normal(size=(3, 1))), inputs=inputs, version=7,
        robot=load_robot(files[0]).name, frame="base")


def doubt(model, files, msg):
    """Give the members' disagreement along a motion, each less its mean over the straight line."""
    robot, context = RobotModel(load_robot(files[0])), load_scene(files[1]).context()
    q = trajectory_from_msg(msg).positions
    own = model.member_rewards(robot.tool_states(np.linspace(q[0], q[-1], 20)), context).mean(axis=1, keepdims=True)
    return (model.member_rewards(robot.tool_states(q), context) - own).std(axis=0).mean()


def test_what_a_request_asks_of_its_motion_holds(plan, files):
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    plain, status = plan()
    assert status == SUCCEEDED and plain.success and 0.0 < plain.first_feasible_s <= plain.seconds
    motion = trajectory_from_msg(plain.trajectory)
    middle = robot.tool_states(motion.positions)[len(motion.times) // 2, :3]
    ball = Zone(name="ball", shape="sphere", position=Point(**dict(zip("xyz", map(float, middle), strict=True))),
                size=[0.08])
    closed = replace(scene, zones={"ball": {"shape": "sphere", "position": middle, "size": [0.08]}})
    meshes = MeshScene(robot, closed)
    assert meshes.touching(motion.positions) > 0, "the zone is not in the way"
    around, status = plan(zones=[ball])
    assert status == SUCCEEDED, around.message
    assert meshes.touching(trajectory_from_msg(around.trajectory).positions) == 0

    slow, status = plan(tool_speed=0.4, duration=5.0)
    moved = trajectory_from_msg(slow.trajectory)
    speeds = np.linalg.norm(np.diff(robot.tool_states(moved.positions)[:, :3], axis=0), axis=1) / np.diff(moved.times)
    assert status == SUCCEEDED and speeds.max() < 0.4, slow.message

    upright, status = plan(cones=[Cone(name="upright", direction=Vector3(z=-1.0), angle=0.2)])
    tilts = robot.tool_states(trajectory_from_msg(upright.trajectory).positions)[:, 5]
    assert status == SUCCEEDED and tilts.max() < -np.cos(0.2) + 1e-6, upright.message

    placed, status = plan(goal_kind="position")
    end = robot.tool_states(np.array(placed.trajectory.points[-1].positions)[None])[0, :3]
    assert status == SUCCEEDED and np.abs(end - scene.goal).max() < 2e-3, placed.message
    posed, status = plan(goal_kind="pose")
    end = robot.tool_states(np.array(posed.trajectory.points[-1].positions)[None])[0]
    assert status == SUCCEEDED and np.abs(end - [*scene.goal, *scene.axis]).max() < 2e-3, posed.message
    assert plan(goal_kind="free")[1] == SUCCEEDED

    goal = Point(**dict(zip("xyz", map(float, scene.goal), strict=True)))
    careful = Zone(name="careful", shape="sphere", position=goal, size=[0.15], speed=0.2)
    calm, status = plan(zones=[careful], duration=5.0)
    moved = trajectory_from_msg(calm.trajectory)
    tool = robot.tool_states(moved.positions)[:, :3]
    speeds = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(moved.times)
    inside = np.linalg.norm(0.5 * (tool[1:] + tool[:-1]) - scene.goal, axis=1) < 0.149
    assert status == SUCCEEDED and inside.any() and speeds[inside].max() < 0.2 < speeds.max(), calm.message

    soft, status = plan(jerk_limit=20.0)
    moved = trajectory_from_msg(soft.trajectory)
    jerks = np.diff(moved.accelerations, axis=0) / np.diff(moved.times)[:, None]
    assert status == SUCCEEDED and np.abs(jerks).max() < 20.0 * (1 + 1e-5), soft.message

    hurried, status = plan(time_budget=1e-6, waypoints=100)
    assert status == SUCCEEDED and hurried.success and hurried.status == "time_budget", hurried.message
    assert "best so far" in hurried.message and len(hurried.trajectory.points) == len(plain.trajectory.points)
    again, status = plan()
    assert status == SUCCEEDED and len(again.trajectory.points) == len(plain.trajectory.points)  # nothing was kept


def test_requests_that_contradict_themselves_are_refused_with_a_sentence(plan, files):
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    goal = Point(**dict(zip("xyz", map(float, scene.goal), strict=True)))
    posture = list(map(float, robot.inverse_kinematics(scene.goal, scene.axis)))
    ball = {"shape": "sphere", "position": goal, "size": [0.1]}
    for request, text in (
        ({"zones": [Zone(name="ball", **ball)]}, "zone ball"),
        ({"zones": [Zone(name="ball", **ball), Zone(name="ball", **ball)]}, "names of the request's zones"),
        ({"zones": [Zone(name="egg", shape="egg", size=[0.1])]}, "shape of a zone"),
        ({"zones": [Zone(name="hole", shape="sphere", size=[float("nan")])]}, "finite"),
        ({"workspace": [0.0, 0.0, 0.0, 0.1, 0.1, 0.1]}, "workspace"),
        ({"workspace": [1.0, 2.0]}, "workspace"),
        ({"goal_kind": "somewhere"}, "posture, pose, position, free"),
        ({"goal": posture, "goal_kind": "free"}, "goal_kind"),
        ({"kappa": [float("nan")]}, "kappa"),
        ({"jerk_limit": -1.0}, "jerk_limit"),
        ({"tool_speed": float("nan")}, "tool_speed"),
        ({"duration": float("nan")}, "duration"),
        ({"duration": -1.0}, "duration"),
        ({"duration": 0.2}, "too far apart"),
        ({"start": [float("nan")] * robot.n}, "start"),
        ({"start": [9.0] * robot.n}, "outside its limits"),
        ({"start": posture[:-1]}, "start"),
        ({"context": TaskContext(task=scene.task, goal=Point(x=3.0, z=0.5))}, "reach"),
        ({"waypoints": 2}, "waypoints"),
        ({"cones": [Cone(name="side", direction=Vector3(x=1.0), angle=0.1)]}, "cone side"),
    ):
        result, status = plan(**request)
        assert status == ABORTED and not result.success and result.status == "infeasible", request
        assert text in result.message and not result.trajectory.points, (request, result.message)
    assert plan()[1] == SUCCEEDED


def test_a_model_that_does_not_fit_is_refused_and_kappa_counts(plan, files, ros_node, spin_until):
    said = []
    ros_node.create_subscription(DiagnosticArray, "/diagnostics", lambda news: said.extend(
        status.message for status in news.status if "trajectory_optimizer" in status.name),
        subscriber_qos("/diagnostics"))
    models = ros_node.create_publisher(RewardModel, "reward_model", publisher_qos("reward_model"))
    model = some_model(files)
    good = model_to_msg(model, 1.0)
    for change, text in (({"robot": "another"}, "another robot"),
                         ({"inputs": ["tool_x"] * len(good.inputs)}, "tool_x"),
                         ({"weights": [float("nan")] * len(good.weights)}, "not finite"),
                         ({"weights": list(good.weights)[:-1]}, "weights of the reward model")):
        bad = model_to_msg(model, 1.0)
        for name, value in change.items():
            setattr(bad, name, value)
        models.publish(bad)
        spin_until(lambda text=text: any(text in message for message in said), 20.0, lambda: said[-1:])
    refused, status = plan()
    assert status == SUCCEEDED and refused.model_version == 0  # the smoothest motion, as before
    models.publish(good)
    spin_until(lambda: any("model 7" in message for message in said), 20.0)
    mean, status = plan()
    wary, other = plan(kappa=[5.0])
    assert (status, other, mean.model_version) == (SUCCEEDED, SUCCEEDED, 7)
    assert len(mean.reward) == len(mean.disagreement) == 20 and min(mean.disagreement) > 0.0
    assert doubt(model, files, wary.trajectory) < doubt(model, files, mean.trajectory)


def test_a_cancel_ends_the_search_where_it_stands(plan, files, ros_node, spin_until):
    models = ros_node.create_publisher(RewardModel, "reward_model", publisher_qos("reward_model"))
    models.publish(model_to_msg(some_model(files), 1.0))
    spin_until(lambda: plan()[0].model_version == 7, 20.0)
    result, status = plan(cancel=1, waypoints=200)
    assert (status, result.status) == (CANCELED, "canceled") and not result.success
    assert result.iterations >= 1 and np.isfinite(result.objective)
    assert not result.trajectory.points, "what was not searched to its end is not to be carried out"
    whole, status = plan(waypoints=200)
    assert status == SUCCEEDED and whole.iterations > result.iterations and whole.objective >= result.objective
