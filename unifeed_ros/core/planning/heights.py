"""The arm's points over the table: the centres of the moving joints, and the tool."""

from __future__ import annotations

import numpy as np

from unifeed_ros.core.planning.constraints import Constraint, Values
from unifeed_ros.core.planning.kinematics import ArmPose
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array

_MARGIN = 2e-3


def height_constraint(robot: RobotModel, scene: Scene, arm_radius: float) -> Constraint:
    """Keep the tool, and each joint after the second whose centre differs from the one before, above the table.

    Args:
        robot: The arm.
        scene: Table and clearance.
        arm_radius: Distance from the joints' centres to the arm's surface [m].
    """
    placements = robot.pin_model.jointPlacements
    joints = [k for k in range(3, robot.n + 1) if np.linalg.norm(placements[k].translation) > 1e-6]
    radii = np.array([arm_radius] * len(joints) + [0.0])
    moved_by = np.array(joints)[:, None] >= np.arange(1, robot.n + 1)

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        del velocities, near
        centres = pose.origins[joints].transpose(1, 0, 2)  # (N, P - 1, 3)
        (x, y, _), (along_x, along_y, _) = pose.origins[1:].transpose(2, 1, 0)[:, :, None], pose.axes.transpose(2, 0, 1)
        vertical = along_x[:, None] * (centres[:, :, 1, None] - y) - along_y[:, None] * (centres[:, :, 0, None] - x)
        vertical *= moved_by  # z of a x (p - o)
        return Values(np.concatenate([centres[:, :, 2], pose.tool[:, 2:]], axis=1),
                      np.concatenate([vertical, pose.tool_jacobian[:, 2:]], axis=1))

    return Constraint(
        names=(*(robot.joint_names[k - 1] for k in joints), robot.config.tool_frame), bounds=scene.floor + radii,
        least=scene.table_height, margin=_MARGIN, evaluate=evaluate,
        say=lambda name, value, bound: f"{name} comes down to {value:.4f} m, floor {bound:.4f} m")
