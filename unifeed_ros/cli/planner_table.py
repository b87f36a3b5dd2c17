"""The table of `unifeed bench planner`: medians over problems, and lower bounds where a peer was ended early."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from unifeed_ros.core.planning.qp import SOLVERS

SUMMARY = ("median_s", "p95_s", "slsqp_fd_s", "slsqp_exact_s", "ratio_fd", "ratio_exact", "floor_s", "worst_violation",
           "objective_gap_p95", "solved", "problems")
"""Figures of each robot, task and number of way-points that others may rely on; all others are details."""

Figures = dict[str, Any]


def summarise(problems: Sequence[Figures]) -> tuple[Figures, Figures]:
    """Summarise the problems of one robot, task and number of way-points.

    Args:
        problems: Figures of each, as `measure_problem` and `measure_peers` give them.

    Returns:
        The summary, and details. What nothing was measured for is None. Objectives are compared where SLSQP with exact
        gradients converged; details hold the largest gap to what it had where it was ended.
    """
    seconds = np.array([p["seconds"] for p in problems])
    gaps = {converged: [p["exact"]["gap"] for p in problems if "exact" in p and p["exact"]["converged"] is converged]
            for converged in (True, False)}
    exceeding = [max(p["excess"].values()) for p in problems if p["excess"]]
    summary: Figures = {"median_s": float(np.median(seconds)), "p95_s": float(np.percentile(seconds, 95))}
    details: Figures = {f"{solver}_s": _median([p[f"{solver}_s"] for p in problems if f"{solver}_s" in p])
                        for solver in SOLVERS}
    for name in ("fd", "exact"):
        peers = [(p[name], p["seconds"]) for p in problems if name in p]
        times = [peer["seconds"] for peer, _ in peers]
        ratios = [peer["seconds"] / ours for peer, ours in peers]
        ended = [not peer["converged"] for peer, _ in peers]
        summary[f"slsqp_{name}_s"], summary[f"ratio_{name}"] = _median(times), _median(ratios)
        details[f"slsqp_{name}_is_bound"] = _is_bound(times, ended)
        details[f"ratio_{name}_is_bound"] = _is_bound(ratios, ended)
        details[f"{name}_problems"], details[f"{name}_converged"] = len(peers), len(peers) - sum(ended)
    summary.update(
        floor_s=_median([p["floor"] for p in problems]), worst_violation=max(exceeding, default=0.0),
        objective_gap_p95=float(np.percentile(gaps[True], 95)) if gaps[True] else None,
        solved=sum(p["solved"] for p in problems), problems=len(problems))
    details.update(
        objective_gap_worst=max(gaps[True], default=None),
        objective_gap_of_ended=max(gaps[False], default=None), iterations=_median([p["iterations"] for p in problems]),
        excess={limit: max(p["excess"].get(limit, 0.0) for p in problems)
                for limit in dict.fromkeys(name for p in problems for name in p["excess"])},
        touching=sum(p["touching"] > 0 for p in problems),
        failures=[p["message"] for p in problems if not p["solved"]],
        **{name: _median([p[key] for p in problems if p.get(key) is not None]) for name, key in (
            ("first_feasible_s", "first"), ("first_feasible_share", "first_share"), ("halved_share", "halved_share"),
            ("halved_gain", "halved_gain"), ("full_share", "full_share"), ("full_gain", "full_gain"))},
        cancel_worst_s=max([p["cancel"] for p in problems if p["cancel"] is not None], default=None))
    return {name: summary[name] for name in SUMMARY}, details


def describe(where: str, summary: Figures, details: Figures) -> str:
    """Write one row of the table as a line.

    Args:
        where: Robot, task and number of way-points.
        summary: From `summarise`.
        details: Likewise.
    """
    parts = [f"{where}: median {summary['median_s']:.3f} s, p95 {summary['p95_s']:.3f} s (floor "
             f"{summary['floor_s']:.3f} s), solved {summary['solved']}/{summary['problems']}, worst violation "
             f"{summary['worst_violation']:.1e}, touching {details['touching']}"]
    if details["cancel_worst_s"] is not None:
        parts.append(f"canceled within {details['cancel_worst_s']:.3f} s")
    if details["first_feasible_s"] is not None:
        parts.append(f"first feasible {details['first_feasible_s']:.4f} s, {details['first_feasible_share']:.0%} of "
                     "all")
    if details["halved_share"] is not None:
        parts += [f"more starts {name} x{details[f'{name}_share']:.2f} of the time, objective "
                  f"{details[f'{name}_gain']:+.3%}" for name in ("halved", "full")]
    parts += [f"{solver} {details[f'{solver}_s']:.3f} s" for solver in SOLVERS if details[f"{solver}_s"] is not None]
    for name in ("exact", "fd"):
        if details[f"{name}_problems"]:
            times, ratio = ("> " * details[f"{what}_{name}_is_bound"] for what in ("slsqp", "ratio"))
            parts.append(f"SLSQP {name} {times}{summary[f'slsqp_{name}_s']:.1f} s (x {ratio}"
                         f"{summary[f'ratio_{name}']:.0f}, converged {details[f'{name}_converged']}/"
                         f"{details[f'{name}_problems']})")
    if summary["objective_gap_p95"] is not None:
        parts.append(f"gap p95 {summary['objective_gap_p95']:+.2%}, worst {details['objective_gap_worst']:+.2%}")
    if details["objective_gap_of_ended"] is not None:
        parts.append(f"gap to SLSQP where it was ended at worst {details['objective_gap_of_ended']:+.2%}")
    return ", ".join(parts)


def _is_bound(values: Sequence[float], ended: Sequence[bool]) -> bool:
    """Tell whether a median is only a lower bound: a value that was cut short is among the lower half or the middle."""
    middle = sorted(values)[len(values) // 2] if values else 0.0
    return any(cut and value <= middle for value, cut in zip(values, ended, strict=True))


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
