"""Nodes that move something do so only while they are active, and only a person's step or the session makes them so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleState
from rclpy.node import Node

from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.waiting import LessonError, Waiting

STEPS = {State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
         State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE}
"""What to do in each state on the way to active."""
ANSWER_S = 5.0
"""Longest wait for a node's lifecycle service [s]."""


class ManagedNode(LifecycleNodeMixin, UnifeedNode):
    """A node with the states of ROS 2's managed nodes (design.ros2.org), unconfigured at first.

    Parameters and topics are there from the beginning; being active is what permits commands.
    """

    def __init__(self, name: str) -> None:
        """Create the node and its lifecycle services."""
        UnifeedNode.__init__(self, name)
        LifecycleNodeMixin.__init__(self)
        self.active = False
        """True while commands may go out."""
        service = self._service_change_state
        service.callback = _refusing(service.callback)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Permit commands."""
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forbid commands."""
        self.active = False
        self.deactivated()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forbid commands for good."""
        self.active = False
        self.deactivated()
        return super().on_shutdown(state)

    def deactivated(self) -> None:
        """Leave things safe when commands are no longer permitted; nodes override this."""


def _refusing(serve: Callable[..., Any]) -> Callable[..., Any]:
    """Let a transition that is not possible now be answered with no: rclpy would raise, and end the executor."""

    def answer(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        try:
            return serve(request, response)
        except rclpy_implementation.RCLError:
            response.success = False
            return response

    return answer


class Activator:
    """Brings a managed node to active, from a thread beside the executor.

    Args:
        node: Whose executor completes the calls.
        name: Name of the managed node.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._name = name
        self._state = node.create_client(GetState, f"{name}/get_state")
        self._change = node.create_client(ChangeState, f"{name}/change_state")

    def activate(self, waiting: Waiting) -> None:
        """Configure and activate, as far as that is not done yet.

        Args:
            waiting: How to wait for the answers.

        Raises:
            LessonError: The node does not answer, refuses, or has been shut down.
            Interrupted: The person interrupted.
        """
        for _ in range(len(STEPS) + 1):
            state = waiting.call(self._state, GetState.Request(), ANSWER_S).current_state
            if state.id == State.PRIMARY_STATE_ACTIVE:
                return
            if state.id not in STEPS:
                break
            request = ChangeState.Request(transition=Transition(id=STEPS[state.id]))
            if not waiting.call(self._change, request, ANSWER_S).success:
                break
        raise LessonError(f"{self._name} cannot be activated", got=f"it is {state.label}", mend="start it again, then "
                          "reset")
