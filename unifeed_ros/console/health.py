"""How the session is: one sentence a part, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from unifeed_ros.console.state import HealthLine

SILENT_S = 3.5
"""A node that said nothing for so long counts as gone: it speaks once a second [s]."""
FREE_MIB = 2000.0
"""Free disk space under which the page warns [MiB]."""
REMEDIES = {
    "shared_control": "Check the cable and the power of the arm, then press Back to start.",
    "capture": "Start the session again; what was taught is in the recording.",
    "reward_learner": 'Press "Discard the last" if it does not like an input; else start the session again.',
    "trajectory_optimizer": 'Press "Back to start"; if it stays, start the session again.',
    "session": "Start the session again.",
    "recorder": "Make room on the disk and start the session again: nothing new is recorded.",
    "sim_arm": "Close other programs: the machine is too slow for the simulated arm.",
    "sim_teacher": "Nothing: it is the simulated person.",
}


@dataclass(frozen=True, kw_only=True)
class Status:
    """What a node said last on /diagnostics."""

    level: int
    """0 well, 1 warning, 2 error, 3 stale."""
    message: str
    age: float
    """Time since it was said [s]."""
    values: Mapping[str, str] = field(default_factory=dict)


def health_lines(expected: Sequence[str], statuses: Mapping[str, Status], rates: Mapping[str, tuple[float, float]],
                 contact_age: float | None) -> tuple[HealthLine, ...]:
    """Judge every part.

    Args:
        expected: Nodes that should be there.
        statuses: What each said last.
        rates: Measured and nominal rate by topic [Hz].
        contact_age: Time since the newest contact message [s]; None before the first.

    Returns:
        One line a part, the nodes first.
    """
    lines = [_node(name, statuses.get(name)) for name in expected]
    lines += [_rate(topic, *pair) for topic, pair in rates.items()]
    lines.append(_contact(contact_age))
    recorder = statuses.get("recorder")
    if recorder is not None:
        lines.append(_disk(recorder.values))
    return tuple(lines)


def worst(lines: Sequence[HealthLine]) -> HealthLine | None:
    """Give the line that most needs a person; None when all is well."""
    bad = max(lines, key=lambda line: line.level, default=None)
    return bad if bad is not None and bad.level else None


def _node(name: str, status: Status | None) -> HealthLine:
    remedy = REMEDIES.get(name, "Start it again.")
    if status is None:
        return HealthLine(name=name, level=1, text="has not been heard of yet", remedy="Wait a moment; then: " + remedy)
    if status.age > SILENT_S:
        return HealthLine(name=name, level=2, text=f"has been silent for {status.age:.0f} s", remedy=remedy)
    level = min(status.level, 2)
    return HealthLine(name=name, level=level, text=status.message or "well", remedy=remedy if level else "")


def _rate(topic: str, measured: float, nominal: float) -> HealthLine:
    slow = measured < 0.5 * nominal
    remedy = "Close other programs, or look at the node that sends it." if slow else ""
    return HealthLine(name=topic, level=int(slow), text=f"{measured:.0f} of {nominal:.0f} messages a second",
                      remedy=remedy)


def _contact(age: float | None) -> HealthLine:
    silent = age is None or age > 1.0
    text = "feels no touch: no message" if silent else "feels the arm"
    remedy = "Check that the arm's driver sends external torques." if silent else ""
    return HealthLine(name="contact sensor", level=2 if silent else 0, text=text, remedy=remedy)


def _disk(values: Mapping[str, str]) -> HealthLine:
    free = float(values.get("free_mib", "nan"))
    low = not free >= FREE_MIB
    text = f"{free / 1024:.1f} GiB free, {int(values.get('messages', 0))} messages recorded"
    return HealthLine(name="disk", level=int(low), text=text, remedy="Make room on the disk." if low else "")
