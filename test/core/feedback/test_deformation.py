"""Laws of the smooth alternatives (paper eqs. M1 and M2)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, ShapeError
from unifeed_ros.core.feedback.deformation import (
    DeformationShape,
    deform_tool_states,
    deformation_matrix,
    delay,
    noise_scale,
    sample_deformations,
    shortcuts,
)

counts = st.integers(2, 40)
both_ends = st.sampled_from(["fixed", "free"])
norms = st.sampled_from(["velocity", "acceleration", "jerk"])
SHAPES = [DeformationShape(norm=norm, noise=noise) for norm in ("velocity", "acceleration", "jerk")
          for noise in ("gaussian", "impulse")]
shapes = st.sampled_from(SHAPES)


def test_matrix_is_the_papers():
    differences = np.array([[1, 0, 0], [-2, 1, 0], [1, -2, 1], [0, 1, -2], [0, 0, 1]], dtype=float)
    np.testing.assert_allclose(deformation_matrix(3), np.linalg.inv(differences.T @ differences), atol=1e-12)


@given(count=counts, ends=both_ends, norm=norms)
def test_matrix_is_symmetric_positive_definite(count, ends, norm):
    matrix = deformation_matrix(count, ends, norm)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0


@given(count=st.integers(10, 60), ends=both_ends)
def test_an_impulse_spreads_smoothly(count, ends):
    impulse = deformation_matrix(count, ends)[:, count // 2]
    assert np.abs(np.diff(impulse, 2)).max() < 0.2 * np.abs(impulse).max()


@given(count=counts, seed=st.integers(0, 99), ends=both_ends, shape=shapes)
def test_the_start_stays_and_a_fixed_end_stays(count, seed, ends, shape):
    shifts = sample_deformations(count + 2, np.full((5, 3), 0.1), np.random.default_rng(seed), ends=ends, shape=shape)
    assert (shifts[:, 0] == 0).all()
    assert (shifts[:, -1] == 0).all() == (ends == "fixed")


@pytest.mark.parametrize("ends", ["fixed", "free"])
@pytest.mark.parametrize("points", [8, 21, 101])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: f"{shape.norm}-{shape.noise}")
def test_the_middle_moves_by_the_size_asked_for(points, ends, shape):
    sizes = np.tile([0.05, 0.3], (4000, 1))
    shifts = sample_deformations(points, sizes, np.random.default_rng(0), ends=ends, shape=shape)
    middle = 1 + ((points - (2 if ends == "fixed" else 1)) - 1) // 2
    np.testing.assert_allclose(np.sqrt((shifts[:, middle] ** 2).mean(axis=0)), [0.05, 0.3], rtol=0.05)


@pytest.mark.parametrize("noise", ["gaussian", "impulse"])
def test_the_higher_the_derivative_that_is_kept_small_the_smoother(noise):
    """Fifth differences, beside the size of the deformation itself: M integrates noise 2, 4 or 6 times."""
    roughness = []
    for norm in ("velocity", "acceleration", "jerk"):
        shifts = sample_deformations(40, np.full((400, 1), 0.1), np.random.default_rng(0),
                                     shape=DeformationShape(norm=norm, noise=noise))[..., 0]
        roughness.append(np.linalg.norm(np.diff(shifts, 5, axis=1)) / np.linalg.norm(shifts))
    assert roughness[0] > 3.0 * roughness[1] > 9.0 * roughness[2]


@given(count=st.integers(4, 30), seed=st.integers(0, 99), ends=both_ends, norm=norms)
def test_an_impulse_deforms_like_one_column_of_the_matrix(count, seed, ends, norm):
    moving = count - (2 if ends == "fixed" else 1)
    shifts = sample_deformations(count, np.full((3, 2), 0.1), np.random.default_rng(seed), ends=ends,
                                 shape=DeformationShape(norm=norm, noise="impulse"))
    columns = deformation_matrix(moving, ends, norm)
    columns = columns / np.linalg.norm(columns, axis=0)
    moved = np.moveaxis(shifts[:, 1:1 + moving], 1, -1).reshape(-1, moving)
    likeness = np.abs(moved @ columns) / np.linalg.norm(moved, axis=1)[:, None]
    np.testing.assert_allclose(likeness.max(axis=1), 1.0, atol=1e-9)


@given(scale=st.floats(0.1, 10.0), seed=st.integers(0, 99))
def test_deformations_scale_with_their_size(scale, seed):
    one = sample_deformations(12, [0.1], np.random.default_rng(seed))
    np.testing.assert_allclose(sample_deformations(12, [0.1 * scale], np.random.default_rng(seed)), scale * one)


def test_longer_trajectories_need_less_noise():
    scales = [noise_scale(count) for count in (10, 20, 40)]
    assert scales == sorted(scales, reverse=True)


def tool_path(count: int = 20) -> np.ndarray:
    position = np.linspace([0.2, 0.2, 0.6], [0.65, -0.4, 0.1], count)
    return np.hstack([position, np.tile([0.0, 0.0, -1.0], (count, 1))])


@given(seed=st.integers(0, 99), axis=st.floats(0.0, 1.0))
def test_alternatives_keep_the_axis_a_unit_vector(seed, axis):
    alternatives = deform_tool_states(tool_path(), np.full(4, 0.1), np.full(4, axis), np.random.default_rng(seed))
    np.testing.assert_allclose(np.linalg.norm(alternatives[..., 3:], axis=-1), 1.0)


def test_what_is_not_deformed_stays():
    rng = np.random.default_rng(0)
    tilted = deform_tool_states(tool_path(), np.zeros(3), np.full(3, 0.3), rng, ends="free")
    np.testing.assert_array_equal(tilted[..., :3], np.broadcast_to(tool_path()[:, :3], (3, 20, 3)))
    moved = deform_tool_states(tool_path(), np.full(3, 0.1), np.zeros(3), rng, ends="free")
    np.testing.assert_array_equal(moved[..., 3:], np.broadcast_to(tool_path()[:, 3:], (3, 20, 3)))


@given(seed=st.integers(0, 99), size=st.floats(0.01, 0.5), ends=both_ends)
def test_delayed_motions_follow_the_path_behind(seed, size, ends):
    path = tool_path()
    delayed = delay(path, np.full(6, size), np.random.default_rng(seed), ends=ends)
    steps = np.diff(delayed[..., :3], axis=1)
    along = path[-1, :3] - path[0, :3]
    assert (steps @ along >= -1e-9).all()
    np.testing.assert_allclose(np.cross(steps, along), 0.0, atol=1e-9)
    assert ((path - delayed)[..., :3] @ along >= -1e-9).all()
    np.testing.assert_array_equal(delayed[:, 0], np.tile(path[0], (6, 1)))
    if ends == "fixed":
        np.testing.assert_array_equal(delayed[:, -1], np.tile(path[-1], (6, 1)))


def test_bad_arguments_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ShapeError, match="at least 3"):
        sample_deformations(2, [0.1], rng)
    with pytest.raises(ConfigError, match="not negative"):
        sample_deformations(10, [-0.1], rng)
    with pytest.raises(ConfigError, match="not negative"):
        sample_deformations(10, [np.nan], rng)
    with pytest.raises(ConfigError, match="fixed or free"):
        deformation_matrix(10, "loose")
    with pytest.raises(ConfigError, match="velocity, acceleration, jerk"):
        DeformationShape(norm="snap")
    with pytest.raises(ConfigError, match="gaussian, impulse"):
        DeformationShape(noise="laplace")


def bow(height, points=21):
    """Give tool states along half a circle flattened to a height, from one end of a metre to the other [m]."""
    angle = np.linspace(0.0, np.pi, points)
    places = np.stack([0.5 - 0.5 * np.cos(angle), height * np.sin(angle), np.zeros(points)], axis=1)
    return np.concatenate([places, np.tile([0.0, 0.0, -1.0], (points, 1))], axis=1)


@given(height=st.floats(0.25, 1.0), seed=st.integers(0, 99))
def test_shortcuts_lie_between_the_path_and_its_chord_and_keep_its_ends(height, seed):
    path = bow(height)
    drawn = shortcuts(path, 50, 0.2, np.random.default_rng(seed))
    np.testing.assert_allclose(drawn[:, [0, -1]], np.tile(path[[0, -1]], (50, 1, 1)), atol=1e-12)
    moved = np.linalg.norm(drawn[..., :3] - path[:, :3], axis=-1)
    assert (moved.max(axis=1) >= 0.2 - 1e-9).all()
    assert (drawn[..., 1] <= path[:, 1] + 1e-9).all() and (drawn[..., 1] >= -1e-9).all()
    lengths = np.linalg.norm(np.diff(drawn[..., :3], axis=1), axis=-1).sum(axis=1)
    assert (lengths < np.linalg.norm(np.diff(path[:, :3], axis=0), axis=-1).sum()).all()


def test_a_shortcut_carries_the_axis_along_at_unit_length():
    path = bow(0.5)
    path[:, 3:] = np.stack([np.sin(path[:, 1]), np.zeros(21), -np.cos(path[:, 1])], axis=1)
    drawn = shortcuts(path, 50, 0.2, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(drawn[..., 3:], axis=-1), 1.0)
    assert (drawn[..., 3] <= path[:, 3] + 1e-9).all() and (drawn[..., 3] < path[:, 3] - 0.05).any()


@pytest.mark.parametrize("path", [bow(0.19), bow(0.0), bow(0.5)[:2]], ids=["shallow", "straight", "two points"])
def test_a_path_without_corners_has_no_shortcuts(path):
    assert shortcuts(path, 50, 0.2, np.random.default_rng(0)).shape == (0, *path.shape)
