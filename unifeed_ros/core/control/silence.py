"""How long nothing has come, as far as this process could see."""

from __future__ import annotations

PAUSE = 3.0
"""Gap between two looks, in periods, beyond which this process itself was not awake [1]."""


class Silence:
    """Time without news, counted in looks.

    A process that got no processor for a while has not looked either: what came meanwhile still waits to be taken. Such
    a gap counts as one period, so that a busy machine is not taken for a dead sender, and a dead one is still noticed.

    Args:
        period: Time between two looks while this process is awake [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
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
            gap = max(now - self._looked, 0.0)
            self._seconds += gap if gap <= PAUSE * self._period else self._period
        self._looked = now
        return self._seconds
