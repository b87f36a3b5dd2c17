"""Hold capture against recordings of real arms and real people, and print what it found in them.

Reads the recordings from ../shared/data beside the repository, or the excerpts in test/data/recordings where those are
all there is, and leaves out what is missing. Run: python benchmarks/capture_recordings.py [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.contact_config import ContactConfig
from unifeed_ros.core.capture.demonstration import DemonstrationConfig, extract_demonstration
from unifeed_ros.core.capture.motion import MotionConfig, moving_segments, ordered_samples
from unifeed_ros.core.capture.touches import Touch, inside_any, judge_recording
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.types import Array

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (ROOT.parent / "shared" / "data", ROOT / "test" / "data" / "recordings")

PANDA_THRESHOLDS = (3.0, 3.0, 3.0, 2.5, 1.5, 1.5, 1.0)
"""Those of config/robots/panda.yaml, by joint [Nm]."""
JACO_THRESHOLDS = (8.0, 8.0, 8.0, 2.0, 1.0, 1.0, 1.0)
"""Thresholds that the JACO2 study itself used, by joint [Nm]; set for a moving arm."""
WRENCH_THRESHOLDS = (5.0, 5.0, 5.0, 1.0, 1.0, 1.0)
"""Touch on a wrist sensor: force [N], torque [Nm]."""
TAIL = 0.3
"""Time after a label in which torque is still fading [s]."""
PRESSES = ("a4", "a5", "b6", "b8", "c2", "c3", "c6", "d3", "f2", "f3", "f4")
FREE = ("run_162545", "run_162853")
LILA = ("il_pick-banana", "il_pick-cereal", "il_pour-cereal", "lila_pick-banana", "lila_pour-cereal")
JACO_CONFIG = ContactConfig(moving_allowance=0.0, share=1.0, doubt_factor=0.0)
WRENCH_CONFIG = {"share": 1.0}


@dataclass(frozen=True)
class PressFigures:
    """Labelled presses against touches found."""

    presses: int
    found: int
    touches: int
    false_touches: int
    true_rate: float
    false_rate: float
    false_rate_beyond_tail: float
    median_delay_s: float


def find(folder: str, name: str) -> Path | None:
    """Find a recording: the whole one, else its excerpt, else None."""
    return next((root / folder / name for root in FOLDERS if (root / folder / name).exists()), None)


def press_figures(data: Mapping[str, Any], thresholds: tuple[float, ...] = PANDA_THRESHOLDS) -> PressFigures:
    """Compare touches with the labels of a glove."""
    times, label = data["t"] - data["t"][0], data["label"].astype(bool)
    _, touches = judge_recording(ContactDetector(thresholds), times, data["tau_ext"], data["dq"])
    found = inside_any(times, touches)
    edges = np.diff(np.concatenate([[0], label.astype(int), [0]]))
    presses = list(zip(times[np.flatnonzero(edges == 1)], times[np.flatnonzero(edges == -1) - 1], strict=True))

    def meets(touch: Touch, press: tuple[float, float]) -> bool:
        return touch.onset < press[1] + 0.1 and touch.end > press[0]

    first = [next((t for t in touches if meets(t, press)), None) for press in presses]
    delays = [t.onset - p[0] for t, p in zip(first, presses, strict=True) if t is not None]
    fading = inside_any(times, [Touch(onset=end, end=end + TAIL, meant=True) for _, end in presses])
    free = ~label
    return PressFigures(
        presses=len(presses), found=len(delays), touches=len(touches),
        false_touches=sum(not any(meets(t, p) for p in presses) for t in touches),
        true_rate=float(found[label].mean()), false_rate=float(found[free].mean()),
        false_rate_beyond_tail=float(found[free & ~fading].mean()),
        median_delay_s=float(np.median(delays)) if delays else float("nan"))


def free_figures(data: Mapping[str, Any], thresholds: tuple[float, ...] = PANDA_THRESHOLDS) -> tuple[int, float, float]:
    """Give touches, highest level, and highest level without moving allowance, of an arm that nobody touches."""
    times = (data["t_ns"] - data["t_ns"][0]) * 1e-9
    samples, touches = judge_recording(ContactDetector(thresholds), times, data["tau_ext"], data["dq"])
    still = ContactDetector(thresholds, ContactConfig(moving_allowance=0.0))
    fixed, _ = judge_recording(still, times, data["tau_ext"], data["dq"])
    return len(touches), max(s.level for s in samples), max(s.level for s in fixed)


def guided_figures(times: Array, positions: Array) -> dict[str, float]:
    """Say what becomes of one guided run: durations [s], pauses, and the part of the joints' travel that is covered."""
    times, positions = ordered_samples(times, positions)
    segments = moving_segments(times, positions, MotionConfig())
    names = [str(k) for k in range(positions.shape[1])]
    whole = extract_demonstration(times, positions, names, DemonstrationConfig(longest_pause=np.inf))
    short = extract_demonstration(times, positions, names)
    first, last = segments[0][0], segments[-1][1]
    ends = np.abs(positions[[0, -1]] - short.positions[[0, -1]]).max()
    travel = np.abs(np.diff(positions, axis=0)).sum(axis=1)
    return {"recorded_s": float(times[-1] - times[0]), "from_first_to_last_motion_s": whole.duration,
            "demonstration_s": short.duration, "pauses": len(segments) - 1,
            "travel_covered": float(travel[first:last].sum() / travel.sum()), "end_moved_rad": float(ends)}


def jaco_torque(data: Mapping[str, Any], trial: str) -> tuple[Array, Array, Array]:
    """Put the logged torques of a trial onto its joint clock; zero where nothing was logged."""
    times, positions = data[f"{trial}/t"].astype(float), np.unwrap(data[f"{trial}/q"].astype(float), axis=0)
    torque = np.zeros_like(positions)
    for stamp, row in zip(data[f"{trial}/tau_t"], data[f"{trial}/tau_h"], strict=True):
        torque[np.argmin(np.abs(times - stamp))] = row
    return times, torque, np.gradient(positions, times, axis=0)


def jaco_touches(data: Mapping[str, Any], trial: str) -> tuple[Array, Array, tuple[Touch, ...]]:
    """Find the pushes of one trial: stamps [s], torques [Nm], touches."""
    times, torque, velocities = jaco_torque(data, trial)
    return times, torque, judge_recording(ContactDetector(JACO_THRESHOLDS, JACO_CONFIG), times, torque, velocities)[1]


def read_bag(path: Path, topic: str) -> Iterator[tuple[float, Any]]:
    """Read messages of a topic from a ROS 1 or ROS 2 bag: time of receipt [s], message."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        for connection, stamp, raw in reader.messages(connections):
            yield stamp * 1e-9, reader.deserialize(raw, connection.msgtype)


def read_wrench(path: Path) -> tuple[Array, Array]:
    """Read a bag's wrenches: time since the first [s] by header stamp, force and torque (N, 6) [N, Nm]."""
    messages = [message for _, message in read_bag(path, "/wrench")]
    stamps = np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in messages])
    wrench = [[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z,
               m.wrench.torque.x, m.wrench.torque.y, m.wrench.torque.z] for m in messages]
    return stamps - stamps[0], np.array(wrench)


def wrench_touches(times: Array, wrench: Array, **settings: float) -> tuple[Touch, ...]:
    """Find the touches on a wrist sensor of an arm at rest."""
    detector = ContactDetector(WRENCH_THRESHOLDS, ContactConfig(**{**WRENCH_CONFIG, **settings}))
    return judge_recording(detector, times, wrench, np.zeros_like(wrench))[1]


def _each(folder: str, names: tuple[str, ...]) -> Iterator[tuple[str, dict[str, Any]]]:
    for name in names:
        path = find(folder, f"{name}.npz")
        if path is not None:
            with np.load(path) as file:
                yield name, dict(file)


def _presses(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name, data in _each("panda_push_labels_mindlab", PRESSES):
        rows[name] = asdict(press_figures(data))
        draw(name, data["t"] - data["t"][0], data["tau_ext"], PANDA_THRESHOLDS, data["dq"], label=data["label"])
    return rows


def _free(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name, data in _each("fr3_follower_1khz", FREE):
        touches, level, fixed = free_figures(data)
        rows[name] = {"touches": touches, "highest_level": level, "highest_level_without_allowance": fixed}
        draw(name, (data["t_ns"] - data["t_ns"][0]) * 1e-9, data["tau_ext"], PANDA_THRESHOLDS, data["dq"])
    return rows


def _guided(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name, data in _each("panda_kinesthetic_lila", LILA):
        runs = [data["demo_id"] == k for k in np.unique(data["demo_id"])]
        figures = [guided_figures(data["t"][run], data["q"][run]) for run in runs]
        rows[name] = {"runs": len(runs), **_summary(figures)}
        draw(name, data["t"][runs[0]], data["q"][runs[0]])
    return rows


def _users(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name, data in _each("panda_kinesthetic_users_hapticskin", tuple(f"user_{k:02d}" for k in range(1, 14))):
        conditions = sorted({key.split("/")[0] for key in data})
        figures = [guided_figures(data[f"{c}/t"], data[f"{c}/q"]) for c in conditions]
        rows[name] = {"runs": len(conditions), **_summary(figures)}
        draw(name, data[f"{conditions[0]}/t"], data[f"{conditions[0]}/q"])
    return rows


def _summary(figures: list[dict[str, float]]) -> dict[str, float]:
    worst = {"travel_covered": min, "end_moved_rad": max}
    return {key: float(worst.get(key, np.median)([f[key] for f in figures])) for key in figures[0]}


def _jaco(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name, data in _each("jaco2_corrections_iact__nolicence", tuple(f"P{k}" for k in range(10))):
        trials = sorted({key.rsplit("/", 1)[0] for key in data})
        touched = {trial: jaco_touches(data, trial) for trial in trials}
        pushed = [t for t in trials if len(data[f"{t}/tau_t"]) > 5]
        lengths = [touch.end - touch.onset for _, _, touches in touched.values() for touch in touches]
        logged = [inside_any(data[f"{t}/tau_t"], touched[t][2]).mean() for t in pushed]
        rows[name] = {"trials": len(trials), "with_push_logged": len(pushed),
                      "with_touch_found": sum(bool(touched[t][2]) for t in pushed),
                      "logged_samples_inside": float(np.mean(logged)), "touches": len(lengths),
                      "median_length_s": float(np.median(lengths)), "longest_s": float(max(lengths))}
        times, torque, velocities = jaco_torque(data, trials[0])
        draw(f"{name} {trials[0]}", times, torque, JACO_THRESHOLDS, velocities, config=JACO_CONFIG)
    return rows


def _wrench(draw: Callable[..., None]) -> dict[str, Any]:
    rows = {}
    for name in ("wrench_pushes", "wrench_twist"):
        path = find("ur10e_wrench_bags__nolicence", f"{name}_ros2")
        if path is None:
            continue
        times, wrench = read_wrench(path)
        for label, settings in (("", {}), (" taps too", {"on_delay": 0.002, "smooth_time": 0.002})):
            touches = wrench_touches(times, wrench, **settings)
            rows[name + label] = {"touches": [round(t.onset, 2) for t in touches if t.meant],
                                  "collisions": [round(t.onset, 2) for t in touches if not t.meant]}
        draw(name, times, wrench, WRENCH_THRESHOLDS, np.zeros_like(wrench))
    return rows


DATA_SETS: dict[str, Callable[[Callable[..., None]], dict[str, Any]]] = {
    "panda_push_labels_mindlab": _presses, "fr3_follower_1khz": _free, "panda_kinesthetic_lila": _guided,
    "panda_kinesthetic_users_hapticskin": _users, "jaco2_corrections_iact__nolicence": _jaco,
    "ur10e_wrench_bags__nolicence": _wrench}


class Figures:
    """Draw one panel a recording, and save them as one picture a data set."""

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._panels = folder, []

    def __call__(self, name: str, times: Array, values: Array, thresholds: tuple[float, ...] = (),
                 velocities: Array | None = None, label: Array | None = None,
                 config: ContactConfig | None = None) -> None:
        """Remember a panel: torque with touches where thresholds are given, else positions with motion."""
        if self._folder is not None:
            self._panels.append((name, times, values, thresholds, velocities, label, config))

    def save(self, data_set: str) -> None:
        """Save the panels so far as DATA_SET.png and forget them."""
        if self._folder is not None:
            self.save_as(self._folder / f"capture_{data_set}.png")

    def save_as(self, path: Path) -> None:
        """Save the panels so far as one picture and forget them."""
        panels, self._panels = self._panels, []
        if not panels:
            return
        from matplotlib.figure import Figure

        figure = Figure(figsize=(12, 2.2 * len(panels)), layout="constrained")
        for axes, panel in zip(np.ravel(figure.subplots(len(panels), squeeze=False)), panels, strict=True):
            _panel(axes, *panel)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=70)


def _panel(axes: Any, name: str, times: Array, values: Array, thresholds: tuple[float, ...], velocities: Array | None,
           label: Array | None, config: ContactConfig | None) -> None:
    axes.plot(times, values, linewidth=0.7)
    axes.set(title=name, xlabel="time [s]", ylabel="external torque [Nm]" if thresholds else "joint position [rad]")
    if thresholds and velocities is not None:
        _, touches = judge_recording(ContactDetector(thresholds, config), times, values, velocities)
        for touch in touches:
            axes.axvspan(touch.onset, touch.end, color="tab:green" if touch.meant else "tab:red", alpha=0.25)
    else:
        for first, last in moving_segments(times, values, MotionConfig()):
            axes.axvspan(times[first], times[last], color="tab:green", alpha=0.2)
    if label is not None:
        axes.fill_between(times, 0, 1, where=label > 0, transform=axes.get_xaxis_transform(), color="black", alpha=0.12)


def _print_table(title: str, rows: dict[str, Any]) -> None:
    print(f"\n{title}")
    for name, row in rows.items():
        cells = (f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items())
        print(f"  {name:<24} {', '.join(cells)}")


def draw_for_documentation(path: Path) -> None:
    """Draw two recordings of presses and one of free motion, whose licences allow it, into one picture."""
    figures = Figures(path.parent)
    for name, data in _each("panda_push_labels_mindlab", ("b8", "f2")):
        figures(f"Panda, {name}: presses on link {dict(b=6, f=2)[name[0]]} (grey: the glove's label, green: found)",
                data["t"] - data["t"][0], data["tau_ext"], PANDA_THRESHOLDS, data["dq"], label=data["label"])
    for name, data in _each("fr3_follower_1khz", ("run_162853",)):
        figures(f"FR3, {name}: free motion, nobody touches", (data["t_ns"] - data["t_ns"][0]) * 1e-9, data["tau_ext"],
                PANDA_THRESHOLDS, data["dq"])
    figures.save_as(path)


def main() -> int:
    """Print the table of every data set that is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="folder for figures and capture_recordings.json")
    parser.add_argument("--picture", type=Path, help="draw the picture of docs/capture.md into this file, nothing else")
    options = parser.parse_args()
    if options.picture is not None:
        draw_for_documentation(options.picture)
        return 0
    out = options.out
    figures, tables = Figures(out), {}
    for data_set, examine in DATA_SETS.items():
        try:
            tables[data_set] = examine(figures)
        except (InputError, ImportError) as error:
            tables[data_set] = {"failed": {"error": str(error)}}
        figures.save(data_set)
        _print_table(data_set, tables[data_set] or {"left out": {"reason": "recordings not found"}})
    if out is not None:
        (out / "capture_recordings.json").write_text(json.dumps(tables, indent=1) + "\n")
    return 1 if any("failed" in rows for rows in tables.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
