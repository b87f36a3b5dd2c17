"""Control of a lesson over ROS: the session keeps who has it, pages and terminals ask for it."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.task import Future
from std_msgs.msg import String

from unifeed_msgs.srv import TakeControl
from unifeed_ros.console.lease import LEASE_S, RENEW_S, ControlLease
from unifeed_ros.nodes.node import UnifeedNode


class ControlDesk:
    """Answers `take_control` and tells on `control_holder` who has control.

    Args:
        node: The node that offers it, without which no lesson runs.
    """

    def __init__(self, node: UnifeedNode) -> None:
        self._lease, self._told = ControlLease(), ""
        self._holder = node.advertise("control_holder")
        node.create_service(TakeControl, "take_control", self._on_ask)
        node.create_timer(RENEW_S, self._tell, clock=node.steady)
        self._holder.publish(String())

    def _on_ask(self, request: TakeControl.Request, response: TakeControl.Response) -> TakeControl.Response:
        now = time.monotonic()
        if request.name and request.wish == TakeControl.Request.TAKE:
            self._lease.take(request.name, now)
        elif request.name and request.wish == TakeControl.Request.KEEP:
            self._lease.keep(request.name, now)
        elif request.wish == TakeControl.Request.RELEASE:
            self._lease.release(request.name)
        response.holder = self._tell()
        response.success = bool(request.name) and response.holder == request.name
        response.message = f"{response.holder or 'nobody'} has control"
        return response

    def _tell(self) -> str:
        holder = self._lease.holder(time.monotonic())
        if holder != self._told:
            self._told = holder
            self._holder.publish(String(data=holder))
        return holder


class ControlClaim:
    """One that could have control, and whether it has it.

    It trusts an answer for as long as the session does, counted from before it asked: when a session or a connection
    dies, it has given up control before anybody else gets it.

    Args:
        node: The node behind the page or the terminal.
        name: What others read when it has control; no two may have the same.
        wanted: Says whether somebody is there who could teach.
    """

    def __init__(self, node: UnifeedNode, name: str, wanted: Callable[[], bool]) -> None:
        self._name, self._wanted = name, wanted
        self._holder, self._until = "", 0.0
        self._client = node.create_client(TakeControl, "take_control")
        node.listen("control_holder", self._on_holder)
        node.create_timer(RENEW_S, self.renew, clock=node.steady)

    @property
    def held(self) -> bool:
        """True while this one has control."""
        return self._holder == self._name and time.monotonic() < self._until

    @property
    def holder(self) -> str:
        """Name of another one that has control; empty if that is nobody, or this one."""
        return "" if self._holder == self._name else self._holder

    def renew(self) -> None:
        """Ask for control if it is free, keep it, or give it back when nobody is there any more."""
        if self._wanted():
            self._ask(TakeControl.Request.KEEP)
        elif self._holder == self._name:
            self._ask(TakeControl.Request.RELEASE)

    def take(self) -> None:
        """Ask for control, whoever has it."""
        self._ask(TakeControl.Request.TAKE)

    def release(self) -> None:
        """Give control back."""
        self._until = 0.0
        self._ask(TakeControl.Request.RELEASE)

    def _ask(self, wish: int) -> None:
        if self._client.service_is_ready():
            asked = time.monotonic()
            self._client.call_async(TakeControl.Request(name=self._name, wish=wish)).add_done_callback(
                lambda future: self._on_answer(future, asked))

    def _on_answer(self, future: Future, asked: float) -> None:
        """Know until when; who it is, only the topic says: an answer may be older than what it told last."""
        if future.result().success:
            self._until = max(self._until, asked + LEASE_S)

    def _on_holder(self, msg: String) -> None:
        self._holder = msg.data
