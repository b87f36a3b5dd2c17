"""Places that a motion keeps out of or is slow in, and directions that the tool keeps to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from unifeed_ros.core.config import from_mapping
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.types import Array, frozen_array

_SIZES: Mapping[str, int] = {"box": 3, "sphere": 1, "capsule": 2}


@dataclass(frozen=True, kw_only=True)
class Zone:
    """A box, sphere or capsule in the robot's base frame."""

    shape: Literal["box", "sphere", "capsule"]
    """Box along the base's axes, sphere, or upright capsule."""
    position: Array
    """Its middle, shape (3,) [m]."""
    size: Array
    """Edges of a box along x, y and z; radius of a sphere; radius and whole height of a capsule [m]."""
    speed: float = 0.0
    """Largest speed of the tool while it is inside [m/s]; 0: the whole arm keeps out."""

    def __post_init__(self) -> None:
        """Check shapes and that sizes are positive."""
        if self.shape not in _SIZES:
            raise ConfigError("shape of a zone", expected=", ".join(_SIZES), got=self.shape)
        for name, length in (("position", 3), ("size", _SIZES[self.shape])):
            object.__setattr__(self, name, frozen_array(f"{name} of a {self.shape}", getattr(self, name), (length,)))
        if self.size.min() <= 0 or not 0 <= self.speed < float("inf"):
            raise ConfigError(f"size and speed of a {self.shape}", expected="size > 0 m, speed >= 0 m/s",
                              got=(self.size.tolist(), self.speed))
        if self.shape == "capsule" and self.size[1] < 2 * self.size[0]:
            raise ConfigError("size of a capsule", expected="a height of twice the radius or more", got=self.size)

    @property
    def half_segment(self) -> float:
        """Half of the length of a capsule's inner segment; 0 for other shapes [m]."""
        return 0.5 * float(self.size[1]) - float(self.size[0]) if self.shape == "capsule" else 0.0

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Compute signed distances of points, negative inside, and their gradients.

        Args:
            points: Shape (N, 3) [m].

        Returns:
            Distances, shape (N,) [m], and unit gradients, shape (N, 3).
        """
        away = points - self.position
        if self.shape == "box":
            return _box_distance(away, 0.5 * self.size)
        half = self.half_segment
        away[:, 2] -= np.clip(away[:, 2], -half, half)
        length = np.linalg.norm(away, axis=1)
        normal = np.where(length[:, None] > 1e-9, away / np.maximum(length, 1e-9)[:, None], [1.0, 0.0, 0.0])
        return length - self.size[0], normal


@dataclass(frozen=True, kw_only=True)
class Cone:
    """Directions that the tool's z axis may have."""

    angle: float
    """Largest angle to the direction [rad]."""
    direction: Array = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Middle of the cone in the base frame, shape (3,), made a unit vector."""

    def __post_init__(self) -> None:
        """Check the angle and scale the direction."""
        if not 0 < self.angle < np.pi:
            raise ConfigError("angle of a cone", expected="between 0 and pi rad", got=self.angle)
        direction = frozen_array("direction of a cone", self.direction, (3,))
        if np.linalg.norm(direction) < 1e-6:
            raise ConfigError("direction of a cone", expected="not zero", got=direction.tolist())
        object.__setattr__(self, "direction", frozen_array("direction", direction / np.linalg.norm(direction), (3,)))


def zones_from(values: Mapping[str, Zone | Mapping[str, Any]]) -> dict[str, Zone]:
    """Read zones by name from settings.

    Raises:
        ConfigError: A value that cannot be used; the message names the zone.
    """
    return {name: v if isinstance(v, Zone) else from_mapping(Zone, v, f"zone {name}") for name, v in values.items()}


def cones_from(values: Mapping[str, Cone | Mapping[str, Any]]) -> dict[str, Cone]:
    """Read cones by name from settings.

    Raises:
        ConfigError: A value that cannot be used; the message names the cone.
    """
    return {name: v if isinstance(v, Cone) else from_mapping(Cone, v, f"cone {name}") for name, v in values.items()}


def _box_distance(away: Array, half: Array) -> tuple[Array, Array]:
    beyond = np.abs(away) - half
    outside = np.maximum(beyond, 0.0)
    length = np.linalg.norm(outside, axis=1)
    face = np.argmax(beyond, axis=1)
    sign = np.where(away >= 0, 1.0, -1.0)
    inner = np.zeros_like(away)
    inner[np.arange(len(away)), face] = sign[np.arange(len(away)), face]
    is_out = length > 0
    normal = np.where(is_out[:, None], sign * outside / np.where(is_out, length, 1.0)[:, None], inner)
    return np.where(is_out, length, beyond.max(axis=1)), normal
