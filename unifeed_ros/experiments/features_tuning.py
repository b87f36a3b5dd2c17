"""Tunes the methods of `features` on people who are not in its results: python -m unifeed_ros.experiments.features_tuning.

What came out is in docs/methods.md, and the values chosen are the defaults of MethodSettings.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from unifeed_ros.experiments.experiment import RunSettings
from unifeed_ros.experiments.features import FEATURES, KNOWN, LearnedFeatures, MethodSettings, lesson_of, run_condition

PEOPLE = range(1000, 1003)
"""Numbers of the people that methods are tuned on; those of the results begin at 0."""
LAST = 5
"""Interactions at the end over which regret is averaged."""


def candidates(method: str) -> Iterator[tuple[str, MethodSettings]]:
    """Give what is tried.

    Only the ratio of Coactive's gain and cap matters: weights of both scaled alike plan alike.

    Args:
        method: Name of the method.

    Yields:
        What it is called, and the settings.
    """
    base = MethodSettings()
    if method == "Ours":
        for penalty, comparisons in itertools.product((0.01, 0.03), (150, 50)):
            ours = replace(base.ours, residual_penalty=penalty, correction_comparisons=comparisons)
            yield f"residual_penalty {penalty}, correction_comparisons {comparisons}", replace(base, ours=ours)
        return
    readings = ("motion", "push") if method == "Coactive" else (base.ferl.coactive.reading,)
    for gain, update, reading in itertools.product((0.1, 0.3, 1.0, 3.0), ("all", "max"), readings):
        coactive = replace(base.coactive, gain=gain, update=update, reading=reading)
        yield (f"gain {gain}, {update}, {reading}",
               replace(base, coactive=coactive, ferl=replace(base.ferl, coactive=coactive)))


def tune(method: str, people: Sequence[int] = PEOPLE, known: Sequence[str] = tuple(KNOWN)) -> list[dict[str, object]]:
    """Measure every candidate of a method.

    Args:
        method: Name of the method.
        people: Numbers of the people.
        known: Sets of features, words of KNOWN.

    Returns:
        One row a candidate, the best first: normalised regret over the last interactions, mean over all cells, and by
        set of features.
    """
    table, lessons = [], {}
    for task, person in itertools.product(FEATURES, people):
        lesson = lesson_of(task, person, RunSettings())
        lessons[task, person] = lesson, LearnedFeatures(task, lesson, MethodSettings().ferl)
    for name, methods in candidates(method):
        regrets = {k: np.mean([[row["normalised_regret"] for row in run_condition(
            task, k, method, lesson, learned, methods)[-LAST:]]
            for (task, _), (lesson, learned) in lessons.items()]) for k in known}
        table.append({"settings": name, "mean": float(np.mean(list(regrets.values()))),
                      **{k: float(v) for k, v in regrets.items()}})
        print(table[-1], file=sys.stderr, flush=True)
    return sorted(table, key=lambda row: row["mean"])


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        for line in tune(sys.argv[1], known=sys.argv[2:] or tuple(KNOWN)):
            print(line)
