"""Whether an arm's own meshes touch zones, the table or each other: apart from the capsules that the planner knows."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array

_TABLE = np.array([4.0, 4.0, 1.0])
_APART = 3
"""Joints between two bodies from which on they may not touch: nearer ones share a housing."""


class MeshScene:
    """The collision meshes of an arm's URDF among the keep-out zones of a scene, over its table."""

    def __init__(self, robot: RobotModel, scene: Scene) -> None:
        """Load the meshes and list the pairs that may not touch."""
        full = pin.buildModelFromUrdf(str(robot.urdf_path))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of package folders that are given by place
            shapes = pin.buildGeomFromUrdf(full, str(robot.urdf_path), pin.COLLISION,
                                           [str(folder) for folder in robot.urdf_path.parents])
        locked = [k for k, name in enumerate(full.names) if k > 0 and name not in robot.joint_names]
        self._model, self._shapes = pin.buildReducedModel(full, shapes, locked, pin.neutral(full))
        bodies = [int(shape.parentJoint) for shape in self._shapes.geometryObjects]
        for i, j in itertools.combinations(range(len(bodies)), 2):
            if abs(bodies[i] - bodies[j]) >= _APART:
                self._shapes.addCollisionPair(pin.CollisionPair(i, j))
        closed = {name: zone for name, zone in scene.zones.items() if zone.speed == 0}
        for name, zone in closed.items():
            self._add(name, _shape(zone.shape, zone.size), zone.position, [k for k, b in enumerate(bodies) if b > 0])
        self._add("table", coal.Box(*_TABLE), np.array([0.0, 0.0, scene.table_height - 0.5 * _TABLE[2]]),
                  [k for k, b in enumerate(bodies) if b > 1])
        self._data, self._places = self._model.createData(), self._shapes.createData()

    def _add(self, name: str, shape: Any, position: Array, others: list[int]) -> None:
        one = self._shapes.addGeometryObject(pin.GeometryObject(name, 0, 0, pin.SE3(np.eye(3), position), shape))
        for other in others:
            self._shapes.addCollisionPair(pin.CollisionPair(other, one))

    def touching(self, postures: Array) -> int:
        """Count the postures in which anything touches.

        Args:
            postures: Joint positions, shape (N, n) [rad].
        """
        return sum(bool(pin.computeCollisions(self._model, self._data, self._shapes, self._places, posture, True))
                   for posture in postures)


def _shape(kind: str, size: Array) -> Any:
    if kind == "box":
        return coal.Box(*size)
    return coal.Sphere(size[0]) if kind == "sphere" else coal.Capsule(size[0], size[1] - 2.0 * size[0])
