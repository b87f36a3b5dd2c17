"""The list of what was taught: order, undo, redo, what changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.console.motions import POINTS, describe_change, drawn, is_task_motion, rewards_along
from unifeed_ros.console.record import TaughtRecord
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.core.types import Trajectory
from unifeed_ros.resources import config_path

ROBOT, SCENE = RobotModel(load_robot(config_path("robots", "panda"))), load_scene(config_path("tasks", "table"))
START = ROBOT.inverse_kinematics(SCENE.start, SCENE.axis)
GOAL = ROBOT.inverse_kinematics(SCENE.goal, SCENE.axis, seed=START)


def motion(*postures):
    return Trajectory(joint_names=ROBOT.joint_names, times=np.linspace(0, 2, len(postures)), positions=postures)


DIRECT, DETOUR = motion(START, GOAL), motion(START, 0.5 * (START + GOAL) + 0.1, GOAL)
COMMON = {"robot": "panda", "context": SCENE.context()}
ITEMS = (Demonstration(id="d", trajectory=DETOUR, **COMMON),
         Correction(id="c", planned=DIRECT, corrected=motion(START, GOAL), span=(0.0, 2.0), **COMMON),
         Preference(id="p", options=(DIRECT, DETOUR), ranks=(1, 0), query_id="q", **COMMON))


@pytest.fixture
def record():
    record = TaughtRecord(ROBOT)
    for item in ITEMS:
        record.add(item)
    return record


def test_inputs_are_listed_as_they_came(record):
    assert [(item.id, item.kind) for item in record.items] == [("d", 1), ("c", 2), ("p", 3)]
    better = record.items[2].paths[0]
    np.testing.assert_allclose(better, drawn(ROBOT, DETOUR).path)  # rank 0 is the best


def test_the_learner_says_what_counts(record):
    assert record.newest(taken_back=False) == "p" and record.newest(taken_back=True) == ""
    record.keep_only(["d", "c"])
    assert [item.taken_back for item in record.items] == [False, False, True]
    assert record.newest(taken_back=False) == "c" and record.newest(taken_back=True) == "p"
    record.add(ITEMS[2])
    record.keep_only(["d", "c", "p"])
    assert [item.id for item in record.items] == ["d", "c", "p"] and record.newest(taken_back=True) == ""


def test_what_changed_is_told_of_the_input_that_changed_it(record):
    record.planned(drawn(ROBOT, DIRECT), ["d"])
    record.planned(drawn(ROBOT, DETOUR), ["c"])
    changes = [item.change for item in record.items]
    assert changes[0].startswith("the first") and "cm" in changes[1] and changes[2] == ""
    record.trust({1: 0.2, 2: 0.5, 3: 1.0})
    assert [item.reliability for item in record.items] == [0.2, 0.5, 1.0]
    record.add(ITEMS[1])
    assert record.items[1].change == changes[1]


def test_a_change_is_measured_at_the_tool():
    before = drawn(ROBOT, DIRECT)
    states = before.states.copy()
    states[30, 2] += 0.2
    assert describe_change(before, replace(before, states=states)) == (
        "moved the motion by up to 20 cm, 20 cm higher, most after 51 % of the way")
    assert "stayed" in describe_change(before, before)


def test_returns_to_the_start_are_no_plans():
    assert is_task_motion(drawn(ROBOT, DIRECT), SCENE.start)
    assert not is_task_motion(drawn(ROBOT, motion(GOAL, START)), SCENE.start)
    assert not is_task_motion(drawn(ROBOT, motion(START, GOAL, START)), SCENE.start)


def test_without_a_model_nothing_is_rewarded():
    rewards, spread = rewards_along(None, drawn(ROBOT, DIRECT), SCENE.context())
    assert rewards.shape == spread.shape == (POINTS,) and not rewards.any() and not spread.any()
