"""Figures of the paper's form: curves with standard errors, bars with standard errors, Q-Q plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from unifeed_ros.core.types import Array

COLOURS = ("#c8553d", "#f2a65a", "#8d99ae", "#588b8b", "#2b2d42", "#1b7f4d", "#7b5ea7", "#b08968")
"""Colours of methods in the order in which they are given."""


def colours_of(methods: Sequence[str]) -> dict[str, str]:
    """Give each method its colour.

    Args:
        methods: Names, at most eight kept apart.

    Returns:
        Colour of each.
    """
    return {method: COLOURS[k % len(COLOURS)] for k, method in enumerate(methods)}


def curves(axes: Axes, rows: pd.DataFrame, value: str, colours: Mapping[str, str]) -> None:
    """Draw the mean of each method over the interactions, the standard error shaded.

    Args:
        axes: Where to draw.
        rows: Rows of one task.
        value: Column of what was measured.
        colours: Colour of each method, in the order of the legend.
    """
    for method, colour in colours.items():
        groups = rows[rows["method"] == method].groupby("interaction")[value]
        if not groups.ngroups:
            continue
        mean, error = groups.mean(), groups.sem().fillna(0.0)
        axes.plot(mean.index, mean, color=colour, label=method, linewidth=1.8)
        axes.fill_between(mean.index, mean - error, mean + error, color=colour, alpha=0.25, linewidth=0)
    axes.set_ylim(bottom=0.0)
    axes.spines[["top", "right"]].set_visible(False)


def bars(axes: Axes, rows: pd.DataFrame, value: str, colours: Mapping[str, str]) -> None:
    """Draw the mean of each method as a bar with its standard error.

    Args:
        axes: Where to draw.
        rows: One row a person and method.
        value: Column of what was measured.
        colours: Colour of each method, from left to right.
    """
    groups = rows.groupby("method")[value]
    mean, error = groups.mean(), groups.sem().fillna(0.0)
    there = [method for method in colours if method in mean]
    axes.bar(there, mean[there], yerr=error[there], color=[colours[m] for m in there], capsize=3, width=0.7)
    axes.tick_params(axis="x", rotation=40)
    for label in axes.get_xticklabels():
        label.set_horizontalalignment("right")
    axes.spines[["top", "right"]].set_visible(False)


def quantile_plot(axes: Axes, values: Array) -> None:
    """Draw values against those that a normal distribution would give (Q-Q plot).

    Args:
        axes: Where to draw.
        values: Residuals, shape (N,).
    """
    (theory, ordered), (slope, middle, correlation) = stats.probplot(values)
    axes.plot(theory, ordered, ".", color=COLOURS[4], markersize=3)
    axes.plot(theory, middle + slope * np.asarray(theory), color=COLOURS[0], linewidth=1.0)
    axes.set(xlabel="normal quantiles", ylabel="residuals", title=f"Q-Q plot, r = {correlation:.3f}")
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure and forget it.

    Args:
        figure: The figure.
        path: PNG file.

    Returns:
        The file.
    """
    figure.savefig(path, dpi=150, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    return path
