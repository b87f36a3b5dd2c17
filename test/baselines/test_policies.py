"""Policies that other libraries train: following them, what a missing environment says, and what each method learns.

The last tests need the environment of `make policies` and are skipped, with that word, where it is missing.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.baselines.policies import (
    PYTHON_VARIABLE,
    USUAL_PYTHON,
    AdversarialConfig,
    AtariConfig,
    CloningConfig,
    PolicyLearner,
    Worker,
    follow,
)
from unifeed_ros.core.errors import ConfigError, InputError, TrainingError
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.resources import config_path

CONTEXT = Context(goal=np.array([0.5, -0.2, 0.3]))
STATES, DURATION = 20, 3.0
pytestmark = pytest.mark.timeout(400)  # the libraries alone take seconds to load
needs_environment = pytest.mark.skipif(not Path(os.environ.get(PYTHON_VARIABLE, USUAL_PYTHON)).is_file(),
                                       reason="`make policies` was not run")


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def start(robot):
    return robot.inverse_kinematics([0.4, 0.2, 0.5])


@pytest.fixture(scope="module")
def worker():
    with Worker() as one:
        yield one


def path(height=0.0, end=(0.5, -0.2, 0.3)):
    """From the start straight to the end, but for a bulge upwards [m]."""
    share = np.linspace(0.0, 1.0, STATES)[:, None]
    smooth = share * share * (3.0 - 2.0 * share)
    bulge = height * np.sin(np.pi * share) * np.array([0.0, 0.0, 1.0])
    return np.array([0.4, 0.2, 0.5]) * (1.0 - smooth) + np.array(end) * smooth + bulge


def motion(robot, start, positions):
    return Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, DURATION, len(positions)),
                      positions=follow(robot, start, positions, DURATION))


def demonstration(robot, start, name, height):
    return Demonstration(id=name, robot="panda", context=CONTEXT, trajectory=motion(robot, start, path(height)))


def learner_of(method, worker, robot, start, config):
    return PolicyLearner(method, worker, robot, start, DURATION, STATES, config, seed=0)


def tool(robot, trajectory):
    return robot.tool_states(trajectory.resampled(STATES))


def test_the_arm_follows_the_tools_path_and_keeps_its_direction(robot, start):
    states = robot.tool_states(follow(robot, start, path(0.1), DURATION))
    np.testing.assert_allclose(states[:, :3], path(0.1), atol=2e-3)
    np.testing.assert_allclose(states[:, 3:], np.tile([0.0, 0.0, -1.0], (STATES, 1)), atol=0.02)


def test_what_the_arm_cannot_follow_keeps_its_limits(robot, start):
    far = path(end=(2.0, -0.2, 0.3))
    followed = follow(robot, start, far, 0.5)
    assert (followed >= robot.lower).all() and (followed <= robot.upper).all()
    assert (np.abs(np.diff(followed, axis=0)) <= robot.velocity_limits * 0.5 / (STATES - 1) + 1e-9).all()
    assert np.linalg.norm(robot.tool_states(followed)[-1, :3] - far[-1]) > 0.5


def test_without_the_environment_it_says_how_to_make_it(robot, start, tmp_path):
    with Worker(tmp_path / "python") as missing:
        learner = learner_of("BC", missing, robot, start, CloningConfig())
        learner.learn(demonstration(robot, start, "d", 0.0))
        with pytest.raises(ConfigError, match="make policies"):
            learner.motion()


def test_an_environment_without_the_libraries_is_said(robot, start):
    with Worker(Path(sys.executable)) as wrong:
        learner = learner_of("BC", wrong, robot, start, CloningConfig())
        learner.learn(demonstration(robot, start, "d", 0.0))
        with pytest.raises(TrainingError, match="make policies"):
            learner.motion()


def test_without_a_demonstration_nothing_is_cloned(robot, start, tmp_path):
    with pytest.raises(InputError, match="demonstration"):
        learner_of("BC", Worker(tmp_path / "python"), robot, start, CloningConfig()).motion()


@needs_environment
def test_cloning_repeats_what_it_was_shown(robot, start, worker):
    learner = learner_of("BC", worker, robot, start, CloningConfig(epochs=300))
    for k in range(2):
        learner.learn(demonstration(robot, start, f"d{k}", 0.1))
    made = learner.motion()
    assert np.linalg.norm(tool(robot, made)[:, :3] - path(0.1), axis=1).max() < 0.04
    assert learner.motion().positions.tobytes() == made.positions.tobytes()  # the same seed, the same bytes
    assert learner.seconds > 0.0


@needs_environment
def test_cloning_takes_over_what_the_person_took_over(robot, start, worker):
    """Human-gated: shown a straight motion, then corrected upwards again and again."""
    learner = learner_of("BC", worker, robot, start, CloningConfig(epochs=200))
    learner.learn(demonstration(robot, start, "d", 0.0))
    before = learner.motion()
    wish = motion(robot, start, path(0.1))
    times, span = np.linspace(0.3, 2.7, 40), (0.3, 2.7)
    planned, corrected = (Trajectory(joint_names=robot.joint_names, times=times, positions=m.positions_at(times))
                          for m in (before, wish))
    for k in range(4):
        learner.learn(Correction(id=f"c{k}", robot="panda", context=CONTEXT, planned=planned, corrected=corrected,
                                 span=span))
    heights = [tool(robot, m)[5:15, 2].mean() for m in (before, learner.motion(), wish)]
    assert heights[1] > heights[0] + 0.5 * (heights[2] - heights[0])


@needs_environment
def test_airl_comes_to_move_as_the_expert_does(robot, start, worker):
    """Fu, Luo and Levine 2018: where the discriminator can no longer tell them apart, the policy is the expert's."""
    errors = []
    for rounds in (1, 40):
        learner = learner_of("AIRL", worker, robot, start, AdversarialConfig(rounds=rounds, clone=0))
        for k, height in enumerate((0.08, 0.12)):
            learner.learn(demonstration(robot, start, f"d{k}", height))
        errors.append(np.linalg.norm(tool(robot, learner.motion())[:, :3] - path(0.1), axis=1).mean())
    assert errors[1] < 0.5 * errors[0]


@needs_environment
def test_atari_moves_towards_what_is_preferred(robot, start, worker):
    """Christiano et al. 2017: rankings of pairs suffice to maximise a reward that nobody wrote down; here, height."""
    def taught(answers):
        learner = learner_of("Atari", worker, robot, start, AtariConfig(automatic=0, learning_rate=1e-3))
        for k, height in enumerate((0.0, 0.1)):
            learner.learn(demonstration(robot, start, f"d{k}", height))
        for k in range(6):
            options = learner.question()
            heights = [tool(robot, option)[:, 2].mean() for option in options]
            first = int(np.argmax(heights)) if answers == "higher" else int(np.argmin(heights))
            learner.learn(Preference(id=f"p{k}", robot="panda", context=CONTEXT, options=options,
                                     ranks=(0, 1) if first == 0 else (1, 0)))
        return tool(robot, learner.motion())[:, 2].mean()
    assert taught("higher") > taught("lower") + 0.05
