"""Let a process end with its parent, so that even kill -9 of the parent leaves nothing behind (Linux)."""

from __future__ import annotations

import ctypes

PR_SET_PDEATHSIG = 1
"""prctl's option for the signal that the kernel sends when the parent dies (linux/prctl.h)."""


def end_with_parent(number: int) -> None:
    """Ask Linux to send this process a signal when its parent dies.

    Args:
        number: Signal.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
