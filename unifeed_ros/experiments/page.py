"""The page of an experiment: the paper's sentences beside ours, tables, figures, and what failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from unifeed_ros.experiments.analysis import PairedTest
from unifeed_ros.experiments.experiment import OK, Experiment, Summary

_VERDICTS = {True: "supported", False: "not supported", None: "cannot be said"}


def write_page(folder: Path, experiment: Experiment, summary: Summary, rows: pd.DataFrame, figures: Sequence[Path],
               run: Mapping[str, Any]) -> Path:
    """Write index.md.

    Args:
        folder: Folder of the results.
        experiment: The experiment.
        summary: What its rows come to.
        rows: All rows.
        figures: Files of the figures, in the folder.
        run: How it was run, from `describe_run`.

    Returns:
        The page.
    """
    people, full = rows["person"].nunique(), experiment.people
    lines = [f"# {experiment.title}", "", f"Repeats the paper's {experiment.source}. Made by `{run['command']}`.", "",
             f"{people} of {full} people of a full run; statistics are of the {summary.people} whose runs were all "
             f"completed. Tests are two-sided at p < 0.05, corrected after Holm; intervals are 95 % bootstrap "
             f"intervals of the mean difference; g is Hedges' g for paired data."]
    if summary.findings:
        lines += ["", "## Hypotheses", "", "| | the paper | ours | verdict |", "| --- | --- | --- | --- |"]
        lines += [f"| {f.hypothesis} | {f.paper} | {f.ours} | {_VERDICTS[f.supported]} |" for f in summary.findings]
        for finding in summary.findings:
            if finding.tests:
                lines += ["", f"Tests of {finding.hypothesis}:", "", *tests_table(finding.tests)]
    if summary.anovas:
        lines += ["", "## Analyses of variance", "", "Repeated measures, corrected after Greenhouse and Geisser.", ""]
        lines += [f"- {what}: {anova}" for what, anova in summary.anovas.items()]
    for heading, table in summary.tables.items():
        lines += ["", f"## {heading}", "", *markdown_table(table)]
    lines += [line for figure in figures for line in ("", f"![{figure.stem}]({figure.relative_to(folder)})")]
    if summary.notes:
        lines += ["", "## Where the paper leaves it open", "", *(f"- {note}" for note in summary.notes)]
    lines += ["", "## Runs that failed", "", *_failures(rows), "", "## How long it took", "", *_times(run)]
    page = folder / "index.md"
    page.write_text("\n".join(lines) + "\n")
    return page


def tests_table(tests: Iterable[PairedTest]) -> list[str]:
    """Write paired tests as a Markdown table.

    Args:
        tests: The tests.

    Returns:
        Its lines.
    """
    return markdown_table([
        {"first less second": f"{t.first} less {t.second}", "mean difference": t.mean, "low": t.interval[0],
         "high": t.interval[1], f"t({t.people - 1})": t.statistic, "p": _p(t.p), "p (Wilcoxon)": _p(t.p_ranks),
         "g": t.effect_size} for t in tests])


def markdown_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Write rows of the same columns as a Markdown table.

    Args:
        rows: The rows.

    Returns:
        Its lines; none without rows.
    """
    if not rows:
        return []
    names = list(rows[0])
    return [f"| {' | '.join(names)} |", f"| {' | '.join('---' for _ in names)} |",
            *(f"| {' | '.join(_cell(row[name]) for name in names)} |" for row in rows)]


def _failures(rows: pd.DataFrame) -> list[str]:
    failed = rows[rows["status"] != OK]
    if failed.empty:
        return ["None."]
    return markdown_table([{"person": int(person), "task": task, "method": method, "interaction": int(interaction),
                            "message": str(message).replace("|", "/").replace("\n", " ")}
                           for person, task, method, interaction, message in failed[
                               ["person", "task", "method", "interaction", "message"]].itertuples(index=False)])


def _times(run: Mapping[str, Any]) -> list[str]:
    return markdown_table([{name: value for name, value in run.items() if name != "command"}])


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
