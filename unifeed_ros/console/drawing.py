"""Shapes and pictures as arrays: tubes, slices, small drawings; colours that colour-blind people can tell."""

from __future__ import annotations

import html

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.errors import ShapeError
from unifeed_ros.core.types import Array

Bytes = NDArray[np.uint8]

COLOURS = matplotlib.colormaps["cividis"]
"""Dark blue for the lowest reward, yellow for the highest; even in lightness for every kind of colour vision."""
THINNEST, THICKEST = 0.006, 0.03
"""Radius of a tube where the networks agree, and where they disagree most [m]."""
MOST_DISAGREEMENT = 0.5
"""Disagreement that is drawn with the thickest tube [reward]."""
SIDES = 10
"""Corners of a tube's cross section."""


def reward_colours(rewards: ArrayLike) -> Bytes:
    """Colour rewards, the lowest and the highest of them at the ends of the scale.

    A reward's constant carries no meaning, so the scale is relative; a constant reward is in the middle.

    Args:
        rewards: Rewards, any shape [1].

    Returns:
        RGB, the same shape and a last axis of 3.
    """
    rewards = np.asarray(rewards, dtype=np.float64)
    low, high = float(rewards.min()), float(rewards.max())
    share = (rewards - low) / (high - low) if high - low > 1e-9 else np.full(rewards.shape, 0.5)
    return np.asarray(np.round(255 * COLOURS(share)[..., :3]), dtype=np.uint8)


def tube_radii(disagreement: ArrayLike) -> Array:
    """Turn disagreement into the radius of a tube.

    Args:
        disagreement: Standard deviation over the ensemble at each point, shape (N,) [reward].

    Returns:
        Radii, shape (N,) [m].
    """
    share = np.clip(np.asarray(disagreement, dtype=np.float64) / MOST_DISAGREEMENT, 0.0, 1.0)
    return THINNEST + (THICKEST - THINNEST) * share


def tube(path: ArrayLike, radii: ArrayLike, sides: int = SIDES) -> tuple[Array, NDArray[np.int32]]:
    """Build the surface of a tube around a path.

    Cross sections are turned as little as possible from one point to the next (parallel transport), so that the
    surface does not twist.

    Args:
        path: Points, shape (N, 3), N >= 2 [m]; points may coincide.
        radii: Radius at each point, shape (N,) [m].
        sides: Corners of a cross section.

    Returns:
        Vertices, shape (N * sides, 3) [m], those of one point after the other, and triangles, shape (M, 3), outward.

    Raises:
        ShapeError: Not a path, or another number of radii.
    """
    path, radii = np.asarray(path, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 2 or radii.shape != (len(path),):
        raise ShapeError("path and radii of a tube", expected="(N, 3) and (N,), N >= 2", got=(path.shape, radii.shape))
    tangents = _tangents(path)
    first = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    normal = np.cross(tangents[0], first)
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    vertices = np.empty((len(path), sides, 3))
    for k, tangent in enumerate(tangents):
        normal = normal - tangent * (normal @ tangent)
        normal /= np.linalg.norm(normal)
        ring = np.outer(np.cos(angles), normal) + np.outer(np.sin(angles), np.cross(tangent, normal))
        vertices[k] = path[k] + radii[k] * ring
    return vertices.reshape(-1, 3), _triangles(len(path), sides)


def _tangents(path: Array) -> Array:
    """Give unit tangents; where the path stands still, that of the nearest earlier moving point."""
    steps = np.gradient(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > 1e-9
    if not moving.any():
        return np.tile([0.0, 0.0, 1.0], (len(path), 1))
    latest = np.maximum.accumulate(np.where(moving, np.arange(len(path)), -1))
    latest[latest < 0] = int(np.argmax(moving))
    return np.asarray(steps[latest] / lengths[latest, None])


def _triangles(count: int, sides: int) -> NDArray[np.int32]:
    ring, corner = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    here, beside = ring * sides + corner, ring * sides + (corner + 1) % sides
    quads = np.stack([here, beside, beside + sides, here + sides], axis=-1).reshape(-1, 4)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def grid_states(low: ArrayLike, high: ArrayLike, height: float, axis: ArrayLike, count: int) -> Array:
    """List the tool states of a level slice through the workspace.

    Args:
        low: Smallest x and y, shape (2,) [m].
        high: Largest x and y, shape (2,) [m].
        height: Height of the slice [m].
        axis: Direction of the tool, shape (3,).
        count: States along each side.

    Returns:
        Tool states, shape (count * count, 6) [m, 1]; rows along y, from the smallest x and y on.
    """
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    x, y = np.meshgrid(np.linspace(low[0], high[0], count), np.linspace(low[1], high[1], count))
    states = np.empty((count * count, 6))
    states[:, 0], states[:, 1], states[:, 2], states[:, 3:] = x.ravel(), y.ravel(), height, np.asarray(axis)
    return states


def small_drawing(paths: tuple[Array, ...], size: tuple[int, int] = (120, 64)) -> str:
    """Draw tool paths seen from the side, along the way from start to goal; the first path is the thick one.

    Args:
        paths: Tool paths, shape (N, 3) each [m].
        size: Width and height [px].

    Returns:
        An SVG picture; an empty text without paths.
    """
    if not paths:
        return ""
    way = paths[0][-1, :2] - paths[0][0, :2]
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    flat = [np.column_stack([(p[:, :2] - paths[0][0, :2]) @ way, p[:, 2]]) for p in paths]
    points = np.concatenate(flat)
    low, spread = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 0.05)
    margin, (width, height) = 6, size
    scale = min(width, height * 2) - 2 * margin
    lines = []
    for k, path in reversed(list(enumerate(flat))):
        kept = path[np.linspace(0, len(path) - 1, min(len(path), 24)).astype(int)]
        spots = " ".join(f"{margin + (x - low[0]) / spread * scale:.1f},"
                         f"{height - margin - (z - low[1]) / spread * scale * 0.5:.1f}" for x, z in kept)
        style = 'stroke="#00529c" stroke-width="3"' if k == 0 else 'stroke="#8a5200" stroke-width="1.5" ' \
            'stroke-dasharray="4 3"'
        lines.append(f'<polyline points="{spots}" fill="none" {style}/>')
    table = f'<line x1="0" y1="{height - 2}" x2="{width}" y2="{height - 2}" stroke="#888" stroke-width="2"/>'
    return f'<svg width="{width}" height="{height}" role="img" aria-label="motion from the side">{table}' \
        + "".join(lines) + "</svg>"


def scale_legend() -> str:
    """Draw the scale of rewards: worse on the left, better on the right."""
    stops = ", ".join(matplotlib.colors.to_hex(COLOURS(k / 8)) for k in range(9))
    return (f'<div style="height:14px;border-radius:4px;background:linear-gradient(to right, {stops})"></div>'
            '<div style="display:flex;justify-content:space-between;font-size:13px"><span>worse</span>'
            "<span>thin: sure &middot; thick: unsure</span><span>better</span></div>")


def as_text(text: str) -> str:
    """Make any text harmless inside HTML: names and messages are shown, never interpreted."""
    return html.escape(text, quote=True)
