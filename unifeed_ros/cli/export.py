"""`unifeed bag export BAG`: tables, a LeRobot dataset, or figures of what was taught."""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from unifeed_msgs.msg import TeachingState
from unifeed_ros.cli.arguments import UserMistake, open_recording
from unifeed_ros.core.config import from_mapping
from unifeed_ros.core.recording import bag_info, bag_settings, read_bag
from unifeed_ros.core.recording.episodes import ControlLog, SensorLog, cut_episodes
from unifeed_ros.core.robot import RobotConfig, RobotModel, load_robot
from unifeed_ros.nodes.conversions import feedback_from_msg, seconds
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.raw_input import import_type
from unifeed_ros.nodes.recorded import RecordedMessages
from unifeed_ros.resources import config_path

FORMATS = ("csv", "parquet", "lerobot", "figure")
SENSED = ("/joint_states", "/external_torques", "/teaching_state")
RETURN = "return"
"""Begin of the names that the session gives motions back to the start: no attempts at the task."""


def add_export_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `unifeed bag export`, which has the argument "bag" and "--json" already."""
    parser.add_argument("--out", type=Path, required=True, help="folder that is made; it must not hold anything")
    parser.add_argument("--format", choices=FORMATS, required=True,
                        help="csv, parquet: a table a topic; lerobot: a LeRobot dataset, v3.0; figure: what was taught")
    parser.add_argument("--topic", action="append", dest="topics", metavar="TOPIC",
                        help="csv, parquet: only this topic (may be repeated)")
    parser.add_argument("--fps", type=int, default=50, help="lerobot: frames a second (default: 50)")
    parser.add_argument("--item", help="figure: only the feedback item of this name")
    parser.add_argument("--robot", help="name or YAML file, for bags that hold no settings")


def run_export(options: argparse.Namespace) -> int:
    """Export a bag; everything or nothing is written.

    Raises:
        UnifeedError: Not a bag, nothing in it that can be exported, or the folder cannot be used.
    """
    out = options.out.expanduser().resolve()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserMistake(f"folder {out}", expected="a new or empty one", mend="give another one with --out")
    if not 1 <= options.fps <= 1000:
        raise UserMistake("--fps", expected="1 to 1000", got=options.fps)
    bag = open_recording(options.bag)
    partial = out.with_name(f".{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    write: Callable[[Path, Path, argparse.Namespace], dict[str, Any]] = {
        "csv": _write_tables, "parquet": _write_tables, "lerobot": _write_lerobot, "figure": _write_figures,
    }[options.format]
    try:
        try:
            partial.mkdir(parents=True)
            written = write(bag, partial, options)
            if out.exists():
                out.rmdir()
            partial.replace(out)
        except OSError as error:
            raise UserMistake(f"cannot write {out}", got=error.strerror or str(error)) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    if options.json:
        print(json.dumps({"bag": str(bag), "out": str(out), "format": options.format, "written": written}))
    else:
        print("\n".join([*(f"{name}: {what}" for name, what in written.items()), f"in {out}"]))
    return 0


def _write_tables(bag: Path, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    from unifeed_ros.nodes.tables import write_csv, write_parquet  # loads pyarrow

    recorded = RecordedMessages(bag)
    there = [t for t in bag_info(bag).topics if t.message_count]
    wanted = [f"/{name.lstrip('/')}" for name in options.topics or ()]
    missing = sorted(set(wanted) - {t.name for t in there})
    if missing or not there:
        raise UserMistake(f"no messages on {', '.join(missing) or 'any topic'} in {bag}",
                          expected=", ".join(t.name for t in there) or "a bag with messages")
    written = {}
    for topic in there:
        if wanted and topic.name not in wanted:
            continue

        def rows(name: str = topic.name) -> Iterator[tuple[int, Any]]:
            return ((message.time, recorded.read(message)) for message in read_bag(bag, [name]))

        path = folder / f"{topic.name.strip('/').replace('/', '.')}.{options.format}"
        count = (write_csv(path, rows) if options.format == "csv"
                 else write_parquet(path, import_type(topic.type), rows))
        written[path.name] = f"{count} rows"
    return written


def _write_lerobot(bag: Path, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    from unifeed_ros.core.recording.lerobot import write_lerobot  # loads pyarrow

    robot = _robot(bag, options.robot)
    missing = [name for name in SENSED if not _count(bag, name)]
    if missing:
        raise UserMistake(f"no messages on {', '.join(missing)} in {bag}", expected="a recorded session")
    sensors, control = read_logs(bag, robot)
    episodes = cut_episodes(sensors, control, rate=options.fps, left_out=[RETURN])
    task = str(bag_settings(bag).get("scene", {}).get("task", "unknown"))
    write_lerobot(folder, episodes, robot=robot.config.name, joint_names=robot.joint_names, task=task,
                  rate=options.fps)
    return {f"episode {k}": f"{e.kind}, {len(e.times)} frames, a person led in {int(e.intervention.sum())}"
            for k, e in enumerate(episodes)}


def read_logs(bag: Path, robot: RobotModel) -> tuple[SensorLog, ControlLog]:
    """Read what sensors and controller said; what cannot be used (another robot's joints, NaN) is refused.

    Args:
        bag: The bag.
        robot: The arm.

    Returns:
        Both logs, each in the order of its stamps.

    Raises:
        InputError: Joint states or torques of another arm, or not finite.
    """
    recorded = RecordedMessages(bag)
    states, torques = JointReader(robot.joint_names), JointReader(robot.joint_names)
    positions: dict[float, tuple[Any, Any]] = {}
    efforts: dict[float, Any] = {}
    control: dict[float, TeachingState] = {}
    for message in read_bag(bag, SENSED):
        if message.topic == "/teaching_state":
            msg = recorded.read(message)
            control[seconds(msg.header.stamp)] = msg
        elif message.topic == "/joint_states":
            state = states.state(recorded.installed_bytes(message))
            positions[state.time] = state.positions, state.velocities
        else:
            time, effort = torques.torques(recorded.installed_bytes(message), "external torques")
            efforts[time] = effort
    times, torque_times, control_times = sorted(positions), sorted(efforts), sorted(control)
    sensors = SensorLog(
        times=np.array(times), positions=np.array([positions[t][0] for t in times]),
        velocities=np.array([positions[t][1] for t in times]), torque_times=np.array(torque_times),
        torques=np.array([efforts[t] for t in torque_times]))
    said = [control[t] for t in control_times]
    return sensors, ControlLog(times=np.array(control_times), modes=[m.mode for m in said],
                               person_leads=[m.control == TeachingState.PERSON for m in said],
                               motions=[m.motion_id for m in said])


def _write_figures(bag: Path, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    from unifeed_ros.cli.item_figure import draw_item  # loads matplotlib

    robot, recorded, written = _robot(bag, options.robot), RecordedMessages(bag), {}
    names = []
    for message in read_bag(bag, ["/feedback"]):
        item = feedback_from_msg(recorded.read(message), robot.joint_names)
        names.append(item.id)
        if options.item in (None, item.id):
            draw_item(robot, item, folder / f"{item.id}.png")
            written[f"{item.id}.png"] = item.kind
    if not written:
        raise UserMistake(f"no feedback item {options.item or ''} in {bag}", got=", ".join(names) or "none at all")
    return written


def _count(bag: Path, topic: str) -> int:
    return next((t.message_count for t in bag_info(bag).topics if t.name == topic), 0)


def _robot(bag: Path, given: str | None) -> RobotModel:
    """Build the arm from the recorded settings, or from those that were asked for; refuse another arm's bag."""
    held = bag_settings(bag)
    if given is None and "robot" not in held:
        raise UserMistake(f"{bag} holds no settings of the robot", mend="give --robot")
    config = load_robot(config_path("robots", given)) if given else from_mapping(RobotConfig, held["robot"],
                                                                                 f"robot in {bag}")
    recorded = RecordedMessages(bag)
    for message, _ in zip(read_bag(bag, ["/feedback"]), range(1), strict=False):
        if (taught := recorded.read(message).robot) != config.name:
            raise UserMistake("robot of the recording", expected=config.name, got=taught)
    return RobotModel(config)

