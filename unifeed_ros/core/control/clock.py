"""Stamps beside the steady clock: a clock that was set, or a driver that began anew, is not taken for time."""

from __future__ import annotations


class ClockWatch:
    """Compare how far stamps and steady clock go from one message to the next.

    Stamps may fall behind (a busy or slow simulation), but never go back, and never run ahead of the steady clock by
    more than the largest step.

    Args:
        largest_step: Leap of the stamps against the steady clock that counts as a set clock [s].
    """

    def __init__(self, largest_step: float) -> None:
        self._largest_step = largest_step
        self._stamp: float | None = None
        self._steady = 0.0

    def fault_of(self, stamp: float, now: float) -> str | None:
        """Take in one message.

        Args:
            stamp: Its stamp [s].
            now: Steady time of its arrival [s].

        Returns:
            What is wrong, as a clause for a person; None if nothing is.
        """
        before, steady = self._stamp, self._steady
        self._stamp, self._steady = stamp, now
        if before is None:
            return None
        if stamp < before:
            return f"the stamps of the joint states went back by {before - stamp:.3f} s; check the clock and the driver"
        leap = stamp - before - (now - steady)
        if leap > self._largest_step:
            return f"the stamps of the joint states leapt ahead by {leap:.3f} s; check the driver's clock"
        return None
