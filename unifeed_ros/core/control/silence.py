"""How long nothing has come, as far as this process could see."""

from __future__ import annotations


class Silence:
    """Time without news, counted in looks.

    A process that got no processor for a while has not looked either: what came meanwhile still waits to be taken. Of
    such a gap between two looks only `longest_gap` counts, so that a busy machine is not taken for a dead sender.

    Args:
        longest_gap: Longest time between two looks that counts in full [s].
    """

    def __init__(self, longest_gap: float) -> None:
        self._longest_gap = longest_gap
        self._looked: float | None = None
        self._seconds = 0.0

    def end(self) -> None:
        """Take note that something has come."""
        self._seconds = 0.0

    def look(self, now: float) -> float:
        """Look again.

        Args:
            now: Steady time [s]; of two looks the second has the later one.

        Returns:
            Time since the last news in which this process was awake [s].
        """
        if self._looked is not None:
            self._seconds += min(max(now - self._looked, 0.0), self._longest_gap)
        self._looked = now
        return self._seconds
