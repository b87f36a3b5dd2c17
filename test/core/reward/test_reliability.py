"""Laws of the weights: only conflict between kinds lowers them, and they weigh as so many comparisons would."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from unifeed_ros.core.errors import ConfigError, TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.buffer import RankingsBuffer, build_buffer
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.reward.reliability import estimate_reliability, log_evidence, reliability_of
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.types import Trajectory

QUICK = TrainingConfig(hidden=(16, 16), steps=25, members=2, pool=50)


@pytest.fixture(scope="module")
def motions(panda, straight) -> list[Trajectory]:
    return vary_trajectory(panda, straight, 0.1, 5, np.random.default_rng(0))


@pytest.fixture(scope="module")
def items(context, straight, motions):
    """The straight motion is right in all of them, and what the last of the motions is worth is left to be said."""
    common = {"robot": "panda", "context": context}
    return (Demonstration(id="d", trajectory=straight, **common),
            Correction(id="c", planned=motions[0], corrected=straight, span=(0.0, 4.0), **common),
            Preference(id="p", options=(straight, *motions), ranks=(0, 1, 2, 3, 4, 5), **common))


def dataset_of(panda, items) -> FeedbackDataset:
    dataset = FeedbackDataset("panda", panda.joint_names)
    for item in items:
        dataset.add(item)
    return dataset


def buffer_of(panda, items) -> RankingsBuffer:
    return build_buffer(dataset_of(panda, items), panda, waypoints=12, demonstration_alternatives=40,
                        correction_alternatives=40, config=QUICK.alternatives, rng=np.random.default_rng(0))


@pytest.mark.parametrize("used", ["D", "C", "P", "DC", "DP", "CP"])
def test_where_no_third_kind_can_decide_all_are_trusted(used, panda, items):
    assert estimate_reliability(buffer_of(panda, [i for i in items if i.letter in used])) == (1.0, 1.0, 1.0)


def test_kinds_that_agree_are_trusted_and_the_one_that_contradicts_is_not(panda, items):
    sound = estimate_reliability(buffer_of(panda, items))
    assert max(sound) == 1.0
    assert min(sound) > 0.8
    backwards = dataclasses.replace(items[2], ranks=(5, 4, 3, 2, 1, 0))
    demonstrations, corrections, preferences = estimate_reliability(buffer_of(panda, (*items[:2], backwards)))
    assert preferences < 0.2
    assert min(demonstrations, corrections) > 0.8


def test_a_few_noisy_answers_doubt_nobody(panda, items):
    few = dataclasses.replace(items[2], options=items[2].options[:3], ranks=(2, 1, 0))
    assert estimate_reliability(buffer_of(panda, (*items[:2], few))) == (1.0, 1.0, 1.0)


def test_order_changes_nothing(panda, items):
    buffer = buffer_of(panda, (*items, dataclasses.replace(items[0], id="d2", trajectory=items[2].options[1])))
    rng = np.random.default_rng(1)
    order = rng.permutation(len(buffer.shown))
    place = np.argsort(order)
    pairs = rng.permutation(len(buffer.better))
    shuffled = dataclasses.replace(
        buffer, shown=buffer.shown[order], demonstrated=place[buffer.demonstrated][::-1],
        demonstration_alternatives=buffer.demonstration_alternatives[::-1], corrected=place[buffer.corrected],
        planned=place[buffer.planned], better=place[buffer.better][pairs], worse=place[buffer.worse][pairs])
    np.testing.assert_allclose(estimate_reliability(shuffled), estimate_reliability(buffer), atol=1e-6)


def test_the_evidence_of_unrelated_comparisons_adds_up():
    rng = np.random.default_rng(0)
    first, second = (a @ a.T for a in rng.normal(size=(2, 4, 3)))
    both = np.block([[first, np.zeros((4, 4))], [np.zeros((4, 4)), second]])
    assert log_evidence(both) == pytest.approx(log_evidence(first) + log_evidence(second), abs=1e-3)


def test_comparisons_that_nothing_is_known_of_are_a_coin_flip_each():
    assert log_evidence(1e-9 * np.eye(5)) == pytest.approx(5 * np.log(0.5), abs=1e-6)


def test_agreement_is_likelier_than_contradiction():
    agree, contradict = np.full((2, 2), 9.0), np.array([[9.0, -9.0], [-9.0, 9.0]])
    assert log_evidence(agree) > log_evidence(9.0 * np.eye(2)) > log_evidence(contradict)


def test_fixed_weights_are_used_as_given(panda, items):
    config = dataclasses.replace(QUICK, reliability=[0.25, 1, 0.5])
    assert train_reward(dataset_of(panda, items), panda, config, version=1, seed=0).reliability == (0.25, 1.0, 0.5)


def test_a_weight_is_worth_as_many_comparisons(panda, items):
    dataset = dataset_of(panda, items)
    weighted = dataclasses.replace(QUICK, reliability=(0.5, 1.0, 0.25), demonstration_comparisons=80,
                                   preference_comparisons=20)
    counted = dataclasses.replace(QUICK, reliability=(1.0, 1.0, 1.0), demonstration_comparisons=40,
                                  preference_comparisons=5)
    first, second = (train_reward(dataset, panda, c, version=1, seed=0).ensemble for c in (weighted, counted))
    assert first.flat_weights().tobytes() == second.flat_weights().tobytes()


def test_training_tells_the_weights_that_it_estimated(panda, items):
    backwards = dataclasses.replace(items[2], ranks=(5, 4, 3, 2, 1, 0))
    result = train_reward(dataset_of(panda, (*items[:2], backwards)), panda, QUICK, version=1, seed=0)
    assert result.reliability[2] < 0.2


def test_weights_that_leave_nothing_are_refused(panda, items):
    buffer = buffer_of(panda, items[:1])
    assert reliability_of(buffer, (0.1, 0.0, 0.0)) == (0.1, 0.0, 0.0)
    with pytest.raises(TrainingError, match="leave nothing"):
        reliability_of(buffer, (0.0, 1.0, 1.0))


@pytest.mark.parametrize("setting", ["guess", (1.0, 1.0), (1.0, 1.0, 1.1), (0.0, 0.0, 0.0), (1.0, np.nan, 1.0)])
def test_settings_that_mean_nothing_are_refused(setting):
    with pytest.raises(ConfigError, match="reliability"):
        TrainingConfig(reliability=setting)
