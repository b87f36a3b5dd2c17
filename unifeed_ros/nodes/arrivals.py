"""Inputs that a request names and that are still on their way: messages and requests travel apart."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from concurrent.futures import Future

PATIENCE_S = 1.0
"""Longest wait for inputs that were named [s]."""


class Arrivals:
    """Let requests wait for inputs until these have come, or for a second."""

    def __init__(self) -> None:
        self._expected: list[tuple[set[str], float, Future[None]]] = []

    def expect(self, ids: Iterable[str], known: Collection[str], now: float) -> Future[None]:
        """Wait for inputs.

        Args:
            ids: Their names.
            known: Names of those that have come.
            now: Steady time [s].

        Returns:
            Done when all have come, or have not come in time.
        """
        missing, arrival = set(ids).difference(known), Future[None]()
        if missing:
            self._expected.append((missing, now, arrival))
        else:
            arrival.set_result(None)
        return arrival

    def note(self, name: str, now: float) -> None:
        """Say that an input has come, or with an empty name only that time has passed.

        Args:
            name: Its name.
            now: Steady time [s].
        """
        for entry in tuple(self._expected):
            missing, since, arrival = entry
            missing.discard(name)
            if not missing or now - since > PATIENCE_S:
                self._expected.remove(entry)
                arrival.set_result(None)
