"""The MuJoCo model of an arm, built joint by joint from the pinocchio model of its URDF.

MuJoCo's own URDF importer stumbles over meshes in COLLADA format and package addresses, and keeps the joints that
RobotModel locks. Taking masses, placements and limits from the pinocchio model gives both sides the same arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

TOOL_RADIUS = 0.02
"""Radius of the ball at the tool; its surface passes through the tool frame's origin [m]."""
LINK_RADIUS = 0.04
"""Radius of the capsules that stand for the links [m]."""
SHORTEST_LINK = 0.06
"""Links shorter than this have no capsule [m]."""


@dataclass(frozen=True, kw_only=True)
class ArmDynamics:
    """What a URDF does not tell about the joints."""

    friction: Sequence[float]
    """Dry friction, length n [Nm]."""
    damping: Sequence[float]
    """Viscous friction, length n [Nm s/rad]."""
    armature: Sequence[float]
    """Inertia of the rotors seen at the joint, length n [kg m^2]."""
    payload: float = 0.0
    """Mass at the tool, beside the URDF's [kg]."""


def build_arm_model(robot: RobotModel, dynamics: ArmDynamics, *, table_height: float | None,
                    timestep: float) -> mujoco.MjModel:
    """Build the arm, with a site named "tool" and a table that the outer links can touch.

    Args:
        robot: The arm.
        dynamics: Joint friction and rotor inertia.
        table_height: Height of the table's plane in the base frame [m]; None for no table.
        timestep: Step of the physics [s].

    Returns:
        The compiled model; its joints are in the robot's order.

    Raises:
        ConfigError: A joint is not a hinge with one angle, or MuJoCo refuses the inertias.
    """
    spec = mujoco.MjSpec()
    _set_options(spec, robot, timestep)
    bodies = [spec.worldbody]
    for joint in range(1, robot.pin_model.njoints):
        bodies.append(_add_link(bodies, robot, joint, dynamics))
    _add_tool(bodies[-1], robot)
    if dynamics.payload > 0.0:
        bodies[-1].add_body(name="payload", pos=_tool_placement(robot).translation, mass=dynamics.payload,
                            explicitinertial=True, ipos=[0.0, 0.0, 0.0], inertia=[1e-4, 1e-4, 1e-4])
    if table_height is not None:
        spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1],
                                pos=[0.0, 0.0, table_height], contype=1, conaffinity=0)
    try:
        return spec.compile()
    except ValueError as error:
        raise ConfigError(f"MuJoCo refuses the arm of {robot.urdf_path.name}", got=str(error)) from error


def _set_options(spec: mujoco.MjSpec, robot: RobotModel, timestep: float) -> None:
    spec.compiler.degree = False
    spec.option.timestep = timestep
    spec.option.gravity = robot.pin_model.gravity.linear
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.iterations = 20
    spec.option.ls_iterations = 10


def _add_link(bodies: list[mujoco.MjsBody], robot: RobotModel, joint: int, dynamics: ArmDynamics) -> mujoco.MjsBody:
    model, column = robot.pin_model, joint - 1
    placement, inertia = model.jointPlacements[joint], model.inertias[joint]
    tensor = inertia.inertia
    body = bodies[model.parents[joint]].add_body(
        name=model.names[joint], pos=placement.translation, quat=_quaternion(placement.rotation),
        mass=inertia.mass, ipos=inertia.lever, explicitinertial=True,
        fullinertia=[tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    body.add_joint(name=model.names[joint], type=mujoco.mjtJoint.mjJNT_HINGE, axis=_axis(robot, joint),
                   limited=True, range=[model.lowerPositionLimit[column], model.upperPositionLimit[column]],
                   damping=[dynamics.damping[column], 0.0, 0.0], armature=dynamics.armature[column],
                   frictionloss=dynamics.friction[column])
    if joint + 1 < model.njoints and joint > 1:  # the first link turns on the spot, next to the table
        _add_capsule(body, model.jointPlacements[joint + 1].translation)
    return body


def _axis(robot: RobotModel, joint: int) -> Array:
    motion = robot.pin_model.joints[joint].createData().S.reshape(6, -1)
    if robot.pin_model.joints[joint].nq != 1 or np.any(motion[:3]):
        raise ConfigError(f"joint {robot.pin_model.names[joint]} of {robot.config.name}",
                          expected="a hinge with limits", got=robot.pin_model.joints[joint].shortname())
    return motion[3:, 0]


def _add_capsule(body: mujoco.MjsBody, end: Array) -> None:
    if np.linalg.norm(end) >= SHORTEST_LINK:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, *end], size=[LINK_RADIUS, 0.0, 0.0],
                      contype=0, conaffinity=1)


def _add_tool(body: mujoco.MjsBody, robot: RobotModel) -> None:
    placement = _tool_placement(robot)
    body.add_site(name="tool", pos=placement.translation, quat=_quaternion(placement.rotation))
    centre = placement.translation - TOOL_RADIUS * placement.rotation[:, 2]
    body.add_geom(name="tool", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, size=[TOOL_RADIUS, 0.0, 0.0],
                  contype=0, conaffinity=1)


def _tool_placement(robot: RobotModel) -> pin.SE3:
    return robot.pin_model.frames[robot.pin_model.getFrameId(robot.config.tool_frame)].placement


def _quaternion(rotation: Array) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion
