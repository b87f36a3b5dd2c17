"""What a demo leaves behind: report.json, the paths over the task, regret over the interactions."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from unifeed_msgs.msg import Interaction
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording.reader import bag_info
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.nodes.conversions import trajectory_from_msg
from unifeed_ros.simulation.tasks import Yardstick, straight_line

KINDS = {1: "demonstration", 2: "correction", 3: "preference"}
INK, MUTED, BEST, FINAL = "#1a1a2e", "#8d99ae", "#1b7f4d", "#c8553d"


@dataclass(frozen=True, kw_only=True)
class Report:
    """Figures of one lesson; the JSON form is a contract (docs/report.md)."""

    robot: str
    """Name of the robot."""
    task: str
    """Name of the task."""
    seed: int
    """Seed of the lesson."""
    feedback: str
    """What was asked for, as letters."""
    ok: bool
    """True if every interaction was completed."""
    message: str
    """Why it ended."""
    interactions: list[dict[str, Any]]
    """One entry an interaction."""
    final: dict[str, float]
    """Regret of the last executed motion [reward], normalised [1], and the return of the optimum [reward]."""
    loop: dict[str, float]
    """Rate [Hz], 99th percentiles of period and latency [ms], late commands."""
    recording: dict[str, Any]
    """Bag, messages in it, messages lost."""

    def to_json(self) -> str:
        """Write as JSON; what is not known is null."""
        return json.dumps(_without_nan(asdict(self)), indent=2)


def build_report(yardstick: Yardstick, monitor: SessionMonitor, *, seed: int, ok: bool, message: str, bag: Path,
                 letters: str) -> Report:
    """Collect the figures of a lesson after its nodes have ended.

    Args:
        yardstick: Robot, true task, optimum and straight line.
        monitor: What was heard of the session.
        seed: Seed of the lesson.
        ok: Whether every interaction was completed.
        message: Why it ended.
        bag: Folder of the recording.
        letters: What was asked for.

    Returns:
        The report.
    """
    rows = [_interaction_row(yardstick, i) for i in monitor.interactions]
    last = rows[-1] if rows else {"regret": math.nan, "normalised_regret": math.nan}
    return Report(
        robot=yardstick.robot.config.name,
        task=yardstick.task.name,
        seed=seed,
        feedback=letters,
        ok=ok,
        message=message,
        interactions=rows,
        final={
            "regret": last["regret"],
            "normalised_regret": last["normalised_regret"],
            "optimal_return": yardstick.optimal_return,
            "straight_return": yardstick.straight_return,
        },
        loop={
            "rate_hz": monitor.figure("shared_control", "rate_hz"),
            "period_p99_ms": monitor.figure("shared_control", "period_p99_ms"),
            "latency_p99_ms": monitor.figure("sim_arm", "latency_p99_ms"),
            "missed_deadlines": monitor.figure("shared_control", "missed_deadlines"),
        },
        recording=_recording(bag, monitor),
    )


def save_report(report: Report, yardstick: Yardstick, monitor: SessionMonitor, out: Path) -> None:
    """Write report.json, paths.png and regret.png into a folder."""
    (out / "report.json").write_text(report.to_json() + "\n")
    names = yardstick.robot.joint_names
    executed = [trajectory_from_msg(i.executed, names) for i in monitor.interactions]
    draw_paths(yardstick, executed, out / "paths.png")
    draw_regret(report, out / "regret.png")


def draw_paths(yardstick: Yardstick, executed: list[Trajectory], path: Path) -> None:
    """Draw the tool's paths from the side and from above: optimal, straight, each interaction, final.

    Args:
        yardstick: Robot, task, optimum.
        executed: Motions after each interaction, as the arm carried them out.
        path: PNG to write.
    """
    figure, axes = plt.subplots(1, 2, figsize=(12, 5.2), constrained_layout=True)
    scene = yardstick.task.scene
    for axis, (first, second), title in (
        (axes[0], (1, 2), "seen from the front"),
        (axes[1], (0, 1), "seen from above"),
    ):
        _draw_scene(axis, yardstick, first, second)
        line = _tool(yardstick, straight_line(yardstick.robot, scene, 50))
        axis.plot(line[:, first], line[:, second], ":", color=MUTED, lw=1.5, label="straight line (before learning)")
        shades = plt.get_cmap("Oranges")(np.linspace(0.3, 0.75, max(1, len(executed) - 1)))
        for k, motion in enumerate(executed[:-1]):
            points = _tool(yardstick, motion)
            axis.plot(points[:, first], points[:, second], color=shades[k], lw=1.3,
                      label="after the first input" if k == 0 else f"after input {k + 1}")
        if executed:
            points = _tool(yardstick, executed[-1])
            axis.plot(points[:, first], points[:, second], color=FINAL, lw=2.8, label="final")
        best = _tool(yardstick, yardstick.optimum)
        axis.plot(best[:, first], best[:, second], "--", color=BEST, lw=2.2, label="optimal (what the person wants)")
        axis.set(title=title, xlabel=f"{'xyz'[first]} [m]", ylabel=f"{'xyz'[second]} [m]")
        axis.set_aspect("equal", adjustable="datalim")
        axis.grid(alpha=0.25)
    axes[1].legend(fontsize=8, loc="best", framealpha=0.9)
    figure.suptitle(
        f"{yardstick.robot.config.name}, task {yardstick.task.name}: path of the tool as the arm carried it out"
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_regret(report: Report, path: Path) -> None:
    """Draw regret after each interaction, with 0 the optimum and 1 not learning."""
    figure, axis = plt.subplots(figsize=(7, 4.2), constrained_layout=True)
    index = [row["index"] for row in report.interactions]
    axis.axhline(1.0, color=MUTED, ls=":", label="straight line: not learning")
    axis.axhline(0.0, color=BEST, ls="--", label="optimum")
    axis.plot(
        index, [row["normalised_regret"] for row in report.interactions], "o-", color=FINAL, lw=2, label="executed"
    )
    axis.plot(
        index,
        [row["planned_normalised_regret"] for row in report.interactions],
        "s",
        color=INK,
        ms=4,
        mfc="none",
        label="planned",
    )
    axis.set_xticks(index, [f"{row['index']}\n{row['kind']}" for row in report.interactions], fontsize=8)
    axis.set(xlabel="interaction", ylabel="normalised regret",
             title=f"{report.robot}, task {report.task}, seed {report.seed}")
    axis.grid(alpha=0.25)
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def describe(report: Report, out: Path) -> str:
    """Say in a few lines how the lesson went."""
    final = report.final
    lines = [
        f"{'ok' if report.ok else 'NOT ok'}: {report.message}",
        f"regret of the executed motion {final['regret']:.2f}, normalised {final['normalised_regret']:.3f} "
        "(0: the optimum, 1: not learning)",
        f"control loop {report.loop['rate_hz']:.0f} Hz, period p99 {report.loop['period_p99_ms']:.2f} ms, "
        f"latency p99 {report.loop['latency_p99_ms']:.2f} ms; recorded {report.recording['messages']} messages, "
        f"lost {report.recording['dropped']}",
        f"report.json, paths.png, regret.png and bag/ are in {out}",
    ]
    return "\n".join(lines)


def _interaction_row(yardstick: Yardstick, interaction: Interaction) -> dict[str, Any]:
    names = yardstick.robot.joint_names
    executed = trajectory_from_msg(interaction.executed, names)
    planned = trajectory_from_msg(interaction.planned, names)
    return {
        "index": int(interaction.index), "kind": KINDS[interaction.kind],
        "regret": yardstick.regret(executed), "normalised_regret": yardstick.normalised_regret(executed),
        "planned_regret": yardstick.regret(planned), "planned_normalised_regret": yardstick.normalised_regret(planned),
        "train_s": interaction.train_s, "plan_s": interaction.plan_s,
        "feedback_to_motion_s": interaction.feedback_to_motion_s, "touched": bool(interaction.touched),
    }


def _recording(bag: Path, monitor: SessionMonitor) -> dict[str, Any]:
    try:
        messages: int | None = bag_info(bag).message_count
    except RecordingError:
        messages = None
    return {"bag": bag.name, "messages": messages, "dropped": monitor.figure("recorder", "lost")}


def _tool(yardstick: Yardstick, motion: Trajectory) -> Array:
    return yardstick.robot.tool_states(motion.resampled(80))[:, :3]


def _draw_scene(axis: Axes, yardstick: Yardstick, first: int, second: int) -> None:
    scene = yardstick.task.scene
    if second == 2:
        axis.axhspan(scene.table_height - 0.04, scene.table_height, color="#d9c7a3", label="table")
    for name, position in scene.objects.items():
        axis.plot(position[first], position[second], "X", color=INK, ms=10)
        axis.annotate(name, (position[first], position[second]), textcoords="offset points", xytext=(8, 6), fontsize=8)
    axis.plot(scene.start[first], scene.start[second], "o", color=INK, ms=7)
    axis.annotate(
        "start", (scene.start[first], scene.start[second]), textcoords="offset points", xytext=(8, 4), fontsize=8
    )
    axis.plot(scene.goal[first], scene.goal[second], "*", color=BEST, ms=14)
    axis.annotate(
        "goal", (scene.goal[first], scene.goal[second]), textcoords="offset points", xytext=(8, 4), fontsize=8
    )


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
