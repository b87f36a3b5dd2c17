"""Tunes RRIC for `multimodal` on other people: python -m unifeed_ros.experiments.multimodal_tuning.

What came out is in docs/methods.md, and the values chosen are the defaults of MultimodalConfig.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from unifeed_ros.experiments.experiment import RunSettings
from unifeed_ros.experiments.features import lesson_of
from unifeed_ros.experiments.multimodal import TASKS, MultimodalConfig, run_condition
from unifeed_ros.experiments.multimodal_findings import RRIC

PEOPLE = range(1000, 1004)
"""Numbers of the people that it is tuned on; those of the results begin at 0."""
SHOWN, RANKED = (5.0, 20.0, 50.0), (2.0, 5.0, 20.0)
"""Rationalities that are tried, of demonstrations and corrections, and of rankings."""


def tune(people: Sequence[int] = PEOPLE) -> list[tuple[float, str]]:
    """Measure every pair of rationalities.

    Args:
        people: Numbers of the people.

    Returns:
        Normalised regret after the last input, mean over tasks and people, of each pair, the best first.
    """
    settings, table = RunSettings(), []
    lessons = [(person, lesson_of(task, person, settings, "panda")) for task in TASKS for person in people]
    for shown, ranked in itertools.product(SHOWN, RANKED):
        base = MultimodalConfig()
        config = replace(base, rric=replace(base.rric, demonstration_rationality=shown, correction_rationality=shown,
                                            preference_rationality=ranked))
        regrets = [run_condition(RRIC, lesson, settings.rng(person, 20), config)[-1]["normalised_regret"]
                   for person, lesson in lessons]
        table.append((float(np.mean(regrets)), f"shown {shown:g}, ranked {ranked:g}"))
        print(*table[-1], file=sys.stderr, flush=True)
    return sorted(table)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        for line in tune():
            print(*line)
