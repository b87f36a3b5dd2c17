"""Make the small recordings in bags/ that tests replay; bags/README.md says which and how.

    .venv/bin/python scripts/golden_bags.py lesson ur10 laptop CD 9 bags/ur10_laptop_cd
    .venv/bin/python scripts/golden_bags.py cut out/demo/bag bags/panda_table_dcp
    .venv/bin/python scripts/golden_bags.py faults out/bench-faults/bag bags/panda_table_faults
    .venv/bin/python scripts/golden_bags.py real DATA bags

"lesson" records a lesson that is taught in one process, in simulated time: it does not depend on the machine's load.
"cut" copies a live recording without what tests do not need: the fast topics only where the arm was guided or touched.
"faults" copies a recording of `unifeed bench faults`: what was said, and the fast topics around each fault.
"real" turns recordings of real arms that may be copied into bags.
"""

from __future__ import annotations

import json
import shutil
import sys
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from unifeed_msgs.msg import TeachingState
from unifeed_ros.cli.arguments import session_files
from unifeed_ros.cli.bench_faults import MENDED
from unifeed_ros.core.capture.contact import ContactDetector, ContactSample
from unifeed_ros.core.capture.feedback_capture import Captured, FeedbackCapture
from unifeed_ros.core.config import load_parameters
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.recording import (
    BagMessage,
    BagWriter,
    Qos,
    RecordedTopic,
    bag_info,
    bag_settings,
    message_type,
    read_bag,
)
from unifeed_ros.core.recording.reader import SETTINGS_KEY
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.core.types import RobotState, Trajectory
from unifeed_ros.nodes.conversions import feedback_from_msg, feedback_to_msg, header, model_to_msg, trajectory_to_msg
from unifeed_ros.nodes.joint_stream import JointWriter
from unifeed_ros.nodes.recorded import RecordedMessages
from unifeed_ros.nodes.topics import find_topic
from unifeed_ros.simulation import lesson, rig

START = 1_780_000_000_000_000_000
"""Recorded time of simulated time zero [ns since the epoch]."""
AROUND = 0.7
"""Time kept before and after a guided or touched run [s]: capture's pre-roll, and the end of its touch."""
BIAS = 1.0
"""Time kept at the start, in which the contact detector learns the sensors' bias [s]."""
BEFORE, AFTER, AFTER_KILL = 0.4, 1.3, 2.2
"""Time kept before a fault begins, and after [s]: a wire is broken for one second, a dead session is noticed in two."""
LEAD = 3.0
"""Time kept before the first fault, in which the arm holds and then begins to move [s]."""
FAST = ("/joint_states", "/external_torques", "/teaching_state")
SLOW = ("/trajectory", "/trajectory_preview", "/feedback", "/reward_model", "/preference_query", "/interaction",
        "/lesson_state")
REAL = {
    "panda_push_labels_mindlab": ("panda_joint", "*.npz"),
    "panda_kinesthetic_lila": ("panda_joint", "*_pick-banana.npz"),  # two of five files: the others are large
    "panda_kinesthetic_users_hapticskin": ("panda_joint", "user_0[1-4].npz"),  # four of eight people
    "fr3_follower_1khz": ("fr3_joint", "*.npz")}
"""Recordings that may be copied: how their joints' names begin, and which files."""


class BagLog:
    """Messages of a lesson, kept in memory until it is known which stretches are worth keeping."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.time = robot, 0.0
        self.messages: list[tuple[str, float, bytes]] = []
        self.kept: list[tuple[float, float]] = [(0.0, BIAS)]
        self._states = JointWriter(robot.joint_names, ("position", "velocity"))
        self._torques = JointWriter(robot.joint_names, ("effort",))
        self._run, self._touched, self._said = 0.0, False, (-1.0, (-1, ""))

    def add(self, topic: str, data: bytes) -> None:
        """Keep one serialised message at the present time."""
        self.messages.append((topic, self.time, data))

    def say(self, topic: str, msg: Any) -> None:
        """Keep one message at the present time."""
        self.add(topic, trimmed(serialize_message(msg), type(msg)))

    def state(self, state: RobotState) -> None:
        """Keep a joint state; it sets the time."""
        self.time = state.time
        self.add("/joint_states", self._states.write(state.time, state.positions, state.velocities))

    def torque(self, time: float, torque: Any) -> None:
        """Keep an external torque."""
        self.time = time
        self.add("/external_torques", self._torques.write(time, torque))

    def teaching(self, time: float, mode: int, motion_id: str, motion_time: float, force: bool) -> None:
        """Keep what the controller does: 100 times a second, and at every change."""
        key = (int(mode), motion_id)
        if key != self._said[1]:
            self._end_run(time)
            self._run, self._touched = time, mode == TeachingMode.GUIDE
        self._touched |= force and mode == TeachingMode.TRACK
        if key != self._said[1] or time - self._said[0] >= 0.01 - 1e-9:
            person = mode == TeachingMode.GUIDE or force
            self.say("/teaching_state", TeachingState(
                header=header(time, self.robot.config.base_frame), mode=int(mode), motion_id=motion_id,
                motion_time=motion_time, control=TeachingState.PERSON if person else TeachingState.ROBOT))
            self._said = (time, key)

    def _end_run(self, time: float) -> None:
        if self._touched:
            self.kept.append((self._run - AROUND, time + AROUND))

    def worth(self) -> Iterator[tuple[str, float, bytes]]:
        """Give what is kept: slow topics always, fast ones around guided and touched runs."""
        for topic, time, data in self.messages:
            if topic not in FAST or any(a <= time <= b for a, b in self.kept):
                yield topic, time, data


def trimmed(data: bytes, kind: type) -> bytes:
    """Take off what rclpy's serialisation leaves behind the last field, and no publisher sends."""
    whole = deserialize_message(data, kind)

    def complete(length: int) -> bool:
        try:
            return bool(deserialize_message(data[:length], kind) == whole)
        except RuntimeError:  # cut into a field
            return False

    return data[:bisect_left(range(len(data)), True, key=complete)]


def record_lesson(robot_name: str, task: str, letters: str, seed: int, out: Path) -> None:
    """Teach a lesson in one process and record it as the nodes would publish it."""
    files = session_files(robot_name, task)
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    log = BagLog(robot)
    _tap(log, robot)
    result = lesson.run_lesson(robot, scene, feedback=letters, seed=seed,
                               on_step=lambda step: print(step.index, step.letter, len(step.taught), step.message,
                                                          f"{step.normalised_regret:.3f}", flush=True))
    if len(result.interactions) != len(letters):
        raise SystemExit("the lesson did not end")
    settings: dict[str, Any] = {}
    for file in files:
        settings |= load_parameters(file)
    log.teaching(log.time + 0.01, int(TeachingMode.INACTIVE), "", 0.0, False)
    _write(out, [(t, START + round(1e9 * s), data) for t, s, data in log.worth()], settings)


def _tap(log: BagLog, robot: RobotModel) -> None:
    """Let the lesson's own parts write down what passes through them."""
    train, plan = lesson.learn_reward, lesson.plan_motion
    given: set[str] = set()

    class Capture(FeedbackCapture):
        def observe_state(self, state: RobotState) -> None:
            log.state(state)
            super().observe_state(state)

        def observe_trajectory(self, motion_id: str, trajectory: Trajectory) -> None:
            log.say("/trajectory", trajectory_to_msg(trajectory, log.time, motion_id))
            super().observe_trajectory(motion_id, trajectory)

        def observe_contact(self, sample: ContactSample) -> None:
            self.touching = sample.in_contact
            super().observe_contact(sample)

        def observe_teaching(self, time: float, mode: int, motion_id: str, motion_time: float) -> list[Captured]:
            log.teaching(time, mode, motion_id, motion_time, self.touching)
            return super().observe_teaching(time, mode, motion_id, motion_time)

    class Detector(ContactDetector):
        def update(self, time: float, torque: Any, velocities: Any, positions: Any = None) -> ContactSample:
            log.torque(time, torque)
            return super().update(time, torque, velocities, positions)

    def training(dataset: Any, *arguments: Any, **named: Any) -> Any:
        heard = FeedbackDataset(robot.config.name, robot.joint_names)  # as messages carry it, stamps to the nanosecond
        for item in dataset.items:
            message = feedback_to_msg(item, log.time, robot.config.base_frame)
            heard.add(feedback_from_msg(message, robot.joint_names))
            if item.id not in given:
                given.add(item.id)
                log.say("/feedback", message)
        result = train(heard, *arguments, **named)
        log.say("/reward_model", model_to_msg(result.ensemble, log.time))
        return result

    def planning(*arguments: Any, **named: Any) -> Any:
        found = plan(*arguments, **named)
        log.say("/trajectory_preview", trajectory_to_msg(found.trajectory))
        return found

    rig.FeedbackCapture, rig.ContactDetector = Capture, Detector
    lesson.learn_reward, lesson.plan_motion = training, planning


def cut(bag: Path, out: Path) -> None:
    """Copy a live recording, the fast topics only around guided and touched runs."""
    recorded = RecordedMessages(bag)
    runs: list[list[Any]] = []
    for message in read_bag(bag, ["/teaching_state"]):
        msg = recorded.read(message)
        key = (msg.mode, msg.motion_id)
        if not runs or runs[-1][0] != key:
            runs.append([key, message.time, message.time, msg.mode == TeachingMode.GUIDE])
        runs[-1][2] = message.time
        runs[-1][3] |= msg.mode == TeachingMode.TRACK and msg.control == msg.PERSON
    margin = int(1e9 * AROUND)
    begun = next(iter(read_bag(bag))).time
    kept = [(begun, begun + int(1e9 * BIAS)), *((a - margin, b + margin) for _, a, b, worth in runs if worth)]

    def worth(message: BagMessage) -> bool:
        return message.topic in SLOW or any(a <= message.time <= b for a, b in kept)

    messages = [(m.topic, m.time, m.data) for m in read_bag(bag, (*FAST, *SLOW)) if worth(m)]
    settings = {name: values for name, values in bag_settings(bag).items() if isinstance(values, dict)}
    settings.pop("recorder", None)
    _write(out, messages, settings)


def cut_faults(bag: Path, out: Path) -> None:
    """Copy a recording of faults: its marks, what was said from the first one on, and the fast topics around each."""
    marks = bag_info(bag).marks
    begins = [(time, AFTER_KILL if text.startswith("kill") else AFTER) for time, text in marks if text != MENDED]
    second = 10**9
    first, last = begins[0][0] - round(LEAD * second), marks[-1][0] + second
    kept = [(first, begins[0][0]), *((t - round(BEFORE * second), t + round(after * second)) for t, after in begins)]

    def worth(message: BagMessage) -> bool:
        return message.topic not in FAST or any(a <= message.time <= b for a, b in kept)

    messages = [(m.topic, m.time, m.data) for m in read_bag(bag, (*FAST, "/trajectory", "/lesson_state"))
                if first <= m.time <= last and worth(m)]
    settings = {name: values for name, values in bag_settings(bag).items() if isinstance(values, dict)}
    settings.pop("recorder", None)
    _write(out, messages, settings, marks)


def real(data: Path, out: Path) -> None:
    """Turn recordings of real arms, of licences that allow it, into bags: a file a run, with its name as a mark."""
    for name, (prefix, pattern) in REAL.items():
        folder, begun = out / f"real_{name}", START
        names = [f"{prefix}{k}" for k in range(1, 8)]
        topics = _topics(("/joint_states", "/external_torques") if name != "panda_kinesthetic_users_hapticskin"
                         else ("/joint_states",))
        with BagWriter(folder, topics, chunk_bytes=1 << 20, flush_period=60.0) as bag:
            for number, (run, times, columns) in enumerate(_real_runs(data / name, pattern)):
                if number:
                    bag.split()
                bag.mark(run, begun)
                begun += _write_run(bag, names, times, columns, begun) + 1_000_000_000
        if (licence := data / name / "LICENSE.txt").exists():
            shutil.copy(licence, folder / "LICENSE.txt")


def _real_runs(folder: Path, pattern: str) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Give every run: its name, its times [s], and its columns by the names of the files."""
    for path in sorted(folder.glob(pattern)):
        held = dict(np.load(path))
        if "demo_id" in held:
            for number in np.unique(held["demo_id"]):
                rows = held["demo_id"] == number
                yield (f"{path.stem} {number}", held["t"][rows],
                       {key: held[key][rows] for key in ("q", "dq", "tau_ext")})
        elif "t_ns" in held:
            yield path.stem, (held["t_ns"] - held["t_ns"][0]) * 1e-9, held
        elif "t" in held:
            yield path.stem, held["t"], held
        else:
            for key in [key for key in held if key.endswith("/t")]:
                run = key.removesuffix("/t")
                yield f"{path.stem} {run}", held[key], {"q": held[f"{run}/q"]}


def _write_run(bag: BagWriter, names: list[str], times: Any, columns: dict[str, Any], begun: int) -> int:
    """Write one run; give its length [ns]. Labels of contact become marks."""
    fields = ("position", "velocity") if "dq" in columns else ("position",)
    states, torques = JointWriter(names, fields), JointWriter(names, ("effort",))
    moments = np.round((times.astype(np.float64) - float(times[0])) * 1e9).astype(np.int64)
    label = 0
    for k, moment in enumerate(moments.tolist()):
        stamp = (begun + moment - START) * 1e-9
        values = [columns[key][k].astype(np.float64) for key in ("q", "dq")[:len(fields)]]
        bag.write("/joint_states", states.write(stamp, *values), begun + moment)
        if "tau_ext" in columns:
            bag.write("/external_torques", torques.write(stamp, columns["tau_ext"][k].astype(np.float64)),
                      begun + moment)
        if "label" in columns and int(columns["label"][k]) != label:
            label = int(columns["label"][k])
            bag.mark("pressed" if label else "released", begun + moment)
    return int(moments.max())


def _topics(names: Sequence[str]) -> list[RecordedTopic]:
    return [RecordedTopic(name=name, type=message_type(find_topic(name).type), qos=(Qos(
        durability="transient_local" if find_topic(name).latched else "volatile"),)) for name in names]


def _write(out: Path, messages: Sequence[tuple[str, int, bytes]], settings: dict[str, Any],
           marks: Sequence[tuple[int, str]] = ()) -> None:
    topics = _topics(sorted({topic for topic, _, _ in messages}))
    with BagWriter(out, topics, chunk_bytes=1 << 20, flush_period=60.0,
                   custom={SETTINGS_KEY: json.dumps(settings)}) as bag:
        for topic, time, data in messages:
            bag.write(topic, data, time)
        for time, text in marks:
            bag.mark(text, time)


if __name__ == "__main__":
    command, *words = sys.argv[1:]
    if command == "lesson":
        record_lesson(words[0], words[1], words[2], int(words[3]), Path(words[4]))
    else:
        {"cut": cut, "faults": cut_faults, "real": real}[command](Path(words[0]), Path(words[1]))
