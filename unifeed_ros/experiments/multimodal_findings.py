"""What the experiment `multimodal` comes to: hypotheses H1 to H3, tables, and the paper's bars."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from unifeed_ros.core.types import Array
from unifeed_ros.experiments.analysis import PairedTest
from unifeed_ros.experiments.experiment import OK, Finding, Summary, complete_people
from unifeed_ros.experiments.statistics import mean_table, normality, paired_tests, residuals, rm_anova

OURS = ("Ours (D)", "Ours (C)", "Ours (P)", "Ours (DC)", "Ours (DP)", "Ours (CP)", "Ours (DCP)")
"""The paper's names of ours, by what it learns from."""
DCP, RRIC = OURS[-1], "RRIC"
END_TO_END = ("BC", "AIRL", "Atari")
"""The paper's other methods that are told no features."""
COLOURS = dict(zip((*END_TO_END, *OURS, RRIC), (
    "#c8553d", "#f2a65a", "#b08968", "#b5d99c", "#8cc5b2", "#d6c14e", "#4f9d69", "#3a86a8", "#7f8f3f", "#081c15",
    "#7b5ea7"), strict=True))
"""Of the methods from left to right; Ours (DCP) is the darkest."""
FEW = 3
"""People under whom nothing is decided."""


def analyse(rows: pd.DataFrame) -> Summary:
    """Compare the methods after the last interaction, both tasks together as in the paper.

    Args:
        rows: All rows.

    Returns:
        What they come to.
    """
    complete, failing = compared(rows)
    excluded = sorted(int(p) for p in rows.loc[rows["status"] != OK, "person"].unique())
    people = complete["person"].nunique()
    if not people:
        return Summary(people=0, excluded=excluded)
    last = complete[complete["interaction"] == complete["interaction"].max()]
    tables = {"Regret after the last interaction, both tasks [reward]": mean_table(last, "regret", ["method"]),
              "Regret by task [reward]": mean_table(last, "regret", ["task", "method"]),
              "The same as a share of the straight line's regret [1]": mean_table(
                  last, "normalised_regret", ["task", "method"]),
              "Mean normalised regret after each interaction, both tasks [1]": _by_interaction(complete)}
    notes = [*NOTES, f"The planner's optimum beside SciPy's SLSQP, from the straight line and from the optimum: SLSQP "
             f"better by at most {max(0.0, -complete['optimum_gap'].min()):.2%} of the straight line's regret.",
             f"Plans that kept no limits, so that the robot stayed with its last motion: "
             f"{int((~complete['planned'].astype(bool)).sum())} of {len(complete)}."]
    if failing:
        notes.append(f"Left out, because every run of theirs failed: {', '.join(failing)}.")
    if people < FEW:
        return Summary(people=people, excluded=excluded, tables=tables, notes=notes)
    there = set(last["method"])
    parts = paired_tests(last, "regret", [(DCP, other) for other in OURS[:-1]])
    others = [name for name in END_TO_END if name in there]
    learned = paired_tests(last, "regret", [(DCP, other) for other in others]) if others else []
    (known,) = paired_tests(last, "regret", [(DCP, RRIC)])
    effects = rm_anova(last, "regret", ["task", "method"])
    anovas = {f"{effect.effect} on regret{PAPER_ANOVA.get(effect.effect, '')}": effect for effect in effects}
    normal = normality(_residuals(last))
    notes.append(f"Normality of the residuals: Shapiro-Wilk W = {normal.statistic:.3f}, p = {normal.p:.2g}, "
                 f"correlation of the Q-Q plot {normal.correlation:.3f}; Wilcoxon's signed ranks are in the table.")
    tables["Ours (DCP) less each other, Holm's correction within a hypothesis"] = [
        {"less": t.second, "mean difference": t.mean, "low": t.interval[0], "high": t.interval[1], "p": t.p,
         "p (ranks)": t.p_ranks, "g": t.effect_size} for t in (*parts, *learned, known)]
    return Summary(people=people, excluded=excluded, tables=tables, notes=notes, anovas=anovas,
                   findings=[_h1(parts), _h2(learned, others), _h3(known)])


def compared(rows: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Take the rows that can be compared: of methods that did not fail with everybody, people without a failed run.

    Args:
        rows: All rows.

    Returns:
        Their rows, and the methods that failed with everybody.
    """
    well = set(rows.loc[rows["status"] == OK, "method"])
    complete, _ = complete_people(rows[rows["method"].isin(well)])
    return complete, sorted(set(rows["method"]) - well)


def _h1(tests: list[PairedTest]) -> Finding:
    missed = [f"{t.second} ({t.mean:+.3g}, p = {t.p:.3g})" for t in tests if not t.less]
    return Finding(
        hypothesis="H1", tests=tests, supported=not missed,
        paper="Ours (DCP) outperforms ours with only one or two kinds of feedback (p < .05)",
        ours="Ours (DCP) has significantly less regret than all its parts" if not missed else
             "not significantly less regret than " + "; ".join(missed))


def _h2(tests: list[PairedTest], others: list[str]) -> Finding:
    paper = "Ours (DCP) outperforms the end-to-end learning baselines BC, AIRL and Atari (p < .05)"
    absent = [name for name in END_TO_END if name not in others]
    if absent:
        return Finding(hypothesis="H2", paper=paper, ours=f"not measured: {', '.join(absent)} not run", tests=tests,
                       supported=None)
    missed = [t.second for t in tests if not t.less]
    return Finding(hypothesis="H2", paper=paper, tests=tests, supported=not missed,
                   ours=f"not significantly better than {', '.join(missed)}" if missed else
                   "significantly better than all of them")


def _h3(test: PairedTest) -> Finding:
    verdict = ("no significant difference" if test.alike else
               f"significantly {'less' if test.less else 'more'} regret than RRIC")
    return Finding(hypothesis="H3", tests=[test], supported=test.alike or test.less,
                   paper="Ours (DCP) matches RRIC with known features (p = .548)", ours=f"{verdict}: {test}")


def _by_interaction(rows: pd.DataFrame) -> list[dict[str, float]]:
    means = rows.groupby(["interaction", "method"])["normalised_regret"].mean().unstack("method")
    return [{"interaction": int(k), **{m: float(row[m]) for m in (*OURS, *END_TO_END, RRIC) if m in row}}
            for k, row in means.iterrows()]


PAPER_ANOVA = {"method": " (paper: F(1.818, 140) = 61.939, p < .05)", "task": " (paper: F(1, 14) = 3.073, p = .101)"}
NOTES = (
    "Each person has a start and a goal of their own within 0.1 m of the task's in each direction, the same for all "
    "methods; the planner fixes both ends (eq. M10) and is the same for all.",
    "Six inputs, split evenly, demonstrations first, then corrections, then rankings. A correction is of the motion "
    "that the robot planned last, before the first input of the smoothest one, however good it is.",
    "A question compares two of 1000 motions, the robot's own and variations of them, chosen by the expected "
    "information for ours and for RRIC alike; before anything was learned, two at random.",
    "BC and AIRL get six demonstrations, Atari two and then four rankings of what its clone does. They plan nothing: "
    "the arm follows what their policy does in the task's duration, and where that ends is not fixed.",
    "H3 counts as supported where no significant difference is found, or ours has less regret; its interval says how "
    "large a difference may be.",
)


def draw(rows: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw the paper's bars, the regret after each interaction, and how normal the residuals are.

    Args:
        rows: All rows.
        folder: Where to write.

    Returns:
        The figures.
    """
    import matplotlib.pyplot as plt

    from unifeed_ros.experiments.figures import bars, curves, quantile_plot, save

    complete, _ = compared(rows)
    if complete.empty:
        return []
    methods = [m for m in COLOURS if m in set(complete["method"])]
    colours = {m: COLOURS[m] for m in methods}
    last = complete[complete["interaction"] == complete["interaction"].max()]
    each = last.groupby(["person", "method"], as_index=False)["regret"].mean()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    bars(left, each, "regret", colours)
    left.set(ylabel="regret [reward]", title="after six interactions, both tasks")
    often = complete.groupby("method")["interaction"].nunique()  # policies move after the last input only
    curves(right, complete, "normalised_regret", {m: colour for m, colour in colours.items() if often[m] > 1})
    right.set(xlabel="interaction", ylabel="normalised regret", title="after each interaction, both tasks")
    right.legend(frameon=False, fontsize=8, ncols=2)
    normal, axes = plt.subplots(figsize=(4, 4), layout="constrained")
    quantile_plot(axes, _residuals(last))
    return [save(figure, folder / "regret.png"), save(normal, folder / "normality.png")]


def _residuals(last: pd.DataFrame) -> Array:
    """Take the means of cells and people off the regret."""
    return residuals(last.assign(cell=last["task"] + ", " + last["method"]), "regret", by="cell")
