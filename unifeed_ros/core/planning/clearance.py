"""Signed distances of the whole arm to zones, to the table and to itself; those to boxes through coal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from unifeed_ros.core.planning.capsules import Capsule, arm_capsules, self_pairs
from unifeed_ros.core.planning.constraints import Constraint, Values
from unifeed_ros.core.planning.kinematics import ArmPose
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array
from unifeed_ros.core.zones import Zone

Indices = NDArray[np.intp]

_MARGIN = 2e-3
_TABLE = "the table"
_UP = np.array([0.0, 0.0, 1.0])
_POINT = 1e-12
"""Square of the length below which a segment is a point [m^2]."""
_PARALLEL = 1e-12
"""Square of the sine below which segments are taken for parallel [1]."""
_CROSSED = 1e-9
"""Distance below which segments cross [m]."""
_LOOKS = 5
"""Points of a segment whose distances to a box tell whether coal need be asked."""


class _Thing(NamedTuple):
    """A convex body, and the capsule around it that tells whether it is near."""

    hull: Capsule
    shape: Any
    """The arm's capsule, or a zone's box, for coal; None: the hull is the zone itself."""
    place: Any
    """Orientation of the capsule in the frame of its joint, or where the box is."""
    zone: Zone | None = None
    """The zone that is a box."""


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
    of_boxes = np.array([j >= len(capsules) and things[j].shape is not None for _, j in pairs], dtype=bool)
    owners, local = np.array([t.hull.body for t in things]), np.array([t.hull.ends for t in things])
    radii, reaches = np.array([t.hull.radius for t in things]), np.array([t.hull.reach for t in things])
    tips, ends_of_tips = np.array(over_table, dtype=np.intp).reshape(-1, 2).T
    rounding = radii[tips] + table_height
    moving = np.arange(robot.n) < owners[:, None]  # (T, n): joints that move each thing
    signs = np.concatenate([moving[tips].astype(float), moving[second].astype(float) - moving[first]])

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        count, n = velocities.shape
        ends = np.einsum("tkij,tej->teki", pose.rotations[owners], local) + pose.origins[owners][:, None]
        values, jacobians = np.full((count, len(names)), np.inf), np.zeros((count, len(names), n))
        heights = ends[tips, ends_of_tips, :, 2] - rounding[:, None]
        tip, at = np.nonzero(heights < distance + near)
        low = _Distances(heights[tip, at], ends[tips[tip], ends_of_tips[tip], at], np.broadcast_to(_UP, (len(tip), 3)))
        pair, sample = _close(ends, reaches[first] + reaches[second] + distance + near, first, second)
        one, other = first[pair], second[pair]
        found = segment_distances(ends[one, :, sample], ends[other, :, sample])
        found = found._replace(values=found.values - radii[one] - radii[other])
        boxes = np.flatnonzero(of_boxes[pair] & (found.values < distance + near))
        if len(boxes):
            _let_coal_compute(found, boxes, pose, things, one, other, sample, ends, distance + near)
        column, sample = np.concatenate([tip, pair + len(tips)]), np.concatenate([at, sample])
        size, points, normals = (np.concatenate(parts) for parts in zip(low, found, strict=True))
        kept = size < distance + near
        column, sample, points, normals = column[kept], sample[kept], points[kept], normals[kept]
        values[sample, column] = size[kept]
        jacobians[sample, column] = pose.moved(sample, points, normals) * signs[column]
        return Values(values, jacobians)

    return Constraint(
        names=tuple(names), bounds=np.full(len(names), distance), least=least, margin=_MARGIN, evaluate=evaluate,
        say=lambda name, value, bound: f"{name}: distance {value:.4f} m, at least {bound:.4f} m")


class _Distances(NamedTuple):
    """K signed distances between two sides."""

    values: Array
    """Shape (K,) [m]."""
    points: Array
    """A point on the line through both nearest points, shape (K, 3) [m]."""
    normals: Array
    """Direction in which the second side's motion adds to the distance, shape (K, 3)."""


def segment_distances(first: Array, second: Array) -> _Distances:
    """Compute the distances of line segments, and where they are nearest.

    The nearest point of one line to the other, moved onto its segment, then onto the nearest point of the other
    segment, and back; that is exact for segments (Ericson, Real-Time Collision Detection, 2005, sec. 5.1.9).

    Args:
        first: Ends of K segments, shape (K, 2, 3) [m].
        second: Ends of the others.
    """
    one, other, apart = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    a, b, e, c, f = ((u * v).sum(axis=1) for u, v in (
        (one, one), (one, other), (other, other), (one, apart), (other, apart)))
    a, e = np.maximum(a, _POINT), np.maximum(e, _POINT)
    share = np.minimum(np.maximum((b * f - c * e) / np.maximum(a * e - b * b, _PARALLEL * a * e), 0.0), 1.0)
    of_other = np.minimum(np.maximum((b * share + f) / e, 0.0), 1.0)
    share = np.minimum(np.maximum((b * of_other - c) / a, 0.0), 1.0)
    points = first[:, 0] + share[:, None] * one
    away = second[:, 0] + of_other[:, None] * other - points
    length = np.sqrt((away * away).sum(axis=1))
    crossed = np.flatnonzero(length < _CROSSED)
    if len(crossed):  # any direction across both is a normal
        away[crossed] = np.cross(one[crossed], other[crossed])
        away[crossed] += np.where(np.abs(away[crossed]).max(axis=1, keepdims=True) < _CROSSED, _UP, 0.0)
    scale = length if not len(crossed) else np.sqrt((away * away).sum(axis=1))
    return _Distances(length, points, away / scale[:, None])


def _can_come_down(capsule: Capsule, end: Array) -> bool:
    """Tell whether an end of a capsule can come down to the table that the arm stands on: a shoulder cannot."""
    return capsule.body > 2 or (capsule.body == 2 and float(np.linalg.norm(end)) > capsule.radius)


def _close(ends: Array, limits: Array, first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Find the pairs and samples whose middles are nearer than limits."""
    middles = 0.5 * (ends[:, 0] + ends[:, 1])
    away = middles[first] - middles[second]
    pair, sample = np.nonzero(np.einsum("qni,qni->qn", away, away) < (np.maximum(limits, 0.0) ** 2)[:, None])
    return pair, sample


def _let_coal_compute(found: _Distances, rows: Indices, pose: ArmPose, things: list[_Thing], first: Indices,
                      second: Indices, samples: Indices, ends: Array, far: float) -> None:
    """Replace the distances to boxes, which are to the spheres around them, by the true ones; inf: surely too far."""
    segments = ends[first[rows], :, samples[rows]]
    found.values[rows], near = np.inf, np.zeros(len(rows), dtype=bool)
    for j in np.unique(second[rows]).tolist():
        of_box = second[rows] == j
        near[of_box] = _may_be_near(segments[of_box], things[j].zone) < far + np.array(
            [things[i].hull.radius for i in first[rows[of_box]]])
    rows, centres = rows[near], segments[near].mean(axis=1)
    one = [things[i] for i in first[rows]]
    turns = (pose.rotations[[thing.hull.body for thing in one], samples[rows]]
             @ np.array([thing.place for thing in one]).reshape(-1, 3, 3))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for k, capsule, turn, centre, j in zip(rows.tolist(), one, turns, centres, second[rows].tolist(), strict=True):
        placed, box = coal.Transform3s(turn, centre), things[j]
        result.clear()
        found.values[k] = coal.distance(capsule.shape, placed, box.shape, box.place, request, result)
        found.points[k], found.normals[k] = result.getNearestPoint1(), result.normal


def _may_be_near(segments: Array, zone: Zone | None) -> Array:
    """Bound the distances of segments, shape (K, 2, 3) [m], to a box from below: it changes no faster than the way."""
    assert zone is not None
    along = segments[:, 1] - segments[:, 0]
    points = segments[:, :1] + np.linspace(0.0, 1.0, _LOOKS)[:, None] * along[:, None]
    nearest = zone.distance(points.reshape(-1, 3))[0].reshape(-1, _LOOKS).min(axis=1)
    return np.asarray(nearest - 0.5 / (_LOOKS - 1) * np.linalg.norm(along, axis=1))


def _arm_thing(capsule: Capsule) -> _Thing:
    along = capsule.ends[1] - capsule.ends[0]
    along = along / np.linalg.norm(along) if capsule.length > 1e-9 else _UP
    turn = pin.Quaternion.FromTwoVectors(_UP, along).toRotationMatrix()
    return _Thing(capsule, coal.Capsule(capsule.radius, capsule.length), turn)


def _zone_thing(name: str, zone: Zone) -> _Thing:
    up = np.array([0.0, 0.0, zone.half_segment])
    is_box = zone.shape == "box"
    radius = 0.5 * float(np.linalg.norm(zone.size)) if is_box else float(zone.size[0])
    hull = Capsule(f"zone {name}", 0, np.stack([zone.position - up, zone.position + up]), radius)
    if not is_box:
        return _Thing(hull, None, None)
    return _Thing(hull, coal.Box(*zone.size.tolist()), coal.Transform3s(np.eye(3), zone.position), zone)
