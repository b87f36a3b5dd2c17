"""Count lost messages from the sequence numbers that publishers give them."""

from __future__ import annotations

from collections.abc import Callable


class LossCounter:
    """Counts the gaps in one topic's sequence numbers.

    The middleware's own report of lost messages leaves out those that a full queue dropped; the numbers do not. A
    message does not say which publisher it is from, so the publishers' counters are kept as a set: each message
    carries on the counter just before it. Where publishers start or end while messages are being lost, a gap may be
    taken for a new publisher.
    """

    def __init__(self) -> None:
        """Start without any publisher."""
        self._last: list[int] = []
        self.lost = 0

    def note(self, sequence: int, publishers: Callable[[], int]) -> int:
        """Take one message's number.

        Args:
            sequence: Its sequence number; a publisher's first is 1.
            publishers: Tells how many publishers the topic has had so far; asked only when a number does not follow.

        Returns:
            Messages found lost by this one.
        """
        try:
            self._last[self._last.index(sequence - 1)] = sequence
            return 0
        except ValueError:
            pass
        earlier = [last for last in self._last if last < sequence]
        if sequence == 1 or not earlier or len(self._last) < publishers():
            self._last.append(sequence)
            return 0
        before = max(earlier)
        self._last[self._last.index(before)] = sequence
        missing = sequence - 1 - before
        self.lost += missing
        return missing
