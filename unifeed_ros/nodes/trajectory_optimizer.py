"""Turns the learned reward into motions (paper eq. M10); a worker plans, the node goes on answering."""

from __future__ import annotations

import sys
import threading

import numpy as np
from rclpy.action.server import ServerGoalHandle

from unifeed_msgs.action import OptimizeTrajectory
from unifeed_msgs.msg import RewardModel
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import InputError, PlanningError, UnifeedError
from unifeed_ros.core.planning.plan import Plan, PlannerConfig, PlanProgress, ToolGoal, plan_motion
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.types import Array, Context
from unifeed_ros.nodes.conversions import constrained, context_from_msg, model_from_msg, trajectory_to_msg
from unifeed_ros.nodes.deferred import DeferredActionServer
from unifeed_ros.nodes.node import OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.real_time import set_niceness
from unifeed_ros.nodes.spin import run_node

NICENESS = 5
"""Priority given up, so that planning never delays the control loop on a machine with few cores."""


class TrajectoryOptimizerNode(UnifeedNode):
    """Answer `optimize_trajectory` with the newest reward model."""

    def __init__(self) -> None:
        super().__init__("trajectory_optimizer")
        set_niceness(NICENESS)
        self._robot = self.load_robot()
        self._scene = self.load_scene()
        self._config = settings(self, "planner", PlannerConfig)
        self._control = settings(self, "control", ControlConfig)
        self._start = self._robot.inverse_kinematics(self._scene.start, self._scene.axis)
        self._goal = self._robot.inverse_kinematics(self._scene.goal, self._scene.axis, seed=self._start)
        self._model: RewardEnsemble | None = None
        self._last: Array | None = None
        self._previews = self.advertise("trajectory_preview")
        self.listen("reward_model", self._on_model)
        self._server = DeferredActionServer(self, OptimizeTrajectory, "optimize_trajectory", self._on_execute)
        self.say(OK, "no reward model yet: the smoothest motion is planned")

    def _on_model(self, msg: RewardModel) -> None:
        try:
            model = model_from_msg(msg)
            if model.robot != self._robot.config.name:
                raise InputError("reward model of another robot", expected=self._robot.config.name, got=model.robot)
            model.bind(self._scene.context())  # refuses a model of other objects
        except UnifeedError as error:
            self.say(WARN, f"reward model {msg.version} was not taken: {error}")
            return
        self._model = model
        self.say(OK, f"plans with reward model {model.version}")

    def _on_execute(self, handle: ServerGoalHandle) -> None:
        threading.Thread(target=self._plan, args=(handle, self._model), name="planning").start()

    def _plan(self, handle: ServerGoalHandle, model: RewardEnsemble | None) -> None:
        """Plan in a thread of its own; whatever happens reaches the action's result."""
        result, status = OptimizeTrajectory.Result(status="infeasible"), "infeasible"
        try:
            goal = handle.request
            model = None if goal.smoothest else model
            context = context_from_msg(goal.context) if goal.context.task else self._scene.context()
            plan = self._search(handle, model, context)
            self._fill(result, plan, model, context)
            status = plan.status
        except UnifeedError as error:
            result.message = str(error)
        except Exception as error:  # a fault of the search must not leave the action without a result
            self.get_logger().error(f"planning failed: {error!r}")
            result.message = str(PlanningError("planning failed", got=repr(error), mend="see the log"))
        self._server.finish(handle, lambda _: self._conclude(handle, result, status))

    def _conclude(self, handle: ServerGoalHandle, result: OptimizeTrajectory.Result,
                  status: str) -> OptimizeTrajectory.Result:
        if status == "canceled":
            handle.canceled()
        elif result.success:
            self._previews.publish(result.trajectory)
            handle.succeed()
        else:
            handle.abort()
        return result

    def _search(self, handle: ServerGoalHandle, model: RewardEnsemble | None, context: Context) -> Plan:
        goal = handle.request
        config = self._config.adjusted(waypoints=goal.waypoints, time_budget=goal.time_budget, goal=goal.goal_kind,
                                       jerk_limit=goal.jerk_limit, kappa=goal.kappa)
        if goal.goal and goal.goal_kind not in ("", "posture"):
            raise InputError("goal_kind of a request with joint positions as its goal", expected="posture",
                             got=goal.goal_kind, mend="leave goal empty, or goal_kind")
        start = self._robot.require_state(goal.start, "start") if goal.start else self._start
        end = self._robot.require_state(goal.goal, "goal") if goal.goal else self._goal_posture(context)
        whole = not goal.smoothest and not goal.start  # only whole motions begin where the next ones do
        seeds = [self._last] if self._last is not None and whole and len(self._last) == config.waypoints else []
        line = self._robot.tool_states(np.linspace(start, end, config.waypoints))  # where members are compared
        plan = plan_motion(
            self._robot,
            model.bind(context, config.kappa, line) if model else None,
            start,
            end if goal.goal or goal.smoothest else self._fixed_goal(config, context, end),
            duration=goal.duration or (0.0 if goal.smoothest else self._scene.duration),
            scene=constrained(self._scene, goal).limited(self._control.tool_speed, self._control.workspace),
            config=config,
            on_iteration=lambda progress: self._on_iteration(handle, progress),
            should_stop=lambda: handle.is_cancel_requested,
            seeds=seeds,
        )
        if plan.success and whole:
            self._last = plan.waypoints
        return plan

    def _fixed_goal(self, config: PlannerConfig, context: Context, posture: Array) -> Array | ToolGoal | None:
        """Fix the goal as the request or the parameters say."""
        kinds = {"posture": posture, "pose": ToolGoal(position=context.goal, axis=self._scene.axis),
                 "position": ToolGoal(position=context.goal), "free": None}
        return kinds[config.goal]

    def _goal_posture(self, context: Context) -> Array:
        if np.allclose(context.goal, self._scene.goal):
            return self._goal
        return self._robot.inverse_kinematics(context.goal, self._scene.axis, seed=self._start)

    def _on_iteration(self, handle: ServerGoalHandle, progress: PlanProgress) -> None:
        handle.publish_feedback(OptimizeTrajectory.Feedback(
            iteration=progress.iteration, objective=float(progress.objective), violation=float(progress.violation),
            best=float(progress.best)))

    def _fill(self, result: OptimizeTrajectory.Result, plan: Plan, model: RewardEnsemble | None,
              context: Context) -> None:
        result.success, result.message, result.status = plan.success, plan.message, plan.status
        result.iterations, result.seconds = int(plan.iterations), float(plan.seconds)
        result.objective, result.first_feasible_s = float(plan.objective), float(plan.first_feasible)
        if plan.success:
            result.trajectory = trajectory_to_msg(plan.trajectory)
        if model is not None:
            rewards = model.member_rewards(self._robot.tool_states(plan.waypoints), context)
            result.reward = list(map(float, rewards.mean(axis=0)))
            result.disagreement = list(map(float, rewards.std(axis=0)))
            result.model_version = model.version


def main() -> int:
    """Run the node `trajectory_optimizer`."""
    return run_node(TrajectoryOptimizerNode)


if __name__ == "__main__":
    sys.exit(main())
