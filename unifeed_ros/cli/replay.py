"""`unifeed replay BAG`: play a recording into live nodes and compare what they say with what was recorded."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

import yaml

from unifeed_msgs.msg import Feedback, RewardModel
from unifeed_ros.cli.arguments import UserMistake, open_recording
from unifeed_ros.cli.processes import NodeProcesses
from unifeed_ros.cli.replayed_nodes import CaptureReplay, LearnerReplay, PlannerReplay, ReplayedNode
from unifeed_ros.core.config import load_settings
from unifeed_ros.core.recording import BagMessage, bag_info, bag_settings, read_bag
from unifeed_ros.core.recording.comparison import Comparison, Tolerance
from unifeed_ros.core.robot import RobotConfig, RobotModel
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.player import PlayClock, Player, ReplayError
from unifeed_ros.nodes.recorded import RecordedMessages
from unifeed_ros.nodes.table import NodeSpec, SessionSetup, node_table
from unifeed_ros.nodes.topics import BY_NAME
from unifeed_ros.resources import config_path

NODES = ("capture", "reward_learner", "trajectory_optimizer")
LARGEST_RATE = 100.0
PRIVATE_SECTIONS = ("recorder", "real_time")
"""Settings of the recording session that a replay has no use for."""


def add_replay_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `replay` to the command line."""
    parser = commands.add_parser(
        "replay", help="play a recording into live nodes and compare what they say with what was recorded",
        description="Starts the chosen nodes, each alone in a namespace of its own, gives each what it got when the "
                    "recording was made, and compares the feedback that is captured, the models that are learned and "
                    "the motions that are planned with the recorded ones. Status 0 if all are the same, 1 if not.")
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of a bag, or of a session")
    parser.add_argument("--node", action="append", choices=NODES, dest="nodes",
                        help="only this node (may be repeated; default: all that the recording has inputs for)")
    parser.add_argument("--topic", action="append", dest="topics", metavar="TOPIC",
                        help="feed only this topic (may be repeated; default: everything that the nodes read)")
    parser.add_argument("--rate", type=float, default=1.0,
                        help="recorded seconds per second; 0: as fast as the nodes follow (default: 1)")
    parser.add_argument("--step", type=float, metavar="S",
                        help="stop after every S recorded seconds until Enter is pressed")
    parser.add_argument("--robot", help="name or YAML file in place of the recorded settings")
    parser.add_argument("--task", help="name or YAML file in place of the recorded settings")
    parser.add_argument("--seed", type=int, help="seed of the training in place of the recorded one")
    parser.add_argument("--time-tolerance", type=float, default=Tolerance.time,
                        help=f"spans this near count as the same, in s (default: {Tolerance.time})")
    parser.add_argument("--joint-tolerance", type=float, default=Tolerance.position,
                        help=f"joint positions this near count as the same, in rad (default: {Tolerance.position})")
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout, progress on stderr")
    parser.set_defaults(run=run_replay)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """A recording, and what is done with it."""

    bag: Path
    """The bag."""
    recorded: RecordedMessages
    """Reads its messages."""
    nodes: tuple[ReplayedNode, ...]
    """Nodes that it is played to."""
    left_out: dict[str, str]
    """Nodes that it is not played to, and why."""
    specs: tuple[NodeSpec, ...]
    """The same nodes as processes."""
    namespace: str
    """Beginning of their namespaces."""


def run_replay(options: argparse.Namespace) -> int:
    """Play a recording; 0 if every result is the same as the recorded one, 1 if not or if a node ended.

    Raises:
        UnifeedError: Not a recording that can be played; nothing was started.
    """
    if not 0.0 <= options.rate <= LARGEST_RATE:
        raise UserMistake("--rate", expected=f"0 to {LARGEST_RATE:.0f}", got=options.rate)
    if options.step is not None and not options.step > 0.0:
        raise UserMistake("--step", expected="more than 0 s", got=options.step)
    bag = open_recording(options.bag)
    progress = sys.stderr if options.json else sys.stdout
    with tempfile.TemporaryDirectory(prefix="unifeed-replay-") as folder:
        replay = prepare(bag, options, Path(folder))
        for name, reason in replay.left_out.items():
            print(f"{name}: left out, {reason}", file=progress)
        try:
            comparisons, sent = _play(replay, options, Path(folder) / "logs", progress)
        except ReplayError as error:
            print(f"unifeed replay: {error}", file=sys.stderr)
            return 1
    same = all(c.same for _, c in comparisons)
    if options.json:
        rows = [{"node": name, **dataclasses.asdict(c)} for name, c in comparisons]
        print(json.dumps({"bag": str(bag), "rate": options.rate, "messages": sent, "left_out": replay.left_out,
                          "same": same, "comparisons": rows}, indent=2))
    else:
        print(f"{sum(c.same for _, c in comparisons)} of {len(comparisons)} results are the same; "
              f"{sent} messages played")
    return 0 if same else 1


def prepare(bag: Path, options: argparse.Namespace, folder: Path) -> Replay:
    """Check that a recording can be played, and say to which nodes.

    Args:
        bag: The bag.
        options: The command's arguments.
        folder: Place for the nodes' parameter file.

    Returns:
        What to do.

    Raises:
        UserMistake: No settings, another robot, missing topics, or an unknown topic or type.
    """
    recorded = RecordedMessages(bag)
    files = _parameter_files(bag, options, folder)
    robot = RobotModel(load_settings(RobotConfig, files[0], "robot"))
    scene = load_scene(files[-1])
    tolerance = Tolerance(time=options.time_tolerance, position=options.joint_tolerance)
    counts = {t.name: t.message_count for t in bag_info(bag).topics}
    seed = _check_session(bag, recorded, robot) if options.seed is None else options.seed
    nodes, left_out = [], {}
    for node in (CaptureReplay(recorded, robot, tolerance), LearnerReplay(recorded),
                 PlannerReplay(recorded, robot, scene, tolerance)):
        wanted = [name for name in (*node.inputs, *node.outputs) if not counts.get(f"/{name}")]
        if options.nodes and node.name not in options.nodes:
            continue
        if wanted and options.nodes:
            raise UserMistake(f"nothing to play to {node.name}", expected=f"messages on {', '.join(wanted)}",
                              got=f"none in {bag}")
        if wanted:
            left_out[node.name] = f"the recording holds nothing on {', '.join(wanted)}"
            continue
        if options.topics:
            node.inputs = _chosen(node.inputs, options.topics)
        nodes.append(node)
    if not nodes:
        raise UserMistake(f"nothing to play in {bag}", got="; ".join(left_out.values()))
    namespace = f"/replay_{os.getpid()}"
    table = node_table(SessionSetup(parameter_files=files, simulated=False, seed=seed))
    names = [node.name for node in nodes]
    specs = tuple(dataclasses.replace(spec, remaps=(*spec.remaps, f"__ns:={namespace}/{spec.executable}"))
                  for spec in table if spec.executable in names)
    return Replay(bag=bag, recorded=recorded, nodes=tuple(nodes), left_out=left_out, specs=specs, namespace=namespace)


def _chosen(inputs: Sequence[str], wanted: Sequence[str]) -> tuple[str, ...]:
    names = [name.lstrip("/") for name in wanted]
    unknown = [name for name in names if name not in BY_NAME]
    if unknown:
        raise UserMistake("--topic", expected=", ".join(BY_NAME), got=", ".join(unknown))
    return tuple(name for name in inputs if name in names)


def _parameter_files(bag: Path, options: argparse.Namespace, folder: Path) -> tuple[Path, ...]:
    """Give the nodes' parameters: those of the recording, under those that were asked for."""
    held = {name: values for name, values in bag_settings(bag).items()
            if isinstance(values, dict) and name not in PRIVATE_SECTIONS}
    given = {"robot": options.robot, "scene": options.task}
    missing = [name for name, value in given.items() if value is None and name not in held]
    if missing:
        raise UserMistake(f"{bag} holds no settings of {' and '.join(missing)}",
                          mend="give --robot and --task")
    recorded = folder / "recorded.yaml"
    recorded.write_text(yaml.safe_dump({"/**": {"ros__parameters": {
        name: values for name, values in held.items() if given.get(name) is None}}}))
    robot = config_path("robots", options.robot).resolve() if options.robot else recorded
    task = config_path("tasks", options.task).resolve() if options.task else recorded
    return tuple(dict.fromkeys((robot, recorded, task)))


def _check_session(bag: Path, recorded: RecordedMessages, robot: RobotModel) -> int:
    """Refuse another robot's recording before anything starts; give the seed of the training."""
    arm, seeds = JointReader(robot.joint_names), {0}
    for message in _first_of_each(bag, ("/feedback", "/reward_model", "/joint_states")):
        if message.topic == "/joint_states":
            arm.state(recorded.installed_bytes(message))  # refuses other joints by name
            continue
        msg: Feedback | RewardModel = recorded.read(message)
        if msg.robot != robot.config.name:
            raise UserMistake("robot of the recording", expected=robot.config.name, got=msg.robot)
        if message.topic == "/reward_model":
            seeds = {int(msg.seed)}
    return seeds.pop()


def _first_of_each(bag: Path, topics: Sequence[str]) -> Iterator[BagMessage]:
    for topic in topics:
        yield from [message for message, _ in zip(read_bag(bag, [topic]), range(1), strict=False)]


def _play(replay: Replay, options: argparse.Namespace, logs: Path,
          progress: TextIO) -> tuple[list[tuple[str, Comparison]], int]:
    with NodeProcesses(replay.specs, logs) as processes:
        def alive() -> None:
            for name, code in processes.dead().items():
                raise ReplayError(f"{name} ended (exit status {code})", got=processes.log_tail(name, 1) or None)

        with Player(replay.namespace, alive) as player:
            for node in replay.nodes:
                node.connect(player)
            print(f"playing {replay.bag} to {', '.join(node.name for node in replay.nodes)}", file=progress, flush=True)
            _feed(replay, player, options, progress)
            found = [(node.name, c) for node in replay.nodes for c in node.finish(player)]
            alive()
    for name, comparison in found:
        print(f"{name}: {comparison.what}: {comparison.message}", file=progress)
    return found, player.sent


def _feed(replay: Replay, player: Player, options: argparse.Namespace, progress: TextIO) -> None:
    clock = PlayClock(options.rate, player.spin)
    topics = {f"/{name}" for node in replay.nodes for name in (*node.inputs, *node.outputs)}
    began: int | None = None
    stop = options.step
    for message in read_bag(replay.bag, topics):
        began = message.time if began is None else began
        elapsed = (message.time - began) * 1e-9
        while stop is not None and elapsed >= stop:
            print(f"{stop:.3f} s; Enter goes on", file=progress, flush=True)
            stop = stop + options.step if sys.stdin.readline() else None
            clock.stand_still()
        clock.wait_until(message.time)
        for node in replay.nodes:
            if node.take(player, message.topic.lstrip("/"), message):
                clock.stand_still()
