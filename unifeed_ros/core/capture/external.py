"""Bring what a robot's driver offers into the form that capture needs: values in joint order, torque from a wrench."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel
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


def torque_from_wrench(robot: RobotModel, q: ArrayLike, wrench: ArrayLike) -> Array:
    """Compute the joint torques that a wrench at the tool causes: tau_ext = J(q)^T F.

    For arms that measure force at the flange instead of torque in the joints. A touch of a link between base and sensor
    does not show.

    Args:
        robot: The arm.
        q: Joint positions, shape (n,) [rad].
        wrench: Force [N], then torque [Nm], acting on the tool at its origin, axes of the base frame, shape (6,).

    Returns:
        External joint torques, shape (n,) [Nm].

    Raises:
        ShapeError: Another number of joints or wrench components.
        InputError: A value is not finite.
    """
    posture = frozen_array("joint positions", q, (robot.n,))
    return np.asarray(robot.tool_jacobian(posture).T @ frozen_array("wrench", wrench, (6,)))
