"""When a contact began and let go, found again in a ring buffer of the moments before that was sure."""

from __future__ import annotations

from collections import deque

import numpy as np

from unifeed_ros.core.types import Array

FADING = 0.25
"""Time before a push is surely over in which it surely still was: the smoothed level of a strong one fades late [s]."""


class EdgeFinder:
    """Keep the last moments of a level, and find where it left and came back to what it was.

    An edge is where the level crosses a quarter of the way from the calm before (or after) it to the push.

    Args:
        span: Time that is kept [s].
        calm: Time over which the calm and the push are averaged [s].
    """

    def __init__(self, span: float = 0.5, calm: float = 0.1) -> None:
        self._span, self._calm = span, calm
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, time: float, level: float) -> None:
        """Add the next sample; one that comes after a gap of more than the span begins anew."""
        samples = self._samples
        if samples and time - samples[-1][0] > self._span:
            samples.clear()
        samples.append((time, level))
        while samples[0][0] < time - self._span:
            samples.popleft()

    def rise(self, sure: float) -> float:
        """Find when the level began to rise.

        Args:
            sure: When it was surely up [s]; the newest sample is of the push.

        Returns:
            Stamp of the first sample of the push, at most sure [s].
        """
        times, levels = self._arrays()
        calm = levels[times <= sure - self._calm]
        low = float(calm[-self._count(calm, times):].mean()) if len(calm) else 0.0
        edge = low + 0.25 * max(float(levels[-1]) - low, 0.0)
        before = np.flatnonzero((times <= sure) & (levels < edge))
        return float(times[before[-1] + 1]) if len(before) and before[-1] + 1 < len(times) else min(sure, times[0])

    def fall(self, onset: float, sure: float) -> float:
        """Find when the level had fallen.

        Args:
            onset: When the push began [s].
            sure: When it was surely down [s]; the newest sample is of the calm afterwards.

        Returns:
            Stamp of the last sample of the push, at most the newest one [s].
        """
        times, levels = self._arrays()
        low = float(levels[times > 0.5 * (sure + times[-1])].mean())
        push = levels[(times >= max(onset, sure - FADING)) & (times <= sure)]
        high = float(np.percentile(push, 90)) if len(push) else low
        above = np.flatnonzero(levels > low + 0.25 * max(high - low, 0.0))
        return float(times[above[-1]]) if len(above) and high > low else sure

    def _arrays(self) -> tuple[Array, Array]:
        times, levels = np.array(self._samples).T
        return times, levels

    def _count(self, part: Array, times: Array) -> int:
        """Give how many samples the calm time holds, at least one."""
        return max(1, round(self._calm / max(float(np.median(np.diff(times))), 1e-6))) if len(times) > 1 else len(part)
