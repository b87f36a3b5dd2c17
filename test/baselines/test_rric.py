"""RRIC's sampled posterior beside exhaustive enumeration, and what it infers from each kind of feedback."""

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.baselines.rric import Choice, Rric, RricConfig, posterior_of, sample_posterior
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.feedback.items import Demonstration, Preference

from .slider import CONTEXT, FEATURES, Slider, correction, motion

HIGH, LOW = ([[0.2, 0.0, z], [0.3, 0.0, z], [0.4, 0.0, z]] for z in (0.4, 0.2))


def choices(rng, count=4, options=5, features=2):
    gaps = rng.normal(size=(count, options, features))
    gaps[:, 0] = 0.0
    return [Choice(gaps=g, rationality=2.0) for g in gaps]


def enumerated(made, steps=201):
    """Mean of the posterior over a grid of the unit disc, each probability written out."""
    axis = np.linspace(-1.0, 1.0, steps)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[(grid**2).sum(axis=1) <= 1.0]
    chances = np.ones(len(grid))
    for choice in made:
        chances *= 1.0 / np.exp(choice.rationality * grid @ choice.gaps.T).sum(axis=1)
    return grid, chances / chances.sum()


@pytest.mark.parametrize("seed", range(3))
def test_the_posterior_mean_is_that_of_exhaustive_enumeration(seed):
    rng = np.random.default_rng(seed)
    made = choices(rng)
    grid, chances = enumerated(made)
    samples = sample_posterior(made, 2, RricConfig(samples=40000, step=0.7), rng)[20000:]
    np.testing.assert_allclose(samples.mean(axis=0), chances @ grid, atol=0.03)
    spread = np.sqrt(chances @ (grid - chances @ grid)**2)
    np.testing.assert_allclose(samples.std(axis=0), spread, atol=0.03)


def test_the_posterior_is_the_product_of_the_choices_inside_the_ball():
    made = choices(np.random.default_rng(0))
    grid, chances = enumerated(made, 21)
    log = np.array([posterior_of(made, 2)(theta) for theta in grid])
    np.testing.assert_allclose(log - log[0], np.log(chances) - np.log(chances[0]), atol=1e-9)
    assert posterior_of(made, 2)(np.array([0.8, 0.8])) == -np.inf


def test_without_choices_it_is_the_prior():
    samples = sample_posterior([], 2, RricConfig(samples=20000, step=0.7), np.random.default_rng(0))
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=0.05)
    assert (np.linalg.norm(samples, axis=1) <= 1.0).all()
    assert np.mean(np.linalg.norm(samples, axis=1) < np.sqrt(0.5)) == pytest.approx(0.5, abs=0.05)


def demonstration():
    return Demonstration(id="d", robot="slider", context=CONTEXT, trajectory=motion(LOW))


def ranking():
    return Preference(id="p", robot="slider", context=CONTEXT, options=(motion(HIGH), motion(LOW)), ranks=(1, 0))


@pytest.mark.parametrize("item", [correction(HIGH, LOW), ranking()], ids=["correction", "ranking"])
def test_low_motions_are_inferred_to_be_wanted(item):
    learner = Rric(Slider(), FEATURES, RricConfig(), seed=0)
    assert not learner.reward(CONTEXT).weights.any()
    learner.learn(item)
    assert learner.reward(CONTEXT).weights[0] < -0.3


def test_a_demonstration_near_the_goal_says_that_the_goal_is_wanted():
    learner = Rric(Slider(), FEATURES, RricConfig(), seed=0)
    at_goal = [CONTEXT.goal] * 3
    learner.learn(Demonstration(id="d", robot="slider", context=CONTEXT, trajectory=motion(at_goal)))
    assert learner.reward(CONTEXT).weights[1] < -0.3


def test_more_of_the_same_makes_it_surer_and_a_tie_changes_nothing_that_was_chosen():
    learner = Rric(Slider(), FEATURES, RricConfig(), seed=0)
    learner.learn(ranking())
    before = learner.samples.std(axis=0)[0]
    learner.learn(correction(HIGH, LOW))
    assert learner.samples.std(axis=0)[0] < before
    count = len(learner.choices)
    learner.learn(replace(ranking(), id="t", ranks=(0, 0)))
    assert len(learner.choices) == count


def test_the_same_seed_gives_the_same_bytes():
    pair = [Rric(Slider(), FEATURES, RricConfig(samples=200), seed=3) for _ in range(2)]
    for learner in pair:
        learner.learn(demonstration())
    assert pair[0].samples.tobytes() == pair[1].samples.tobytes()


def test_bad_settings_are_refused():
    for settings in ({"samples": 1}, {"step": 0.0}, {"choices": 0}, {"preference_rationality": -1.0}):
        with pytest.raises(ConfigError):
            RricConfig(**settings)
