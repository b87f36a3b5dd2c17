"""The only place where messages meet core types."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Contact, Feedback, RewardModel, TaskContext, TeachingState, TrackedRun
from unifeed_ros.core.capture.contact import ContactSample
from unifeed_ros.core.capture.external import joint_places
from unifeed_ros.core.capture.feedback_capture import CapturedCorrections
from unifeed_ros.core.control.command import Command
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Context, RobotState, Trajectory
from unifeed_ros.core.zones import cones_from, zones_from

NANOSECONDS = 1_000_000_000


def seconds(stamp: Time | Duration) -> float:
    """Convert a stamp or a duration to seconds."""
    return float(stamp.sec) + stamp.nanosec / NANOSECONDS


def stamp(time: float) -> Time:
    """Convert seconds to a stamp, to the nanosecond."""
    sec, nanosec = divmod(round(time * NANOSECONDS), NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def header(time: float, frame: str = "") -> Header:
    """Make a header from seconds and a frame."""
    return Header(stamp=stamp(time), frame_id=frame)


def trajectory_to_msg(trajectory: Trajectory, time: float = 0.0, frame: str = "") -> JointTrajectory:
    """Convert a trajectory; its times become times from the start."""
    msg = JointTrajectory(header=header(time, frame), joint_names=list(trajectory.joint_names))
    for k, moment in enumerate(trajectory.times):
        relative = stamp(float(moment))
        point = JointTrajectoryPoint(positions=array("d", trajectory.positions[k].tobytes()))
        point.time_from_start = Duration(sec=relative.sec, nanosec=relative.nanosec)
        if trajectory.velocities is not None:
            point.velocities = array("d", trajectory.velocities[k].tobytes())
        if trajectory.accelerations is not None:
            point.accelerations = array("d", trajectory.accelerations[k].tobytes())
        msg.points.append(point)
    return msg


def trajectory_from_msg(msg: JointTrajectory, names: Sequence[str] | None = None) -> Trajectory:
    """Convert a trajectory message, mapping its joints by name.

    Args:
        msg: The message.
        names: Joint order wanted; the message's own by default.

    Returns:
        The trajectory.

    Raises:
        InputError: Joints are missing, or times, positions or lengths cannot be used.
    """
    wanted, points = tuple(names or msg.joint_names), msg.points
    if not points:
        raise InputError("trajectory without positions", expected="at least two points", got="none")
    places = joint_places(msg.joint_names, wanted, "the trajectory")

    def column(field: str) -> Array | None:
        rows = [getattr(point, field) for point in points]
        lengths = set(map(len, rows))
        if 0 in lengths:
            return None
        if lengths != {len(msg.joint_names)}:
            raise InputError(f"number of {field} of the trajectory", expected=f"{len(msg.joint_names)}, one a name",
                             got=", ".join(map(str, sorted(lengths))))
        return np.array(rows)[:, places]

    positions = column("positions")
    if positions is None:
        raise InputError("trajectory without positions", expected="at least two points", got=f"{len(points)} points")
    times = [seconds(point.time_from_start) for point in points]
    return Trajectory(joint_names=wanted, times=times, positions=positions, velocities=column("velocities"),
                      accelerations=column("accelerations"))


def context_to_msg(context: Context) -> TaskContext:
    """Convert a context."""
    return TaskContext(
        task=context.task, goal=Point(**dict(zip("xyz", map(float, context.goal), strict=True))),
        object_names=list(context.objects),
        object_positions=[Point(**dict(zip("xyz", map(float, p), strict=True))) for p in context.objects.values()])


def context_from_msg(msg: TaskContext) -> Context:
    """Convert a context message; names and positions must be as many."""
    if len(msg.object_names) != len(msg.object_positions):
        raise InputError(
            "objects of the context", expected=f"{len(msg.object_names)} positions", got=len(msg.object_positions)
        )
    positions = [np.array([p.x, p.y, p.z]) for p in msg.object_positions]
    return Context(task=msg.task, goal=np.array([msg.goal.x, msg.goal.y, msg.goal.z]),
                   objects=dict(zip(msg.object_names, positions, strict=True)))


def constrained(scene: Scene, goal: OptimizeTrajectory.Goal) -> Scene:
    """Add to a scene what a request asks of its motion; what the request leaves empty stays as it is.

    Args:
        scene: The task.
        goal: The request.

    Raises:
        ConfigError: A zone, a cone, the workspace or the speed cannot be used; the message names it.
        InputError: Two zones or two cones of the request have the same name, or one has none.
    """
    for kind, names in (("zone", [z.name for z in goal.zones]), ("cone", [c.name for c in goal.cones])):
        if "" in names or len(set(names)) < len(names):
            raise InputError(f"names of the request's {kind}s", expected="each its own", got=names)
    zones = {z.name: {"shape": z.shape, "position": _components(z.position), "size": list(z.size), "speed": z.speed}
             for z in goal.zones}
    cones = {c.name: {"direction": _components(c.direction), "angle": c.angle} for c in goal.cones}
    return replace(scene, zones={**scene.zones, **zones_from(zones)}, cones={**scene.cones, **cones_from(cones)},
                   workspace=tuple(goal.workspace) or scene.workspace, tool_speed=goal.tool_speed or scene.tool_speed)


def _components(msg: Point | Vector3) -> list[float]:
    return [msg.x, msg.y, msg.z]


def feedback_to_msg(item: FeedbackItem, time: float, frame: str) -> Feedback:
    """Convert one thing that the person taught."""
    msg = Feedback(header=header(time, frame), id=item.id, robot=item.robot, context=context_to_msg(item.context))
    if isinstance(item, Demonstration):
        msg.kind = Feedback.DEMONSTRATION
        msg.demonstration = trajectory_to_msg(item.trajectory)
    elif isinstance(item, Correction):
        msg.kind = Feedback.CORRECTION
        msg.planned, msg.corrected = trajectory_to_msg(item.planned), trajectory_to_msg(item.corrected)
        msg.span_start, msg.span_end = map(float, item.span)
    else:
        msg.kind = Feedback.PREFERENCE
        msg.query_id = item.query_id
        msg.options = [trajectory_to_msg(option) for option in item.options]
        msg.ranks = [int(rank) for rank in item.ranks]
    return msg


def feedback_from_msg(msg: Feedback, names: Sequence[str] | None = None) -> FeedbackItem:
    """Convert a feedback message, its joints put into the given order.

    Raises:
        InputError: The kind is unknown, or a trajectory cannot be used.
    """
    common = {"id": msg.id, "robot": msg.robot, "context": context_from_msg(msg.context)}
    if msg.kind == Feedback.DEMONSTRATION:
        return Demonstration(trajectory=trajectory_from_msg(msg.demonstration, names), **common)
    if msg.kind == Feedback.CORRECTION:
        return Correction(
            planned=trajectory_from_msg(msg.planned, names),
            corrected=trajectory_from_msg(msg.corrected, names),
            span=(msg.span_start, msg.span_end),
            **common,
        )
    if msg.kind == Feedback.PREFERENCE:
        return Preference(options=tuple(trajectory_from_msg(o, names) for o in msg.options), ranks=tuple(msg.ranks),
                          query_id=msg.query_id, **common)
    raise InputError("kind of feedback", expected="1, 2 or 3", got=msg.kind)


def model_to_msg(model: RewardEnsemble, time: float) -> RewardModel:
    """Convert a learned reward."""
    return RewardModel(
        header=header(time, model.frame), version=model.version, robot=model.robot, inputs=list(model.inputs),
        layer_sizes=list(model.layer_sizes), activation=model.activation, members=int(model.weights[0].shape[0]),
        weights=array("f", model.flat_weights().astype(np.float32).tobytes()), feedback_ids=list(model.feedback_ids),
        seed=model.seed)


def model_from_msg(msg: RewardModel) -> RewardEnsemble:
    """Convert a reward model message.

    Raises:
        ConfigError: The activation is unknown.
        ShapeError: The number of weights does not fit the layers.
    """
    return RewardEnsemble.from_flat(
        np.array(msg.weights, dtype=np.float32), version=msg.version, robot=msg.robot, frame=msg.header.frame_id,
        inputs=tuple(msg.inputs), layer_sizes=tuple(msg.layer_sizes), members=msg.members,
        feedback_ids=tuple(msg.feedback_ids), seed=msg.seed, activation=msg.activation)


def teaching_state_to_msg(command: Command, state: RobotState, duration: float, frame: str) -> TeachingState:
    """Convert what the controller does; the duration is that of the motion under way [s]."""
    return TeachingState(
        header=header(state.time, frame),
        positions=array("d", np.asarray(state.positions).tobytes()),
        mode=int(command.mode),
        control=int(command.control),
        authority=float(command.authority),
        motion_id=command.motion_id,
        motion_time=float(command.motion_time),
        motion_duration=float(duration),
        force=float(command.force),
        message=command.message,
    )


def wrench_from_msg(msg: Wrench) -> Array:
    """Convert a wrench: force [N], then torque [Nm], shape (6,)."""
    return np.array([msg.force.x, msg.force.y, msg.force.z, msg.torque.x, msg.torque.y, msg.torque.z])


def wrench_to_msg(wrench: Array, time: float, frame: str) -> WrenchStamped:
    """Convert force [N] and torque [Nm], shape (6,), at the origin and in the axes of a frame."""
    force, torque = (Vector3(**dict(zip("xyz", map(float, part), strict=True))) for part in (wrench[:3], wrench[3:]))
    return WrenchStamped(header=header(time, frame), wrench=Wrench(force=force, torque=torque))


def contact_to_msg(sample: ContactSample, joint_names: Sequence[str], frame: str) -> Contact:
    """Convert a contact sample."""
    return Contact(
        header=header(sample.time, frame), kind=int(sample.kind), onset=stamp(sample.onset or 0.0),
        release=stamp(sample.release or 0.0), level=float(sample.level), link=sample.link,
        link_joint=joint_names[sample.link - 1] if sample.link else "",
        torque=array("d", np.asarray(sample.torque).tobytes()), bias=array("d", np.asarray(sample.bias).tobytes()))


def tracked_run_to_msg(captured: CapturedCorrections, joint_names: Sequence[str], feedback_ids: Sequence[str],
                       rate: float, frame: str) -> TrackedRun:
    """Convert a whole run, thinned to a rate [Hz], with its corrections tagged by the names of their items."""
    assert captured.run is not None
    run = captured.run.thinned(rate)
    began = float(run.times[0])
    measured = Trajectory(joint_names=tuple(joint_names), times=run.times - began, positions=run.positions)
    return TrackedRun(
        header=header(captured.time, frame), motion_id=captured.motion_id, measured=trajectory_to_msg(measured),
        motion_times=array("d", run.motion_times.tobytes()), in_contact=run.in_contact.tolist(),
        feedback_ids=list(feedback_ids), span_starts=[span.interval[0] - began for span in captured.corrections],
        span_ends=[span.interval[1] - began for span in captured.corrections])
