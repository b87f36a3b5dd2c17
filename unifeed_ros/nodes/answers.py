"""Answers to clients whose readers this process has not discovered yet.

A client may ask as soon as it sees the server, and the server may see where the answer should go later still:
rmw_fastrtps waits 0.1 s for that, then drops the answer with a warning, and the client waits for ever.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

DROPPED = "failed to send response (timeout)"
"""How rclpy's warning of a dropped answer begins."""
AGAIN_S = 0.2
"""Time between two tries [s]; each may keep the node for 0.1 s more."""
TRIES = 25
"""Tries in all; a client that has gone ends them at once."""


def answer_until_seen(node: Node, send: Callable[[], None], tries: int = TRIES) -> None:
    """Send an answer, and again if it was dropped.

    Args:
        node: Node whose timers try again.
        send: Sends the answer.
        tries: How often at most.
    """
    with noticing_drops(node, send, tries):
        send()


@contextmanager
def noticing_drops(node: Node, send: Callable[[], None], tries: int = TRIES) -> Iterator[None]:
    """Send an answer later if it is dropped within the block.

    Args:
        node: Node whose timers try again.
        send: Sends the answer again.
        tries: How often at most, the block's own try among them.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    if not any(str(warning.message).startswith(DROPPED) for warning in caught):
        return
    if tries <= 1:
        node.get_logger().warning("an answer was given up: its client was never discovered")
        return

    def again() -> None:
        node.destroy_timer(timer)
        answer_until_seen(node, send, tries - 1)

    timer = node.create_timer(AGAIN_S, again, clock=Clock(clock_type=ClockType.STEADY_TIME))
