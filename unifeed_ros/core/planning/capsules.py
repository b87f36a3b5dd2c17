"""The arm's bodies as capsules, fitted once to the collision geometry of its URDF.

A capsule holds all points of its geometry, so that its distance is never larger than the true one. It is convex and
smooth, coal knows its distance in closed form, and one for each collision geometry is enough.
"""

from __future__ import annotations

import itertools
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

_APART = 3
"""Number of joints between two bodies from which on they can reach each other: nearer ones share a joint's housing."""


class Capsule(NamedTuple):
    """All points within a radius of a line segment, in the frame of the joint that moves it."""

    name: str
    """Name of the body."""
    body: int
    """Joint that moves it; 0: none, it belongs to the base."""
    ends: Array
    """Ends of the segment, shape (2, 3) [m]."""
    radius: float
    """Radius [m]."""

    @property
    def middle(self) -> Array:
        """Middle of the segment, shape (3,) [m]."""
        return np.asarray(self.ends.mean(axis=0))

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def reach(self) -> float:
        """Radius of the sphere around the middle that holds the capsule [m]."""
        return 0.5 * self.length + self.radius


def fit_capsule(points: Array) -> tuple[Array, float]:
    """Find a small capsule that holds all points, along one of their principal axes.

    Args:
        points: Shape (V, 3) [m].

    Returns:
        Ends of the segment, shape (2, 3) [m], and radius [m].
    """
    directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    fits = [_along(points, direction) for direction in directions]
    return min(fits, key=lambda fit: fit[1] ** 2 * (float(np.linalg.norm(fit[0][1] - fit[0][0])) + 4 / 3 * fit[1]))


def _along(points: Array, direction: Array) -> tuple[Array, float]:
    """Fit a capsule with a given direction: the smallest circle around the points seen along it, then the ends."""
    side = np.linalg.svd(direction[None])[2][1:]
    flat = points @ side.T
    centre = 0.5 * (flat.max(axis=0) + flat.min(axis=0))
    for k in range(1, 400):  # Badoiu and Clarkson: towards the farthest point, by ever smaller steps
        away = flat - centre
        centre = centre + away[int(np.argmax((away**2).sum(axis=1)))] / (k + 1)
    off = np.linalg.norm(flat - centre, axis=1)
    radius = float(off.max())
    along, cap = points @ direction, np.sqrt(radius**2 - off**2)
    low, high = float((along + cap).min()), float((along - cap).max())
    if low > high:
        low = high = 0.5 * (along.min() + along.max())
        centred = np.hypot(along - low, off)
        radius = float(centred.max())
    base = centre @ side
    return np.stack([base + low * direction, base + high * direction]), radius


def arm_capsules(robot: RobotModel) -> tuple[Capsule, ...]:
    """Fit capsules to an arm's collision geometry, each read once.

    Args:
        robot: The arm.

    Raises:
        ConfigError: The URDF's collision geometry cannot be read, or there is none.
    """
    return _capsules(str(robot.urdf_path), tuple(robot.config.joints))


def self_pairs(capsules: tuple[Capsule, ...]) -> tuple[tuple[int, int], ...]:
    """Choose the pairs of the arm's own bodies that can meet: those with three joints or more between them."""
    return tuple((i, j) for i, j in itertools.combinations(range(len(capsules)), 2)
                 if abs(capsules[i].body - capsules[j].body) >= _APART)


@lru_cache(maxsize=8)
def _capsules(urdf: str, joints: tuple[str, ...]) -> tuple[Capsule, ...]:
    full = pin.buildModelFromUrdf(urdf)
    folders = [str(folder) for folder in Path(urdf).parents]  # packages lie somewhere above their URDF
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of package folders that are given by place
            shapes = pin.buildGeomFromUrdf(full, urdf, pin.COLLISION, folders)
    except Exception as error:  # pinocchio raises ValueError and RuntimeError
        raise ConfigError(f"collision geometry of {urdf} cannot be read", got=str(error),
                          mend="put the meshes beside the URDF, or set planner.whole_arm to false") from error
    locked = [k for k, name in enumerate(full.names) if k > 0 and name not in joints]
    _, shapes = pin.buildReducedModel(full, shapes, locked, pin.neutral(full))
    by_body: dict[tuple[str, int], list[Array]] = {}
    for shape in shapes.geometryObjects:
        corners = _corners(shape.geometry) * shape.meshScale
        place = shape.placement
        body = (shape.name.rpartition("_")[0], int(shape.parentJoint))
        by_body.setdefault(body, []).append(corners @ place.rotation.T + place.translation)
    if not by_body:
        raise ConfigError(f"{urdf} has no collision geometry", mend="add some, or set planner.whole_arm to false")
    return tuple(Capsule(name, body, *fit_capsule(np.concatenate(points)))
                 for (name, body), points in by_body.items())


def _corners(shape: Any) -> Array:
    """Return points whose convex hull holds a shape, shape (V, 3) [m]."""
    if hasattr(shape, "vertices"):
        return np.asarray(shape.vertices(), dtype=np.float64)
    shape.computeLocalAABB()
    box = shape.aabb_local
    return np.array([[x, y, z] for x, y, z in itertools.product(*np.stack([box.min_, box.max_]).T)])
