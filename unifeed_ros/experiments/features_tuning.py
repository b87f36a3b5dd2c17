"""Tunes the methods of `features` on other people: python -m unifeed_ros.experiments.features_tuning METHOD.

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
from unifeed_ros.experiments.features import FEATURES, LearnedFeatures, MethodSettings, lesson_of, run_condition

PEOPLE = range(1000, 1003)
"""Numbers of the people that methods are tuned on; those of the results begin at 0."""
LAST = 5
"""Interactions at the end over which regret is averaged."""
TUNED_ON = {"Coactive": ("all known",), "FERL": ("one missing",), "Ours": ("all known", "one missing")}
"""Sets of features that each method is tuned on, those that it was made for; ours where its penalty matters."""
PENALTIES = (0.01, 0.03, 0.1)
"""Residual penalties of ours that are tried; sessions have the first."""


def candidates(method: str) -> Iterator[tuple[str, MethodSettings]]:
    """Give what is tried.

    Only the ratio of Coactive's gain and cap matters: weights of both scaled alike plan alike. Of ours is tried how
    much the networks may explain beside the known features.

    Args:
        method: Name of the method.

    Yields:
        What it is called, and the settings.
    """
    base = MethodSettings()
    if method == "Ours":
        for penalty in PENALTIES:
            yield f"residual penalty {penalty}", replace(base, ours=replace(base.ours, residual_penalty=penalty))
        return
    gains = (0.1, 0.3, 1.0, 3.0) if method == "Coactive" else (0.1, 1.0)
    for gain, update, reading in itertools.product(gains, ("all", "max"), ("motion", "push")):
        coactive = replace(base.coactive, gain=gain, update=update, reading=reading)
        yield (f"gain {gain}, {update}, {reading}",
               replace(base, coactive=coactive, ferl=replace(base.ferl, coactive=coactive)))


def tune(method: str, people: Sequence[int] = PEOPLE) -> list[tuple[float, str]]:
    """Measure every candidate of a method.

    Args:
        method: Name of the method, a word of TUNED_ON.
        people: Numbers of the people.

    Returns:
        Normalised regret over the last interactions, mean over tasks and people, of each candidate, the best first.
    """
    table, lessons = [], {}
    for task, person in itertools.product(FEATURES, people):
        lesson = lesson_of(task, person, RunSettings())
        lessons[task, person] = lesson, LearnedFeatures(task, lesson, MethodSettings().ferl)
    for name, methods in candidates(method):
        regrets = [row["normalised_regret"] for (task, _), (lesson, learned) in lessons.items()
                   for known in TUNED_ON[method]
                   for row in run_condition(task, known, method, lesson, learned, methods)[-LAST:]]
        table.append((float(np.mean(regrets)), name))
        print(*table[-1], file=sys.stderr, flush=True)
    return sorted(table)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        for line in tune(sys.argv[1]):
            print(*line)
