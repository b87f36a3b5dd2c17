"""How an experiment goes on: people per minute, and what the time went into."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence
from typing import Any

import pandas as pd

from unifeed_ros.experiments.experiment import FAILED, TIMES, Row

PARTS = ("train", "plan", "sample")
"""What times are told apart: training, planning, and sampling (of posteriors, of questions)."""
_PAUSE = 2.0
"""Shortest time between two sentences but the last [s]."""


class Progress:
    """Counts finished people and seconds.

    Attributes:
        line: The last sentence of progress.
    """

    def __init__(self, people: int, kept: int) -> None:
        """Begin.

        Args:
            people: How many are asked for.
            kept: How many of them were finished before.
        """
        self._people, self._kept, self._done, self._failed = people, kept, 0, 0
        self._began = time.perf_counter()
        self._said = -_PAUSE
        self._seconds = dict.fromkeys(PARTS, 0.0)
        self.line = f"{kept} of {people} people were finished before" if kept else f"{people} people to run"

    def count(self, rows: Sequence[Row]) -> str:
        """Count one finished person.

        Args:
            rows: Their rows.

        Returns:
            A sentence of progress; empty if the last one is fresh.
        """
        self._done += 1
        self._failed += any(row["status"] == FAILED for row in rows)
        for part in PARTS:
            self._seconds[part] += sum(row.get(TIMES + part, 0.0) for row in rows)
        seconds, left = time.perf_counter() - self._began, self._people - self._kept - self._done
        if left and seconds < self._said + _PAUSE:
            return ""
        self._said, rate = seconds, 60.0 * self._done / max(seconds, 1e-9)
        self.line = (f"{self._kept + self._done} of {self._people} people, {rate:.1f} people/min, "
                     f"{left / rate:.0f} min left; {self._shares()}; {self._failed} failed")
        return self.line

    def _shares(self) -> str:
        whole = sum(self._seconds.values())
        if not whole:
            return "no times measured"
        return ", ".join(f"{100.0 * value / whole:.0f} % {name}" for name, value in
                         zip(("training", "planning", "sampling"), self._seconds.values(), strict=True))

    def describe(self, rows: pd.DataFrame, command: str, jobs: int, cluster: str) -> dict[str, Any]:
        """Say how the run went, for the page.

        Args:
            rows: All rows, of earlier runs too.
            command: The command line.
            jobs: Processes at once.
            cluster: Address of the scheduler, if there was one.

        Returns:
            Figures by their names.
        """
        minutes = (time.perf_counter() - self._began) / 60.0
        sums = {part: float(rows[TIMES + part].sum()) if TIMES + part in rows else 0.0 for part in PARTS}
        whole = sum(sums.values())
        return {"command": command, "people of this run": self._done, "minutes": round(minutes, 2),
                "people/min": round(self._done / minutes, 2) if self._done else 0.0,
                **{f"{part} [%]": round(100.0 * value / whole, 1) if whole else 0.0 for part, value in sums.items()},
                "where": cluster or f"{jobs} processes of {os.cpu_count()} cores, {platform.machine()}",
                "load": round(os.getloadavg()[0], 1)}
