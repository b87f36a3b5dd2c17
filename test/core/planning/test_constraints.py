"""Every kind of constraint: values and derivatives against finite differences, distances against closed forms."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, PlanningError
from unifeed_ros.core.planning.capsules import arm_capsules, fit_capsule
from unifeed_ros.core.planning.check import motion_bounds, scene_constraints
from unifeed_ros.core.planning.clearance import clearance_constraint, segment_distances
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.kinematics import Kinematics
from unifeed_ros.core.planning.tool_limits import end_constraint
from unifeed_ros.core.zones import Cone, Zone

CONFIG = PlannerConfig()
ZONES = {"ball": Zone(shape="sphere", position=(0.45, 0.0, 0.5), size=(0.12,)),
         "crate": Zone(shape="box", position=(0.6, -0.3, 0.3), size=(0.2, 0.3, 0.25)),
         "person": Zone(shape="capsule", position=(0.5, 0.35, 0.5), size=(0.1, 0.8)),
         "careful": Zone(shape="box", position=(0.4, 0.0, 0.4), size=(0.5, 0.8, 0.6), speed=0.1)}


def everything(scene):
    return replace(scene, zones=ZONES, workspace=(-0.2, -0.8, 0.0, 0.9, 0.8, 1.2), tool_speed=0.25,
                   cones={"upright": Cone(angle=0.4), "aside": Cone(direction=(1.0, 0.0, -1.0), angle=1.0)})


def _differences(function, x, step=1e-6):
    columns = []
    for j in range(x.size):
        high, low = x.copy(), x.copy()
        high[0, j] += step
        low[0, j] -= step
        columns.append((function(high) - function(low)) / (2 * step))
    return np.stack(columns, axis=-1)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_derivatives_of_all_constraints_match_differences(case, seed):
    rng = np.random.default_rng(seed)
    share = rng.uniform()
    posture = (case.start + share * (case.goal - case.start) + rng.normal(scale=0.3, size=case.robot.n))[None]
    velocity = rng.normal(scale=0.3, size=posture.shape)
    kinematics = Kinematics(case.robot)
    end = end_constraint(case.scene.goal, case.scene.axis, 1e-3)
    for one in (*scene_constraints(case.robot, everything(case.scene), CONFIG), end):
        at = one.evaluate(kinematics.evaluate(posture), velocity, 0.1)
        near = np.isfinite(at.values[0])

        def values(q, v, one=one, near=near):
            return one.evaluate(kinematics.evaluate(q), v, 0.5).values[0, near]

        numeric = _differences(lambda q: values(q, velocity), posture)
        off = np.abs(at.jacobians[0, near] - numeric).max(axis=1, initial=0.0)
        kinks = np.abs(numeric - _differences(lambda q: values(q, velocity), posture, 1e-5)).max(axis=1, initial=0.0)
        smooth = kinks < 1e-4  # nearest points jump between features of a box, between ends of parallel capsules
        assert (off[smooth] < 1e-4).all(), np.array(one.names)[near][smooth & (off > 1e-4)]
        assert smooth.mean() > 0.5 if len(smooth) else True
        if at.rate_jacobians is not None:
            numeric = _differences(lambda v: values(posture, v), velocity)
            np.testing.assert_allclose(at.rate_jacobians[0, near], numeric, atol=1e-6)


def test_distances_to_spheres_are_the_closed_form(case):
    """A capsule's signed distance to a sphere: from the segment to the middle, less both radii; also inside."""
    rng = np.random.default_rng(1)
    postures = case.start + rng.normal(scale=0.3, size=(20, case.robot.n))
    pose = Kinematics(case.robot).evaluate(postures)
    zone = Zone(shape="sphere", position=(0.3, 0.1, 0.5), size=(0.15,))
    constraint = clearance_constraint(case.robot, {"ball": zone}, -5.0, 0.0)
    values = constraint.evaluate(pose, np.zeros(postures.shape), 10.0).values
    capsules = {c.name: c for c in arm_capsules(case.robot) if c.body > 0}
    checked, deepest = 0, 0.0
    for p, name in enumerate(constraint.names):
        if not name.endswith("to zone ball"):
            continue
        capsule = capsules[name.removesuffix(" to zone ball")]
        low, high = (pose.rotations[capsule.body] @ end + pose.origins[capsule.body] for end in capsule.ends)
        shares = np.linspace(0.0, 1.0, 2001)[:, None, None]
        distances = np.linalg.norm(low + shares * (high - low) - zone.position, axis=2).min(axis=0)
        np.testing.assert_allclose(values[:, p], distances - capsule.radius - 0.15, atol=1e-6)
        checked, deepest = checked + 1, min(deepest, values[:, p].min())
    assert checked == len(capsules) and deepest < -0.05


@pytest.mark.parametrize("near", [0.0, 0.1])
def test_distances_to_boxes_are_coals_and_left_out_only_where_they_are_far(case, near):
    rng = np.random.default_rng(2)
    postures = case.start + rng.normal(scale=0.4, size=(40, case.robot.n))
    pose = Kinematics(case.robot).evaluate(postures)
    zone = Zone(shape="box", position=(0.4, 0.0, 0.4), size=(0.2, 0.3, 0.25))
    values = clearance_constraint(case.robot, {"crate": zone}, -5.0, 0.02)
    found = values.evaluate(pose, np.zeros(postures.shape), near).values
    capsules = {c.name: c for c in arm_capsules(case.robot) if c.body > 0}
    box, place, known = coal.Box(*zone.size), coal.Transform3s(np.eye(3), zone.position), 0
    for p, name in enumerate(values.names):
        capsule = capsules.get(name.removesuffix(" to zone crate"))
        if capsule is None or not name.endswith("to zone crate"):
            continue
        for k in range(len(postures)):
            low, high = (pose.rotations[capsule.body, k] @ end + pose.origins[capsule.body, k] for end in capsule.ends)
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), high - low).toRotationMatrix()
            true = coal.distance(coal.Capsule(capsule.radius, capsule.length), coal.Transform3s(
                turn if capsule.length > 1e-9 else np.eye(3), 0.5 * (low + high)), box, place, coal.DistanceRequest(),
                coal.DistanceResult())
            assert found[k, p] == pytest.approx(true, abs=1e-5) or (found[k, p] == np.inf and true >= 0.02 + near)
            known += np.isfinite(found[k, p])
    assert known > 10


@given(seed=st.integers(0, 10_000))
def test_distances_of_segments_are_those_of_coal(seed):
    """Thin capsules of coal around the same segments: askew, parallel, meeting at an end, and points."""
    rng = np.random.default_rng(seed)
    first, second = rng.uniform(-0.5, 0.5, size=(2, 12, 2, 3))
    second[:3, 1] = second[:3, 0] + rng.uniform(-2.0, 2.0, size=(3, 1)) * (first[:3, 1] - first[:3, 0])  # parallel
    first[3, 1], second[4, 1] = first[3, 0], second[4, 0]  # points
    first[5, 1], second[5, 1] = first[5, 0], second[5, 0]
    found = segment_distances(first, second)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-9)
    request, result, radius = coal.DistanceRequest(), coal.DistanceResult(), 1e-4
    for k in range(len(first)):
        shapes = [(coal.Capsule(radius, np.linalg.norm(ends[1] - ends[0])), _placed(ends))
                  for ends in (first[k], second[k])]
        result.clear()
        theirs = coal.distance(*shapes[0], *shapes[1], request, result) + 2.0 * radius
        assert found.values[k] == pytest.approx(theirs, abs=1e-6)
        np.testing.assert_allclose(found.points[k] + found.values[k] * found.normals[k],
                                   _nearest_on(second[k], found.points[k]), atol=1e-7)


def test_segments_that_cross_or_coincide_have_a_unit_normal():
    first = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]] * 3)
    second = np.array([[[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]], [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.2, 0.0, 0.0]] * 2])
    found = segment_distances(first, second)
    np.testing.assert_allclose(found.values, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)
    assert abs(found.normals[0, 2]) == pytest.approx(1.0)


def _placed(ends):
    along = ends[1] - ends[0]
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along if np.any(along) else np.ones(3))
    return coal.Transform3s(turn.toRotationMatrix(), ends.mean(axis=0))


def _nearest_on(ends, point):
    along = ends[1] - ends[0]
    share = np.clip((point - ends[0]) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return ends[0] + share * along


@given(seed=st.integers(0, 1000))
def test_points_distances_to_zones_have_unit_gradients_and_the_right_size(seed):
    rng = np.random.default_rng(seed)
    points = np.array([0.5, 0.0, 0.4]) + rng.uniform(-1.0, 1.0, size=(20, 3))
    for zone in ZONES.values():
        distances, normals = zone.distance(points)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
        surface = points - distances[:, None] * normals
        np.testing.assert_allclose(zone.distance(surface)[0], 0.0, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_capsules_hold_all_points_and_little_more(seed):
    rng = np.random.default_rng(seed)
    along = rng.uniform(-0.3, 0.3, size=400)[:, None] * [0.0, 0.6, 0.8]
    off = rng.normal(size=(400, 3))
    points = along + 0.1 * off / np.linalg.norm(off, axis=1, keepdims=True)
    ends, radius = fit_capsule(points)
    share = np.clip((points - ends[0]) @ (ends[1] - ends[0]) / ((ends[1] - ends[0]) ** 2).sum(), 0.0, 1.0)
    distances = np.linalg.norm(points - ends[0] - share[:, None] * (ends[1] - ends[0]), axis=1)
    assert distances.max() <= radius + 1e-9
    assert radius < 0.125 and np.linalg.norm(ends[1] - ends[0]) < 0.7


def test_the_arms_own_bodies_are_apart_at_the_tasks_ends_and_meet_when_folded(case):
    bounds = motion_bounds(case.robot, case.scene, case.start, case.goal, CONFIG)
    assert all((one.bounds >= 0).all() for one in bounds.constraints[1:])
    rng = np.random.default_rng(0)
    postures = rng.uniform(case.robot.lower, case.robot.upper, size=(300, case.robot.n))
    constraint = clearance_constraint(case.robot, {}, -5.0, 0.0)
    values = constraint.evaluate(Kinematics(case.robot).evaluate(postures), np.zeros(postures.shape), 0.1).values
    touching = (values < 0).any(axis=1).mean()
    assert 0.02 < touching < 0.6


def test_capsules_that_touch_at_the_start_may_stay_as_close_but_not_closer(panda):
    """Fingers just over the table: their capsules are longer than they."""
    low = panda.robot.inverse_kinematics((0.5, 0.0, 0.01), seed=panda.start)
    clearance = motion_bounds(panda.robot, panda.scene, low, panda.goal, CONFIG).constraints[1]
    at = clearance.evaluate(Kinematics(panda.robot).evaluate(low[None]), np.zeros((1, 7)), 0.1).values[0]
    assert at.min() < 0.0
    np.testing.assert_allclose(clearance.bounds, np.minimum(at, CONFIG.body_clearance), atol=1e-12)


@pytest.mark.parametrize(("changes", "text"), [
    ({"zones": {"ball": {"shape": "sphere", "position": (0.2, 0.2, 0.6), "size": (0.1,)}}}, "start .*zone ball: dist"),
    ({"zones": {"ball": {"shape": "sphere", "position": (0.65, -0.4, 0.1), "size": (0.1,)}}}, "goal .*zone ball: dist"),
    ({"workspace": (0.3, -1.0, 0.0, 1.0, 1.0, 1.0)}, "start .*workspace at its smallest x by 0.1"),
    ({"cones": {"level": {"angle": 0.5, "direction": (1.0, 0.0, 0.0)}}}, "start .*tilts 1.57.* rad from cone level"),
])
def test_ends_that_contradict_the_scene_are_refused_with_numbers(panda, changes, text):
    with pytest.raises(PlanningError, match=text):
        motion_bounds(panda.robot, replace(panda.scene, **changes), panda.start, panda.goal, CONFIG)


@pytest.mark.parametrize(("changes", "text"), [
    ({"zones": {"a": {"shape": "cube", "position": (0, 0, 0), "size": (1,)}}}, "shape of a zone"),
    ({"zones": {"a": {"shape": "sphere", "position": (0, 0, 0), "size": (0.0,)}}}, "size > 0"),
    ({"zones": {"a": {"shape": "capsule", "position": (0, 0, 0), "size": (0.2, 0.3)}}}, "twice the radius"),
    ({"zones": {"a": {"shape": "sphere", "size": (0.1,)}}}, "zone a lacks settings.*position"),
    ({"cones": {"a": {"angle": 0.0}}}, "angle of a cone"), ({"tool_speed": -1.0}, "tool_speed"),
    ({"workspace": (0.0, 0.0, 0.0, 1.0, 1.0, -1.0)}, "workspace"),
])
def test_scenes_that_cannot_be_are_refused(panda, changes, text):
    with pytest.raises(ConfigError, match=text):
        replace(panda.scene, **changes)
