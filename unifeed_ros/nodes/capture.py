"""Turns touch into feedback: contact, demonstrations and corrections from joint states and external torques."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.msg import TeachingState
from unifeed_msgs.srv import ListFeedback
from unifeed_ros.core.capture.contact import ContactDetector, ContactSample
from unifeed_ros.core.capture.contact_config import ContactConfig
from unifeed_ros.core.capture.feedback_capture import (
    CaptureConfig,
    Captured,
    CapturedCorrections,
    CapturedDemonstration,
    FeedbackCapture,
)
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.types import Array, RobotState
from unifeed_ros.nodes.conversions import (
    contact_to_msg,
    feedback_to_msg,
    seconds,
    tracked_run_to_msg,
    trajectory_from_msg,
)
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.node import OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.torque_input import TorqueInput

CONTACT_PERIOD = 0.01
"""Time between two messages on `contact` while nothing changes [s]."""

KEPT_SAMPLES = 1000
"""Samples of a fast topic that wait for this node: a push whose samples are lost teaches something else."""


def highest_numbers(names: Iterable[str]) -> dict[str, int]:
    """Find up to where names such as "demonstration-3" are in use.

    Args:
        names: Names of feedback.

    Returns:
        The highest number by kind.
    """
    numbers: dict[str, int] = {}
    for name in names:
        kind, _, number = name.rpartition("-")
        if number.isdecimal():
            numbers[kind] = max(numbers.get(kind, 0), int(number))
    return numbers


class CaptureNode(UnifeedNode):
    """Watch the arm being touched and publish what the person showed."""

    def __init__(self) -> None:
        super().__init__("capture")
        self._robot = self.load_robot()
        self._task_context = self.load_scene().context()
        self._frame = self._robot.config.base_frame
        self._detector = ContactDetector(
            self._robot.config.contact_thresholds, settings(self, "contact", ContactConfig), self._robot
        )
        config = settings(self, "capture", CaptureConfig)
        self._capture, self._run_rate = FeedbackCapture(self._robot, config), config.correction.rate
        self._state_reader = JointReader(self._robot.joint_names)
        self._torque_input = TorqueInput(self, self._robot, self._on_torque,
                                         lambda reason: self.say(WARN, f"external torque skipped: {reason}"),
                                         depth=KEPT_SAMPLES)
        self._state: RobotState | None = None
        self._contact_sent, self._was_in_contact = 0.0, False
        self._taken = {"demonstration": 0, "correction": 0}
        self._ids_of_run: list[str] = []
        self._taught = self.create_client(ListFeedback, "list_feedback")
        self._asking = self.create_timer(0.2, self._ask_for_names, clock=self.steady)
        self._contacts = self.advertise("contact")
        self._feedback = self.advertise("feedback")
        self._runs = self.advertise("tracked_run")
        self.listen("joint_states", self._on_state, raw=True, depth=KEPT_SAMPLES)
        self.listen("teaching_state", self._on_teaching)
        self.listen("trajectory", self._on_trajectory)
        self.say(OK, "watching")

    def _on_state(self, data: bytes) -> None:
        try:
            state = self._state_reader.state(data)
            self._capture.observe_state(state)
        except InputError as error:
            self.say(WARN, f"joint state skipped: {error}")
            return
        self._state = state
        self._torque_input.observe_state(state)

    def _on_torque(self, time: float, torque: Array) -> None:
        if self._state is None:
            return
        try:
            sample = self._detector.update(time, torque, self._state.velocities, self._state.positions)
        except InputError as error:
            self.say(WARN, f"external torque skipped: {error}")
            return
        self._capture.observe_contact(sample)
        self._publish_contact(sample)

    def _publish_contact(self, sample: ContactSample) -> None:
        changed = sample.in_contact != self._was_in_contact
        if changed or not 0.0 <= sample.time - self._contact_sent < CONTACT_PERIOD:
            self._contacts.publish(contact_to_msg(sample, self._robot.joint_names, self._frame))
            self._contact_sent, self._was_in_contact = sample.time, sample.in_contact

    def _on_trajectory(self, msg: JointTrajectory) -> None:
        try:
            self._capture.observe_trajectory(msg.header.frame_id, trajectory_from_msg(msg, self._robot.joint_names))
        except InputError as error:
            self.say(WARN, f"motion {msg.header.frame_id} cannot be corrected: {error}")

    def _on_teaching(self, msg: TeachingState) -> None:
        for captured in self._capture.observe_teaching(
            seconds(msg.header.stamp), msg.mode, msg.motion_id, msg.motion_time
        ):
            items = self._items(captured)
            for item in items:
                self._feedback.publish(feedback_to_msg(item, captured.time, self._frame))
                self.say(OK, f"{item.kind} {item.id} captured")
            self._ids_of_run += [item.id for item in items]
            if isinstance(captured, CapturedCorrections) and captured.run is not None:
                self._runs.publish(tracked_run_to_msg(captured, self._robot.joint_names, self._ids_of_run,
                                                      self._run_rate, self._frame))
            if isinstance(captured, CapturedDemonstration) or not captured.goes_on:
                self._ids_of_run = []
            if captured.reason:
                self.say(WARN, captured.reason)

    def _items(self, captured: Captured) -> list[FeedbackItem]:
        robot = self._robot.config.name
        if isinstance(captured, CapturedDemonstration):
            if captured.trajectory is None:
                return []
            return [Demonstration(id=self._name("demonstration"), robot=robot, context=self._task_context,
                                  trajectory=captured.trajectory)]
        return [Correction(id=self._name("correction"), robot=robot, context=self._task_context, planned=span.planned,
                           corrected=span.corrected, span=span.span) for span in captured.corrections[captured.known:]]

    def _ask_for_names(self) -> None:
        """Ask once what was taught before this node began: names count on from there."""
        if self._taught.service_is_ready():
            self._asking.cancel()
            self._taught.call_async(ListFeedback.Request()).add_done_callback(self._on_taught)

    def _on_taught(self, future: Future[ListFeedback.Response]) -> None:
        answer = future.result()
        for kind, number in highest_numbers((*answer.ids, *answer.taken_back)).items():
            if kind in self._taken:
                self._taken[kind] = max(self._taken[kind], number)

    def _name(self, kind: str) -> str:
        self._taken[kind] += 1
        return f"{kind}-{self._taken[kind]}"


def main() -> int:
    """Run the node `capture`."""
    return run_node(CaptureNode)


if __name__ == "__main__":
    sys.exit(main())
