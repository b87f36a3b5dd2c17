"""A growing record of joint positions that already holds the moments before it was started."""

from __future__ import annotations

from collections import deque

import numpy as np

from unifeed_ros.core.types import Array


class JointRecord:
    """Record joint positions over time.

    While it does not run it keeps the last moments (the pre-roll), so that what happened just before the start is not
    lost. Samples that come faster than the rate, or whose stamp is not later than the last, are left out.

    Args:
        pre_roll: Time kept from before the start [s].
        rate: Largest rate of the samples kept [Hz].
        longest: Time after which a running record takes no more [s].
    """

    def __init__(self, *, pre_roll: float, rate: float, longest: float) -> None:
        self._pre_roll, self._step, self._longest = pre_roll, 1.0 / rate - 1e-9, longest
        self._samples: deque[tuple[float, Array]] = deque()
        self._started: float | None = None
        self._running = False
        self.full = False
        """True if a running record reached its longest time and left samples out."""

    @property
    def running(self) -> bool:
        """True between start and stop."""
        return self._running

    def append(self, time: float, positions: Array) -> None:
        """Add a sample.

        Args:
            time: Stamp [s].
            positions: Joint positions, shape (n,) [rad]; kept, not copied: the caller must not write to it later.
        """
        if self._samples and time - self._samples[-1][0] < self._step:
            return
        if not self._running:
            self._samples.append((time, positions))
            while time - self._samples[0][0] > self._pre_roll:
                self._samples.popleft()
            return
        if self._started is None:
            self._started = time
        if time - self._started > self._longest:
            self.full = True
            return
        self._samples.append((time, positions))

    def start(self) -> None:
        """Keep every sample from now on, and those of the pre-roll."""
        self._running, self._started, self.full = True, None, False

    def so_far(self) -> tuple[Array, Array]:
        """Give the record.

        Returns:
            Stamps, shape (N,) [s], and joint positions, shape (N, n) [rad]; N may be 0.
        """
        times = np.array([time for time, _ in self._samples])
        positions = np.array([positions for _, positions in self._samples]) if self._samples else np.empty((0, 0))
        return times, positions

    def stop(self) -> tuple[Array, Array]:
        """End the record and forget it.

        Returns:
            As so_far.
        """
        record = self.so_far()
        self.clear()
        return record

    def clear(self) -> None:
        """Forget everything, the pre-roll too, and do not run."""
        self._samples.clear()
        self._running = False
