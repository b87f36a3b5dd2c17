"""What the benches of the control loop print, and how they count processor time."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from unifeed_ros.cli.bench_faults import Tries, markdown, torque_rate
from unifeed_ros.cli.bench_loop import describe, processor_time
from unifeed_ros.core.control.safety import SafetyFilter
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.resources import config_path


def test_processor_time_is_what_a_session_of_processes_uses():
    session = os.getsid(0)
    before, began = processor_time([session]), time.process_time()
    while time.process_time() - began < 0.3:
        pass
    assert processor_time([session]) - before >= 0.25
    assert processor_time([]) == 0.0


def test_figures_are_printed_by_name():
    table = {"machine": {"cpus": 2, "load_before": 1.25, "load_after": 2.0},
             "summary": {"command_hz": 499.87, "late": 3}}
    text = describe(table)
    assert "load of the machine before 1.2" in text
    assert text.splitlines()[1].split() == ["command_hz", "499.870"] and text.splitlines()[2].split() == ["late", "3"]


def test_the_worst_of_all_tries_stands_in_the_table_of_faults():
    tries = Tries(stops=[0.01, 0.09], stills=[0.2], messages=["stopped: a", "stopped: a"], kept=2, invented=1)
    row = {**tries.row("states stop"), "torque_rate_max": 900.0}
    assert (row["tries"], row["stopped"], row["stop_max_s"], row["kept"]) == (2, 2, 0.09, 2)
    assert "| states stop | 2 | 2 | 0.090 | 0.20 | 900 | 2 | 1 | stopped: a |" in markdown([row])


@pytest.mark.parametrize("dt", [-10.0, 0.0, 0.002, 0.007, 0.3])
def test_the_wire_finds_the_controllers_rate_limit_kept_and_finds_it_broken(dt):
    config, robot = ControlConfig(), RobotModel(load_robot(config_path("robots", "panda")))
    limits = SafetyFilter(robot, config)
    first = limits.limited(np.zeros(7), 0.002).copy()
    second = limits.limited(np.array([50.0, -50.0, 0.0, 0.0, 0.0, 0.0, 0.0]), dt).copy()
    assert torque_rate((5.0, first), (5.0 + dt, second)) <= config.torque_rate * (1 + 1e-9)
    if dt >= 0.002:
        assert torque_rate((5.0, first), (5.0 + dt, 1.5 * second)) > 1.4 * config.torque_rate
