"""The lesson: the paper's Algorithm 1 as a state machine that a person steps through in any order."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import Feedback, Interaction, LessonState, RewardModel
from unifeed_msgs.srv import SelectQuery, SetMode, TrainReward
from unifeed_ros.core.control.silence import Silence
from unifeed_ros.core.errors import ConfigError, UnifeedError
from unifeed_ros.core.reward.storage import save_model
from unifeed_ros.nodes.control import ControlDesk
from unifeed_ros.nodes.conversions import context_to_msg, model_from_msg, seconds
from unifeed_ros.nodes.lifecycle import Activator
from unifeed_ros.nodes.motions import Motion, Motions
from unifeed_ros.nodes.node import DIAGNOSTICS_PREFIX, ERROR, OK, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.waiting import Interrupted, LessonError, Waiting

LETTERS = {Feedback.DEMONSTRATION: "D", Feedback.CORRECTION: "C", Feedback.PREFERENCE: "P"}
STATE_PERIOD = 0.1
"""Time between two messages on `lesson_state` [s]."""
STEADY_PATIENCE = 20.0
"""Longest wait for states of the arm without gaps [s]."""
LAST_PUSH_S = 0.3
"""Wait for a push that lasted to the end of a motion in which others were captured before [s]."""


@dataclass(frozen=True, kw_only=True)
class SessionConfig:
    """How a lesson runs."""

    show_options: bool = True
    """True: the arm carries out both motions of a question before it is asked."""
    hand_back_patience: float = 1.0
    """How long the arm waits where it was pushed to, while the rest of its motion is learned and planned anew; 0: the
    arm comes back to its motion at once, and what was shown is learned when that has ended [s]."""
    capture_timeout: float = 2.0
    """Longest wait for what capture made of a motion [s]."""
    node_timeout: float = 5.0
    """A node that says nothing on /diagnostics for this long counts as dead [s]."""
    steady: float = 3.0
    """How long the arm's states must have come without a gap before it is led [s]: nodes that just met may stall."""
    required_nodes: tuple[str, ...] = ("shared_control", "capture", "reward_learner", "trajectory_optimizer")
    """Nodes without which no lesson runs."""
    save_folder: str = ""
    """Folder that `save` writes models to; empty: the working folder."""

    def __post_init__(self) -> None:
        """Reject waits that never end or never begin."""
        object.__setattr__(self, "required_nodes", tuple(self.required_nodes))
        if not (self.capture_timeout > 0 and self.node_timeout > 1.0 and self.steady >= 0.0):
            raise ConfigError("session times", expected="capture_timeout > 0 s, node_timeout > 1 s, steady >= 0 s",
                              got=f"{self.capture_timeout} s, {self.node_timeout} s, {self.steady} s")
        if not 0.0 <= self.hand_back_patience <= 60.0:
            raise ConfigError("hand_back_patience", expected="0 to 60 s", got=self.hand_back_patience)


@dataclass
class _Run:
    """A motion that was carried out, and what the person made of it."""

    executed: JointTrajectory = field(default_factory=JointTrajectory)
    """What the arm did, up to where a push changed the rest."""
    touched: bool = False
    """Whether somebody touched the arm."""
    pushes: list[Feedback] = field(default_factory=list)
    """The corrections, in order."""
    trained: TrainReward.Response | None = None
    """What was learned of them on the way; None if nothing was, or not of all."""
    hand_over_s: float | None = None
    """Time from the end of the first push to the new motion, on the arm's clock [s]; None where there was none."""


class SessionNode(UnifeedNode):
    """Walk a person through a lesson.

    Services only check and queue; one worker thread carries the steps out one after the other and waits on futures
    that the executor's thread completes.
    """

    answers_later = True

    def __init__(self) -> None:
        super().__init__("session")
        self._robot = self.load_robot()
        self._scene = self.load_scene()
        self._config = settings(self, "session", SessionConfig)
        self._phase, self._message = LessonState.WAITING, "waiting for the other nodes"
        self._taught: list[str] = []
        self._plan: JointTrajectory | None = None
        self._plan_version = 0
        self._shown: list[JointTrajectory] = []
        self._model: RewardModel | None = None
        self._feedback: queue.Queue[Feedback] = queue.Queue()
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._waiting = Waiting(self, lambda: self._message if self._phase == LessonState.FAULT else "")
        start = self._robot.inverse_kinematics(self._scene.start, self._scene.axis)
        self._motions = Motions(self, start, self._scene.context(), self._waiting, self._on_return)
        self._silences: dict[str, Silence] = {}
        self._connect()
        self._worker = threading.Thread(target=self._work, name="lesson", daemon=True)
        self._worker.start()

    def _connect(self) -> None:
        self._states = self.advertise("lesson_state")
        self._interactions = self.advertise("interaction")
        self._queries = self.advertise("preference_query")
        self.listen("feedback", self._feedback.put)
        self.listen("reward_model", self._on_model)
        self.listen("diagnostics", self._on_diagnostics)
        self._set_mode = self.create_client(SetMode, "set_mode")
        self._stop = self.create_client(Trigger, "stop")
        self._activator = Activator(self, "shared_control")
        self._train = self.create_client(TrainReward, "train_reward")
        self._select = self.create_client(SelectQuery, "select_query")
        for name, serve in {"start_demonstration": self._on_start, "finish_demonstration": self._on_finish,
                            "run": self._on_run, "pause": self._on_pause, "ask": self._on_ask, "save": self._on_save,
                            "reset": self._on_reset}.items():
            self.create_service(Trigger, name, serve)
        ControlDesk(self)
        self.create_timer(STATE_PERIOD, self._tick, clock=self.steady)

    # Callbacks: store, check, queue.

    def _on_model(self, msg: RewardModel) -> None:
        self._model = msg

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            name = status.name.removeprefix(DIAGNOSTICS_PREFIX)
            self._silences.setdefault(name, Silence(STATE_PERIOD)).end()

    def _tick(self) -> None:
        dead = self._dead_nodes() if self._phase != LessonState.WAITING else []
        told = f"{', '.join(dead)} died: the arm is stopped, what was taught is kept; start it again, then reset"
        if dead and self._message != told:  # also after another fault, which may have come of the death
            self._fault(told)
            self._stop.call_async(Trigger.Request())
            self._motions.cancel()
        if self._motions.lost and self._phase != LessonState.FAULT:
            self._fault("shared_control was started anew during a motion; reset goes on")
            self._motions.cancel()
        if self._motions.stopped and self._phase == LessonState.DEMONSTRATING:  # else a motion's end says it
            self._fault(f"the arm {self._motions.teaching.message}; reset, then start_demonstration")
        self._publish_state()

    def _dead_nodes(self) -> list[str]:
        now = time.monotonic()
        silent = {name: silence.look(now) for name, silence in self._silences.items()}
        return [n for n in self._config.required_nodes if silent.get(n, np.inf) > self._config.node_timeout]

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._accept(response, (LessonState.READY,), self._demonstrate,
                            "the arm becomes weightless: guide it, then call finish_demonstration")

    def _on_finish(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._accept(response, (LessonState.DEMONSTRATING,), self._finish_demonstration,
                            "learning from the demonstration")

    def _on_run(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._accept(response, (LessonState.READY, LessonState.PAUSED), self._run,
                            "the arm moves: push it where it should move differently")

    def _on_ask(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._accept(response, (LessonState.READY,), self._ask, "choosing a question")

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._phase in (LessonState.WAITING, LessonState.FAULT, LessonState.PAUSED):
            response.success, response.message = False, f"nothing to pause: {self._message}"
            return response
        self._waiting.interrupt.set()
        self._motions.cancel()
        response.success, response.message = True, "pausing; run or reset goes on"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        dead = self._dead_nodes()
        if dead:
            response.success, response.message = False, f"{', '.join(dead)} not running; start it, then reset"
            return response
        self._waiting.interrupt.set()
        self._motions.cancel()
        self._enter(LessonState.WAITING, "resetting")
        self._jobs.put(self._prepare)
        response.success, response.message = True, "moving back to the start; what was taught is kept"
        return response

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._model is None:
            response.success, response.message = False, "nothing was learned yet: teach something first"
            return response
        folder = Path(self._config.save_folder or ".")
        try:
            path = save_model(folder / f"reward_model_{self._model.version}.safetensors", model_from_msg(self._model))
        except (OSError, UnifeedError) as error:
            response.success, response.message = False, f"not saved: {error}"
            return response
        response.success, response.message = True, f"saved {path}"
        return response

    def _accept(self, response: Trigger.Response, phases: tuple[int, ...], job: Callable[[], None],
                message: str) -> Trigger.Response:
        if self._phase not in phases or not self._jobs.empty():
            response.success, response.message = False, f"not now: {self._message}"
            return response
        self._jobs.put(job)
        response.success, response.message = True, message
        return response

    # The worker's thread: steps of the lesson.

    def _work(self) -> None:
        self._jobs.put(self._prepare)
        while (job := self._jobs.get()) is not None:
            self._waiting.interrupt.clear()
            try:
                try:
                    job()
                finally:
                    self._motions.end_return()
            except Interrupted:
                if self._phase != LessonState.FAULT:
                    self._enter(LessonState.PAUSED, "paused: run or reset goes on")
            except UnifeedError as error:
                if self._phase != LessonState.FAULT:  # else the step ended because of a fault that was told already
                    self._fault(str(error))

    def _prepare(self) -> None:
        """Wait for the nodes and for the arm's state, then move to the start."""
        self._enter(LessonState.WAITING, "waiting for the other nodes")
        said = ""
        while (missing := self._dead_nodes()) or self._motions.teaching is None:
            said_now = f"waiting for {', '.join(missing) or 'the arm'}"
            if said_now != said:
                self._enter(LessonState.WAITING, said := said_now)
            time.sleep(0.1)
        patience = time.monotonic() + STEADY_PATIENCE
        while time.monotonic() < min(patience, self._motions.steady_since + self._config.steady):
            time.sleep(0.05)
        self._activator.activate(self._waiting)
        self._mode(SetMode.Request.HOLD)
        self._motions.return_to_start()
        self._ready("ready: start_demonstration, run or ask")

    def _demonstrate(self) -> None:
        self._drain_feedback()
        self._mode(SetMode.Request.GUIDE)
        self._enter(LessonState.DEMONSTRATING, "the arm is weightless: guide it, then finish_demonstration")

    def _finish_demonstration(self) -> None:
        ended = time.monotonic()
        self._mode(SetMode.Request.HOLD)
        items = self._captured(Feedback.DEMONSTRATION, self._config.capture_timeout)
        if not items:
            self._motions.return_to_start()
            self._ready("no demonstration was found: the arm hardly moved; start_demonstration tries again")
            return
        self._learn_and_show(Feedback.DEMONSTRATION, items, ended)

    def _run(self) -> None:
        """Carry out the newest plan; pushes become corrections."""
        self._motions.return_to_start()
        self._drain_feedback()
        if self._plan is None or self._plan_is_old():
            self._plan_anew()
        self._enter(LessonState.RUNNING, "the arm moves: push it where it should move differently")
        run = self._carried_out(self._plan, "run")
        if not run.pushes:
            self._motions.return_to_start()
            self._ready("the push changed nothing" if run.touched else "nobody touched the arm")
            return
        self._learn_and_show(Feedback.CORRECTION, run.pushes, time.monotonic(), run)

    def _ask(self) -> None:
        """Choose a question, show its motions, wait for the answer, learn from it."""
        if self._plan is None:
            raise LessonError("no motion to ask about", mend="teach a demonstration or run first, then reset")
        self._enter(LessonState.PLANNING, "choosing a question")
        if self._plan_is_old():
            self._plan_anew()
        request = SelectQuery.Request(
            candidates=[self._plan, *self._shown], context=context_to_msg(self._scene.context())
        )
        chosen = self._waiting.call(self._select, request, 30.0)
        if not chosen.success:
            self._ready(f"no question: {chosen.message}")
            return
        self._drain_feedback()
        for k, option in enumerate(chosen.query.options if self._config.show_options else []):
            self._motions.return_to_start()
            self._enter(LessonState.SHOWING, f"option {chr(ord('A') + k)}: watch, do not touch")
            self._motions.carry_out(option, f"option {chr(ord('A') + k)}")
        self._enter(LessonState.ASKING, "which motion was better? answer_query takes the ranks")
        self._queries.publish(chosen.query)
        self._motions.begin_return()
        answer = self._next_feedback(Feedback.PREFERENCE, None)
        ended = time.monotonic()
        if not answer.ranks:
            self._motions.end_return()
            self._motions.return_to_start()
            self._ready("neither was good: noted, nothing learned from it")
            return
        self._learn_and_show(Feedback.PREFERENCE, [answer], ended)

    def _learn_and_show(self, kind: int, items: list[Feedback], ended: float, run: _Run | None = None) -> None:
        """Learn, plan and move back at the same time; then show the new motion in a run that nobody needs to touch.

        Args:
            kind: Of the input.
            items: What was captured of it.
            ended: When it ended; steady time [s].
            run: The run in which it was given, if it was a correction.
        """
        self._enter(LessonState.LEARNING, f"learning from {len(items)} input{'s' if len(items) > 1 else ''}")
        self._motions.begin_return()
        trained = run.trained if run is not None and run.trained is not None else self._learned(items)
        self._enter(LessonState.PLANNING, "planning the new motion")
        planned = self._plan_anew(trained.version)
        self._motions.end_return()
        ready = time.monotonic() - ended
        self._motions.return_to_start()
        self._enter(LessonState.SHOWING, "showing what was learned")
        self._drain_feedback()
        shown = self._carried_out(self._plan, "show")
        if not shown.pushes:
            self._shown.append(shown.executed)
        self._taught.append(LETTERS[kind])
        self._interactions.publish(Interaction(
            header=self._header(), index=len(self._taught), kind=kind, feedback_ids=[item.id for item in items],
            model_version=trained.version, train_s=trained.seconds, plan_s=planned.seconds,
            feedback_to_motion_s=ready if run is None or run.hand_over_s is None else run.hand_over_s,
            planned=self._plan, executed=shown.executed, touched=shown.touched))
        if shown.pushes:
            self._learn_and_show(Feedback.CORRECTION, shown.pushes, time.monotonic(), shown)
            return
        self._motions.return_to_start()
        self._ready("ready: start_demonstration, run or ask")

    def _carried_out(self, trajectory: JointTrajectory, name: str) -> _Run:
        """Carry out a motion; when the person lets go after a push, the rest goes on as they showed."""
        run, patience = _Run(), self._config.hand_back_patience
        motion = self._motions.begin(trajectory, name, patience)
        while (push := self._push_in(motion)) is not None:
            run.pushes.append(push)
            run.trained = None
            other = self._changed(motion, run, push) if patience > 0.0 else None
            if other is not None:
                broken_off, _ = self._waiting.end(motion.action, None)
                run.executed = run.executed if run.executed.points else broken_off.executed
                motion = other
        last = self._motions.end(motion)
        run.executed = run.executed if run.executed.points else last.executed
        run.touched = bool(last.touched or run.pushes)
        timeout = LAST_PUSH_S if run.pushes else self._config.capture_timeout
        late = self._captured(Feedback.CORRECTION, timeout) if last.touched else []
        if late:
            run.pushes, run.trained = [*run.pushes, *late], None
        return run

    def _push_in(self, motion: Motion) -> Feedback | None:
        """Wait for what the person changes in a motion; None when the motion has ended."""
        try:
            return self._waiting.next(self._feedback, lambda item: item.kind == Feedback.CORRECTION, None,
                                      ended=lambda: motion.ended)
        except queue.Empty:
            return None

    def _changed(self, motion: Motion, run: _Run, push: Feedback) -> Motion | None:
        """Learn from a push that has ended, and replace the rest of the motion; None if it goes on as it was."""
        phase = self._phase
        try:
            self._enter(phase, "learning from the push: the arm waits where it was left")
            run.trained = self._learned([push])
            rest = self._motions.plan_rest(run.trained.version)
            begun = rest and self._motions.replace(motion, rest.trajectory, "rest", self._config.hand_back_patience)
        except LessonError as error:  # what was shown is kept: it is learned from when the motion has ended
            self.get_logger().warning(f"the motion is not changed on its way: {error}")
            begun = None
        if not begun:
            self._enter(phase, "the motion goes on; what was shown changes the next one")
            return None
        other, began = begun
        waited = seconds(began.header.stamp) - seconds(push.header.stamp)
        run.hand_over_s = run.hand_over_s or waited
        self._enter(phase, f"goes on as shown, {waited:.2f} s after the push")
        return other

    def _learned(self, items: list[Feedback]) -> TrainReward.Response:
        request = TrainReward.Request(feedback_ids=[item.id for item in items])
        trained = self._waiting.call(self._train, request, 120.0)
        if not trained.success:
            raise LessonError(f"not learned: {trained.message}", mend="undo_feedback takes an input back; then reset")
        return trained

    # Steps that wait on other nodes.

    def _plan_is_old(self) -> bool:
        """Say whether a reward was learned since the plan was made, as after an undo."""
        return self._model is not None and self._model.version > self._plan_version

    def _plan_anew(self, version: int = 0) -> OptimizeTrajectory.Result:
        result = self._motions.plan(version=version)
        self._plan, self._plan_version = result.trajectory, result.model_version
        return result

    def _mode(self, mode: int) -> None:
        response = self._waiting.call(self._set_mode, SetMode.Request(mode=mode), 2.0)
        if not response.success:
            raise LessonError(f"mode not changed: {response.message}", mend="reset goes on")

    def _on_return(self) -> None:
        if self._phase not in (LessonState.ASKING, LessonState.LEARNING, LessonState.PLANNING):
            self._enter(LessonState.RETURNING, "moving back to the start")

    def _captured(self, kind: int, timeout: float) -> list[Feedback]:
        """Collect what capture made of the motion that just ended."""
        try:
            items = [self._next_feedback(kind, timeout)]
        except queue.Empty:
            return []
        time.sleep(0.1)  # several corrections of one run come in one burst
        while not self._feedback.empty():
            item = self._feedback.get_nowait()
            if item.kind == kind:
                items.append(item)
        return items

    def _next_feedback(self, kind: int, timeout: float | None) -> Feedback:
        return self._waiting.next(self._feedback, lambda item: item.kind == kind, timeout)

    def _drain_feedback(self) -> None:
        while not self._feedback.empty():
            self._feedback.get_nowait()

    # Phases.

    def _ready(self, message: str) -> None:
        self._enter(LessonState.READY, message)

    def _enter(self, phase: int, message: str) -> None:
        """Go on to a phase; a fault is only left by a reset, whatever a step was about to do."""
        if self._phase == LessonState.FAULT and phase != LessonState.WAITING:
            raise LessonError(self._message, mend="reset goes on")
        self._phase, self._message = phase, message
        self.say(OK, message, taught="".join(self._taught))
        self._publish_state()

    def _fault(self, message: str) -> None:
        self._phase, self._message = LessonState.FAULT, message
        self.say(ERROR, message, taught="".join(self._taught))
        self._publish_state()

    def _publish_state(self) -> None:
        self._states.publish(LessonState(
            header=self._header(), phase=self._phase, interactions=len(self._taught), taught="".join(self._taught),
            message=self._message))

    def _header(self) -> Any:
        msg = LessonState().header
        msg.frame_id = self._robot.config.base_frame
        teaching = self._motions.teaching
        msg.stamp = teaching.header.stamp if teaching is not None else self.get_clock().now().to_msg()
        return msg

    def close(self) -> None:
        """End the worker; the controller holds the arm."""
        self._waiting.interrupt.set()
        self._motions.cancel()
        self._jobs.put(None)
        self._worker.join(timeout=1.0)


def main() -> int:
    """Run the node `session`."""
    return run_node(SessionNode)


if __name__ == "__main__":
    sys.exit(main())
