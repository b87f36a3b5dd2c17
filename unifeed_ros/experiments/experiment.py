"""What an experiment is: people, conditions, a function that runs one person, and what is made of all their rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.experiments.analysis import Anova, PairedTest

if TYPE_CHECKING:  # processes that run people wait for neither pandas nor the statistics to load
    import pandas as pd

EXPERIMENTS: Mapping[str, str] = {
    name: f"unifeed_ros.experiments.{name}" for name in ("multimodal", "features", "preferences", "deformations")}
"""Module of each experiment, which holds it as EXPERIMENT; loaded only when it is asked for."""
KEYS = ("experiment", "task", "method", "person", "interaction")
"""Columns that every row has, and by which rows are sorted."""
TIMES = "seconds_"
"""Begins the names of columns that are measured times, which no two runs share: they are kept apart."""
OK, FAILED = "ok", "failed"
"""What `status` says of a row."""

Row: TypeAlias = dict[str, Any]
"""One interaction of one person in one condition. Given by `run_person`: task, method, interaction (the first is 1; 0:
before any), what was measured, and the processor's seconds_train, seconds_plan, seconds_sample [s]; status and message
where something failed. The experiment, the person and status "ok" are added."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What a person meets in an experiment: one task taught by one method."""

    task: str
    """Name of the task."""
    method: str
    """Name of the method, as the paper and the figures write it."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What a person's run depends on, besides the person."""

    seed: int = 0
    """Seed of the whole experiment; with the person's number it seeds everything that is random."""

    def rng(self, person: int, stream: int = 0) -> np.random.Generator:
        """Give a person's own source of randomness, the same on every machine and in every order of running.

        Args:
            person: Number of the person.
            stream: Number of the source, where one person needs several that do not disturb each other.

        Returns:
            The source.
        """
        return np.random.default_rng([self.seed, person, stream])


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What became of a hypothesis, the paper's words beside ours."""

    hypothesis: str
    """Its name in the paper, for example H8."""
    paper: str
    """What the paper says of it."""
    ours: str
    """What we found, in a sentence."""
    supported: bool | None
    """Whether it is supported; None: it cannot be said, of so few people or because something was not run."""
    tests: Sequence[PairedTest] = ()
    """The comparisons that decide it."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What all rows of an experiment come to; the same rows give the same summary."""

    people: int
    """People whose runs were complete, which statistics are of."""
    excluded: Sequence[int] = ()
    """People with a failed run."""
    findings: Sequence[Finding] = ()
    """The hypotheses."""
    anovas: Mapping[str, Anova] = field(default_factory=dict)
    """Analyses of variance by what they are of."""
    tables: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    """Further tables by their headings, rows of the same columns."""
    notes: Sequence[str] = ()
    """Sentences for the page: what was chosen where the paper leaves it open."""

    def to_mapping(self) -> dict[str, Any]:
        """Give it as what JSON can write."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One of the paper's comparisons."""

    name: str
    """Word of the command line."""
    title: str
    """Heading of its page."""
    source: str
    """Section or figure of the paper that it repeats."""
    people: int
    """People of a full run."""
    conditions: Sequence[Condition]
    """What every person meets; a person whose whole run fails is listed once in each."""
    run_person: Callable[[int, RunSettings], Sequence[Row]]
    """Runs one person through all conditions. A function of a module, so that other processes find it; the same
    arguments give the same rows. What it raises becomes a failed row in each condition."""
    analyse: Callable[[pd.DataFrame], Summary]
    """Makes the summary of all rows, failed ones too."""
    draw: Callable[[pd.DataFrame, Path], Sequence[Path]]
    """Draws the figures into a folder and gives their files."""


def find_experiment(name: str) -> Experiment:
    """Load an experiment.

    Args:
        name: Its word.

    Returns:
        The experiment.

    Raises:
        ConfigError: There is none of that name.
    """
    if name not in EXPERIMENTS:
        raise ConfigError("unknown experiment", expected=", ".join(EXPERIMENTS), got=name)
    experiment: Experiment = import_module(EXPERIMENTS[name]).EXPERIMENT
    return experiment


def person_rows(experiment: Experiment, person: int, rows: Sequence[Row]) -> list[Row]:
    """Complete the rows of a person.

    Args:
        experiment: The experiment.
        person: Number of the person.
        rows: What `run_person` gave.

    Returns:
        The rows with the keys and the status.
    """
    return [{"experiment": experiment.name, "person": person, "status": OK, "message": "", **row} for row in rows]


def failed_rows(experiment: Experiment, person: int, message: str) -> list[Row]:
    """List a person whose run failed, once in each condition.

    Args:
        experiment: The experiment.
        person: Number of the person.
        message: Why.

    Returns:
        One row a condition.
    """
    return [{"experiment": experiment.name, "person": person, "task": c.task, "method": c.method, "interaction": 0,
             "status": FAILED, "message": message} for c in experiment.conditions]


def complete_people(rows: pd.DataFrame) -> tuple[pd.DataFrame, list[int]]:
    """Leave out the people of whom any run failed: repeated measures compare the same people.

    Args:
        rows: All rows.

    Returns:
        Rows of the complete people, and the numbers of the others.
    """
    excluded = sorted(int(p) for p in rows.loc[rows["status"] != OK, "person"].unique())
    return rows[~rows["person"].isin(excluded)], excluded
