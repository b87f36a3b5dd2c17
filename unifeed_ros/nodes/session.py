"""The lesson: the paper's Algorithm 1 as a state machine that a person steps through in any order."""

from __future__ import annotations

import queue
import sys
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.action import ExecuteTrajectory, OptimizeTrajectory
from unifeed_msgs.msg import Feedback, Interaction, LessonState, RewardModel, TeachingState
from unifeed_msgs.srv import SelectQuery, SetMode, TrainReward
from unifeed_ros.core.control.silence import Silence
from unifeed_ros.core.errors import ConfigError, UnifeedError
from unifeed_ros.core.reward.storage import save_model
from unifeed_ros.nodes.control import ControlDesk
from unifeed_ros.nodes.conversions import context_to_msg, model_from_msg
from unifeed_ros.nodes.lifecycle import Activator
from unifeed_ros.nodes.node import DIAGNOSTICS_PREFIX, ERROR, OK, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.waiting import Interrupted, LessonError, Waiting

LETTERS = {Feedback.DEMONSTRATION: "D", Feedback.CORRECTION: "C", Feedback.PREFERENCE: "P"}
STATE_PERIOD = 0.1
"""Time between two messages on `lesson_state` [s]."""
STEADY_GAP, STEADY_PATIENCE = 0.1, 20.0
"""Time without a state of the arm that counts as a gap, and the longest wait for states without gaps [s]."""
FINAL_PHASES = (LessonState.READY, LessonState.PAUSED, LessonState.FAULT)


@dataclass(frozen=True, kw_only=True)
class SessionConfig:
    """How a lesson runs."""

    show_options: bool = True
    """True: the arm carries out both motions of a question before it is asked."""
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
        self._start = self._robot.inverse_kinematics(self._scene.start, self._scene.axis)
        self._phase, self._message = LessonState.WAITING, "waiting for the other nodes"
        self._taught: list[str] = []
        self._plan: JointTrajectory | None = None
        self._plan_version = 0
        self._shown: list[JointTrajectory] = []
        self._model: RewardModel | None = None
        self._feedback: queue.Queue[Feedback] = queue.Queue()
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._waiting = Waiting(self, lambda: self._message if self._phase == LessonState.FAULT else "")
        self._goal: Any = None
        self._back: threading.Thread | None = None
        self._silences: dict[str, Silence] = {}
        self._teaching: TeachingState | None = None
        self._heard = self._steady_since = 0.0
        self._connect()
        self._worker = threading.Thread(target=self._work, name="lesson", daemon=True)
        self._worker.start()

    def _connect(self) -> None:
        self._states = self.advertise("lesson_state")
        self._interactions = self.advertise("interaction")
        self._queries = self.advertise("preference_query")
        self.listen("feedback", self._feedback.put)
        self.listen("reward_model", self._on_model)
        self.listen("teaching_state", self._on_teaching)
        self.listen("diagnostics", self._on_diagnostics)
        self._set_mode = self.create_client(SetMode, "set_mode")
        self._stop = self.create_client(Trigger, "stop")
        self._activator = Activator(self, "shared_control")
        self._train = self.create_client(TrainReward, "train_reward")
        self._select = self.create_client(SelectQuery, "select_query")
        self._optimize = ActionClient(self, OptimizeTrajectory, "optimize_trajectory")
        self._execute = ActionClient(self, ExecuteTrajectory, "execute_trajectory")
        for name, serve in {"start_demonstration": self._on_start, "finish_demonstration": self._on_finish,
                            "run": self._on_run, "pause": self._on_pause, "ask": self._on_ask, "save": self._on_save,
                            "reset": self._on_reset}.items():
            self.create_service(Trigger, name, serve)
        ControlDesk(self)
        self.create_timer(STATE_PERIOD, self._tick, clock=self.steady)

    # Callbacks: store, check, queue.

    def _on_model(self, msg: RewardModel) -> None:
        self._model = msg

    def _on_teaching(self, msg: TeachingState) -> None:
        now = time.monotonic()
        if now - self._heard > STEADY_GAP:
            self._steady_since = now
        self._teaching, self._heard = msg, now

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
            self._cancel()
        stopped = self._teaching is not None and self._teaching.mode == TeachingState.STOPPED
        if stopped and self._phase == LessonState.DEMONSTRATING:  # a motion's end says it; here nobody would
            self._fault(f"the arm {self._teaching.message}; reset, then start_demonstration")
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
        self._cancel()
        response.success, response.message = True, "pausing; run or reset goes on"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        dead = self._dead_nodes()
        if dead:
            response.success, response.message = False, f"{', '.join(dead)} not running; start it, then reset"
            return response
        self._waiting.interrupt.set()
        self._cancel()
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
                    self._end_return()
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
        while (missing := self._dead_nodes()) or self._teaching is None:
            said_now = f"waiting for {', '.join(missing) or 'the arm'}"
            if said_now != said:
                self._enter(LessonState.WAITING, said := said_now)
            time.sleep(0.1)
        patience = time.monotonic() + STEADY_PATIENCE
        while time.monotonic() < min(patience, self._steady_since + self._config.steady):
            time.sleep(0.05)
        self._activator.activate(self._waiting)
        self._mode(SetMode.Request.HOLD)
        self._return_to_start()
        self._ready("ready: start_demonstration, run or ask")

    def _demonstrate(self) -> None:
        self._drain_feedback()
        self._mode(SetMode.Request.GUIDE)
        self._enter(LessonState.DEMONSTRATING, "the arm is weightless: guide it, then finish_demonstration")

    def _finish_demonstration(self) -> None:
        ended = time.monotonic()
        self._mode(SetMode.Request.HOLD)
        items = self._captured(Feedback.DEMONSTRATION)
        if not items:
            self._return_to_start()
            self._ready("no demonstration was found: the arm hardly moved; start_demonstration tries again")
            return
        self._learn_and_show(Feedback.DEMONSTRATION, items, ended)

    def _run(self) -> None:
        """Carry out the newest plan; pushes become corrections."""
        self._return_to_start()
        self._drain_feedback()
        if self._plan is None or self._plan_is_old():
            self._plan_anew()
        self._enter(LessonState.RUNNING, "the arm moves: push it where it should move differently")
        result = self._executed(self._plan, "run")
        ended = time.monotonic()
        items = self._captured(Feedback.CORRECTION) if result.touched else []
        if not items:
            self._return_to_start()
            self._ready("the push changed nothing" if result.touched else "nobody touched the arm")
            return
        self._learn_and_show(Feedback.CORRECTION, items, ended)

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
            self._return_to_start()
            self._enter(LessonState.SHOWING, f"option {chr(ord('A') + k)}: watch, do not touch")
            self._executed(option, f"option {chr(ord('A') + k)}")
        self._enter(LessonState.ASKING, "which motion was better? answer_query takes the ranks")
        self._queries.publish(chosen.query)
        self._begin_return()
        answer = self._next_feedback(Feedback.PREFERENCE, None)
        ended = time.monotonic()
        if not answer.ranks:
            self._end_return()
            self._return_to_start()
            self._ready("neither was good: noted, nothing learned from it")
            return
        self._learn_and_show(Feedback.PREFERENCE, [answer], ended)

    def _learn_and_show(self, kind: int, items: list[Feedback], ended: float) -> None:
        """Train, plan and move back at the same time; then show the new motion in a run that nobody needs to touch."""
        self._enter(LessonState.LEARNING, f"learning from {len(items)} input{'s' if len(items) > 1 else ''}")
        self._begin_return()
        trained = self._waiting.call(self._train, TrainReward.Request(), 120.0)
        if not trained.success:
            raise LessonError(f"not learned: {trained.message}", mend="undo_feedback takes an input back; then reset")
        self._enter(LessonState.PLANNING, "planning the new motion")
        planned = self._plan_anew()
        self._end_return()
        ready = time.monotonic() - ended
        self._return_to_start()
        self._enter(LessonState.SHOWING, "showing what was learned")
        self._drain_feedback()
        result = self._executed(self._plan, "show")
        self._shown.append(result.executed)
        self._taught.append(LETTERS[kind])
        self._interactions.publish(Interaction(
            header=self._header(), index=len(self._taught), kind=kind, feedback_ids=[item.id for item in items],
            model_version=trained.version, train_s=trained.seconds, plan_s=planned.seconds, feedback_to_motion_s=ready,
            planned=self._plan, executed=result.executed, touched=result.touched))
        pushes = self._captured(Feedback.CORRECTION) if result.touched else []
        if pushes:
            self._learn_and_show(Feedback.CORRECTION, pushes, time.monotonic())
            return
        self._return_to_start()
        self._ready("ready: start_demonstration, run or ask")

    # Steps that wait on other nodes.

    def _plan_is_old(self) -> bool:
        """Say whether a reward was learned since the plan was made, as after an undo."""
        return self._model is not None and self._model.version > self._plan_version

    def _plan_anew(self) -> OptimizeTrajectory.Result:
        result = self._optimized()
        self._plan, self._plan_version = result.trajectory, result.model_version
        return result

    def _optimized(self, *, smoothest: bool = False, start: np.ndarray | None = None) -> OptimizeTrajectory.Result:
        goal = OptimizeTrajectory.Goal(context=context_to_msg(self._scene.context()), smoothest=smoothest)
        if smoothest:
            goal.start, goal.goal = list(map(float, start)), list(map(float, self._start))
        result, status = self._waiting.act(self._optimize, goal, 60.0)
        if status != GoalStatus.STATUS_SUCCEEDED or not result.success:
            raise LessonError(f"no motion: {result.message or 'the optimizer gave up'}", mend="reset goes on")
        return result

    def _executed(self, trajectory: JointTrajectory, name: str) -> ExecuteTrajectory.Result:
        goal = ExecuteTrajectory.Goal(trajectory=trajectory, motion_id=f"{name} {uuid.uuid4().hex[:8]}")
        result, status = self._waiting.act(self._execute, goal, None, self._set_goal)
        if status != GoalStatus.STATUS_SUCCEEDED:
            raise LessonError(f"motion stopped: {result.message or 'the controller gave up'}", mend="reset goes on")
        return result

    def _return_to_start(self) -> None:
        here = self._arm_positions()
        if float(np.abs(here - self._start).max()) < 0.01:
            return
        if self._phase not in (LessonState.ASKING, LessonState.LEARNING, LessonState.PLANNING):
            self._enter(LessonState.RETURNING, "moving back to the start")
        self._executed(self._optimized(smoothest=True, start=here).trajectory, "return")

    def _begin_return(self) -> None:
        """Move back to the start while the lesson goes on, unless the arm is on its way already."""
        if self._back is None:
            self._back = threading.Thread(target=self._return_quietly, name="return")
            self._back.start()

    def _end_return(self) -> None:
        """Wait until the arm that was sent back is there."""
        if self._back is not None:
            self._back.join()
            self._back = None

    def _return_quietly(self) -> None:
        """Move back; a failure here is met again by the move before the next motion."""
        try:
            self._return_to_start()
        except (UnifeedError, Interrupted) as error:
            self.get_logger().warning(f"moving back: {error or 'interrupted'}")

    def _mode(self, mode: int) -> None:
        response = self._waiting.call(self._set_mode, SetMode.Request(mode=mode), 2.0)
        if not response.success:
            raise LessonError(f"mode not changed: {response.message}", mend="reset goes on")

    def _captured(self, kind: int) -> list[Feedback]:
        """Collect what capture made of the motion that just ended."""
        try:
            items = [self._next_feedback(kind, self._config.capture_timeout)]
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

    def _arm_positions(self) -> np.ndarray:
        return np.array(self._teaching.positions)

    def _set_goal(self, handle: Any) -> None:
        self._goal = handle

    def _cancel(self) -> None:
        goal = self._goal
        if goal is not None:
            goal.cancel_goal_async()

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
        msg.stamp = self._teaching.header.stamp if self._teaching is not None else self.get_clock().now().to_msg()
        return msg

    def close(self) -> None:
        """End the worker; the controller holds the arm."""
        self._waiting.interrupt.set()
        self._cancel()
        self._jobs.put(None)
        self._worker.join(timeout=1.0)


def main() -> int:
    """Run the node `session`."""
    return run_node(SessionNode)


if __name__ == "__main__":
    sys.exit(main())
