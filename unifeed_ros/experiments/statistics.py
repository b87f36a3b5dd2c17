"""The paper's statistics, from pingouin and scipy: normality, repeated-measures ANOVA, post-hoc tests, intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pingouin
from numpy.typing import ArrayLike
from scipy import stats

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.types import Array
from unifeed_ros.experiments.analysis import Anova, PairedTest

RESAMPLES = 9999
"""Resamples of a bootstrap interval."""


@dataclass(frozen=True, kw_only=True)
class Normality:
    """How far values are from a normal distribution."""

    statistic: float
    """Shapiro and Wilk's W, 1 for normal values."""
    p: float
    """Probability of so small a W if they were normal."""
    correlation: float
    """Correlation of the points of the Q-Q plot, 1 on a line."""


def rm_anova(rows: pd.DataFrame, value: str, within: str | Sequence[str], person: str = "person") -> list[Anova]:
    """Analyse repeated measures, with Greenhouse and Geisser's correction.

    Args:
        rows: One row a measurement; several of one person in one cell are averaged.
        value: Column of what was measured.
        within: Column of what differs within people, or two of them.
        person: Column of the people.

    Returns:
        One analysis an effect: each column's, then their interaction's.

    Raises:
        InputError: Fewer than two people or two levels, or a person who lacks a measurement.
    """
    factors = [within] if isinstance(within, str) else list(within)
    cells = rows.groupby([person, *factors], as_index=False, sort=True, observed=True)[value].mean()
    levels = [cells[factor].nunique() for factor in factors]
    people = cells[person].nunique()
    if people < 2 or min(levels) < 2:
        raise InputError("analysis of variance", expected="two people and two levels at least",
                         got=f"{people} people and {min(levels)} levels")
    if len(cells) != people * int(np.prod(levels)) or not np.isfinite(cells[value]).all():
        raise InputError("analysis of variance", expected=f"{people * int(np.prod(levels))} finite measurements",
                         got=f"{int(np.isfinite(cells[value]).sum())}", mend="leave incomplete people out")
    table = pingouin.rm_anova(cells, dv=value, within=factors if len(factors) > 1 else factors[0], subject=person,
                              correction=True, detailed=True, effsize="ng2")
    return [_anova(row, table) for row in table.to_dict("records") if row["Source"] != "Error"]


def _anova(row: dict[str, Any], table: pd.DataFrame) -> Anova:
    epsilon = float(row["eps"]) if np.isfinite(row["eps"]) else 1.0
    if "ddof1" in row:  # two factors: each effect has an error of its own
        numerator, denominator = float(row["ddof1"]), float(row["ddof2"])
    else:
        numerator, denominator = float(row["DF"]), float(table.loc[table["Source"] == "Error", "DF"].iloc[0])
    corrected = float(stats.f.sf(row["F"], epsilon * numerator, epsilon * denominator))
    return Anova(effect=str(row["Source"]), statistic=float(row["F"]), df_effect=epsilon * numerator,
                 df_error=epsilon * denominator, p=corrected, epsilon=epsilon, effect_size=float(row["ng2"]))


def paired_tests(rows: pd.DataFrame, value: str, pairs: Sequence[tuple[str, str]], *, by: str = "method",
                 person: str = "person", seed: int = 0) -> list[PairedTest]:
    """Compare methods over the same people, post hoc: paired t tests with Holm's correction over all pairs given.

    Args:
        rows: One row a measurement; several of one person in one cell are averaged.
        value: Column of what was measured.
        pairs: Names (first, second) of what is compared, one family of tests.
        by: Column of the names.
        person: Column of the people.
        seed: Seed of the bootstrap.

    Returns:
        One test a pair.

    Raises:
        InputError: Fewer than two people, or a person who lacks one of the two.
    """
    wide = rows.pivot_table(index=person, columns=by, values=value, aggfunc="mean", dropna=False, observed=True)
    both = [(_column(wide, first), _column(wide, second)) for first, second in pairs]
    raw = [stats.ttest_rel(a, b) if np.ptp(a - b) else None for a, b in both]
    ranks = [stats.wilcoxon(a - b).pvalue if (a != b).any() else 1.0 for a, b in both]
    p = _holm([_p_of_equal(a, b) if t is None else float(t.pvalue) for t, (a, b) in zip(raw, both, strict=True)])
    p_ranks = _holm(ranks)
    return [PairedTest(
        first=first, second=second, people=len(a), mean=float((a - b).mean()), interval=bootstrap_interval(a - b, seed),
        statistic=0.0 if raw[k] is None else float(raw[k].statistic), p=p[k], p_ranks=p_ranks[k],
        effect_size=float(pingouin.compute_effsize(a, b, paired=True, eftype="hedges")) if (a != b).any() else 0.0)
        for k, ((first, second), (a, b)) in enumerate(zip(pairs, both, strict=True))]


def _column(wide: pd.DataFrame, name: str) -> Array:
    if name not in wide.columns:
        raise InputError("nothing was measured of what is compared", expected=name, got=", ".join(map(str, wide)))
    values = wide[name].to_numpy(dtype=np.float64)
    if len(values) < 2 or not np.isfinite(values).all():
        raise InputError(f"measurements of {name}", expected="two people at least, one a person, finite",
                         got=f"{int(np.isfinite(values).sum())} of {len(values)}", mend="leave incomplete people out")
    return values


def _p_of_equal(a: Array, b: Array) -> float:
    """Give the probability where all differences are the same number, of which t is not defined."""
    return 1.0 if np.array_equal(a, b) else 0.0


def _holm(p: Sequence[float]) -> list[float]:
    return [float(value) for value in pingouin.multicomp(list(p), method="holm")[1]] if p else []


def bootstrap_interval(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """Compute the 95 % bootstrap interval of a mean (bias-corrected and accelerated).

    Args:
        values: What was measured, one a person, shape (N,).
        seed: Seed of the resampling.

    Returns:
        Lower and upper end; both the mean where all values are equal.
    """
    sample = np.asarray(values, dtype=np.float64)
    if not np.ptp(sample):
        return float(sample[0]), float(sample[0])
    found = stats.bootstrap((sample,), np.mean, n_resamples=RESAMPLES, confidence_level=0.95, method="BCa",
                            batch=1000, rng=np.random.default_rng(seed)).confidence_interval
    return float(found.low), float(found.high)


def mean_table(rows: pd.DataFrame, value: str, by: Sequence[str], person: str = "person") -> list[dict[str, Any]]:
    """Compute mean, standard error and 95 % bootstrap interval in each cell.

    Args:
        rows: One row a measurement; several of one person in one cell are averaged.
        value: Column of what was measured.
        by: Columns that make the cells.
        person: Column of the people.

    Returns:
        One row a cell, in order of appearance.
    """
    table = []
    for cell, group in rows.groupby(list(by), sort=False, observed=True):
        values = group.groupby(person)[value].mean().to_numpy(dtype=np.float64)
        low, high = bootstrap_interval(values)
        error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
        table.append({**dict(zip(by, cell, strict=True)), "people": len(values), "mean": float(values.mean()),
                      "standard error": error, "low": low, "high": high, "median": float(np.median(values))})
    return table


def residuals(rows: pd.DataFrame, value: str, by: str = "method", person: str = "person") -> Array:
    """Compute what an analysis of variance leaves unexplained: each value less its person's and its method's mean.

    Args:
        rows: One row a person and method.
        value: Column of what was measured.
        by: Column of the methods.
        person: Column of the people.

    Returns:
        Residuals, shape (people * methods,).
    """
    cells = rows.pivot_table(index=person, columns=by, values=value, aggfunc="mean", observed=True)
    matrix = cells.to_numpy(dtype=np.float64)
    left = matrix - matrix.mean(axis=0) - matrix.mean(axis=1, keepdims=True) + matrix.mean()
    return np.asarray(left.ravel())


def normality(values: ArrayLike) -> Normality:
    """Test whether values may come from a normal distribution.

    Args:
        values: Residuals, shape (N,), at least 3.

    Returns:
        The test. Among thousands of values, any small departure is significant: look at the Q-Q plot.
    """
    sample = np.asarray(values, dtype=np.float64)
    if len(sample) < 3 or not np.ptp(sample):
        return Normality(statistic=1.0, p=1.0, correlation=1.0)
    test = stats.shapiro(sample)
    return Normality(statistic=float(test.statistic), p=float(test.pvalue),
                     correlation=float(stats.probplot(sample)[1][2]))
