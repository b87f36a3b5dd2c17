"""FERL learns features that it is shown, and tells when one is missing."""

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr

from unifeed_ros.baselines.ferl import Ferl, FerlConfig
from unifeed_ros.baselines.learned_feature import FeatureTrace, TraceTraining, learn_feature
from unifeed_ros.core.errors import InputError, ShapeError
from unifeed_ros.core.reward.features import make_feature
from unifeed_ros.core.types import Context

from .slider import Slider, correction

LOW, HIGH = (0.2, -0.5, 0.05), (0.75, 0.5, 0.6)
CONTEXT = Context(goal=np.add(LOW, HIGH) / 2.0)
"""The goal is in the middle, so that it is far from all corners, not from one side only."""
QUICK = TraceTraining(epochs=25)
"""A quarter of the passes: enough to rank states rightly."""


def states(places):
    return np.concatenate([places, np.tile([0.0, 0.0, -1.0], (len(places), 1))], axis=1)


def traces(name, rng, count=10, points=12):
    """Straight down the feature from one of the places where there is much of it, with a hand's noise."""
    shown = []
    for _ in range(count):
        places = rng.uniform(LOW, HIGH, size=(30, 3))
        much = make_feature(name, CONTEXT)(states(places))[0]
        start = rng.choice(places[much >= 0.8 * much.max()])
        end = {"distance(goal)": CONTEXT.goal, "height(0.0)": [*start[:2], LOW[2]]}[name]
        path = np.linspace(start, end, points) + rng.normal(scale=0.005, size=(points, 3))
        shown.append(FeatureTrace(context=CONTEXT, states=states(path)))
    return shown


@pytest.fixture(scope="module")
def height():
    return learn_feature(traces("height(0.0)", np.random.default_rng(0)), QUICK, seed=0)


@pytest.fixture(scope="module")
def somewhere():
    return states(np.random.default_rng(9).uniform(LOW, HIGH, size=(500, 3)))


def test_a_learned_height_ranks_states_as_the_true_one(height, somewhere):
    learned = height(CONTEXT)(somewhere)[0]
    assert spearmanr(learned, make_feature("height(0.0)", CONTEXT)(somewhere)[0]).statistic > 0.857
    assert -0.3 < learned.min() < 0.2 and 0.8 < learned.max() < 1.3


def test_a_learned_distance_ranks_states_as_the_true_one(somewhere):
    name = "distance(goal)"
    learned = learn_feature(traces(name, np.random.default_rng(1)), QUICK, seed=0)(CONTEXT)(somewhere)[0]
    assert spearmanr(learned, make_feature(name, CONTEXT)(somewhere)[0]).statistic > 0.85


def test_learned_features_are_between_0_and_1_over_their_traces(height):
    shown = np.concatenate([t.states for t in traces("height(0.0)", np.random.default_rng(0))])
    values = height(CONTEXT)(shown)[0]
    assert values.min() == pytest.approx(0.0, abs=1e-5) and values.max() == pytest.approx(1.0, abs=1e-5)


def test_learned_features_have_exact_gradients(height, somewhere):
    feature, few, step = height(CONTEXT), somewhere[:20], 1e-3
    _, gradients = feature(few)
    for column in range(3):
        moved = np.zeros(6)
        moved[column] = step
        slopes = (feature(few + moved)[0] - feature(few - moved)[0]) / (2.0 * step)
        # single precision, and kinks: nearly all states have none within the step
        assert np.mean(np.abs(slopes - gradients[:, column]) < 0.02) > 0.8


def test_a_learned_feature_is_its_network_s_output(height, somewhere):
    inputs = np.array(somewhere[:, :3])
    inputs = torch.from_numpy(np.concatenate([inputs, CONTEXT.goal - inputs], axis=1).astype(np.float32))
    output = height.network(inputs)[:, 0].numpy()
    expected = (output - height.low) / (height.high - height.low)
    np.testing.assert_allclose(height(CONTEXT)(somewhere)[0], expected, atol=1e-4)


def test_the_inputs_that_explain_the_feature_are_chosen(height):
    assert "z" in height.inputs
    rng, tilted = np.random.default_rng(2), []
    for _ in range(6):
        angles, turn = np.linspace(rng.uniform(1.0, 1.5), 0.0, 12), rng.uniform(-np.pi, np.pi)
        axes = np.stack([np.sin(angles) * np.cos(turn), np.sin(angles) * np.sin(turn), -np.cos(angles)], axis=1)
        places = np.tile(rng.uniform(LOW, HIGH), (12, 1)) + rng.normal(scale=0.005, size=(12, 3))
        tilted.append(FeatureTrace(context=CONTEXT, states=np.concatenate([places, axes], axis=1)))
    assert learn_feature(tilted, TraceTraining(epochs=1), seed=0).inputs == ("axis_x", "axis_y", "axis_z")


def test_the_same_seed_gives_the_same_feature(somewhere):
    few = traces("height(0.0)", np.random.default_rng(3), count=3, points=5)
    one, two = (learn_feature(few, TraceTraining(epochs=2), seed=5)(CONTEXT)(somewhere)[0] for _ in range(2))
    assert one.tobytes() == two.tobytes()


def test_pushing_down_is_explained_by_height_and_not_by_the_distance_over_the_table():
    down = correction([[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]], [[0.2, 0.0, 0.3], [0.4, 0.0, 0.3]])
    knows, lacks = (Ferl(Slider(), [name], FerlConfig(), seed=0) for name in ("height(0.0)", "distance_xy(goal)"))
    assert knows.confidences(down)[0] > 1e6 and not knows.misses_feature(down)
    assert lacks.confidences(down)[0] == 0.0 and lacks.misses_feature(down)
    assert Ferl(Slider(), [], FerlConfig(), seed=0).misses_feature(down)


def test_a_push_at_45_degrees_to_a_feature_is_explained_by_half():
    aslant = correction([[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]], [[0.2, 0.1, 0.3], [0.4, 0.1, 0.3]])
    ferl = Ferl(Slider(), ["height(0.0)"], FerlConfig(), seed=0)
    # ||u*||^2 is half of ||u||^2: beta = 1 * (1/2) / (2 * (1 - 1/2))
    assert ferl.confidences(aslant)[0] == pytest.approx(0.5)


def test_a_learned_feature_takes_part_in_the_reward(height):
    ferl = Ferl(Slider(), ["distance_xy(goal)"], FerlConfig(), seed=0)
    ferl.add(height)
    down = correction([[0.2, 0.0, 0.5], [0.4, 0.0, 0.5]], [[0.2, 0.0, 0.2], [0.4, 0.0, 0.2]])
    ferl.learn(down)
    (low, high), _ = ferl.reward(CONTEXT).value_and_gradient(states(np.array([[0.4, 0.0, 0.2], [0.4, 0.0, 0.5]])))
    assert low > high + 0.1
    assert not ferl.misses_feature(down)


def test_traces_that_teach_nothing_are_refused():
    with pytest.raises(InputError, match="at least two"):
        FeatureTrace(context=CONTEXT, states=np.zeros((1, 6)))
    with pytest.raises(ShapeError):
        FeatureTrace(context=Context(goal=np.zeros(3)), states=np.zeros((4, 3)))
    with pytest.raises(InputError, match="at least two"):
        learn_feature(traces("height(0.0)", np.random.default_rng(0), count=1), QUICK, seed=0)
