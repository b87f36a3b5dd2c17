"""The node shared_control by itself: commands only while active, every fault of its inputs, each kind of output."""

from __future__ import annotations

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from unifeed_msgs.action import ExecuteTrajectory
from unifeed_msgs.msg import TeachingState
from unifeed_msgs.srv import SetMode
from unifeed_ros.core.robot import load_robot
from unifeed_ros.core.types import Trajectory
from unifeed_ros.nodes.conversions import stamp, trajectory_to_msg
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.resources import config_path

FILES = (config_path("robots", "panda"), config_path("tasks", "table"))
ROBOT = load_robot(FILES[0])
NAMES, REST = list(ROBOT.joints), np.array(ROBOT.seed)


class Listener:
    """Hears what the controller says."""

    def __init__(self, node):
        self.teaching, self.commands, self.figures = TeachingState(), [], {}
        node.create_subscription(TeachingState, "teaching_state", self._on_teaching, subscriber_qos("teaching_state"))
        node.create_subscription(JointState, "joint_command", self.commands.append, subscriber_qos("joint_command"))
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_figures, publisher_qos("diagnostics"))

    def _on_teaching(self, msg):
        self.teaching = msg

    def _on_figures(self, msg):
        for status in msg.status:
            if status.name.endswith("shared_control"):
                self.figures = {pair.key: pair.value for pair in status.values}


@pytest.fixture
def change(call):
    """Change the controller's lifecycle state: change(Transition.…); true if it was done."""

    def ask(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return call(ChangeState, "shared_control/change_state", request).success

    return ask


@pytest.fixture
def activate(change):
    return lambda: change(Transition.TRANSITION_CONFIGURE) and change(Transition.TRANSITION_ACTIVATE)


def pause(spin_until, seconds):
    end = time.monotonic() + seconds
    spin_until(lambda: time.monotonic() > end, seconds + 5.0)


def test_commands_go_out_only_while_active(start_node, ros_node, spin_until, call, change, activate):
    start_node("sim_arm", parameter_files=FILES)
    controller = start_node("shared_control", parameter_files=FILES)
    heard = Listener(ros_node)
    spin_until(lambda: heard.teaching.positions, 60.0, lambda: controller.output)
    assert not change(Transition.TRANSITION_ACTIVATE)  # not configured: refused, and the node goes on
    refused = call(SetMode, "set_mode")
    assert not refused.success and "not active" in refused.message
    assert call(Trigger, "stop").success
    pause(spin_until, 0.3)
    assert heard.commands == [] and heard.teaching.mode == TeachingState.INACTIVE
    assert activate()
    assert call(GetState, "shared_control/get_state").current_state.id == State.PRIMARY_STATE_ACTIVE
    pause(spin_until, 0.3)
    assert heard.commands == []  # active, and no mode chosen yet
    assert call(SetMode, "set_mode").success
    spin_until(lambda: len(heard.commands) > 100, 10.0)
    spin_until(lambda: float(heard.figures.get("commands", 0)) > 0, 10.0)
    assert {"rate_hz", "states_hz", "torques_hz", "worst_latency_ms", "missed_deadlines", "contact",
            "authority"} <= set(heard.figures)

    rival = ros_node.create_publisher(JointState, "joint_command", publisher_qos("joint_command"))
    spin_until(lambda: heard.teaching.mode == TeachingState.STOPPED, 10.0)
    assert "another node publishes on joint_command" in heard.teaching.message
    ros_node.destroy_publisher(rival)
    spin_until(lambda: call(SetMode, "set_mode").success and heard.teaching.mode == TeachingState.HOLD, 10.0)
    pause(spin_until, 0.3)
    assert heard.teaching.mode == TeachingState.HOLD

    assert change(Transition.TRANSITION_DEACTIVATE)
    pause(spin_until, 0.3)
    heard.commands.clear()
    pause(spin_until, 0.3)
    assert heard.commands == [] and heard.teaching.mode == TeachingState.INACTIVE
    assert change(Transition.TRANSITION_ACTIVATE) and call(SetMode, "set_mode").success


class Driver:
    """Says what an arm at rest says, and whatever else the test asks it to."""

    def __init__(self, node):
        self._states = node.create_publisher(JointState, "joint_states", publisher_qos("joint_states"))
        self._torques = node.create_publisher(JointState, "external_torques", publisher_qos("external_torques"))
        self._began, self._noise = time.monotonic(), np.random.default_rng(0)
        self.offset, self.names, self.state, self.torque, self.silent = 100.0, NAMES, {}, {}, False
        self.ticks = 0
        node.create_timer(0.005, self._tick)

    def _tick(self):
        self.ticks += 1
        if self.silent:
            return
        header = JointState().header
        header.stamp = stamp(time.monotonic() - self._began + self.offset)
        values = {"position": (REST + 1e-5 * self._noise.normal(size=7)).tolist(), "velocity": [0.0] * 7} | self.state
        self._states.publish(JointState(header=header, name=self.names, **values))
        self._torques.publish(JointState(header=header, name=NAMES, **({"effort": [0.0] * 7} | self.torque)))

    def break_with(self, **what):
        for name, value in what.items():
            setattr(self, name, value)


NAN = [float("nan")] * 7
FAULTS = {
    "a joint is missing": ({"names": [*NAMES[:6], "other"]}, "panda_joint7"),
    "positions are NaN": ({"state": {"position": NAN}}, "finite"),
    "too few velocities": ({"state": {"velocity": [0.0] * 3}}, "velocities"),
    "a position jumps": ({"state": {"position": np.roll(REST, 1).tolist()}}, "jumped"),
    "a joint races": ({"state": {"velocity": [0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0]}}, "panda_joint2 moves at 9.00"),
    "torques are NaN": ({"torque": {"effort": NAN}}, "finite"),
    "the clock is set back": ({"offset": 50.0}, "went back"),
    "the clock is set ahead": ({"offset": 5000.0}, "leapt ahead"),
    "nothing comes": ({"silent": True}, "no joint state"),
}


def test_every_fault_of_the_inputs_stops_the_arm_and_is_named(start_node, ros_node, spin_until, call, activate):
    """One after the other on one node, so that recovery by set_mode is shown too."""
    controller = start_node("shared_control", {"loop.rate": 100.0}, parameter_files=FILES)
    heard, driver = Listener(ros_node), Driver(ros_node)
    spin_until(lambda: heard.teaching.positions, 60.0, lambda: controller.output)
    assert activate()
    client = ros_node.create_client(SetMode, "set_mode")

    def held():
        answer = client.call_async(SetMode.Request())
        spin_until(answer.done, 20.0)
        return answer.result().success and heard.teaching.mode == TeachingState.HOLD

    for name, (what, word) in FAULTS.items():
        spin_until(held, 20.0, lambda name=name: f"before {name}: {heard.teaching.message}")
        healthy, broken_at = {key: getattr(driver, key) for key in what}, driver.ticks
        driver.break_with(**what)
        spin_until(lambda at=broken_at: driver.ticks > at + 40, 10.0)
        spin_until(lambda: heard.teaching.mode == TeachingState.STOPPED, 10.0, lambda name=name: name)  # still broken
        driver.break_with(**(healthy if "offset" not in what else {}))
        assert heard.teaching.message.startswith("stopped: ") and word in heard.teaching.message, name
    ros_node.destroy_client(client)


@pytest.mark.parametrize("output", ["setpoint", "trajectory"])
def test_an_arm_that_closes_the_loop_itself_carries_motions_out(start_node, ros_node, spin_until, call, activate,
                                                                output):
    start_node("sim_arm", parameter_files=FILES)
    controller = start_node("shared_control", {"control.output": output}, parameter_files=FILES)
    heard = Listener(ros_node)
    spin_until(lambda: heard.teaching.positions, 60.0, lambda: controller.output)
    assert activate() and call(SetMode, "set_mode").success
    pause(spin_until, 0.5)
    start = np.array(heard.teaching.positions)
    t = np.linspace(0.0, 1.5, 151)
    s = (t / 1.5)[:, None]
    motion = Trajectory(joint_names=NAMES, times=t, positions=start + 0.2 * (10 * s**3 - 15 * s**4 + 6 * s**5))
    client = ActionClient(ros_node, ExecuteTrajectory, "execute_trajectory")
    spin_until(client.server_is_ready, 60.0)
    sent = client.send_goal_async(ExecuteTrajectory.Goal(trajectory=trajectory_to_msg(motion)))
    spin_until(sent.done, 20.0)
    answer = sent.result().get_result_async()
    spin_until(answer.done, 20.0)
    result = answer.result().result
    client.destroy()
    assert result.success, result.message
    assert result.tracking_rms < 0.02
    np.testing.assert_allclose(result.executed.points[-1].positions, start + 0.2, atol=0.03)
    assert heard.commands == []
