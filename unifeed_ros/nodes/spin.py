"""Run one node as a process: start, spin, end on Ctrl-C and SIGTERM with the node's own last words."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.nodes.real_time import calm_garbage_collector, prefer_real_time

SPIN_S = 0.05
"""Longest wait of one spin [s]; also how late a signal is noticed. The events executor needs it to be finite."""

PROBE_S = 1.0
"""Time that the events executor has to run one timer before the other executor takes over [s]."""

GRACE_S = 2.7
"""Time from the first signal to the end of the process, whatever the node does [s]."""

OK, FAILED, USER_MISTAKE = 0, 1, 2


class StopSignal:
    """SIGINT and SIGTERM as a flag, so that the ROS context stays usable for the node's last words.

    rclpy's own handlers shut the context down at once: a node could not publish its stop command any more.
    """

    def __init__(self, grace: float = GRACE_S) -> None:
        """Set up without touching the process.

        Args:
            grace: Time from the first signal to the forced end of the process [s].
        """
        self._raised = False  # no lock: the next signal may come in the middle of the handler of this one
        self._grace = grace

    def install(self) -> None:
        """Take both signals over; to be called from the main thread."""
        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGTERM, self._on_signal)

    @property
    def raised(self) -> bool:
        """True after a signal."""
        return self._raised

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._raised:
            return
        self._raised = True
        watch = threading.Timer(self._grace, self._give_up)
        watch.daemon = True
        watch.start()

    def _give_up(self) -> None:
        sys.stderr.write(f"did not end within {self._grace} s of the signal, giving up; it was here:\n")
        faulthandler.dump_traceback(all_threads=True)
        os._exit(FAILED)


def make_executor(node: Node) -> Executor:
    """Give the node the events executor, or the single-threaded one where the first does not run a timer.

    The events executor cannot answer a service from a coroutine (it sends the coroutine itself): a node that has such
    services, and no fast topics, says so by the attribute ``answers_later = True`` and gets the single-threaded one.

    Args:
        node: Node to add.

    Returns:
        An executor that holds the node.
    """
    if getattr(node, "answers_later", False):
        return _with_node(SingleThreadedExecutor(), node)
    try:
        from rclpy.experimental.events_executor import EventsExecutor

        executor = EventsExecutor()
    except (ImportError, AttributeError):
        return _with_node(SingleThreadedExecutor(), node)
    executor.add_node(node)
    if _runs_a_timer(executor, node):
        return executor
    executor.remove_node(node)
    executor.shutdown()
    node.get_logger().warning("the events executor does not run here, taking the single-threaded one")
    return _with_node(SingleThreadedExecutor(), node)


def _with_node(executor: Executor, node: Node) -> Executor:
    executor.add_node(node)
    return executor


def _runs_a_timer(executor: Executor, node: Node) -> bool:
    fired = threading.Event()
    timer = node.create_timer(0.001, fired.set, clock=Clock(clock_type=ClockType.STEADY_TIME))
    end = time.monotonic() + PROBE_S
    while not fired.is_set() and time.monotonic() < end:
        executor.spin_once(timeout_sec=SPIN_S)
    node.destroy_timer(timer)
    return fired.is_set()


def run_node(factory: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run a node until a signal comes or the context is shut down.

    A node may have a method ``close()``: it is called once before the node is destroyed, while the ROS context still
    works, also after an error (send the stop command, close the bag). A node that wants to end by itself sets its
    attribute ``exit_status`` to a number. A node that controls the arm has an attribute ``real_time`` (RealTimeConfig).

    Args:
        factory: Makes the node; called after rclpy.init.
        args: Command line; that of the process by default.

    Returns:
        Exit status: 0 after a signal, the node's own number if it ended by itself, 2 if it refused its settings (one
        line on stderr says which), 1 after an error while it ran.
    """
    stop = StopSignal()
    node: Node | None = None
    try:
        stop.install()
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
        node = factory()
    except UnifeedError as error:
        return _refuse(str(error))
    except Exception as error:
        if node is None and _is_settings_error(error):
            return _refuse(str(error))
        rclpy.try_shutdown()
        raise
    return _run(node, stop)


def _run(node: Node, stop: StopSignal) -> int:
    status = OK
    executor: Executor | None = None
    try:
        executor = make_executor(node)
        calm_garbage_collector()
        if (real_time := getattr(node, "real_time", None)) is not None:
            node.get_logger().info(prefer_real_time(real_time))
        while rclpy.ok() and not stop.raised and getattr(node, "exit_status", None) is None:
            executor.spin_once(timeout_sec=SPIN_S)
        status = getattr(node, "exit_status", None) or OK
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except UnifeedError as error:
        node.get_logger().fatal(str(error))
        status = FAILED
    finally:
        status = max(status, _close(node))
        if executor is not None:
            executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return status


def _close(node: Node) -> int:
    close = getattr(node, "close", None)
    if close is None:
        return OK
    try:
        close()
    except UnifeedError as error:
        sys.stderr.write(f"{node.get_name()}: {error}\n")
        return FAILED
    return OK


def _is_settings_error(error: Exception) -> bool:
    """Tell a parameter file or value that rcl refuses from a fault of the program."""
    return type(error).__module__.startswith(("rclpy.exceptions", "rclpy.parameter")) or type(error).__name__ in (
        "RCLError", "RCLInvalidROSArgsError", "UnknownROSArgsError")


def _refuse(message: str) -> int:
    sys.stderr.write(" ".join(message.split()) + "\n")
    rclpy.try_shutdown()
    return USER_MISTAKE
