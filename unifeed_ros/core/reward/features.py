"""Named features of a state (paper's augmented state (s, phi(s))): values and exact gradients over tool states.

A feature is written as a call, for example `distance(goal)`, `height(0.0)` or `near_xy(person, 0.4)`: the name of its
kind and its arguments. The whole text is the name of the network's input, so that a model says by itself what it needs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points

import numpy as np

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.reward.terms import Values, box_distance, distance, height, shortfall, tilt
from unifeed_ros.core.types import Array, Context

GROUP = "unifeed_ros.features"
"""Group of entry points that other packages offer their own kinds of feature in."""
DOWN = (0.0, 0.0, -1.0)
"""Direction that `tilt` is measured from unless another is given."""

Feature = Callable[[Array], Values]
"""Values, shape (N,), and gradients, shape (N, 6), at tool states, shape (N, 6) [m, 1]."""
FeatureKind = Callable[..., Feature]
"""Makes a feature from the scene and the arguments, as they were written: kind(context, *arguments)."""

_CALL = re.compile(r"(\w+)(?:\((.*)\))?")


def _distance(context: Context, thing: str) -> Feature:
    place = _place(context, thing)
    return lambda states: distance(states, place)


def _distance_xy(context: Context, thing: str) -> Feature:
    place = _place(context, thing)
    return lambda states: distance(states, place, dimensions=2)


def _near(context: Context, thing: str, radius: str) -> Feature:
    place, limit = _place(context, thing), float(radius)
    return lambda states: shortfall(distance(states, place), limit)


def _near_xy(context: Context, thing: str, radius: str) -> Feature:
    place, limit = _place(context, thing), float(radius)
    return lambda states: shortfall(distance(states, place, dimensions=2), limit)


def _near_box(context: Context, thing: str, half_x: str, half_y: str, half_z: str, radius: str) -> Feature:
    place, half, limit = _place(context, thing), (float(half_x), float(half_y), float(half_z)), float(radius)
    return lambda states: shortfall(box_distance(states, place, half), limit)


def _height(context: Context, level: str = "0") -> Feature:
    number = float(level)
    return lambda states: height(states, number)


def _tilt(context: Context, x: str = str(DOWN[0]), y: str = str(DOWN[1]), z: str = str(DOWN[2])) -> Feature:
    direction = np.array([float(x), float(y), float(z)])
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise ValueError("the direction has no length")
    return lambda states: tilt(states, direction / length)


KINDS: dict[str, FeatureKind] = {
    "distance": _distance, "distance_xy": _distance_xy, "near": _near, "near_xy": _near_xy, "near_box": _near_box,
    "height": _height, "tilt": _tilt}
"""Kinds that are built in: distance to the goal or an object, in space or over the table; how far nearer than a radius
the tool is to it, in space, over the table, or to a box around it; height over or under a level; tilt of its axis."""


def feature_name(text: str) -> str:
    """Write a feature's name in the one way that models use.

    Args:
        text: For example "tilt" or "near_xy(person,0.4)".

    Returns:
        For example "tilt()" or "near_xy(person, 0.4)".

    Raises:
        ConfigError: It is not written as a call.
    """
    name, arguments = _parsed(text)
    return f"{name}({', '.join(arguments)})"


def is_feature(name: str) -> bool:
    """Tell a feature among the names of a network's inputs."""
    return name.endswith(")")


def make_feature(text: str, context: Context) -> Feature:
    """Make a feature for a scene.

    Args:
        text: Name of the feature with its arguments.
        context: Scene that the arguments refer to.

    Returns:
        The feature.

    Raises:
        ConfigError: The kind is unknown here, or its arguments are wrong.
        InputError: The scene lacks an object.
    """
    name, arguments = _parsed(text)
    kind = KINDS.get(name) or _of_other_packages(name)
    try:
        return kind(context, *arguments)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"arguments of the reward's feature {text}", got=str(error)) from error


def evaluate(features: Sequence[Feature], states: Array) -> tuple[Array, Array]:
    """Compute several features.

    Args:
        features: F features.
        states: Tool states, shape (N, 6) [m, 1].

    Returns:
        Values, shape (N, F), and gradients by the tool state, shape (N, F, 6).

    Raises:
        ShapeError: A feature gave arrays of another shape.
        InputError: A feature gave a value that is not finite.
    """
    count = len(states)
    values, gradients = np.zeros((count, len(features))), np.zeros((count, len(features), states.shape[1]))
    for column, feature in enumerate(features):
        value, gradient = feature(states)
        if np.shape(value) != (count,) or np.shape(gradient) != states.shape:
            raise ShapeError(f"shapes of feature {column}", expected=((count,), states.shape),
                             got=(np.shape(value), np.shape(gradient)))
        values[:, column], gradients[:, column] = value, gradient
    if not (np.isfinite(values).all() and np.isfinite(gradients).all()):
        raise InputError("a feature of the reward is not finite", expected="numbers at every state")
    return values, gradients


def _parsed(text: str) -> tuple[str, list[str]]:
    match = _CALL.fullmatch(text.strip())
    if match is None:
        raise ConfigError("feature of the reward", expected="a name with arguments such as distance(goal)", got=text)
    inside = (match[2] or "").strip()
    return match[1], [argument.strip() for argument in inside.split(",")] if inside else []


def _of_other_packages(name: str) -> FeatureKind:
    found = entry_points(group=GROUP)
    if name not in found.names:
        raise ConfigError("the reward's feature is not known here", expected=", ".join([*KINDS, *sorted(found.names)]),
                          got=name, mend=f"install the package that offers it as an entry point of {GROUP}")
    kind: FeatureKind = found[name].load()
    return kind


def _place(context: Context, thing: str) -> Array:
    places = {**context.objects, "goal": context.goal}
    if thing not in places:
        raise InputError("the scene lacks what a feature of the reward is about", expected=thing,
                         got=", ".join(places), mend="add the object to the scene, or train again without the feature")
    return places[thing]
