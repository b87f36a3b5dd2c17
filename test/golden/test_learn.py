"""`unifeed learn` on recordings: what was learned is learned again, what cannot be used is refused with one line."""

import json

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from unifeed_msgs.msg import Feedback
from unifeed_ros.cli.main import main
from unifeed_ros.core.recording import BagWriter, Qos, RecordedTopic, message_type, read_bag
from unifeed_ros.core.reward.storage import load_model

from .test_lesson import BAG

FEEDBACK = "unifeed_msgs/msg/Feedback"


def write_bag(folder, messages):
    topic = RecordedTopic(name="/feedback", type=message_type(FEEDBACK),
                          qos=(Qos(history="keep_last", depth=10, reliability="reliable", durability="volatile"),))
    with BagWriter(folder, [topic]) as bag:
        for k, msg in enumerate(messages):
            bag.write("/feedback", serialize_message(msg), 10**9 + k)
    return folder


@pytest.fixture(scope="module")
def taught():
    return [deserialize_message(m.data, Feedback) for m in read_bag(BAG, topics=["/feedback"])]


def test_feedback_without_a_model_is_learned_from(tmp_path, taught, capsys):
    bag, out = write_bag(tmp_path / "bag", taught), tmp_path / "out"
    assert main(["learn", str(bag), "--out", str(out), "--seed", "3", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((out / "learn.json").read_text())
    (row,) = report["models"]
    assert (row["version"], row["feedback"], row["seed"], row["identical"]) == (1, 3, 3, None)
    model = load_model(out / "reward_model_1.safetensors")
    assert model.robot == "panda" and model.feedback_ids == tuple(msg.id for msg in taught)


@pytest.mark.parametrize(("case", "words"), [
    ("no bag", "is not a bag"), ("nothing taught", "nothing was taught"), ("other robot", "robot of the recording"),
    ("two sessions", "different sessions"), ("unknown robot", "nowhere")])
def test_what_cannot_be_learned_from_is_refused(tmp_path, taught, capsys, case, words):
    bags, more = [BAG], []
    if case == "no bag":
        bags = [tmp_path]
    elif case == "nothing taught":
        bags = [write_bag(tmp_path / "empty", [])]
    elif case == "other robot":
        more = ["--robot", "ur10"]
    elif case == "two sessions":
        other = deserialize_message(serialize_message(taught[0]), Feedback)
        other.span_end += 1.0
        bags.append(write_bag(tmp_path / "other", [other]))
    else:
        more = ["--robot", "nowhere"]
    assert main(["learn", *map(str, bags), "--out", str(tmp_path / "out"), *more]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
