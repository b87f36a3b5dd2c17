"""Stands in for the person: presses the lesson's buttons, guides, pushes and ranks; sees only what a person sees."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.task import Future
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.msg import LessonState, PreferenceQuery, TeachingState
from unifeed_msgs.srv import AnswerQuery
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.types import Array, RobotState
from unifeed_ros.nodes.conversions import header, trajectory_from_msg
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.node import OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.simulation.person import SimulatedPerson
from unifeed_ros.simulation.tasks import TrueTask, measure


@dataclass(frozen=True, kw_only=True)
class TeacherConfig:
    """What the simulated person does."""

    feedback: str = "DDCCPP"
    """Inputs in order: D demonstration, C correction, P preference."""
    seed: int = 0
    """Seed of this person."""
    attempts: int = 3
    """Tries at an input that did not come through. A correction that changed nothing so often was none, and the
    person goes on; otherwise they give up."""
    resets: int = 2
    """Times that the person presses reset after a fault, before they give up."""
    patience: float = 2.0
    """Time that the person looks at a fault before they press reset [s]."""

    def __post_init__(self) -> None:
        """Refuse letters that mean nothing."""
        if set(self.feedback) - set("DCP"):
            raise ConfigError("feedback of the simulated person", expected="letters D, C and P", got=self.feedback)


class _Step(Enum):
    """Where the person is within one input."""

    WAIT = auto()
    BUTTON = auto()
    GUIDE = auto()
    WATCH = auto()
    JUDGE = auto()
    DONE = auto()


DONE, GAVE_UP = "done", "gave up"
"""How teaching ended, as the value "outcome" of the node's status."""
HAND_PERIOD = 0.0015
"""Simulated time that passes at least between two answers of the hand: every second state at 1 kHz [s]."""
BUTTONS = {"D": "start_demonstration", "C": "run", "P": "ask"}


class SimTeacherNode(UnifeedNode):
    """Go through the inputs one after the other, as a person would."""

    def __init__(self) -> None:
        super().__init__("sim_teacher")
        self._robot = self.load_robot()
        self._config = settings(self, "teacher", TeacherConfig)
        yardstick = measure(self._robot, TrueTask(scene=self.load_scene()))
        self._person = SimulatedPerson(yardstick, self._config.seed)
        self._reader = JointReader(self._robot.joint_names)
        self._joints: bytes | None = None
        self._lesson = LessonState()
        self._teaching = TeachingState()
        self._motion, self._watched, self._tracked = JointTrajectory(), "", False
        self._query: PreferenceQuery | None = None
        self._step, self._tries, self._done_before, self._passed = _Step.WAIT, 0, 0, 0
        self._answer: Future | None = None
        self._content = False
        self._resets_left = self._config.resets
        self._fault_seen: float | None = None
        self._pushing, self._felt = False, 0.0
        self._connect()

    def _connect(self) -> None:
        self._hand = self.advertise("hand_wrench")
        self.listen("joint_states", self._on_state, raw=True)
        self.listen("teaching_state", self._on_teaching)
        self.listen("trajectory", self._on_trajectory)
        self.listen("lesson_state", self._on_lesson)
        self.listen("preference_query", self._on_query)
        names = [*BUTTONS.values(), "finish_demonstration", "reset"]
        self._buttons = {name: self.create_client(Trigger, name) for name in names}
        self._answers = self.create_client(AnswerQuery, "answer_query")
        self.create_timer(0.05, self._tick, clock=self.steady)

    # What the person sees.

    def _on_teaching(self, msg: TeachingState) -> None:
        self._teaching = msg
        self._tracked = self._tracked or (bool(self._watched) and msg.motion_id == self._watched)

    def _on_lesson(self, msg: LessonState) -> None:
        self._lesson = msg

    def _on_query(self, msg: PreferenceQuery) -> None:
        self._query = msg

    def _on_trajectory(self, msg: JointTrajectory) -> None:
        self._motion = msg
        self._watch_motion()

    def _on_state(self, data: bytes) -> None:
        self._joints = data
        if not self._hand_is_used():
            if self._pushing:
                self._let_go()
            return
        if (state := self._arm_state()) is None:
            return
        if not 0.0 <= state.time - self._felt < HAND_PERIOD:
            self._felt = state.time
            wrench = self._person.hand_wrench(state.time, state.positions, state.velocities, self._teaching.motion_time)
            self._push(wrench, state.time)

    def _arm_state(self) -> RobotState | None:
        """Read the newest joint state; nearly all of them pass unread, because the hand is idle most of the time."""
        if self._joints is None:
            return None
        try:
            return self._reader.state(self._joints)
        except InputError as error:
            self.say(WARN, f"joint state skipped: {error}")
            return None

    # What the person does.

    def _watch_motion(self) -> None:
        """Look at the motion that the robot announced, once, if it is one to correct."""
        motion_id = self._motion.header.frame_id
        if self._step == _Step.WATCH and motion_id.startswith("run") and motion_id != self._watched:
            self._watched = motion_id
            motion = trajectory_from_msg(self._motion, self._robot.joint_names)
            self._content = not self._person.begin_correction(motion)

    def _hand_is_used(self) -> bool:
        if self._step == _Step.GUIDE:
            return True
        tracked = self._teaching.mode == TeachingMode.TRACK and self._teaching.motion_id == self._watched
        return self._step == _Step.WATCH and tracked

    def _push(self, wrench: Array, time: float) -> None:
        pushing = bool(np.any(wrench))
        if pushing or self._pushing:
            msg = WrenchStamped(header=header(time, self._robot.config.base_frame))
            for part, values in ((msg.wrench.force, wrench[:3]), (msg.wrench.torque, wrench[3:])):
                part.x, part.y, part.z = map(float, values)
            self._hand.publish(msg)
        self._pushing = pushing

    def _let_go(self) -> None:
        state = self._arm_state()
        if state is not None:
            self._push(np.zeros(6), state.time)

    def _tick(self) -> None:
        if self._lesson.phase == LessonState.FAULT:
            self._recover()
            return
        self._fault_seen = None
        {_Step.WAIT: self._wait, _Step.BUTTON: self._press, _Step.GUIDE: self._guide, _Step.WATCH: self._watch,
         _Step.JUDGE: self._judge, _Step.DONE: lambda: None}[self._step]()

    def _recover(self) -> None:
        """Press reset after a fault, and begin the input anew."""
        now = self.steady.now().nanoseconds * 1e-9
        self._fault_seen = self._fault_seen or now
        if self._resets_left > 0 and now - self._fault_seen > self._config.patience:
            self._let_go()
            self._resets_left -= 1
            self.say(WARN, f"reset after a fault: {self._lesson.message}")
            self._buttons["reset"].call_async(Trigger.Request())
            self._leave()

    def _wait(self) -> None:
        """Choose the next input once the lesson is ready."""
        if self._lesson.phase != LessonState.READY or self._joints is None:
            return
        if self._lesson.interactions > self._done_before:
            self._done_before, self._tries, self._content = self._lesson.interactions, 0, False
        if (self._content or self._tries >= self._config.attempts) and self._letter == "C":
            self._passed, self._tries, self._content = self._passed + 1, 0, False
            self.say(OK, f"has nothing to correct, and goes on: {self._lesson.message}")
        if self._done_before + self._passed >= len(self._config.feedback):
            self._step = _Step.DONE
            self.say(OK, "has shown everything", outcome=DONE, passed=self._passed)
            return
        if self._tries >= self._config.attempts:
            self._step = _Step.DONE
            self.say(WARN, f"gives up after {self._tries} tries: {self._lesson.message}", outcome=GAVE_UP)
            return
        self._tries += 1
        self._answer = self._buttons[BUTTONS[self._letter]].call_async(Trigger.Request())
        self._query = None
        self._step = _Step.BUTTON

    @property
    def _letter(self) -> str:
        return self._config.feedback[self._done_before + self._passed]

    def _press(self) -> None:
        """Wait for the button's answer, then begin."""
        if not self._answer.done():
            return
        answer = self._answer.result()
        self.say(OK if answer.success else WARN, f"{BUTTONS[self._letter]}: {answer.message}")
        if not answer.success:
            self._step = _Step.WAIT
        elif self._letter == "D":
            if self._lesson.phase == LessonState.DEMONSTRATING and self._teaching.mode == TeachingMode.GUIDE:
                state = self._arm_state()
                if state is not None:
                    self._person.begin_demonstration(state.positions)
                    self._step = _Step.GUIDE
        else:
            self._step = _Step.WATCH if self._letter == "C" else _Step.JUDGE
            self._watched, self._tracked = "", False
            self._watch_motion()

    def _guide(self) -> None:
        """Guide until the motion is shown, then press the button."""
        if self._lesson.phase != LessonState.DEMONSTRATING:
            self._step = _Step.WAIT
        elif self._person.finished:
            self._let_go()
            self._buttons["finish_demonstration"].call_async(Trigger.Request())
            self._leave()

    def _watch(self) -> None:
        ended = (LessonState.READY, LessonState.LEARNING, LessonState.RETURNING, LessonState.SHOWING)
        if self._tracked and self._lesson.phase in ended and self._teaching.motion_id != self._watched:
            self._let_go()
            self._leave()

    def _judge(self) -> None:
        """Answer the question once it has been asked."""
        if self._query is not None and self._lesson.phase == LessonState.ASKING:
            options = [trajectory_from_msg(o, self._robot.joint_names) for o in self._query.options]
            ranks = [int(r) for r in self._person.rank(options)]
            self._answers.call_async(AnswerQuery.Request(query_id=self._query.id, ranks=ranks))
            self._leave()

    def _leave(self) -> None:
        """The lesson goes on by itself now; the next input waits for the next message that says it is ready."""
        self._lesson = LessonState(phase=LessonState.LEARNING, interactions=self._lesson.interactions)
        self._step = _Step.WAIT


def main() -> int:
    """Run the node `sim_teacher`."""
    return run_node(SimTeacherNode)


if __name__ == "__main__":
    sys.exit(main())
