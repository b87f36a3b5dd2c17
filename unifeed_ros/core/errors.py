"""Errors that say what was expected, what was there, and how to mend it."""

from __future__ import annotations


class UnifeedError(Exception):
    """Base of every error that this project raises on purpose.

    Args:
        what: What is wrong, as a clause without a full stop.
        expected: What would have been right, if that helps.
        got: What was there instead.
        mend: What the reader can do about it.
    """

    def __init__(self, what: str, *, expected: object = None, got: object = None, mend: str | None = None) -> None:
        self.what, self.expected, self.got, self.mend = what, expected, got, mend
        text = what
        if expected is not None:
            text += f": expected {expected}"
        if got is not None:
            text += f"{',' if expected is not None else ':'} got {got}"
        if mend:
            text += f"; {mend}"
        super().__init__(text)


class ConfigError(UnifeedError):
    """A setting, or a file of settings, that cannot be used."""


class ShapeError(UnifeedError):
    """An array of the wrong shape."""


class InputError(UnifeedError):
    """Data that cannot be used: not finite, out of order, of another robot."""


class UnreachableError(UnifeedError):
    """A pose that the arm cannot take."""


class PlanningError(UnifeedError):
    """No motion satisfies the constraints."""


class TrainingError(UnifeedError):
    """A training that gave no usable model."""


class RecordingError(UnifeedError):
    """A recording that cannot be written or read."""
