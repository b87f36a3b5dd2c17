"""What the reward network sees: the tool, the goal and the objects, all linear in the tool's state, and features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.reward.features import Feature, evaluate, feature_name, is_feature, make_feature
from unifeed_ros.core.robot import TOOL_STATE
from unifeed_ros.core.types import Array, Context

GOAL = "goal"
"""Prefix of the offsets to the goal."""
WEAK = "/10"
"""Ending of the names of inputs in tens of metres. The penalty on weights and the optimiser's steps make them a hundred
and ten times dearer than others: they are looked at only for what the others do not explain. Taught at one goal, where
the tool is, where the goal is from it and where an object is from it are the same up to a constant; a reward that looks
at all three alike holds for that goal and that place of the object only (`unifeed bench context`)."""


def input_names(contexts: Sequence[Context], features: Sequence[str] = ()) -> tuple[str, ...]:
    """Name the network's inputs for scenes that it must be able to compare.

    Height of the tool, its axis (3), its offset to the goal (3); weakly, its place over the table (2) and its offset to
    each object that every scene knows (3); features.

    Args:
        contexts: Scenes, at least one.
        features: Features that are given, as written in the settings.

    Returns:
        Names such as "z", "axis_z", "goal_dx", "x/10", "laptop_dy/10", "tilt()"; objects in alphabetical order.
    """
    shared = set.intersection(*(set(c.objects) for c in contexts)) - {GOAL}
    to_goal = (f"{GOAL}_d{axis}" for axis in "xyz")
    weak = ("x", "y", *(f"{thing}_d{axis}" for thing in sorted(shared) for axis in "xyz"))
    return (*TOOL_STATE[2:], *to_goal, *(name + WEAK for name in weak), *map(feature_name, features))


def input_scale(name: str) -> float:
    """Give what a length is multiplied by to become an input of that name."""
    return 0.1 if name.endswith(WEAK) else 1.0


def feature_count(names: Sequence[str]) -> int:
    """Count the features among the inputs.

    Args:
        names: Names of the inputs.

    Returns:
        Number of features F, which are the last inputs.

    Raises:
        ConfigError: A feature stands before another input.
    """
    count = sum(map(is_feature, names))
    if not all(map(is_feature, names[len(names) - count:])):
        raise ConfigError("order of the reward's inputs", expected="features last", got=", ".join(names))
    return count


@dataclass(frozen=True, kw_only=True)
class SceneInputs:
    """The inputs in one scene: (state @ matrix + offset, phi(state)) for I inputs, F of them features."""

    matrix: Array
    """Linear part, shape (6, I - F)."""
    offset: Array
    """Its offset, shape (I - F,) [m, 1]."""
    features: tuple[Feature, ...]
    """The features."""

    def values(self, states: Array) -> Array:
        """Compute the inputs.

        Args:
            states: Tool states, shape (..., 6) [m, 1].

        Returns:
            Inputs, shape (..., I).
        """
        linear = states @ self.matrix + self.offset
        if not self.features:
            return linear
        phi, _ = evaluate(self.features, states.reshape(-1, states.shape[-1]))
        return np.concatenate([linear, phi.reshape(*states.shape[:-1], len(self.features))], axis=-1)


def scene_inputs(names: Sequence[str], context: Context) -> SceneInputs:
    """Express the inputs by the tool state.

    Args:
        names: Names of the inputs, as from input_names.
        context: Scene that offsets and features refer to.

    Returns:
        The inputs in that scene.

    Raises:
        ConfigError: A feature is unknown, or its arguments are wrong.
        InputError: An input is unknown, or is about an object that the scene lacks.
    """
    linear = names[:len(names) - feature_count(names)]
    matrix, offset = np.zeros((len(TOOL_STATE), len(linear))), np.zeros(len(linear))
    places = {**context.objects, GOAL: context.goal}
    for column, full in enumerate(linear):
        name, scale = full.removesuffix(WEAK), input_scale(full)
        if name in TOOL_STATE:
            matrix[TOOL_STATE.index(name), column] = scale
            continue
        thing, _, axis = name.rpartition("_d")
        if thing not in places or axis not in ("x", "y", "z"):
            raise InputError(f"the scene does not say what the reward's input {full} is", expected=thing or "an object",
                             got=", ".join(places), mend="add the object to the scene, or train again")
        matrix["xyz".index(axis), column] = -scale
        offset[column] = scale * places[thing]["xyz".index(axis)]
    return SceneInputs(matrix=matrix, offset=offset,
                       features=tuple(make_feature(name, context) for name in names[len(linear):]))
