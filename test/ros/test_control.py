"""Control of a lesson over ROS: one of several has it, and its death sets it free."""

from __future__ import annotations

import pytest
from rclpy.executors import SingleThreadedExecutor

from unifeed_msgs.srv import TakeControl
from unifeed_ros.console.lease import LEASE_S
from unifeed_ros.nodes.control import ControlClaim, ControlDesk
from unifeed_ros.nodes.node import UnifeedNode


class Party:
    """A page server or a terminal."""

    def __init__(self, executor, context, name):
        self.node, self.there, self.executor = UnifeedNode(name, context=context), True, executor
        self.claim = ControlClaim(self.node, name, lambda: self.there)
        executor.add_node(self.node)

    def die(self):
        self.executor.remove_node(self.node)
        self.node.destroy_node()


@pytest.fixture
def executor(ros_node):
    executor = SingleThreadedExecutor(context=ros_node.context)
    executor.add_node(ros_node)
    yield executor
    executor.shutdown()


@pytest.fixture
def spin_until(executor):
    """Spin everything: the tests of this file have all nodes in one process."""
    from time import monotonic

    def spin(condition, timeout=20.0, explain=lambda: ""):
        end = monotonic() + timeout
        while not condition():
            assert monotonic() < end, f"did not happen within {timeout} s {explain()}"
            executor.spin_once(timeout_sec=0.02)

    return spin


@pytest.mark.timeout(120)
def test_one_has_control_and_its_death_sets_it_free(executor, ros_node, spin_until, call):
    first, second = (Party(executor, ros_node.context, name) for name in ("first", "second"))
    assert not first.claim.held and not second.claim.held
    session = UnifeedNode("session", context=ros_node.context)
    ControlDesk(session)
    executor.add_node(session)
    parties = (first, second)
    spin_until(lambda: sum(p.claim.held for p in parties) == 1 and all(p.claim.held or p.claim.holder for p in parties))
    holder, other = parties if first.claim.held else parties[::-1]
    name, rival = holder.node.get_name(), other.node.get_name()
    assert holder.claim.holder == "" and other.claim.holder == name

    other.claim.take()
    spin_until(lambda: other.claim.held)
    spin_until(lambda: holder.claim.holder == rival)
    assert not holder.claim.held

    answer = call(TakeControl, "take_control")  # an empty request changes nothing
    assert (answer.success, answer.holder) == (False, rival) and rival in answer.message
    other.there = False  # nobody is at the page any more: the next one gets control without waiting for the lease
    spin_until(lambda: holder.claim.held, LEASE_S - 0.5)
    other.there = True
    spin_until(lambda: other.claim.holder == name)

    holder.die()  # without a word
    spin_until(lambda: other.claim.held)

    executor.remove_node(session)  # a session that hangs: what it granted ends by itself
    spin_until(lambda: not other.claim.held, LEASE_S + 1.0)
    for node in (session, other.node):
        node.destroy_node()
