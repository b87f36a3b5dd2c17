"""What a task is in space and time: start, goal, table, objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from unifeed_ros.core.config import load_settings
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.types import Array, Context, frozen_array
from unifeed_ros.core.zones import Cone, Zone, cones_from, zones_from

CONTROLLED_SPEED = 0.9
"""Part of the controller's largest speed of the tool that planned motions use [1]: the arm overshoots a little."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One task, in the robot's base frame."""

    task: str
    """Name of the task, for example "table"."""
    start: Array
    """Where the tool starts, shape (3,) [m]."""
    goal: Array
    """Where the tool ends, shape (3,) [m]."""
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Direction of the tool's z axis at both ends, shape (3,), made a unit vector."""
    duration: float = 3.0
    """Duration of a motion from start to goal [s]."""
    table_height: float = 0.0
    """Height of the table's top [m]."""
    clearance: float = 0.05
    """Height above the table that the tool and the arm keep [m]."""
    objects: Mapping[str, Array] = field(default_factory=dict)
    """Positions of named objects, shape (3,) each [m]."""
    zones: Mapping[str, Zone] = field(default_factory=dict)
    """Zones by name: shape, position, size, and a speed where the tool may be slow inside instead of keeping out."""
    cones: Mapping[str, Cone] = field(default_factory=dict)
    """Cones by name that the tool's z axis stays in: direction, and angle [rad]."""
    workspace: Sequence[float] = ()
    """Box that the tool stays in, smallest x, y, z, then largest, length 6 [m]; empty: anywhere."""
    tool_speed: float = 0.0
    """Largest speed of the tool [m/s]; 0: no limit but the joints'."""

    def __post_init__(self) -> None:
        """Check shapes, and that both ends are above the table."""
        for name in ("start", "goal", "axis"):
            object.__setattr__(self, name, frozen_array(f"{name} of task {self.task}", getattr(self, name), (3,)))
        length = float(np.linalg.norm(self.axis))
        if length < 1e-6:
            raise ConfigError(f"axis of task {self.task}", expected="a direction", got=self.axis.tolist())
        object.__setattr__(self, "axis", frozen_array("axis", self.axis / length, (3,)))
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ConfigError(f"duration of task {self.task}", expected="> 0 s", got=self.duration)
        if not (np.isfinite(self.table_height) and np.isfinite(self.clearance) and self.clearance >= 0):
            raise ConfigError(f"table_height and clearance of task {self.task}", expected="finite, clearance >= 0 m",
                              got=(self.table_height, self.clearance))
        for name in ("start", "goal"):
            if getattr(self, name)[2] < self.floor:
                raise ConfigError(f"{name} of task {self.task} is too low", expected=f"z >= {self.floor:.3f} m",
                                  got=f"{getattr(self, name)[2]:.3f} m", mend="raise it, or lower the clearance")
        checked = {name: frozen_array(f"position of {name}", p, (3,)) for name, p in self.objects.items()}
        object.__setattr__(self, "objects", checked)
        object.__setattr__(self, "zones", zones_from(self.zones))
        object.__setattr__(self, "cones", cones_from(self.cones))
        if not 0 <= self.tool_speed < float("inf"):
            raise ConfigError(f"tool_speed of task {self.task}", expected="0 or more m/s", got=self.tool_speed)
        if len(self.workspace):
            box = frozen_array(f"workspace of task {self.task}", self.workspace, (6,))
            if (box[:3] >= box[3:]).any():
                raise ConfigError(f"workspace of task {self.task}", expected="smallest x, y, z, then largest",
                                  got=box.tolist())
            object.__setattr__(self, "workspace", tuple(box.tolist()))

    @property
    def floor(self) -> float:
        """Lowest height that the tool may have: table and clearance [m]."""
        return self.table_height + self.clearance

    def limited(self, tool_speed: float, workspace: Sequence[float]) -> Scene:
        """Give the scene as a controller with limits of its own can carry it out.

        Args:
            tool_speed: Largest speed of the tool that the controller takes [m/s].
            workspace: Box that it keeps the tool in, as the scene's; it counts where the scene has none.
        """
        speed = min(self.tool_speed or tool_speed, CONTROLLED_SPEED * tool_speed)
        return replace(self, tool_speed=speed, workspace=self.workspace or workspace)

    def context(self) -> Context:
        """Return what of the scene belongs to the state that rewards are learned over."""
        return Context(task=self.task, goal=self.goal, objects=self.objects)


def load_scene(path: Path) -> Scene:
    """Read a task from a ROS 2 parameter file with the group ``scene``.

    Args:
        path: YAML file, for example config/tasks/table.yaml.

    Returns:
        The task.

    Raises:
        ConfigError: The file is missing or malformed, or a value cannot be used; the message names the file.
    """
    return load_settings(Scene, path, "scene")
