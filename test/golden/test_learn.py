"""`unifeed learn` on recordings: what was learned is learned again, what cannot be used is refused with one line."""

import json

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from unifeed_msgs.msg import Feedback
from unifeed_ros.cli.main import main
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.recording import BagWriter, Qos, RecordedTopic, message_type, read_bag
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.learning import learn_reward
from unifeed_ros.core.reward.storage import load_model
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.nodes.conversions import feedback_from_msg, model_to_msg
from unifeed_ros.resources import config_path

from .test_lesson import BAG

FEEDBACK = "unifeed_msgs/msg/Feedback"


def write_bag(folder, messages, models=()):
    qos = (Qos(history="keep_last", depth=10, reliability="reliable", durability="volatile"),)
    topics = [RecordedTopic(name=name, type=message_type(kind), qos=qos)
              for name, kind in (("/feedback", FEEDBACK), ("/reward_model", "unifeed_msgs/msg/RewardModel"))]
    with BagWriter(folder, topics) as bag:
        for k, msg in enumerate(messages):
            bag.write("/feedback", serialize_message(msg), 10**9 + k)
        for k, model in enumerate(models):
            bag.write("/reward_model", serialize_message(model_to_msg(model, 2.0 + k)), 2 * 10**9 + k)
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


def test_models_that_went_on_from_others_are_learned_again_as_they_were(tmp_path, taught, capsys):
    robot = RobotModel(load_robot(config_path("robots", "panda")))
    dataset, models = FeedbackDataset("panda", robot.joint_names), []

    def learn(**changes):
        models.append(learn_reward(dataset, robot, TrainingConfig(**changes), version=len(models) + 1, seed=1,
                                   known=models[-1].ensemble if models else None))

    for msg in taught:
        dataset.add(feedback_from_msg(msg, robot.joint_names))
        learn()
    learn(warm_steps=0)  # asked to begin from scratch
    dataset.undo(taught[1].id)
    learn()
    cold, warm = TrainingConfig().steps, TrainingConfig().warm_steps
    # the second input is a correction, which is learned from scratch; without it the third one went on from the first
    assert [m.steps for m in models] == [cold, cold, warm, cold, cold + warm]
    bag = write_bag(tmp_path / "bag", taught, [m.ensemble for m in models])
    assert main(["learn", str(bag), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert [row["identical"] for row in json.loads(capsys.readouterr().out)["models"]] == [True] * 5


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
