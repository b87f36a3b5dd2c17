"""What training promises: it learns what was shown, the same way every time, and refuses what cannot be learned."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from unifeed_ros.core.errors import ConfigError, TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.buffer import AlternativesConfig, build_buffer
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.types import Trajectory

QUICK = TrainingConfig(hidden=(32, 32), steps=120, demonstration_comparisons=40, correction_comparisons=40,
                       preference_comparisons=40)


def span(trajectory: Trajectory) -> Trajectory:
    return Trajectory(joint_names=trajectory.joint_names, times=trajectory.times[15:46],
                      positions=trajectory.positions[15:46])


@pytest.fixture(scope="module")
def shown(panda, straight) -> list[Trajectory]:
    return vary_trajectory(panda, straight, 0.1, 3, np.random.default_rng(0))


@pytest.fixture(scope="module")
def items(context, straight, shown):
    """The straight motion is right in all of them."""
    common = {"robot": "panda", "context": context}
    return (
        Demonstration(id="d", trajectory=straight, **common),
        Correction(id="c", planned=span(shown[0]), corrected=span(straight), span=(1.0, 3.0), **common),
        Preference(id="p", options=(shown[1], straight, shown[2]), ranks=(1, 0, 1), **common),
        Preference(id="neither", options=(shown[1], shown[2]), ranks=(), **common),
    )


def dataset_of(panda, items) -> FeedbackDataset:
    dataset = FeedbackDataset("panda", panda.joint_names)
    for item in items:
        dataset.add(item)
    return dataset


@pytest.fixture(scope="module")
def result(panda, items):
    return train_reward(dataset_of(panda, items), panda, QUICK, version=4, seed=7)


def test_it_prefers_what_was_shown(result, panda, straight, shown, context):
    assert result.accuracy > 0.8
    reward = result.ensemble.bind(context)
    total = lambda t: reward.member_rewards(panda.tool_states(t.resampled(20))).sum(axis=1)  # noqa: E731 - local
    fresh = vary_trajectory(panda, straight, 0.15, 10, np.random.default_rng(99))
    better = np.array([total(straight) > total(other) for other in fresh])
    assert better.mean() > 0.75


def test_it_says_what_it_learned_from(result, context):
    model = result.ensemble
    assert (model.version, model.robot, model.frame, model.seed) == (4, "panda", "panda_link0", 7)
    assert model.feedback_ids == ("d", "c", "p", "neither")
    assert model.layer_sizes == (len(model.inputs), 32, 32, 1)
    assert result.steps == QUICK.steps
    assert result.seconds > 0
    assert 0 < result.loss_demonstrations < 0.7
    assert 0 < result.loss_corrections < 0.7
    assert 0 < result.loss_preferences < 0.7


def test_a_tilt_far_beyond_what_was_shown_is_worse(panda, items, straight, context):
    reward = train_reward(dataset_of(panda, items[:2]), panda, QUICK, version=1, seed=0).ensemble.bind(context)
    states = panda.tool_states(straight.resampled(20))
    bump = np.sin(np.linspace(0.0, np.pi, 20))[:, None]
    for turned in np.concatenate([np.eye(3), -np.eye(3)]):
        sideways = turned - (states[:, 3:] @ turned)[:, None] * states[:, 3:]
        returns = []
        for angle in (0.0, 1.2):
            tilted = states.copy()
            tilted[:, 3:] += np.tan(angle * bump) * sideways
            tilted[:, 3:] /= np.linalg.norm(tilted[:, 3:], axis=1, keepdims=True)
            returns.append(reward.value_and_gradient(tilted)[0].sum())
        assert returns[0] >= returns[1]


def test_a_larger_pool_makes_the_seed_matter_less(panda, items, straight, context):
    fresh = [panda.tool_states(t.resampled(20))
             for t in vary_trajectory(panda, straight, 0.15, 12, np.random.default_rng(5))]
    base = panda.tool_states(straight.resampled(20))

    def spread(pool: int) -> float:
        models = [train_reward(dataset_of(panda, items[:1]), panda, dataclasses.replace(QUICK, pool=pool), version=1,
                               seed=seed).ensemble.bind(context) for seed in range(4)]
        gains = [[(m.value_and_gradient(f)[0] - m.value_and_gradient(base)[0]).sum() for f in fresh] for m in models]
        return float(np.std(gains, axis=0).mean())

    assert spread(1000) < spread(8)


def test_members_are_independent(result):
    first = result.ensemble.weights[0]
    assert np.abs(first[0] - first[1]).max() > 0.01


def test_same_seed_same_bytes_and_another_seed_others(result, panda, items):
    again = train_reward(dataset_of(panda, items), panda, QUICK, version=4, seed=7)
    assert again.ensemble.flat_weights().tobytes() == result.ensemble.flat_weights().tobytes()
    other = train_reward(dataset_of(panda, items), panda, QUICK, version=4, seed=8)
    assert other.ensemble.flat_weights().tobytes() != result.ensemble.flat_weights().tobytes()


def test_the_number_of_threads_changes_no_byte(result, panda, items):
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        again = train_reward(dataset_of(panda, items), panda, QUICK, version=4, seed=7)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert again.ensemble.flat_weights().tobytes() == result.ensemble.flat_weights().tobytes()


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_one_kind_of_feedback_is_enough(kind, panda, items):
    result = train_reward(dataset_of(panda, items[kind:kind + 1]), panda, QUICK, version=1, seed=0)
    losses = (result.loss_demonstrations, result.loss_corrections, result.loss_preferences)
    assert [loss > 0 for loss in losses] == [k == kind for k in range(3)]


def test_progress_grows_to_one(panda, items):
    told: list[float] = []
    train_reward(dataset_of(panda, items[:1]), panda, QUICK, version=1, seed=0, on_progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_it_goes_on_from_the_last_model_where_that_fits(result, panda, items):
    warm = dataclasses.replace(QUICK, warm_steps=15)
    dataset = dataset_of(panda, items)
    went_on = train_reward(dataset, panda, warm, version=5, seed=1, previous=result.ensemble)
    assert went_on.steps == 15
    assert went_on.accuracy > 0.8
    wider = dataclasses.replace(warm, hidden=(16, 16))
    assert train_reward(dataset, panda, wider, version=5, seed=1, previous=result.ensemble).steps == wider.steps


def test_it_does_not_go_on_from_a_model_that_cannot_learn_any_more(result, panda, items):
    biases = result.ensemble.biases
    saturated = dataclasses.replace(result.ensemble, biases=(*biases[:-1], biases[-1] - 12.0))
    anew = train_reward(dataset_of(panda, items), panda, QUICK, version=5, seed=1, previous=saturated)
    assert anew.steps == QUICK.steps
    assert anew.accuracy > 0.8


def test_the_buffer_holds_algorithm_1s_comparisons(panda, items):
    buffer = build_buffer(dataset_of(panda, items), panda, waypoints=12, demonstration_alternatives=9,
                          correction_alternatives=5, config=AlternativesConfig(delay_share=0.0),
                          rng=np.random.default_rng(0))
    assert buffer.shown.shape == (6, 12, len(buffer.inputs))
    assert buffer.demonstration_alternatives.shape == (1, 9, 12, len(buffer.inputs))
    assert buffer.correction_alternatives.shape == (1, 5, 12, len(buffer.inputs))
    assert (buffer.demonstrated.tolist(), buffer.corrected.tolist(), buffer.planned.tolist()) == ([0], [1], [2])
    assert list(zip(buffer.better.tolist(), buffer.worse.tolist(), strict=True)) == [(4, 3), (4, 5)]
    ends = buffer.correction_alternatives[0][:, [0, -1], :3]
    np.testing.assert_allclose(ends, np.broadcast_to(buffer.shown[1][[0, -1], :3], ends.shape), atol=1e-6)


def test_delayed_alternatives_stay_on_the_path_and_need_not_arrive(panda, items):
    buffer = build_buffer(dataset_of(panda, items), panda, waypoints=12, demonstration_alternatives=1,
                          correction_alternatives=40, config=AlternativesConfig(delay_share=1.0),
                          rng=np.random.default_rng(0))
    path, delayed = buffer.shown[1][:, :3], buffer.correction_alternatives[0][..., :3]
    np.testing.assert_allclose(delayed[:, 0], np.broadcast_to(path[0], (40, 3)), atol=1e-6)
    fine = np.stack([np.interp(np.linspace(0, 11, 400), np.arange(12), column) for column in path.T], axis=-1)
    gaps = np.linalg.norm(delayed[:, :, None] - fine[None, None], axis=-1).min(axis=-1)
    assert gaps.max() < 0.005
    assert (np.linalg.norm(delayed[:, -1] - path[-1], axis=-1) > 0.01).any()


def test_a_pause_within_a_correction_changes_nothing(panda, items):
    correction = items[1]
    states = []
    for item in (correction, dataclasses.replace(correction, corrected=paused(correction.corrected),
                                                 planned=paused(correction.planned))):
        buffer = build_buffer(dataset_of(panda, [item]), panda, waypoints=12, demonstration_alternatives=1,
                              correction_alternatives=1, config=AlternativesConfig(), rng=np.random.default_rng(0))
        states.append(buffer.shown[[*buffer.corrected, *buffer.planned]])
    np.testing.assert_allclose(states[0], states[1], atol=0.01)


def paused(trajectory):
    """Stop for two seconds in the middle."""
    middle = len(trajectory.times) // 2
    return dataclasses.replace(
        trajectory, velocities=None, accelerations=None,
        times=np.concatenate([trajectory.times[:middle + 1], trajectory.times[middle:] + 2.0]),
        positions=np.insert(trajectory.positions, middle, trajectory.positions[middle], axis=0))


def test_nothing_to_learn_from_is_said(panda, items):
    for useless in ((), items[3:]):
        with pytest.raises(TrainingError, match="nothing to learn from"):
            train_reward(dataset_of(panda, useless), panda, QUICK, version=1, seed=0)


def test_a_diverged_training_is_refused(panda, items):
    wild = dataclasses.replace(QUICK, learning_rate=0.9, weight_penalty=1e30)
    with pytest.raises(TrainingError, match="dead or diverged"):
        train_reward(dataset_of(panda, items[:1]), panda, wild, version=1, seed=0)


@pytest.mark.parametrize("setting", [
    {"members": 1}, {"hidden": ()}, {"hidden": (0,)}, {"waypoints": 3}, {"steps": 0}, {"batch": 0}, {"pool": 0},
    {"learning_rate": 0.0}, {"weight_penalty": -1.0}, {"weight_penalty": np.nan}, {"demonstration_comparisons": 0},
    {"rationality": 0.0}])
def test_settings_that_cannot_work_are_refused(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        TrainingConfig(**setting)


@pytest.mark.parametrize("setting", [
    {"position_sizes": ()}, {"position_sizes": (0.0,)}, {"axis_sizes": (np.inf,)}, {"axis_share": 1.5},
    {"free_end_share": np.nan}, {"delay_share": -0.1}])
def test_alternatives_that_cannot_work_are_refused(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        AlternativesConfig(**setting)
