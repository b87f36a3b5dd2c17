"""What the arm does and who has control, as numbers that the message TeachingState uses too."""

from __future__ import annotations

from enum import IntEnum


class TeachingMode(IntEnum):
    """What the shared controller does."""

    INACTIVE = 0
    """No command goes out."""
    HOLD = 1
    """The arm holds a posture and yields to force."""
    GUIDE = 2
    """The arm is weightless: a person guides it."""
    TRACK = 3
    """The arm follows a motion and yields to force."""
    STOPPED = 4
    """Stopped, until somebody chooses another mode."""


class Control(IntEnum):
    """Who leads the arm."""

    ROBOT = 1
    """The robot leads."""
    PERSON = 2
    """A person leads."""
    NOBODY = 3
    """Nobody leads."""
