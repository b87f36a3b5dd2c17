"""The folder of an experiment: finished people one by one while it runs, then all rows as two Parquet files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow
import pyarrow.parquet

from unifeed_ros import __version__
from unifeed_ros.core.errors import ConfigError, RecordingError
from unifeed_ros.experiments.experiment import FAILED, KEYS, TIMES, Row, RunSettings

RESULTS, TIMINGS = "results.parquet", "timings.parquet"
SETTINGS = "settings.json"


class ResultFolder:
    """Keeps each person as soon as they are finished; a file is there whole or not at all.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: Path, experiment: str, settings: RunSettings, *, resume: bool) -> None:
        """Open a folder.

        Args:
            path: Where to write; made if it is not there.
            experiment: Name of the experiment.
            settings: Settings of the run.
            resume: Go on with what is there.

        Raises:
            ConfigError: It holds people already and is not to be gone on with, or it is of another experiment or seed.
        """
        self.path, self._people = path, path / "people"
        wanted = {"experiment": experiment, "version": __version__, **asdict(settings)}
        if self._people.exists() and any(self._people.glob("*.json")):
            if not resume:
                raise ConfigError(f"folder {path} holds results already", expected="an empty folder",
                                  mend="go on with them by --resume, or give another folder with --out")
            there = self._settings()
            if there != wanted:
                raise ConfigError(f"folder {path} is of another run", expected=wanted, got=there,
                                  mend="give another folder with --out")
        self._people.mkdir(parents=True, exist_ok=True)
        write_whole(path / SETTINGS, json.dumps(wanted, indent=2).encode())

    def _settings(self) -> Any:
        try:
            return json.loads((self.path / SETTINGS).read_text())
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self.path / SETTINGS} cannot be read", got=str(error),
                                 mend="give another folder with --out") from error

    def keep(self, person: int, rows: Sequence[Row]) -> None:
        """Write the rows of a finished person.

        Args:
            person: Number of the person.
            rows: Complete rows.
        """
        write_whole(self._file(person), json.dumps(list(rows)).encode())

    def finished(self, people: Sequence[int]) -> list[int]:
        """List the people who need not be run again: those who are here and did not fail as a whole.

        Args:
            people: Numbers of people.

        Returns:
            Those of them that are finished.
        """
        return [p for p in people if self._file(p).exists()
                and not all(row["status"] == FAILED and row["interaction"] == 0 for row in self._rows(p))]

    def collect(self, people: Sequence[int]) -> pd.DataFrame:
        """Read people, and write what was measured into one file and how long it took into another.

        Rows are sorted, so that the same people give the same bytes of results whoever ran them and when.

        Args:
            people: Numbers of the people.

        Returns:
            All rows.
        """
        rows = pd.DataFrame([row for person in people for row in self._rows(person)])
        rows = rows.sort_values(list(KEYS), kind="stable", ignore_index=True)
        times = [name for name in rows if name.startswith(TIMES)]
        results = rows[[*KEYS, *sorted(set(rows) - {*KEYS, *times})]]
        for name, part in ((RESULTS, results), (TIMINGS, rows[[*KEYS, *times]])):
            table = pyarrow.Table.from_pandas(part, preserve_index=False).replace_schema_metadata(None)
            partial = self.path / f".{name}"
            pyarrow.parquet.write_table(table, partial, compression="zstd")
            partial.replace(self.path / name)
        return rows

    def _rows(self, person: int) -> list[Row]:
        rows: list[Row] = json.loads(self._file(person).read_text())
        return rows

    def _file(self, person: int) -> Path:
        return self._people / f"{person:05d}.json"


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a crash leaves the old one or the new one, never a part.

    Args:
        path: The file.
        content: What to write.
    """
    partial = path.with_name(f".{path.name}")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
