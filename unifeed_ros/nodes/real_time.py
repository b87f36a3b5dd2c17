"""Processor time when it is due: what the controller's process asks the system for, and what it got.

Only the controller asks for real-time priority. Where all that a session runs wants more than there is, the simulated
arm slows down and the rest goes on; with real-time priority it would not, and capture, learning and recording would
starve. Niceness is what the others differ by.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path

from unifeed_ros.core.errors import ConfigError

FASTER = -10
"""Niceness asked for where real-time scheduling is not permitted."""
LOCK_PRESENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4
"""Flags of mlockall(2)."""


@dataclass(frozen=True, kw_only=True)
class RealTimeConfig:
    """What the controller's process asks for; whatever is not permitted is left out."""

    priority: int = 20
    """Priority under SCHED_FIFO, 1 to 99; 0: scheduled like any other process."""
    lock_memory: bool = True
    """Whether pages in use stay in memory."""

    def __post_init__(self) -> None:
        """Reject priorities that the system does not have."""
        if not 0 <= self.priority <= 99:
            raise ConfigError("real-time priority", expected="0 to 99", got=self.priority)


def prefer_real_time(config: RealTimeConfig) -> str:
    """Ask for real-time scheduling and locked memory for all threads of this process.

    To be called when everything is set up: threads that begin later inherit from the one that begins them.

    Args:
        config: What to ask for.

    Returns:
        What was permitted, as a clause for a person.
    """
    if config.priority == 0:
        return "ordinary scheduling, as configured"
    scheduling = _schedule(config.priority)
    locked = config.lock_memory and _lock_memory()
    return scheduling + (", memory locked" if locked else "")


def calm_garbage_collector() -> None:
    """Let the garbage collector never look again at what exists now; to be called when everything is set up."""
    gc.collect()
    gc.freeze()


def set_niceness(niceness: int, leader: int | None = None) -> None:
    """Give up priority, or ask for more; what is not permitted is left out.

    Linux shares the processor between sessions first (autogroups), and niceness counts only within one: where a process
    leads a session of its own, as `unifeed up` starts nodes, that session gets the same niceness.

    Args:
        niceness: Niceness added, -20 to 19; positive: what this process computes never delays the control loop.
        leader: Process that leads the session if it is the project's own; by default this process.
    """
    with contextlib.suppress(OSError):
        os.nice(niceness)
        if os.getsid(0) == (leader or os.getpid()):
            Path("/proc/self/autogroup").write_text(str(niceness))


def _schedule(priority: int) -> str:
    threads = [int(task.name) for task in Path("/proc/self/task").iterdir()]
    try:
        for thread in threads:
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        try:
            for thread in threads:
                os.setpriority(os.PRIO_PROCESS, thread, FASTER)
        except PermissionError:
            return "ordinary scheduling: real-time priority is not permitted (rtprio in /etc/security/limits.conf)"
        return f"niceness {FASTER}"
    return f"SCHED_FIFO {priority}"


def _lock_memory() -> bool:
    flags = LOCK_PRESENT | LOCK_FUTURE | LOCK_ON_FAULT
    return ctypes.CDLL(None, use_errno=True).mlockall(flags) == 0
