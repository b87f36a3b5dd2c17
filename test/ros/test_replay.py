"""`unifeed replay`: a golden recording is played into live nodes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from unifeed_msgs.msg import Feedback
from unifeed_ros.cli.main import main
from unifeed_ros.core.recording import BagWriter, RecordedTopic, bag_types, message_type, metadata, read_bag

BAGS = Path(__file__).resolve().parents[2] / "bags"
LESSON = BAGS / "panda_cup_dc"


@pytest.fixture
def replay(start_process):
    """Run the command in a process of its own; gives exit status, JSON and what it printed."""

    def run(bag, *arguments, timeout=100.0):
        command = [sys.executable, "-m", "unifeed_ros.cli.main", "replay", bag, *arguments]
        process = start_process(command, name="replay")
        status = process.wait(timeout)
        return status, process.output

    return run


def first_seconds(folder, seconds, change=lambda message: message.data):
    """Copy the beginning of the golden lesson, with its settings."""
    topics = [RecordedTopic(name=name, type=kind) for name, kind in bag_types(LESSON).items()]
    begun = None
    with BagWriter(folder, topics, custom=metadata.read(LESSON)["custom_data"]) as bag:
        for message in read_bag(LESSON):
            begun = begun or message.time
            if message.time - begun > seconds * 1e9:
                break
            bag.write(message.topic, change(message), message.time)
    return folder


def results(output):
    return json.loads(output[output.index("\n{") + 1:])


def test_capture_finds_in_a_played_lesson_what_it_found_then(replay):
    status, output = replay(LESSON, "--rate", "0", "--node", "capture", "--json")
    said = results(output)
    assert [row["what"] for row in said["comparisons"]] == ["1-0", "2-0"]
    assert (status, said["same"]) == (0, True), output


def test_what_differs_is_said_and_is_the_exit_status(replay, tmp_path):
    def moved(message):
        if message.topic != "/feedback":
            return message.data
        msg = deserialize_message(message.data, Feedback)
        for point in msg.demonstration.points:
            point.positions[0] += 0.3
        return serialize_message(msg)

    bag = first_seconds(tmp_path / "bag", 10.0, moved)
    status, output = replay(bag, "--rate", "0", "--node", "capture", "--json")
    (row,) = results(output)["comparisons"]
    assert (status, row["same"], row["what"]) == (1, False, "1-0"), output
    assert row["difference"] == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize(("case", "words"), [
    ("no bag", "is not a bag"), ("other robot", "robot of the recording"), ("missing topics", "nothing to play"),
    ("unknown topic", "--topic"), ("other joints", "panda_joint1"), ("no settings", "holds no settings"),
    ("rate", "--rate")])
def test_what_cannot_be_played_is_refused_before_anything_starts(tmp_path, capsys, case, words):
    bag, more = LESSON, ["--node", "capture"]
    if case == "no bag":
        bag = tmp_path
    elif case == "other robot":
        more += ["--robot", "ur10"]
    elif case == "unknown topic":
        more += ["--topic", "nothing"]
    elif case == "rate":
        more += ["--rate", "-1"]
    elif case == "other joints":
        bag, more = BAGS / "real_fr3_follower_1khz", ["--robot", "panda", "--task", "table"]
    else:
        with BagWriter(tmp_path / "bag", [RecordedTopic(name="/words", type=message_type("std_msgs/msg/String"))],
                       custom=metadata.read(LESSON)["custom_data"] if case == "missing topics" else None) as empty:
            bag = empty.folder
    assert main(["replay", str(bag), *more]) == 2
    printed = capsys.readouterr().err
    assert words in printed and printed.count("\n") == 1, printed
