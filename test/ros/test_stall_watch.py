"""The watch that lets a test try again sees that processors were away, and does not see it otherwise."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from stall_watch import STALL, StallWatch


@pytest.fixture
def watch():
    watch = StallWatch()
    yield watch
    watch.close()


def test_a_stopped_watch_is_a_stall_from_then_on_until_the_next_test(watch):
    time.sleep(1.0)  # until its process has begun
    begun = time.monotonic()
    os.kill(watch.pid, signal.SIGSTOP)
    time.sleep(4 * STALL)
    os.kill(watch.pid, signal.SIGCONT)
    time.sleep(0.2)
    assert watch.stalled_since(begun)
    assert not watch.stalled_since(time.monotonic())


def test_its_process_ends_with_it(watch):
    watch.close()
    with pytest.raises(ProcessLookupError):
        os.kill(watch.pid, 0)
