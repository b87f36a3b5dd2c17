"""The model of what was taught depends on what was taught, and on nothing else."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from unifeed_ros.core.errors import TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.learning import LONGEST_CHAIN, learn_reward
from unifeed_ros.core.reward.queries import vary_trajectory

CONFIG = TrainingConfig(members=3, hidden=(16, 16), steps=30, warm_steps=10, pool=60)
LETTERS = "DCPNDP"


@pytest.fixture(scope="module")
def items(panda, straight, context):
    """Some of each kind, N a ranking of "neither"."""
    others = vary_trajectory(panda, straight, 0.1, 8, np.random.default_rng(0))

    def item(k, letter):
        common = {"id": f"{k}{letter}", "robot": "panda", "context": context}
        if letter == "D":
            return Demonstration(trajectory=others[k], **common)
        if letter == "C":
            return Correction(planned=others[k], corrected=straight, span=(0.0, straight.duration), **common)
        return Preference(options=(others[k], straight), ranks=() if letter == "N" else (1, 0), **common)

    return [item(k, letter) for k, letter in enumerate(LETTERS)]


def dataset_of(panda, items):
    return FeedbackDataset("panda", panda.joint_names).only(items)


def learned(panda, dataset, known=None, **changes):
    config = dataclasses.replace(CONFIG, **changes)
    return learn_reward(dataset, panda, config, version=9, seed=3, known=known)


def weights(result):
    return result.ensemble.flat_weights().tobytes()


@pytest.mark.parametrize("undone", range(len(LETTERS)))
def test_undo_gives_the_model_that_would_have_been_learned_without_the_input(panda, items, undone):
    dataset = dataset_of(panda, items)
    everything = learned(panda, dataset).ensemble
    dataset.undo(items[undone].id)
    without = dataset_of(panda, [item for k, item in enumerate(items) if k != undone])
    after = learned(panda, dataset, known=everything)
    assert weights(after) == weights(learned(panda, without))
    assert after.ensemble.feedback_ids == tuple(item.id for item in without.items)


@pytest.mark.parametrize("undone", range(len(LETTERS)))
def test_what_is_given_back_is_where_it_was(panda, items, undone):
    dataset = dataset_of(panda, items)
    dataset.undo(items[undone].id)
    without = learned(panda, dataset).ensemble
    dataset.add(items[undone])
    assert [item.id for item in dataset.items] == [item.id for item in items]
    assert weights(learned(panda, dataset, known=without)) == weights(learned(panda, dataset_of(panda, items)))


def test_when_trainings_were_asked_for_makes_no_difference(panda, items):
    at_once = weights(learned(panda, dataset_of(panda, items)))
    for asked in ([1, 2, 3, 4, 5, 6], [1, 6], [4, 5, 6, 6], [2, 3, 6]):
        known = None
        for count in asked:
            known = learned(panda, dataset_of(panda, items[:count]), known=known).ensemble
        assert known.flat_weights().tobytes() == at_once, asked


def test_what_is_known_is_gone_on_from_and_a_correction_begins_anew(panda, items):
    steps, known = [], None
    for count in range(1, len(items) + 1):
        result = learned(panda, dataset_of(panda, items[:count]), known=known)
        steps.append(result.steps)
        known = result.ensemble
    # the ranking of "neither" teaches nothing: its training does the last one again
    assert steps == [30, 30, 10, 40, 10, 10]
    assert learned(panda, dataset_of(panda, items)).steps == 30 + 3 * 10


def test_models_of_other_inputs_and_seeds_are_not_gone_on_from(panda, items):
    dataset = dataset_of(panda, items[:3])
    wanted = weights(learned(panda, dataset))
    other_seed = learn_reward(dataset_of(panda, items[:2]), panda, CONFIG, version=1, seed=4).ensemble
    other_inputs = learned(panda, dataset_of(panda, [items[1], items[0]])).ensemble
    for known in (other_seed, other_inputs):
        assert weights(learned(panda, dataset, known=known)) == wanted


def test_chains_are_bounded(panda, straight, context):
    shown = vary_trajectory(panda, straight, 0.05, 2 * LONGEST_CHAIN + 1, np.random.default_rng(1))
    items = [Demonstration(id=f"{k}", robot="panda", context=context, trajectory=t) for k, t in enumerate(shown)]
    steps = [learned(panda, dataset_of(panda, items[:count]), steps=2, warm_steps=1).steps
             for count in (1, 2, LONGEST_CHAIN, LONGEST_CHAIN + 1, 2 * LONGEST_CHAIN, 2 * LONGEST_CHAIN + 1)]
    assert steps == [2, 3, LONGEST_CHAIN + 1, 2, LONGEST_CHAIN + 1, 2]


def test_without_warm_steps_everything_is_learned_at_once(panda, items):
    assert learned(panda, dataset_of(panda, items), warm_steps=0).steps == 30


def test_progress_goes_from_training_to_training(panda, items):
    told = []
    learn_reward(dataset_of(panda, items), panda, CONFIG, version=1, seed=0, on_progress=told.append)
    assert told[-1] == 1.0 and all(a < b for a, b in itertools.pairwise(told))


def test_nothing_to_learn_from_is_said(panda, items):
    for useless in ([], [items[3]]):
        with pytest.raises(TrainingError, match="nothing to learn from"):
            learned(panda, dataset_of(panda, useless))
