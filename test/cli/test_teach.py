"""`unifeed teach` where there is nothing to teach from."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from rclpy.executors import SingleThreadedExecutor

from unifeed_ros.cli.main import main
from unifeed_ros.core.errors import UnifeedError


def test_a_pipe_is_no_terminal(capsys):
    assert main(["teach"]) == 2
    assert "expected a terminal" in (said := capsys.readouterr().err) and "ssh -t" in said


def test_without_a_session_it_says_how_to_start_one(monkeypatch):
    import rclpy
    from rclpy.context import Context

    from unifeed_ros.nodes import terminal

    monkeypatch.setattr(terminal, "PATIENCE_S", 0.2)
    context = Context()
    rclpy.init(context=context, domain_id=99)
    node, executor = rclpy.create_node("asks", context=context), SingleThreadedExecutor(context=context)
    with pytest.raises(UnifeedError, match="unifeed up"):
        terminal.parameters_of_session(node, executor)
    node.destroy_node()
    rclpy.shutdown(context=context)
