"""Tunes the policies of `multimodal` on other people: python -m unifeed_ros.experiments.policies_tuning METHOD.

What came out is in docs/methods.md, and the values chosen are the defaults of `baselines/policies.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from unifeed_ros.baselines.policies import AdversarialConfig, AtariConfig, CloningConfig, PolicyConfig, Worker
from unifeed_ros.core.errors import TrainingError
from unifeed_ros.experiments.experiment import FAILED, RunSettings
from unifeed_ros.experiments.features import lesson_of
from unifeed_ros.experiments.multimodal import TASKS, MultimodalConfig, run_policy

PEOPLE = range(1000, 1002)
"""Numbers of the people that they are tuned on; those of the results begin at 0."""
TRIED: Mapping[str, Sequence[PolicyConfig]] = {
    "BC": [CloningConfig(epochs=300, batches=10), CloningConfig()],
    "AIRL": [AdversarialConfig(rounds=10), AdversarialConfig(rounds=10, discriminator_epochs=2, learning_rate=3e-4),
             AdversarialConfig(rounds=30), AdversarialConfig(rounds=30, clone=0, log_std=-1.0)],
    "Atari": [AtariConfig(learning_rate=1e-3), AtariConfig(), AtariConfig(automatic=0), AtariConfig(steps=4000)],
}
"""What is tried of each method."""


def tune(method: str, people: Sequence[int] = PEOPLE) -> list[tuple[float, str]]:
    """Measure everything that is tried of a method.

    Args:
        method: "BC", "AIRL" or "Atari".
        people: Numbers of the people.

    Returns:
        Normalised regret after the last input, mean over tasks and people, of each, the best first.

    Raises:
        TrainingError: A policy could not be trained.
    """
    lessons = [lesson_of(task, person, RunSettings(), "panda") for task in TASKS for person in people]
    base, table = MultimodalConfig(), []
    with Worker() as worker:
        for tried in TRIED[method]:
            config = replace(base, policies={**base.policies, method: tried})
            last = [run_policy(method, lesson, worker, config)[-1] for lesson in lessons]
            if failed := [row["message"] for row in last if row.get("status") == FAILED]:
                raise TrainingError(f"tuning of {method}", got=failed[0])
            table.append((float(np.mean([row["normalised_regret"] for row in last])), str(tried)))
            print(*table[-1], file=sys.stderr, flush=True)
    return sorted(table)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        for line in tune(sys.argv[1]):
            print(*line)
