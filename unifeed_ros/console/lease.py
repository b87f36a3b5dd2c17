"""Who of those who could teach has control: one page server or one terminal, as long as it says that it is there."""

from __future__ import annotations

LEASE_S = 3.0
"""Time after which one that has not been heard of loses control [s]."""
RENEW_S = 0.5
"""Time between two words of one that has control, or wants it when it is free [s]."""


class ControlLease:
    """Control of one lesson; times are any steady time [s]."""

    def __init__(self) -> None:
        self._holder, self._heard = "", 0.0

    def holder(self, now: float) -> str:
        """Give the name of the one in control; empty for nobody."""
        if now - self._heard >= LEASE_S:
            self._holder = ""
        return self._holder

    def keep(self, name: str, now: float) -> bool:
        """Take control if nobody else has it, or keep it; true if this one has it now."""
        if self.holder(now) in ("", name):
            self.take(name, now)
        return self._holder == name

    def take(self, name: str, now: float) -> None:
        """Take control, whoever has it."""
        self._holder, self._heard = name, now

    def release(self, name: str) -> None:
        """Give control back; without effect for one that does not have it."""
        if name == self._holder:
            self._holder = ""
