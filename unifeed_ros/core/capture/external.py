"""Bring the values of a robot's driver into joint order, by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.types import Array, frozen_array


def by_name(names: Sequence[str], values: ArrayLike, wanted: Sequence[str], what: str = "values") -> Array:
    """Pick values by joint name.

    Drivers send joints in their own order (often alphabetical), add joints of a gripper, or leave an array empty.

    Args:
        names: Names that came with the values.
        values: One value a name, shape (len(names),).
        wanted: Names in the order wanted; others are left out.
        what: Name of the values, for the error.

    Returns:
        Values in the order wanted, read-only, shape (len(wanted),).

    Raises:
        InputError: A name is missing or twice there, another number of values than names, or a wanted value is not
            finite.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (len(names),):
        raise InputError(f"number of {what}", expected=f"{len(names)}, one a name", got=values.shape)
    return frozen_array(what, values[joint_places(names, wanted, what)], (len(wanted),))


def joint_places(names: Sequence[str], wanted: Sequence[str], what: str = "values") -> list[int]:
    """Find where joints stand.

    Args:
        names: Names of a message, in its order.
        wanted: Names in the order wanted.
        what: Name of the values, for the error.

    Returns:
        For each name wanted its place among the names.

    Raises:
        InputError: A name is missing or twice there.
    """
    places = {name: k for k, name in enumerate(names)}
    if len(places) != len(names):
        raise InputError(f"names of {what} repeat", got=", ".join(names))
    missing = [name for name in wanted if name not in places]
    if missing:
        raise InputError(f"{what} lack joints {', '.join(missing)}", expected=", ".join(wanted), got=", ".join(names))
    return [places[name] for name in wanted]
