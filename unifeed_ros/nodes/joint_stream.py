"""Joint states at 1 kHz, as the bytes that travel: rclpy's message objects would cost more than the control law.

A joint state is read and written in CDR (OMG DDS-XTypes 1.3, 7.4.1, plain encoding, as ROS 2's middleware sends it).
What comes before the numbers (frame and names) is the same in every message of a stream: it is understood once, by
rclpy, and after that only compared. A sender that leaves the gaps between names undefined is understood anew each time.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from unifeed_ros.core.capture.external import joint_places
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.types import Array, RobotState

PLAIN = b"\x00\x01\x00\x00"
"""Encapsulation header of plain little-endian CDR; alignment counts from its end."""
STAMP = struct.Struct("<iI")
COUNT = struct.Struct("<I")
NAMES_AT = len(PLAIN) + STAMP.size
NANOSECONDS = 1_000_000_000
NOTHING = np.zeros(0)


class JointReader:
    """Read serialised joint states of one stream into a robot's joint order, by name.

    Args:
        names: The robot's joints, in order.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._head: bytes | None = None
        self._count = 0
        self._index: list[int] | None = None

    def state(self, data: bytes) -> RobotState:
        """Read a measured state.

        Args:
            data: The serialised sensor_msgs/msg/JointState.

        Returns:
            The state; its arrays are read-only where no joint had to change places.

        Raises:
            InputError: Not a joint state, a joint is missing or comes twice, positions or velocities are not one a
                joint, or not finite.
        """
        return self._state(*self._read(data))

    def state_and_torques(self, data: bytes, what: str) -> tuple[RobotState, Array]:
        """Read a measured state and the efforts that came with it.

        Args:
            data: The serialised sensor_msgs/msg/JointState.
            what: What the efforts are, for the error.

        Returns:
            The state, and torques, shape (n,) [Nm].

        Raises:
            InputError: As for state, of the efforts too.
        """
        time, columns = self._read(data)
        return self._state(time, columns), self._ordered(columns[2], what)

    def torques(self, data: bytes, what: str) -> tuple[float, Array]:
        """Read the efforts.

        Args:
            data: The serialised sensor_msgs/msg/JointState.
            what: What they are, for the error.

        Returns:
            Stamp [s] and torques, shape (n,) [Nm].

        Raises:
            InputError: As for state, of the efforts.
        """
        time, (_, _, efforts) = self._read(data)
        return time, self._ordered(efforts, what)

    def _state(self, time: float, columns: Sequence[Array]) -> RobotState:
        return RobotState(time=time, positions=self._ordered(columns[0], "joint positions"),
                          velocities=self._ordered(columns[1], "joint velocities"))

    def _read(self, data: bytes) -> tuple[float, list[Array]]:
        """Give the stamp and the three arrays as they were sent."""
        if self._head is None or not data.startswith(PLAIN) or not data.startswith(self._head, NAMES_AT):
            data = self._learn(data)
        try:
            sec, nanosec = STAMP.unpack_from(data, len(PLAIN))
            at = NAMES_AT + len(self._head or b"")
            columns = []
            for _ in range(3):
                (count,) = COUNT.unpack_from(data, at)
                at += COUNT.size
                if count:
                    at = _aligned(at, 8)
                columns.append(np.frombuffer(data, "<f8", count, at) if count else NOTHING)
                at += 8 * count
        except (struct.error, ValueError) as error:
            raise InputError("joint state is cut short", got=f"{len(data)} bytes, {error}") from error
        return sec + nanosec / NANOSECONDS, columns

    def _learn(self, data: bytes) -> bytes:
        """Take in names and their order; give the message in plain little-endian CDR."""
        try:
            msg = deserialize_message(data, JointState)
        except Exception as error:  # the middleware raises RuntimeError and its own kinds
            raise InputError("not a joint state", got=f"{len(data)} bytes, {error}") from error
        names = list(msg.name)
        index = joint_places(names, self._names, "the joint state")
        self._index = None if index == list(range(len(names))) else index
        self._count = len(names)
        data = data if data.startswith(PLAIN) else serialize_message(msg)
        self._head = data[NAMES_AT:_values_at(msg.header.frame_id, names)]
        return data

    def _ordered(self, values: Array, what: str) -> Array:
        if len(values) != self._count:
            raise InputError(f"number of {what}", expected=self._count, got=len(values))
        ordered = values if self._index is None else values[self._index]
        if not math.isfinite(sum(ordered.tolist())) and not np.isfinite(ordered).all():
            broken = [self._names[k] for k in np.flatnonzero(~np.isfinite(ordered))]
            raise InputError(f"{what} are not finite", got=f"NaN or inf at {', '.join(broken)}")
        return ordered


class JointWriter:
    """Write joint states of one stream as bytes that a publisher takes.

    Args:
        names: Joints, in order.
        fields: Those of "position", "velocity" and "effort" that are sent, in this order.
        frame: Frame id.
    """

    def __init__(self, names: Sequence[str], fields: Sequence[str], frame: str = "") -> None:
        msg = JointState(name=list(names))
        msg.header.frame_id = frame
        for field in fields:
            setattr(msg, field, [0.0] * len(names))
        self._data = bytearray(serialize_message(msg))
        at = _values_at(frame, list(names))
        self._columns = []
        for field in ("position", "velocity", "effort"):
            at += COUNT.size
            if field in fields:
                at = _aligned(at, 8)
                self._columns.append(np.frombuffer(self._data, "<f8", len(names), at))
                at += 8 * len(names)
        self._length = at  # rclpy may leave more behind

    def write(self, time: float, *values: Array) -> bytes:
        """Serialise one message.

        Args:
            time: Stamp, to the nanosecond [s].
            *values: One array a field, shape (n,) each.

        Returns:
            The serialised sensor_msgs/msg/JointState.
        """
        STAMP.pack_into(self._data, len(PLAIN), *divmod(round(time * NANOSECONDS), NANOSECONDS))
        for column, numbers in zip(self._columns, values, strict=True):
            column[:] = numbers
        return bytes(self._data[: self._length])


def _aligned(at: int, size: int) -> int:
    return at + (len(PLAIN) - at) % size


def _values_at(frame: str, names: Sequence[str]) -> int:
    """Offset of the first count behind the names."""
    at = NAMES_AT + COUNT.size + len(frame.encode()) + 1
    at = _aligned(at, 4) + COUNT.size
    for name in names:
        at = _aligned(at, 4) + COUNT.size + len(name.encode()) + 1
    return _aligned(at, 4)
