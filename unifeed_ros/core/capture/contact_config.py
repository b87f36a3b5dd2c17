"""Settings of the contact detector, and the kinds of contact that it tells apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

from unifeed_ros.core.capture.untouched import UntouchedConfig
from unifeed_ros.core.errors import ConfigError


class ContactKind(IntEnum):
    """What a contact is, as numbers that the message Contact uses too."""

    NONE = 0
    """No touch."""
    TOUCH = 1
    """A touch that is meant."""
    COLLISION = 2
    """Short and hard: never learned from."""


@dataclass(frozen=True, kw_only=True)
class ContactConfig:
    """Settings of the contact detector."""

    startup: float = 0.3
    """Time at the start over which the bias is the median; no contact is reported before its end [s]."""
    share: float = 0.4
    """Part of the robot's contact thresholds that begins a contact, all joints together [1]."""
    smooth_time: float = 0.03
    """Time constant of the filter on the torque that is judged [s]."""
    release_level: float = 0.6
    """Level below which a contact ends; contacts begin above 1 [1]."""
    on_delay: float = 0.02
    """Time that the level must stay above 1 before a contact begins [s]."""
    off_delay: float = 0.1
    """Time that the level must stay below the release level before a contact ends [s]."""
    fade: float = 0.15
    """Part of its own highest level below which a contact counts as below the release level too [1]."""
    faint_time: float = 0.6
    """Time after which a contact ends too whose level stays below 1: what is left then is the sensor's [s]."""
    moving_allowance: float = 0.5
    """Rise of all thresholds while the arm moves, as a part of them: friction is known less well then [1]."""
    moving_speed: float = 0.1
    """Speed of the fastest joint at which the whole moving allowance holds [rad/s]."""
    moving_memory: float = 0.3
    """Time constant with which the moving allowance fades after a motion [s]."""
    doubt_factor: float = 1.5
    """How much of what the model of the untouched arm does not know yet is added to the thresholds [1]."""
    steady_time: float = 6.0
    """A contact whose torque stays the same for so long is a shifted bias; it ends and the bias is set anew [s]."""
    steady_band: float = 0.5
    """Part of a threshold within which a torque counts as the same [1]."""
    collision_rate: float = 300.0
    """Rise of the level above which a contact begins as a collision [1/s]."""
    collision_time: float = 0.25
    """A collision that still presses after this time becomes a touch [s]."""
    link_level: float = 0.8
    """Part of a threshold that a joint must feel for its link to count as touched [1]."""
    gap: float = 0.5
    """Longest step between samples that delays are counted across; stamps that go back by more begin anew [s]."""
    untouched: UntouchedConfig = field(default_factory=UntouchedConfig)
    """What an untouched arm shows, and how fast it is learned."""

    def __post_init__(self) -> None:
        """Reject settings that would make the detector silent or stuck."""
        for name in ("startup", "share", "moving_speed", "moving_memory", "steady_time", "steady_band",
                     "faint_time", "collision_rate", "link_level", "gap"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        for name in ("smooth_time", "fade", "on_delay", "off_delay", "moving_allowance", "doubt_factor",
                     "collision_time"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(name, expected=">= 0 and finite", got=getattr(self, name))
        if not 0.0 < self.release_level <= 1.0:
            raise ConfigError("release_level", expected="above 0, at most 1", got=self.release_level)
