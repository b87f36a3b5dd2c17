"""The arm's meshes in the page, from the same URDF that the robot model is built from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import viser
import yourdfpy
from viser.extras import ViserUrdf

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

PACKAGE = "package://"


def find_mesh(fname: str, urdf: Path) -> str:
    """Find a file that a URDF names.

    Args:
        fname: As in the URDF: a path beside it, or package://<package>/<path>.
        urdf: The URDF.

    Returns:
        Path of an existing file.

    Raises:
        ConfigError: No folder above the URDF holds it.
    """
    if not fname.startswith(PACKAGE):
        return str(urdf.parent / fname)
    below = fname.removeprefix(PACKAGE)
    for folder in urdf.parents:
        if (folder / below).is_file():
            return str(folder / below)
    raise ConfigError(f"mesh {fname} of {urdf}", expected="a file below one of the folders above the URDF",
                      mend="install the package that holds it")


def load_urdf(robot: RobotModel, *, meshes: str) -> yourdfpy.URDF:
    """Load an arm's URDF with one kind of meshes.

    Args:
        robot: The arm.
        meshes: "visual", or "collision" for the coarse ones.
    """
    visual = meshes == "visual"
    return yourdfpy.URDF.load(
        str(robot.urdf_path), build_scene_graph=visual, load_meshes=visual, build_collision_scene_graph=not visual,
        load_collision_meshes=not visual,
        filename_handler=lambda fname: find_mesh(fname, robot.urdf_path))


class DrawnArm:
    """An arm in the scene.

    Args:
        server: The page.
        robot: The arm.
        urdf: Its URDF with meshes of one kind.
        name: Name in the scene.
        colour: RGB and opacity of a ghost; None: the arm's own colours.
    """

    def __init__(self, server: viser.ViserServer, robot: RobotModel, urdf: yourdfpy.URDF, name: str,
                 colour: tuple[float, float, float, float] | None = None) -> None:
        self._root = server.scene.add_frame(name, show_axes=False)
        coarse = urdf.scene is None
        self._shape = ViserUrdf(server, urdf, root_node_name=name, load_meshes=not coarse,
                                load_collision_meshes=coarse, mesh_color_override=colour,
                                collision_mesh_color_override=colour)
        self._robot = robot
        order = {joint: k for k, joint in enumerate(robot.joint_names)}
        names = urdf.actuated_joint_names
        self._from = [order[n] for n in names if n in order]
        self._to = [k for k, n in enumerate(names) if n in order]
        self._all = np.zeros(len(names))

    def move(self, positions: Array) -> None:
        """Show a posture, shape (n,) [rad]; joints that the robot model locks stay where they are."""
        self._all[self._to] = positions[self._from]
        self._shape.update_cfg(self._all)

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._root.visible = shown


GHOSTS: Mapping[str, tuple[float, float, float, float]] = {"A": (0, 82, 200, 0.45), "B": (214, 94, 0, 0.45)}
"""Colours of the two motions of a question: blue and orange differ for every kind of colour vision."""
