"""How the control loop runs: rates, periods, latencies, deadlines."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

KEPT = 30000
"""Periods and latencies that the percentiles are taken over: a minute at 500 Hz [1]."""


class LoopFigures:
    """Counts states and commands.

    Args:
        rate: Wanted rate of commands [Hz].
        late: Time between two commands that counts as a missed deadline [s].
    """

    def __init__(self, rate: float, late: float) -> None:
        self._period, self._late = 1.0 / rate, late
        self._periods: deque[float] = deque(maxlen=KEPT)
        self._latencies: deque[float] = deque(maxlen=KEPT)
        self._states = self._torques = self._commands = self._missed = 0
        self._last_command = self._came = 0.0
        self._last_look = time.monotonic()
        self._before = (0, 0)

    def state(self) -> float:
        """Take note of a joint state; gives the steady time of its arrival [s]."""
        self._states += 1
        self._came = time.monotonic()
        return self._came

    def torque(self) -> None:
        """Take note of an external torque."""
        self._torques += 1

    def command(self) -> None:
        """Take note of a command that has just gone out, in answer to the last state."""
        now = time.monotonic()
        self._latencies.append(now - self._came)
        if self._last_command > 0.0:
            self._periods.append(now - self._last_command)
            self._missed += now - self._last_command > self._late
        self._last_command = now
        self._commands += 1

    def pause(self) -> None:
        """Take note that no command is due."""
        self._last_command = 0.0

    def values(self) -> dict[str, object]:
        """Give the figures, by name with unit; rates of inputs since the last call."""
        now = time.monotonic()
        since, self._last_look = max(now - self._last_look, 1e-6), now
        states, torques = self._states - self._before[0], self._torques - self._before[1]
        self._before = (self._states, self._torques)
        periods = 1e3 * np.array(self._periods) if self._periods else np.array([np.nan])
        latencies = 1e3 * np.array(self._latencies) if self._latencies else np.array([np.nan])
        return {
            "rate_hz": f"{1e3 / np.mean(periods):.1f}",
            "states_hz": f"{states / since:.0f}",
            "torques_hz": f"{torques / since:.0f}",
            "commands": self._commands,
            "period_p50_ms": f"{np.percentile(periods, 50):.3f}",
            "period_p99_ms": f"{np.percentile(periods, 99):.3f}",
            "period_max_ms": f"{periods.max():.3f}",
            "period_error_p99_ms": f"{np.percentile(np.abs(periods - 1e3 * self._period), 99):.3f}",
            "worst_latency_ms": f"{latencies.max():.3f}",
            "missed_deadlines": self._missed,
        }
