"""Watch whether the machine stalls: a process that wakes every 10 ms on every processor remembers when it woke late.

A simulated arm holds, rightly, when commands are missing for a tenth of a second. On a shared machine a processor can
be away for that long; a test that fails then has tested the machine.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time

PERIOD = 0.01
"""Time between two looks [s]."""
STALL = 0.05
"""How late a look is when the processor was away, and not merely busy [s]."""


class StallWatch:
    """Remember when a processor was last away; begins with the object and ends with `close`."""

    def __init__(self):
        context = multiprocessing.get_context("spawn")
        self._last = context.Array("d", len(os.sched_getaffinity(0)), lock=False)
        self._process = context.Process(target=_watch, args=(self._last, os.getpid()), daemon=True)
        self._process.start()
        self.pid = self._process.pid

    def stalled_since(self, time):
        """Say whether a processor was away at any moment after that time of time.monotonic() [s]."""
        return max(self._last) > time

    def close(self):
        """End the process."""
        self._process.kill()
        self._process.join()


def _watch(last, parent):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for place, processor in enumerate(sorted(os.sched_getaffinity(0))):
        threading.Thread(target=_watch_processor, args=(last, place, processor), daemon=True).start()
    while os.getppid() == parent:
        time.sleep(1.0)


def _watch_processor(last, place, processor):
    with contextlib.suppress(OSError):  # a processor that is not ours: watch from wherever this thread runs
        os.sched_setaffinity(0, {processor})
    while True:
        planned = time.monotonic() + PERIOD
        time.sleep(PERIOD)
        woke = time.monotonic()
        if woke - planned > STALL:
            last[place] = woke
