"""What the reward network sees: the tool, the goal and the objects, all of it linear in the tool's state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import TOOL_STATE
from unifeed_ros.core.types import Array, Context

GOAL = "goal"
"""Prefix of the offsets to the goal."""


def input_names(contexts: Sequence[Context]) -> tuple[str, ...]:
    """Name the network's inputs for scenes that it must be able to compare.

    Tool position (3), tool axis (3), offset to the goal (3), then the offset to each object that every scene knows.

    Args:
        contexts: Scenes, at least one.

    Returns:
        Names such as "x", "axis_z", "goal_dx", "laptop_dy"; objects in alphabetical order.
    """
    shared = set.intersection(*(set(c.objects) for c in contexts)) - {GOAL}
    return TOOL_STATE + tuple(f"{thing}_d{axis}" for thing in (GOAL, *sorted(shared)) for axis in "xyz")


def input_map(names: Sequence[str], context: Context) -> tuple[Array, Array]:
    """Express the inputs as a linear function of the tool state: inputs = state @ matrix + offset.

    Args:
        names: Names of the inputs, as from input_names.
        context: Scene that offsets refer to.

    Returns:
        Matrix, shape (6, I), and offset, shape (I,) [m, 1].

    Raises:
        InputError: An input is unknown, or is about an object that the scene lacks.
    """
    matrix, offset = np.zeros((len(TOOL_STATE), len(names))), np.zeros(len(names))
    places = {**context.objects, GOAL: context.goal}
    for column, name in enumerate(names):
        if name in TOOL_STATE:
            matrix[TOOL_STATE.index(name), column] = 1.0
            continue
        thing, _, axis = name.rpartition("_d")
        if thing not in places or axis not in ("x", "y", "z"):
            raise InputError(f"the scene does not say what the reward's input {name} is", expected=thing or "an object",
                             got=", ".join(places), mend="add the object to the scene, or train again")
        matrix["xyz".index(axis), column] = -1.0
        offset[column] = places[thing]["xyz".index(axis)]
    return matrix, offset
