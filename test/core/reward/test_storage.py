"""Models as files: nothing is lost, and nothing else is taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.storage import load_model, save_model

INPUTS = ("x", "y", "z", "axis_x", "axis_y", "axis_z", "goal_dx", "goal_dy", "goal_dz")


def some_model():
    weights = np.random.default_rng(1).normal(size=2 * (9 * 5 + 5 + 5 + 1)).astype(np.float32)
    return RewardEnsemble.from_flat(weights, members=2, layer_sizes=(9, 5, 1), inputs=INPUTS, version=4, robot="ur10",
                                    frame="base_link", feedback_ids=("demonstration-1",), seed=3)


def test_a_model_comes_back_from_its_file(tmp_path):
    model = some_model()
    back = load_model(save_model(tmp_path / "new" / "model.safetensors", model))
    assert back.flat_weights().tobytes() == model.flat_weights().tobytes()
    assert (back.version, back.robot, back.frame, back.inputs, back.layer_sizes, back.feedback_ids, back.seed) == (
        model.version, model.robot, model.frame, model.inputs, model.layer_sizes, model.feedback_ids, model.seed)


def test_the_same_model_gives_the_same_bytes(tmp_path):
    first, second = (save_model(tmp_path / name, some_model()) for name in ("a.safetensors", "b.safetensors"))
    assert first.read_bytes() == second.read_bytes()


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text").write_text("not a model")
    for name in ("text", "missing"):
        with pytest.raises(InputError, match="not a reward model"):
            load_model(tmp_path / name)
