"""Signed distances of the whole arm to zones, to the table and to itself, through coal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from unifeed_ros.core.planning.capsules import Capsule, arm_capsules, self_pairs
from unifeed_ros.core.planning.constraints import Constraint, Values
from unifeed_ros.core.planning.kinematics import ArmPose, point_gradient
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array
from unifeed_ros.core.zones import Zone

Indices = NDArray[np.intp]

_MARGIN = 2e-3
_TABLE = "the table"


class _Thing(NamedTuple):
    """A convex body, and the capsule around it that tells whether it is near."""

    hull: Capsule
    shape: Any
    turn: Array
    """Orientation of the shape in the frame of its joint."""


def clearance_constraint(robot: RobotModel, zones: Mapping[str, Zone], table_height: float,
                         distance: float) -> Constraint:
    """Keep the arm's capsules away from zones, from the table and from each other.

    A start whose capsules touch the table or each other is taken for apart, since capsules are larger than the arm and
    a real arm is not in its own way; the motion then comes no closer. A start inside a zone is refused.

    Args:
        robot: The arm.
        zones: What to keep out of.
        table_height: Height of the table's top [m].
        distance: Distance to keep [m].

    Raises:
        ConfigError: The URDF's collision geometry cannot be read.
    """
    capsules = arm_capsules(robot)
    things = [_arm_thing(c) for c in capsules] + [_zone_thing(name, zone) for name, zone in zones.items()]
    bodies = [k for k, c in enumerate(capsules) if c.body > 0]
    over_table = [(k, e) for k in bodies for e in (0, 1) if _can_come_down(capsules[k], capsules[k].ends[e])]
    pairs = [*self_pairs(capsules), *((k, j) for j in range(len(capsules), len(things)) for k in bodies)]
    names = [*(f"{capsules[k].name} to {_TABLE}" for k, _ in over_table),
             *(f"{things[i].hull.name} to {things[j].hull.name}" for i, j in pairs)]
    of_zones = np.array([j >= len(capsules) for _, j in pairs], dtype=bool)
    least = np.concatenate([np.full(len(over_table), -np.inf), np.where(of_zones, 0.0, -np.inf)])
    first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    segments = _by_body([t.hull for t in things])
    radii, reaches = np.array([t.hull.radius for t in things]), np.array([t.hull.reach for t in things])

    tips, ends_of_tips = np.array(over_table, dtype=np.intp).reshape(-1, 2).T
    owners, rounding = np.array([t.hull.body for t in things]), radii[tips] + table_height

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        count, n = velocities.shape
        ends = np.empty((len(things), 2, count, 3))
        for body, (members, local) in segments.items():
            ends[members] = pose.points(body, local).reshape(-1, 2, count, 3)
        values, jacobians = np.full((count, len(names)), np.inf), np.zeros((count, len(names), n))
        heights = ends[tips, ends_of_tips, :, 2] - rounding[:, None]
        tip, at = np.nonzero(heights < distance + near)
        values[at, tip] = heights[tip, at]
        low = _Side(owners[tips[tip]], ends[tips[tip], ends_of_tips[tip], at], np.tile([0.0, 0.0, 1.0], (len(tip), 1)))
        _add_gradients(jacobians, pose, at, tip, low)
        pair, sample = _close(ends, radii, reaches, first, second, distance + near)
        if len(pair):
            column, one, other = pair + len(tips), first[pair], second[pair]
            values[sample, column], points, others, normals = _distances(pose, things, one, other, sample, ends)
            _add_gradients(jacobians, pose, sample, column, _Side(owners[one], points, -normals))
            _add_gradients(jacobians, pose, sample, column, _Side(owners[other], others, normals))
        return Values(values, jacobians)

    return Constraint(
        names=tuple(names), bounds=np.full(len(names), distance), least=least, margin=_MARGIN, evaluate=evaluate,
        say=lambda name, value, bound: f"{name}: distance {value:.4f} m, at least {bound:.4f} m")


class _Side(NamedTuple):
    """One side of K distances."""

    bodies: Indices
    """Joint that moves it; 0: none."""
    points: Array
    """The point that is nearest to the other side, shape (K, 3) [m]."""
    directions: Array
    """Direction in which the point's motion adds to the distance, shape (K, 3)."""


def _add_gradients(jacobians: Array, pose: ArmPose, samples: Indices, columns: Indices, side: _Side) -> None:
    """Add to the distances' derivatives what one side's motion does."""
    for body in np.unique(side.bodies[side.bodies > 0]).tolist():
        rows = np.flatnonzero(side.bodies == body)
        jacobians[samples[rows], columns[rows]] += point_gradient(
            pose, samples[rows], body, side.points[rows], side.directions[rows])


def _by_body(hulls: list[Capsule]) -> dict[int, tuple[list[int], Array]]:
    """Sort capsules by the joint that moves them: their indices, and their ends, shape (2 L, 3) [m]."""
    owners = {hull.body: [k for k, one in enumerate(hulls) if one.body == hull.body] for hull in hulls}
    return {body: (members, np.concatenate([hulls[k].ends for k in members])) for body, members in owners.items()}


def _can_come_down(capsule: Capsule, end: Array) -> bool:
    """Tell whether an end of a capsule can come down to the table that the arm stands on: a shoulder cannot."""
    return capsule.body > 2 or (capsule.body == 2 and float(np.linalg.norm(end)) > capsule.radius)


def _close(ends: Array, radii: Array, reaches: Array, first: Indices, second: Indices,
           near: float) -> tuple[Indices, Indices]:
    """Find pairs and samples that may be nearer than a distance: first by spheres, then by segments and spheres."""
    middles = ends.mean(axis=1)
    away = middles[first] - middles[second]
    limit = reaches[first] + reaches[second] + near
    pair, sample = np.nonzero(np.einsum("qni,qni->qn", away, away) < (np.maximum(limit, 0.0) ** 2)[:, None])
    one, other = first[pair], second[pair]
    apart = np.maximum(_to_segment(ends[one, :, sample], middles[other, sample]) - radii[one] - reaches[other],
                       _to_segment(ends[other, :, sample], middles[one, sample]) - radii[other] - reaches[one])
    return pair[apart < near], sample[apart < near]


def _to_segment(segments: Array, points: Array) -> Array:
    """Compute distances from segments, shape (K, 2, 3), to points, shape (K, 3)."""
    along, away = segments[:, 1] - segments[:, 0], points - segments[:, 0]
    share = (along * away).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    away -= np.minimum(np.maximum(share, 0.0), 1.0)[:, None] * along
    return np.sqrt((away**2).sum(axis=1))


def _distances(pose: ArmPose, things: list[_Thing], first: Indices, second: Indices, samples: Indices,
               ends: Array) -> tuple[Array, Array, Array, Array]:
    """Let coal compute K signed distances, nearest points of both, and directions from the first to the second."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    distances, points = np.empty(len(samples)), np.empty((3, len(samples), 3))
    placed: dict[tuple[int, int], Any] = {}
    for k, (i, j, at) in enumerate(zip(first.tolist(), second.tolist(), samples.tolist(), strict=True)):
        for m in (i, j):
            if (m, at) not in placed:
                turn = pose.rotations[things[m].hull.body, at] @ things[m].turn
                placed[m, at] = coal.Transform3s(turn, 0.5 * (ends[m, 0, at] + ends[m, 1, at]))
        result.clear()
        distances[k] = coal.distance(things[i].shape, placed[i, at], things[j].shape, placed[j, at], request, result)
        points[0, k], points[1, k] = result.getNearestPoint1(), result.getNearestPoint2()
        points[2, k] = result.normal
    return distances, points[0], points[1], points[2]


def _arm_thing(capsule: Capsule) -> _Thing:
    along = capsule.ends[1] - capsule.ends[0]
    along = along / np.linalg.norm(along) if capsule.length > 1e-9 else np.array([0.0, 0.0, 1.0])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).toRotationMatrix()
    return _Thing(capsule, coal.Capsule(capsule.radius, capsule.length), turn)


def _zone_thing(name: str, zone: Zone) -> _Thing:
    up = np.array([0.0, 0.0, zone.half_segment])
    shape: Any
    if zone.shape == "box":
        shape, radius = coal.Box(*zone.size.tolist()), 0.5 * float(np.linalg.norm(zone.size))
    else:
        radius = float(zone.size[0])
        shape = coal.Sphere(radius) if zone.shape == "sphere" else coal.Capsule(radius, 2 * zone.half_segment)
    hull = Capsule(f"zone {name}", 0, np.stack([zone.position - up, zone.position + up]), radius)
    return _Thing(hull, shape, np.eye(3))
