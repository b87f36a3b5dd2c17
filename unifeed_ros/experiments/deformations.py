"""The paper's figure of a sine wave and its alternatives (fig:deformations), with what other norms would give."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from unifeed_ros.core.feedback.deformation import DeformationShape, Ends, sample_deformations
from unifeed_ros.core.types import Array
from unifeed_ros.experiments.experiment import (
    Condition,
    Experiment,
    Finding,
    Row,
    RunSettings,
    Summary,
    complete_people,
)
from unifeed_ros.experiments.statistics import mean_table, paired_tests

POINTS, DURATION, LENGTH, HEIGHT, SIZE = 41, 4.0, 1.0, 0.3, 0.1
"""Points of the wave; how long it takes [s]; its length and height [m]; size of the alternatives' middles [m]."""
DRAWN = 12
"""Alternatives in the figure."""
PAPERS, WHITE = "acceleration", "white noise"
TASK = "sine"


class Way(NamedTuple):
    """A way to make alternatives."""

    shape: DeformationShape | None
    """Norm and noise; None: noise as it is, M the identity."""
    ends: Ends = "fixed"
    """What happens to the last point."""


WAYS: dict[str, Way] = {
    PAPERS: Way(DeformationShape()),
    "acceleration, free end": Way(DeformationShape(), "free"),
    "acceleration, one push": Way(DeformationShape(noise="impulse")),
    "velocity": Way(DeformationShape(norm="velocity")),
    "jerk": Way(DeformationShape(norm="jerk")),
    WHITE: Way(None)}
"""Ways to make alternatives by their names, the paper's first."""


def sine_wave() -> Array:
    """Give the points of the paper's wave, evenly spaced in time, shape (H, 2) [m]."""
    share = np.linspace(0.0, 1.0, POINTS)
    return np.stack([LENGTH * share, HEIGHT * np.sin(2.0 * np.pi * share)], axis=-1)


def alternatives(way: Way, count: int, rng: np.random.Generator) -> Array:
    """Draw deformations of the wave.

    Args:
        way: How.
        count: How many, K.
        rng: Source of randomness.

    Returns:
        What is added to the wave, shape (K, H, 2) [m].
    """
    if way.shape is not None:
        return sample_deformations(POINTS, np.full((count, 2), SIZE), rng, ends=way.ends, shape=way.shape)
    noise = rng.normal(scale=SIZE, size=(count, POINTS, 2))
    noise[:, [0, -1]] = 0.0
    return noise


def measure(deformation: Array) -> dict[str, float]:
    """Measure one deformation.

    Args:
        deformation: Shape (H, 2) [m].

    Returns:
        How far middle, first and last point and the farthest one move in a coordinate [m, root mean square over the
        coordinates but for the farthest], and root mean squares of the velocity [m/s], acceleration [m/s^2] and jerk
        [m/s^3] that are added, rest before and after included.
    """
    step = DURATION / (POINTS - 1)
    rates = {f"{name} [{unit}]": _rms(np.diff(np.pad(deformation, ((order, order), (0, 0)), mode="edge"), order, axis=0)
                                     / step**order)
             for order, (name, unit) in enumerate((("velocity", "m/s"), ("acceleration", "m/s²"), ("jerk", "m/s³")), 1)}
    return {"start [m]": _rms(deformation[0]), "middle [m]": _rms(deformation[POINTS // 2]),
            "end [m]": _rms(deformation[-1]), "farthest [m]": float(np.abs(deformation).max()), **rates}


def run_person(person: int, settings: RunSettings) -> list[Row]:
    """Draw one alternative in each way, from the same noise wherever the ways need as much of it.

    Args:
        person: Number of the alternative.
        settings: Seed.

    Returns:
        One row a way.
    """
    return [{"task": TASK, "method": name, "interaction": 1,
             **measure(alternatives(way, 1, settings.rng(person))[0])} for name, way in WAYS.items()]


def analyse(rows: pd.DataFrame) -> Summary:
    """Compare how smooth the ways are.

    Args:
        rows: All rows.

    Returns:
        What they come to.
    """
    complete, excluded = complete_people(rows)
    people = complete["person"].nunique()
    measured = [name for name in measure(np.zeros((POINTS, 2))) if name in complete]
    table = [{"alternatives": name, **{what: _rms(part[what].to_numpy()) for what in measured}}
             for name, part in ((name, complete[complete["method"] == name]) for name in WAYS)]
    findings = []
    if people > 1:
        tests = paired_tests(complete, "acceleration [m/s²]", [(PAPERS, WHITE), (PAPERS, "velocity"), ("jerk", PAPERS)])
        share = table[0]["acceleration [m/s²]"] / table[-1]["acceleration [m/s²]"]
        ends = max(table[0]["start [m]"], table[0]["end [m]"])
        findings = [Finding(
            hypothesis="smoothness (eq. M2)", tests=tests,
            paper="the acceleration norm was selected in order to get smooth deformations",
            ours=f"at the same size in the middle ({table[0]['middle [m]']:.3f} m) they add {share:.2%} of the "
                 f"acceleration of white noise; both ends move by {ends:.3g} m",
            supported=bool(tests[0].less and tests[1].less))]
    sizes = mean_table(complete, "farthest [m]", ["method"])
    return Summary(people=people, excluded=excluded, findings=findings, tables={
        "Root mean squares over all alternatives": table, "How far the farthest point moves [m]": sizes},
        notes=[f"The wave: {POINTS} points, {LENGTH} m long, ± {HEIGHT} m, {DURATION:.0f} s; all ways are scaled to "
               f"{SIZE} m root mean square in the middle, where the paper names no size.",
               "\"Free end\" leaves out the rows of A past the last point; \"one push\" is one impulse a coordinate, "
               "as public relatives of the paper draw them; white noise is M the identity."])


def draw(rows: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw the wave with alternatives of each way.

    Args:
        rows: All rows; the alternatives in the figure are drawn with a seed of their own.
        folder: Where to write.

    Returns:
        The figure.
    """
    import matplotlib.pyplot as plt

    from unifeed_ros.experiments.figures import COLOURS, save

    wave = sine_wave()
    figure, axes = plt.subplots(2, 3, figsize=(11, 6), sharex=True, sharey=True, layout="constrained")
    for axis, (name, way) in zip(axes.flat, WAYS.items(), strict=True):
        for bent in wave + alternatives(way, DRAWN, np.random.default_rng(0)):
            axis.plot(*bent.T, color=COLOURS[2], linewidth=0.9, label="alternatives")
        axis.plot(*wave.T, color=COLOURS[0], linewidth=2.2, label="shown")
        axis.plot(*wave[[0, -1]].T, "o", color=COLOURS[0], markersize=5)
        axis.set(title=f"{name} (the paper's)" if name == PAPERS else name, aspect="equal")
        axis.spines[["top", "right"]].set_visible(False)
    shown, bent = axes[0, 0].lines[DRAWN], axes[0, 0].lines[0]
    axes[0, 0].legend([shown, bent], ["shown ξ", "alternatives ξ̂"], frameon=False, fontsize=8)
    figure.supxlabel("x [m]")
    figure.supylabel("y [m]")
    return [save(figure, folder / "deformations.png")]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _conditions() -> Sequence[Condition]:
    return [Condition(task=TASK, method=name) for name in WAYS]


EXPERIMENT = Experiment(
    name="deformations", title="Alternatives near a motion", people=1000, conditions=_conditions(),
    source="figure of a sine wave and its alternatives (fig:deformations; here a person is one alternative)",
    run_person=run_person, analyse=analyse, draw=draw)
