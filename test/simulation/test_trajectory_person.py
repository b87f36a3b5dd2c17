"""People who act on trajectories: what they want, how they err, and that no draw disturbs another."""

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.reward.features import make_feature
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.tasks import TrueTask, measure, straight_line
from unifeed_ros.simulation.trajectory_person import (
    WORKSPACE,
    TrajectoryPerson,
    TrajectoryPersonConfig,
    erring,
)

SURE = TrajectoryPersonConfig(error=0.0, correcting_error=0.0, axis_error=0.0, pace_spread=0.0, trace_error=0.0)
"""Someone who never errs."""


@pytest.fixture(scope="module")
def laptop():
    robot = RobotModel(load_robot(config_path("robots", "ur10")))
    return measure(robot, TrueTask(scene=load_scene(config_path("tasks", "laptop"))))


@pytest.fixture(scope="module")
def line(laptop):
    return straight_line(laptop.robot, laptop.task.scene, 61)


def test_who_never_errs_shows_the_optimum_at_their_pace(laptop):
    shown = TrajectoryPerson(laptop, [0], SURE).demonstrate("d").trajectory
    assert shown.duration == pytest.approx(1.15 * laptop.optimum.duration)
    np.testing.assert_allclose(shown.resampled(20), laptop.optimum.resampled(20), atol=5e-3)


def test_errors_have_the_size_that_is_asked_for_and_keep_both_ends(laptop):
    rng = np.random.default_rng(0)
    motion = laptop.optimum.resampled(61)
    true = laptop.robot.tool_states(motion)
    offsets = np.stack([laptop.robot.tool_states(erring(laptop.robot, motion, 0.02, 0.03, rng)) - true
                        for _ in range(100)])
    size = np.sqrt((offsets[:, 30]**2).mean(axis=0))
    np.testing.assert_allclose(size[:3], 0.02, rtol=0.3)
    np.testing.assert_allclose(np.sqrt((size[3:]**2).sum()), np.sqrt(2.0) * 0.03, rtol=0.3)
    assert np.abs(offsets[:, [0, -1]]).max() < 1e-9


def test_a_correction_is_where_the_motion_falls_short_most_and_improves_it(laptop, line):
    person = TrajectoryPerson(laptop, [0])
    item = person.correct("c", line)
    start, end = item.span
    assert end - start == pytest.approx(1.5, abs=0.06)
    np.testing.assert_allclose(item.planned.positions, line.positions_at(item.planned.times))
    for at in (0, -1):  # it leaves the robot's motion and comes back to it
        np.testing.assert_allclose(item.corrected.positions[at], item.planned.positions[at])
    rewards = laptop.task.rewards
    better, worse = (rewards(laptop.robot.tool_states(m.positions)).sum() for m in (item.corrected, item.planned))
    assert better > worse
    shares = np.linspace(0.0, 1.0, 61)
    short = (rewards(laptop.robot.tool_states(laptop.optimum.resampled(61)))
             - rewards(laptop.robot.tool_states(line.resampled(61))))
    inside = (shares * 3.0 >= start) & (shares * 3.0 <= end)
    assert short[inside].mean() > short[~inside].mean()


def test_who_never_errs_leaves_the_optimum_as_it_is(laptop):
    item = TrajectoryPerson(laptop, [0], SURE).correct("c", laptop.optimum)
    np.testing.assert_allclose(item.corrected.positions, item.planned.positions, atol=5e-3)


def test_the_better_of_two_motions_is_ranked_first(laptop, line):
    assert TrajectoryPerson(laptop, [0]).rank("p", [line, laptop.optimum]).ranks == (1, 0)


@pytest.mark.parametrize("name", ["distance(goal)", "height(0.0)", "near_xy(laptop, 1.0)", "tilt"])
def test_a_feature_falls_all_the_way_along_its_trace(laptop, name):
    person = TrajectoryPerson(laptop, [0], SURE)
    feature = make_feature(name, laptop.task.scene.context())
    for _ in range(3):
        states = person.trace(name)
        values = feature(states)[0]
        assert states.shape == (15, 6)
        assert (np.diff(values) < 0.0).all() and values[-1] < 0.35 * values[0]
        assert (states[:, :3] >= np.array(WORKSPACE[0]) - 1e-9).all()
        assert (states[:, :3] <= np.array(WORKSPACE[1]) + 1e-9).all()
        np.testing.assert_allclose(np.linalg.norm(states[:, 3:], axis=1), 1.0)


def test_the_same_seed_acts_alike_and_no_kind_of_feedback_disturbs_another(laptop, line):
    one, two, other = (TrajectoryPerson(laptop, seed) for seed in ([1, 2], [1, 2], [1, 3]))
    one.trace("tilt")
    one.correct("c", line)
    shown = [p.demonstrate("d").trajectory.positions for p in (one, two, other)]
    assert shown[0].tobytes() == shown[1].tobytes() != shown[2].tobytes()
    first, second = two.correct("a", line), two.correct("b", line)
    assert first.corrected.positions.tobytes() != second.corrected.positions.tobytes()


def test_settings_that_no_person_has_are_refused():
    for name, value in (("pace", 0.0), ("error", -0.1), ("trace_points", 1), ("trace_ways", 0)):
        with pytest.raises(ConfigError):
            replace(TrajectoryPersonConfig(), **{name: value})
