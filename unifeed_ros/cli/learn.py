"""`unifeed learn BAG...`: learn again from recordings, without any node."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from unifeed_ros.cli.arguments import UserMistake, open_recording
from unifeed_ros.core.config import from_mapping
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import FeedbackItem
from unifeed_ros.core.recording import bag_settings, read_bag
from unifeed_ros.core.reward.buffer import AlternativesConfig
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.storage import save_model
from unifeed_ros.core.robot import RobotConfig, RobotModel, load_robot
from unifeed_ros.nodes.conversions import feedback_from_msg, model_from_msg
from unifeed_ros.nodes.recorded import RecordedMessages
from unifeed_ros.resources import config_path

TAUGHT = ("/feedback", "/reward_model")


@dataclass(frozen=True)
class Recorded:
    """What bags of one session hold of learning."""

    robot: RobotModel
    training: TrainingConfig
    items: Mapping[str, FeedbackItem]
    """Everything that was taught, by name, in order; also what was taken back later."""
    models: Sequence[RewardEnsemble]
    """Every model that was learned live, in order."""


def add_learn_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `learn` to the command line."""
    parser = commands.add_parser(
        "learn", help="learn again from recordings, without any node",
        description="Learn every recorded model again from the recorded feedback, and say whether it is the same. "
                    "Without a recorded model, learn one from everything that was taught.")
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folders of bags of one session")
    parser.add_argument("--out", type=Path, required=True, help="folder for the models and learn.json")
    parser.add_argument("--robot", help="name or YAML file, for bags that hold no settings")
    parser.add_argument("--seed", type=int, help="learn the newest model with this seed in place of the recorded one")
    parser.add_argument("--json", action="store_true", help="print learn.json on stdout, progress on stderr")
    parser.set_defaults(run=run_learn)


def run_learn(options: argparse.Namespace) -> int:
    """Learn again; status 0 if every model is the same, byte for byte, or none was recorded; 1 otherwise.

    Raises:
        UnifeedError: Not bags of one session, or nothing was taught; nothing is written.
    """
    from unifeed_ros.core.reward.learning import learn_reward  # loads torch: seconds that the other commands spare

    recorded = read_taught(options.bags, options.robot)
    wanted = _wanted(recorded, options.seed)
    rows, models, known = [], [], None
    scratch = replace(recorded.training, warm_steps=0)
    for live, ids, version, seed in wanted:
        dataset = FeedbackDataset(recorded.robot.config.name, recorded.robot.joint_names)
        for name in ids:
            dataset.add(recorded.items[name])
        result = learn_reward(dataset, recorded.robot, recorded.training, version=version, seed=seed, known=known)
        row, known = _row(live, result.ensemble, result.seconds), result.ensemble
        if row["identical"] is False:  # it may have been told to begin from scratch: a recording does not say
            again = learn_reward(dataset, recorded.robot, scratch, version=version, seed=seed)
            if _row(live, again.ensemble, again.seconds)["identical"]:
                result, row = again, _row(live, again.ensemble, again.seconds)
        models.append(result.ensemble)
        rows.append(row)
        print(_line(rows[-1]), file=sys.stderr if options.json else sys.stdout, flush=True)
    out = options.out.expanduser()
    for model in models:
        save_model(out / f"reward_model_{model.version}.safetensors", model)
    report = {"robot": recorded.robot.config.name, "bags": [str(bag) for bag in options.bags], "models": rows}
    (out / "learn.json").write_text(json.dumps(report, indent=2) + "\n")
    if options.json:
        print(json.dumps(report, indent=2))
    return 0 if all(row["identical"] in (True, None) for row in rows) else 1


def read_taught(bags: Sequence[Path], robot: str | None = None) -> Recorded:
    """Read what bags of one session hold of learning.

    Args:
        bags: Folders of the bags, in order.
        robot: Name or YAML file of the robot; by default the settings in the bag, then the name in the feedback.

    Returns:
        Robot, settings, feedback and models.

    Raises:
        RecordingError: Not a bag, not closed, or damaged.
        UserMistake: Nothing was taught in them, or they are of different robots or sessions.
        ConfigError: The settings cannot be used.
    """
    bags = [open_recording(bag) for bag in bags]
    feedback: dict[str, Any] = {}
    models: dict[int, Any] = {}
    for bag in bags:
        recorded = RecordedMessages(bag)
        for message in read_bag(bag, topics=TAUGHT):
            msg = recorded.read(message)
            if message.topic == "/feedback":
                _once(feedback, msg.id, msg, f"feedback {msg.id}")
            else:
                _once(models, int(msg.version), msg, f"model {msg.version}")
    if not feedback:
        raise UserMistake("nothing was taught in this recording", expected="messages on /feedback",
                          got=", ".join(map(str, bags)))
    taught = list(feedback.values())
    arm, training = _settings(bags[0], robot, taught[0].robot)
    others = {msg.robot for msg in taught} - {arm.config.name}
    if others:
        raise UserMistake("robot of the recording", expected=arm.config.name, got=", ".join(sorted(others)),
                          mend="give the robot that was taught with --robot")
    return Recorded(
        robot=arm, training=training, items={msg.id: feedback_from_msg(msg, arm.joint_names) for msg in taught},
        models=[model_from_msg(msg) for msg in models.values()])


def _once(seen: dict[Any, Any], key: Any, msg: Any, what: str) -> None:
    """Take a message in; latched ones come again in every bag of a session, but never changed."""
    if seen.setdefault(key, msg) != msg:
        raise UserMistake(f"two recordings of different sessions: each has its own {what}",
                          mend="learn from one session at a time")


def _settings(bag: Path, robot: str | None, taught: str) -> tuple[RobotModel, TrainingConfig]:
    held = bag_settings(bag)
    if robot is None and "robot" in held:
        config = from_mapping(RobotConfig, held["robot"], f"robot in {bag}")
    else:
        config = load_robot(config_path("robots", robot or taught))
    training = dict(held.get("training", {}))
    if "alternatives" in training:
        training["alternatives"] = from_mapping(AlternativesConfig, training["alternatives"], f"training in {bag}")
    return RobotModel(config), from_mapping(TrainingConfig, training, f"training in {bag}")


def _wanted(recorded: Recorded, seed: int | None) -> list[tuple[RewardEnsemble | None, Sequence[str], int, int]]:
    """List what to learn: the live model to compare with, the feedback, the version and the seed."""
    if not recorded.models:
        return [(None, list(recorded.items), 1, seed or 0)]
    if seed is not None:
        newest = recorded.models[-1]
        return [(None, newest.feedback_ids, newest.version, seed)]
    for model in recorded.models:
        missing = set(model.feedback_ids) - set(recorded.items)
        if missing:
            raise UserMistake(f"model {model.version} was learned from feedback that is not in the recording",
                              got=", ".join(sorted(missing)), mend="give all bags of the session")
    return [(model, model.feedback_ids, model.version, model.seed) for model in recorded.models]


def _row(live: RewardEnsemble | None, again: RewardEnsemble, seconds: float) -> dict[str, Any]:
    row: dict[str, Any] = {"version": again.version, "feedback": len(again.feedback_ids), "seed": again.seed,
                           "seconds": seconds, "identical": None, "largest_difference": None}
    if live is not None:
        row["identical"] = live.layer_sizes == again.layer_sizes and live.members == again.members and (
            live.flat_weights().tobytes() == again.flat_weights().tobytes())
        if live.flat_weights().shape == again.flat_weights().shape:
            row["largest_difference"] = float(np.abs(live.flat_weights() - again.flat_weights()).max())
    return row


def _line(row: Mapping[str, Any]) -> str:
    same = {True: "the same as live, byte for byte", None: "nothing recorded to compare with",
            False: f"NOT the same as live: largest difference {row['largest_difference']}"}[row["identical"]]
    return (f"model {row['version']}: learned from {row['feedback']} inputs in {row['seconds']:.2f} s with seed "
            f"{row['seed']}, {same}")
