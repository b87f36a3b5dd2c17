"""Laws of the shapes and pictures of the page."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from unifeed_ros.console.drawing import (
    MOST_DISAGREEMENT,
    THICKEST,
    THINNEST,
    grid_states,
    reward_colours,
    small_drawing,
    tube,
    tube_radii,
)
from unifeed_ros.console.health import FREE_MIB, SILENT_S, Status, health_lines, worst
from unifeed_ros.console.state import LessonView, Question, Taught
from unifeed_ros.console.words import banner_html, health_html, notes_html, question_html, sound_html, taught_html
from unifeed_ros.core.errors import ShapeError

HELIX = np.stack([np.cos(np.linspace(0, 6, 50)), np.sin(np.linspace(0, 6, 50)), np.linspace(0, 1, 50)], axis=1)
EVIL = "<script>alert('&\"')</script>"


def test_a_tube_keeps_its_radius_and_faces_outward():
    radii = np.linspace(0.01, 0.03, len(HELIX))
    vertices, faces = tube(HELIX, radii, sides=12)
    rings = vertices.reshape(len(HELIX), 12, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - HELIX[:, None], axis=2), np.tile(radii[:, None], 12), atol=1e-12)
    np.testing.assert_allclose(rings.mean(axis=1), HELIX, atol=1e-12)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    middle = np.repeat(HELIX, 12, axis=0)[faces].mean(axis=1)
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center - middle)
    assert (outward > 0).all()


def test_a_tube_does_not_twist_on_a_straight_line_and_bears_standing_still():
    line = np.outer([0, 0.1, 0.1, 0.2], [1.0, 0.5, 0.2])
    rings = tube(line, np.full(4, 0.01))[0].reshape(4, -1, 3)
    np.testing.assert_allclose(rings - line[:, None], np.tile(rings[0] - line[0], (4, 1, 1)), atol=1e-12)
    assert np.isfinite(tube(np.zeros((3, 3)), np.ones(3))[0]).all()


@pytest.mark.parametrize(("path", "radii"), [(np.zeros((1, 3)), [1]), (np.zeros((4, 2)), np.ones(4)),
                                             (np.zeros((4, 3)), np.ones(3))])
def test_what_is_no_path_is_refused(path, radii):
    with pytest.raises(ShapeError, match="tube"):
        tube(path, radii)


def test_colours_do_not_depend_on_a_constant_and_grow_lighter_with_reward():
    rewards = np.linspace(-1, 1, 20)
    colours = reward_colours(rewards)
    np.testing.assert_array_equal(colours, reward_colours(5.0 + 3.0 * rewards))
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()
    assert len(np.unique(reward_colours(np.zeros(5)), axis=0)) == 1


def test_width_says_disagreement():
    np.testing.assert_allclose(tube_radii([0.0, MOST_DISAGREEMENT, 9.0]), [THINNEST, THICKEST, THICKEST])


def test_a_slice_lists_its_states_row_by_row():
    states = grid_states((0.0, -1.0), (2.0, 1.0), 0.3, (0, 0, -1), 3)
    np.testing.assert_allclose(states[1], [1.0, -1.0, 0.3, 0, 0, -1])
    np.testing.assert_allclose(states[3], [0.0, 0.0, 0.3, 0, 0, -1])


def test_small_drawings_stay_inside_their_frame():
    picture = small_drawing((HELIX, HELIX * 2), size=(120, 64))
    points = [tuple(map(float, p.split(","))) for part in picture.split('points="')[1:] for p in
              part.partition('"')[0].split()]
    assert len(points) > 20 and all(0 <= x <= 120 and 0 <= y <= 64 for x, y in points)
    assert small_drawing(()) == ""


def test_texts_from_elsewhere_are_shown_as_text():
    status = Status(level=2, message=EVIL, age=0.0)
    lines = health_lines([EVIL], {EVIL: status}, {EVIL: (1.0, 100.0)}, None)
    view = LessonView(message=EVIL, stop_reason=EVIL, notes=(EVIL,), health=lines,
                      question=Question(id=EVIL, information=0.0, reason=EVIL))
    item = Taught(id=EVIL, kind=9, change=EVIL)
    for page in (banner_html(view), notes_html(view), question_html(view), health_html(lines), taught_html(1, item)):
        assert "<script" not in page
    assert "&lt;script" in notes_html(view) + question_html(view)


def test_health_names_what_is_wrong_and_what_helps():
    well = {"capture": Status(level=0, message="watching", age=0.1),
            "recorder": Status(level=0, message="recording", age=0.1,
                               values={"free_mib": str(2 * FREE_MIB), "messages": "12"})}
    lines = health_lines(["capture"], well, {"contact": (100.0, 100.0)}, 0.1)
    assert worst(lines) is None and all(not line.remedy for line in lines)
    for change, name in (({"capture": Status(level=0, message="", age=SILENT_S + 1)}, "capture"),
                         ({"capture": Status(level=1, message="bad", age=0.0)}, "capture"),
                         ({"recorder": Status(level=0, message="", age=0.0, values={"free_mib": "10"})}, "disk")):
        sick = worst(health_lines(["capture"], {**well, **change}, {"contact": (100.0, 100.0)}, 0.1))
        assert sick is not None and sick.name == name and sick.remedy
    assert worst(health_lines(["capture"], well, {"contact": (10.0, 100.0)}, 0.1)).name == "contact"
    assert worst(health_lines(["capture"], well, {}, None)).name == "contact sensor"
    assert worst(health_lines(["session"], well, {}, 0.1)).name == "session"


def test_a_sound_is_new_each_time():
    assert sound_html((440.0,), 1) != sound_html((440.0,), 2) and "data:audio/wav" in sound_html((440.0,), 1)
