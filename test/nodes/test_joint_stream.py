"""Laws of the joint stream: what rclpy writes it reads, what it writes rclpy reads, the rest is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from unifeed_ros.core.errors import InputError
from unifeed_ros.nodes.joint_stream import COUNT, JointReader, JointWriter

NAMES = ("a", "joint_2", "schulter ö")
FIELDS = ("position", "velocity", "effort")
NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3)


def message(names=NAMES, frame="", sec=0, nanosec=0, **fields):
    msg = JointState(name=list(names), **fields)
    msg.header.frame_id, msg.header.stamp.sec, msg.header.stamp.nanosec = frame, sec, nanosec
    return msg


@given(names=st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=9),
                      min_size=1, max_size=9, unique=True),
       frame=st.text("abö", max_size=9), effort=st.booleans(), data=st.data())
@settings(max_examples=80, deadline=None)
def test_reads_what_rclpy_writes_in_any_order(names, frame, effort, data):
    numbers = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=len(names), max_size=len(names))
    position, velocity, torque = (np.array(data.draw(numbers)) for _ in range(3))
    order = data.draw(st.permutations(range(len(names))))
    msg = message(names, frame, 5, 25, position=position.tolist(), velocity=velocity.tolist(),
                  effort=torque.tolist() if effort else [])
    reader = JointReader([names[i] for i in order])
    state = reader.state(serialize_message(msg))
    assert state.time == 5 + 25e-9
    np.testing.assert_array_equal(state.positions, position[list(order)])
    np.testing.assert_array_equal(state.velocities, velocity[list(order)])
    if effort:
        np.testing.assert_array_equal(reader.torques(serialize_message(msg), "torques")[1], torque[list(order)])
    else:
        with pytest.raises(InputError, match="number of torques"):
            reader.torques(serialize_message(msg), "torques")


@given(frame=st.text("abö", max_size=9), values=st.tuples(NUMBERS, NUMBERS, NUMBERS),
       sent=st.lists(st.sampled_from(FIELDS), unique=True), nanoseconds=st.integers(0, 2**31 * 10**9 - 10**6))
@settings(max_examples=80, deadline=None)
def test_writes_what_rclpy_writes(frame, values, sent, nanoseconds):
    sent = [f for f in FIELDS if f in sent]
    chosen = dict(zip(sent, values, strict=False))
    time = nanoseconds / 1e9
    written = JointWriter(NAMES, sent, frame).write(time, *chosen.values())
    sec, nanosec = divmod(round(time * 1e9), 10**9)
    assert deserialize_message(written, JointState) == message(NAMES, frame, sec, nanosec, **chosen)


def test_a_stream_that_changes_its_names_is_followed():
    reader = JointReader(("a", "b"))
    for names, numbers in ((("a", "b"), [1.0, 2.0]), (("b", "a"), [2.0, 1.0]), (("x", "b", "a"), [9.0, 2.0, 1.0])):
        for _ in range(2):
            _, torques = reader.torques(serialize_message(message(names, effort=numbers)), "torques")
            np.testing.assert_array_equal(torques, [1.0, 2.0])


def test_what_is_not_asked_for_may_be_bad():
    nothing = [float("nan")] * 3
    state = JointReader(NAMES).state(serialize_message(message(position=[1, 2, 3], velocity=[4, 5, 6], effort=nothing)))
    assert state.velocities.tolist() == [4, 5, 6]
    extra = message((*NAMES, "gripper"), effort=[1, 2, 3, float("nan")])
    assert JointReader(NAMES).torques(serialize_message(extra), "torques")[1].tolist() == [1, 2, 3]


def test_big_endian_messages_are_read():
    big = bytes.fromhex("00000000" "00000005" "00000019" "00000001" "00000000" "00000001" "00000002" "61000000"
                        "00000000" "00000000" "00000001" "3ff0000000000000")
    time, torques = JointReader(("a",)).torques(big, "torques")
    assert time == 5 + 25e-9 and torques.tolist() == [1.0]


@pytest.mark.parametrize(("msg", "words"), [
    (message(("a", "b")), "lack joints joint_2"),
    (message(("a", "a", "joint_2", "schulter ö")), "repeat"),
    (message(effort=[1.0, 2.0]), "number of pushes: expected 3, got 2"),
    (message(), "number of pushes: expected 3, got 0"),
    (message(effort=[1.0, float("nan"), 2.0]), "pushes are not finite: got NaN or inf at joint_2"),
    (message(effort=[1.0, float("inf"), float("-inf")]), "pushes are not finite"),
])
def test_what_cannot_be_used_is_refused(msg, words):
    reader = JointReader(NAMES)
    with pytest.raises(InputError, match=words):
        reader.torques(serialize_message(msg), "pushes")
    assert reader.torques(serialize_message(message(effort=[1, 2, 3])), "pushes")[1].tolist() == [1, 2, 3]


@pytest.mark.parametrize(("position", "velocity", "words"), [
    ([1.0, 1.0, 2.0], [], "number of joint velocities"), ([], [1.0, 1.0, 2.0], "number of joint positions"),
    ([1.0, float("nan"), 2.0], [0.0] * 3, "positions are not finite")])
def test_a_state_needs_positions_and_velocities(position, velocity, words):
    with pytest.raises(InputError, match=words):
        JointReader(NAMES).state(serialize_message(message(position=position, velocity=velocity)))


@pytest.mark.parametrize("known", [False, True])
def test_a_message_cut_anywhere_is_refused(known):
    whole = JointWriter(NAMES, ("position", "velocity")).write(1.0, np.arange(3.0), np.ones(3))
    whole = whole[:-COUNT.size]  # no efforts: how many there are may be cut off, since they are not read
    for length in range(len(whole)):
        reader = JointReader(NAMES)
        if known:
            reader.state(whole + bytes(COUNT.size))
        with pytest.raises(InputError):
            reader.state(whole[:length])
