"""A figure of one thing that was taught: joints over time, and the path of the tool."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Trajectory

SAMPLES = 80
STYLES = ("-", "--", ":", "-.")


def draw_item(robot: RobotModel, item: FeedbackItem, path: Path) -> None:
    """Draw a demonstration, a correction beside what was planned, or the options of a preference with their ranks.

    Args:
        robot: The arm.
        item: What was taught.
        path: PNG to write.
    """
    figure, (joints, front, above) = plt.subplots(1, 3, figsize=(15, 4.6), constrained_layout=True)
    for (label, motion), style in zip(_motions(item), STYLES * 4, strict=False):
        joints.set_prop_cycle(None)
        times = motion.times - motion.times[0]
        for name, column in zip(motion.joint_names, motion.positions.T, strict=True):
            joints.plot(times, column, style, lw=1.3, label=name if style == "-" else None)
        tool = robot.tool_states(motion.resampled(SAMPLES))
        for axis, first, second in ((front, 1, 2), (above, 0, 1)):
            axis.plot(tool[:, first], tool[:, second], style, lw=2, label=label)
            axis.plot(tool[0, first], tool[0, second], "o", color="black", ms=5)
    joints.set(xlabel="time [s]", ylabel="joint position [rad]", title="joints")
    for axis, first, second, title in ((front, 1, 2, "tool from the front"), (above, 0, 1, "tool from above")):
        goal = item.context.goal
        axis.plot(goal[first], goal[second], "*", color="#1b7f4d", ms=14)
        for name, place in item.context.objects.items():
            axis.plot(place[first], place[second], "X", color="#1a1a2e", ms=9)
            axis.annotate(name, (place[first], place[second]), textcoords="offset points", xytext=(8, 6), fontsize=8)
        axis.set(xlabel=f"{'xyz'[first]} [m]", ylabel=f"{'xyz'[second]} [m]", title=title)
        axis.set_aspect("equal", adjustable="datalim")
    for axis in (joints, front, above):
        axis.grid(alpha=0.25)
    joints.legend(fontsize=7)
    above.legend(fontsize=8)
    figure.suptitle(f"{item.robot}, task {item.context.task or 'unknown'}: {item.kind} {item.id}")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _motions(item: FeedbackItem) -> list[tuple[str, Trajectory]]:
    if isinstance(item, Demonstration):
        return [("shown", item.trajectory)]
    if isinstance(item, Correction):
        return [("corrected", item.corrected), ("planned", item.planned)]
    ranks = item.ranks or ("neither",) * len(item.options)
    return [(f"option {chr(ord('A') + k)}, rank {rank}", option)
            for k, (option, rank) in enumerate(zip(item.options, ranks, strict=True))]
