"""Learned rewards as files: weights in safetensors, settings in its metadata, nothing that could run."""

from __future__ import annotations

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.reward.ensemble import RewardEnsemble

FORMAT = "unifeed reward 1"


def save_model(path: Path, model: RewardEnsemble) -> Path:
    """Write a model.

    Args:
        path: File to write; its folder is made.
        model: Learned reward.

    Returns:
        The path, absolute.

    Raises:
        OSError: The file cannot be written.
    """
    path = path.expanduser().resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {
        "format": FORMAT,
        "version": model.version,
        "robot": model.robot,
        "frame": model.frame,
        "inputs": list(model.inputs),
        "layer_sizes": list(model.layer_sizes),
        "members": int(model.weights[0].shape[0]),
        "feedback_ids": list(model.feedback_ids),
        "seed": model.seed,
        "activation": model.activation,
    }
    temporary = path.with_suffix(".partial")
    # one entry only: safetensors writes several in no fixed order, and the same model must give the same bytes
    save_file({"weights": model.flat_weights()}, temporary, metadata={"reward": json.dumps(about)})
    temporary.replace(path)
    return path


def load_model(path: Path) -> RewardEnsemble:
    """Read a model that save_model wrote.

    Args:
        path: File to read.

    Returns:
        The model.

    Raises:
        InputError: The file is missing, or is not such a model.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            about = json.loads((file.metadata() or {}).get("reward", "{}"))
            if about.get("format") != FORMAT:
                raise InputError(f"{path} is not a reward model", expected=FORMAT, got=about.get("format"))
            weights = file.get_tensor("weights")
    except (OSError, SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(f"{path} is not a reward model", got=str(error)) from error
    return RewardEnsemble.from_flat(
        weights, version=about["version"], robot=about["robot"], frame=about["frame"], inputs=tuple(about["inputs"]),
        layer_sizes=tuple(about["layer_sizes"]), members=about["members"], feedback_ids=tuple(about["feedback_ids"]),
        seed=about["seed"], activation=about.get("activation", "leaky_relu"))
