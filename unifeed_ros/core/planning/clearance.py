"""Signed distances of the whole arm to zones, to the table and to itself, through coal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import coal
import numpy as np
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
    first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    segments = _by_body([t.hull for t in things])
    radii, reaches = np.array([t.hull.radius for t in things]), np.array([t.hull.reach for t in things])

    def evaluate(pose: ArmPose, velocities: Array, near: float) -> Values:
        count, n = velocities.shape
        ends = np.empty((len(things), 2, count, 3))
        for body, (members, local) in segments.items():
            ends[members] = pose.points(body, local).reshape(-1, 2, count, 3)
        table = _over_table(pose, capsules, over_table, ends, table_height, distance + near)
        values, jacobians = np.full((count, len(pairs)), np.inf), np.zeros((count, len(pairs), n))
        pair, sample = _close(ends, radii, reaches, first, second, distance + near)
        if len(pair):
            found = _distances(pose, things, first[pair], second[pair], sample, ends)
            values[sample, pair] = found.distances
            jacobians[sample, pair] = _gradients(pose, things, first[pair], second[pair], sample, found)
        return Values(np.concatenate([table.values, values], axis=1),
                      np.concatenate([table.jacobians, jacobians], axis=1))

    return Constraint(
        names=tuple(names), bounds=np.full(len(names), distance), least=0.0, margin=_MARGIN, evaluate=evaluate,
        say=lambda name, value, bound: f"{name}: distance {value:.4f} m, at least {bound:.4f} m")


class _Found(NamedTuple):
    """K signed distances with their nearest points and the direction from the first to the second."""

    distances: Array
    ones: Array
    others: Array
    normals: Array


def _by_body(hulls: list[Capsule]) -> dict[int, tuple[list[int], Array]]:
    """Sort capsules by the joint that moves them: their indices, and their ends, shape (2 L, 3) [m]."""
    owners = {hull.body: [k for k, one in enumerate(hulls) if one.body == hull.body] for hull in hulls}
    return {body: (members, np.concatenate([hulls[k].ends for k in members])) for body, members in owners.items()}


def _can_come_down(capsule: Capsule, end: Array) -> bool:
    """Tell whether an end of a capsule can come down to the table that the arm stands on: a shoulder cannot."""
    return capsule.body > 2 or (capsule.body == 2 and float(np.linalg.norm(end)) > capsule.radius)


def _over_table(pose: ArmPose, capsules: tuple[Capsule, ...], chosen: list[tuple[int, int]], ends: Array,
                table_height: float, near: float) -> Values:
    """Compute the heights of capsules' ends over the table; no gradient where they are far."""
    count, n = len(pose.tool), pose.axes.shape[1]
    which = np.array(chosen, dtype=np.intp).reshape(-1, 2)
    values = ends[which[:, 0], which[:, 1], :, 2].T - np.array([capsules[k].radius for k, _ in chosen]) - table_height
    jacobians = np.zeros((count, len(chosen), n))
    for p, (k, end) in enumerate(chosen):
        samples = np.flatnonzero(values[:, p] < near)
        if len(samples):
            up = np.tile([0.0, 0.0, 1.0], (len(samples), 1))
            jacobians[samples, p] = point_gradient(pose, samples, capsules[k].body, ends[k, end, samples], up)
    return Values(np.where(values < near, values, np.inf), jacobians)


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
               ends: Array) -> _Found:
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    out = np.empty((len(samples), 10))
    middles = ends.mean(axis=1)
    for k, (i, j, at) in enumerate(zip(first.tolist(), second.tolist(), samples.tolist(), strict=True)):
        one, other = things[i], things[j]
        result.clear()
        places = [coal.Transform3s(pose.rotations[t.hull.body, at] @ t.turn, middles[m, at])
                  for t, m in ((one, i), (other, j))]
        out[k, 0] = coal.distance(one.shape, places[0], other.shape, places[1], request, result)
        out[k, 1:4], out[k, 4:7] = result.getNearestPoint1(), result.getNearestPoint2()
        out[k, 7:] = result.normal
    return _Found(out[:, 0], out[:, 1:4], out[:, 4:7], out[:, 7:])


def _gradients(pose: ArmPose, things: list[_Thing], first: Indices, second: Indices, samples: Indices,
               found: _Found) -> Array:
    gradients = np.zeros((len(samples), pose.axes.shape[1]))
    body = np.array([t.hull.body for t in things])
    for members, points, sign in ((first, found.ones, -1.0), (second, found.others, 1.0)):
        owners = body[members]
        for owner in np.unique(owners[owners > 0]).tolist():
            rows = np.flatnonzero(owners == owner)
            gradients[rows] += point_gradient(pose, samples[rows], owner, points[rows], sign * found.normals[rows])
    return gradients


def _arm_thing(capsule: Capsule) -> _Thing:
    along = capsule.ends[1] - capsule.ends[0]
    along = along / np.linalg.norm(along) if capsule.length > 1e-9 else np.array([0.0, 0.0, 1.0])
    side = np.linalg.svd(along[None])[2][1]
    turn = np.stack([side, np.cross(along, side), along], axis=1)
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
