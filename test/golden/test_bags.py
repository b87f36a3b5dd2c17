"""Every golden recording: its format, what independent readers make of it, and what capture finds in it again."""

from __future__ import annotations

import contextlib
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_ros.cli.bench_faults import KILLED, MENDED
from unifeed_ros.cli.faulty_wire import FAULTS
from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.feedback_capture import CapturedDemonstration, FeedbackCapture
from unifeed_ros.core.capture.stuck import StuckTorque
from unifeed_ros.core.config import from_mapping
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.feedback.items import Correction, Demonstration
from unifeed_ros.core.recording import bag_info, bag_settings, check_bag, read_bag
from unifeed_ros.core.recording.comparison import Tolerance, compare_items
from unifeed_ros.core.robot import RobotConfig, RobotModel, load_robot
from unifeed_ros.core.types import Context
from unifeed_ros.nodes.conversions import feedback_from_msg, seconds, trajectory_from_msg
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.recorded import RecordedMessages
from unifeed_ros.resources import config_path

BAGS = sorted(path.parent for path in (Path(__file__).resolve().parents[2] / "bags").glob("*/metadata.yaml"))
SESSIONS = [bag for bag in BAGS if not bag.name.startswith("real_")]
LARGEST_MIB = 45
TOLERANCE = Tolerance(time=0.15, position=0.05)
"""How far capture may move the ends of what it cuts out, and the motions with them, without a new recording."""


def test_the_folder_stays_small():
    assert sum(path.stat().st_size for bag in BAGS for path in bag.iterdir()) < LARGEST_MIB << 20


@pytest.mark.parametrize("bag", BAGS, ids=lambda bag: bag.name)
def test_a_bag_keeps_every_rule_and_every_checksum(bag):
    assert [str(finding) for finding in check_bag(bag) if finding.problems] == []
    for path in bag.glob("*.mcap"):
        with path.open("rb") as stream:
            assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) > 0


@pytest.mark.parametrize("bag", BAGS, ids=lambda bag: bag.name)
def test_an_independent_reader_finds_the_same_messages(bag):
    own = Counter((m.topic, m.time, m.data) for m in read_bag(bag))
    with Reader(bag) as reader:
        assert Counter((c.topic, time, bytes(data)) for c, time, data in reader.messages()) == own


@pytest.mark.parametrize("bag", BAGS, ids=lambda bag: bag.name)
def test_an_independent_reader_understands_each_type_by_the_recorded_definition(bag):
    with AnyReader([bag]) as reader:
        for connection in reader.connections:
            time, data = next(((t, d) for _, t, d in reader.messages([connection])), (0, b""))
            if data:
                msg = reader.deserialize(data, connection.msgtype)
                assert msg.__msgtype__ == connection.msgtype, (connection.topic, time)


def captured_again(bag, robot):
    """Feed the recorded sensors to the capture code as the node does."""
    recorded, capture = RecordedMessages(bag), FeedbackCapture(robot)
    detector = ContactDetector(robot.config.contact_thresholds, robot=robot)
    states, torques = JointReader(robot.joint_names), JointReader(robot.joint_names)
    stuck, velocities, positions, found = StuckTorque(robot), np.zeros(robot.n), np.zeros(robot.n), []
    for message in read_bag(bag, ["/joint_states", "/external_torques", "/teaching_state", "/trajectory"]):
        if message.topic == "/joint_states":
            with contextlib.suppress(InputError):  # skipped by the node too
                state = states.state(recorded.installed_bytes(message))
                capture.observe_state(state)
                velocities, positions = state.velocities, state.positions
        elif message.topic == "/external_torques":
            with contextlib.suppress(InputError):
                time, torque = torques.torques(recorded.installed_bytes(message), "external torques")
                stuck.check(time, torque)
                capture.observe_contact(detector.update(time, torque, velocities, positions))
        elif message.topic == "/trajectory":
            msg = recorded.read(message)
            capture.observe_trajectory(msg.header.frame_id, trajectory_from_msg(msg, robot.joint_names))
        else:
            msg = recorded.read(message)
            found += capture.observe_teaching(seconds(msg.header.stamp), msg.mode, msg.motion_id, msg.motion_time)
    named = {"robot": robot.config.name, "context": Context(goal=np.zeros(3))}
    items = []
    for captured in found:
        if not isinstance(captured, CapturedDemonstration):
            items += [Correction(id=f"correction {span.span}", planned=span.planned, corrected=span.corrected,
                                 span=span.span, **named) for span in captured.corrections[captured.known:]]
        elif captured.trajectory is not None:
            items.append(Demonstration(id="demonstration", trajectory=captured.trajectory, **named))
    return items


@pytest.mark.parametrize("bag", SESSIONS, ids=lambda bag: bag.name)
def test_capture_finds_in_the_sensors_what_it_found_then(bag):
    held = bag_settings(bag).get("robot")  # the oldest bag has no settings
    robot = RobotModel(from_mapping(RobotConfig, held, f"robot in {bag.name}") if held else
                       load_robot(config_path("robots", "panda")))
    recorded = RecordedMessages(bag)
    then = [feedback_from_msg(recorded.read(m), robot.joint_names) for m in read_bag(bag, ["/feedback"])]
    rows = compare_items(then, captured_again(bag, robot), TOLERANCE)
    assert [str(row) for row in rows if not row.same] == []
    assert bool(rows) is ("_fault" not in bag.name)


def test_the_session_with_a_fault_says_what_happened():
    bag = next(bag for bag in SESSIONS if bag.name.endswith("_fault"))
    said = [deserialize_message(m.data, LessonState) for m in read_bag(bag, ["/lesson_state"])]
    faults = {msg.message for msg in said if msg.phase == LessonState.FAULT}
    assert faults and all("capture died" in message for message in faults)


SAID = {
    "states stop": "no joint state for 0.10 s", "states freeze": "have not changed for 0.10 s",
    "states jump": "jumped by 0.30 rad", "joints permuted": "jumped by", "states NaN": "positions are not finite",
    "torques NaN": "external torques are not finite", "torque saturates": "external torques are stuck",
    "torque drifts": "a person leads", "commands 50 ms late": "from where it should be",
    "clock set ahead": "leapt ahead by", "clock set back": "went back by", "network cut": "no joint state for 0.10 s",
    "kill -9 capture": "capture died", "kill -9 reward_learner": "reward_learner died",
    "kill -9 trajectory_optimizer": "trajectory_optimizer died", "kill -9 session": "the session died"}
"""What is said of each fault before it is mended. A dead shared_control says nothing: the arm holds itself."""


def test_every_fault_is_said_while_it_lasts():
    bag = next(bag for bag in SESSIONS if bag.name == "panda_table_faults")
    marks = bag_info(bag).marks
    said = [(m.time, deserialize_message(m.data, kind).message)
            for topic, kind in (("/teaching_state", TeachingState), ("/lesson_state", LessonState))
            for m in read_bag(bag, [topic])]
    assert {text for _, text in marks} == {*FAULTS, *(f"kill -9 {name}" for name in KILLED), MENDED}
    spans = [(fault, begun, mended) for (begun, fault), (mended, _) in pairwise(marks) if fault != MENDED]
    heard = {fault: {message for time, message in said if begun <= time <= mended + 300_000_000}
             for fault, begun, mended in spans}
    unsaid = [fault for fault, words in SAID.items() if not any(words in message for message in heard[fault])]
    assert unsaid == []
    [(begun, mended)] = [span for fault, *span in spans if fault not in SAID]
    times = sorted(m.time for m in read_bag(bag, ["/teaching_state"]) if m.time >= begun)
    assert max(b - a for a, b in pairwise([begun, *times])) > 0.9 * (mended - begun)


def test_the_labels_of_the_real_pushes_are_marks():
    info = bag_info(next(bag for bag in BAGS if bag.name == "real_panda_push_labels_mindlab"))
    texts = Counter(text for _, text in info.marks)
    assert texts["pressed"] > 100 and abs(texts["pressed"] - texts["released"]) <= len(info.files)
