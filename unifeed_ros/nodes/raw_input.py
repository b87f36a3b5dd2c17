"""Take a topic's messages as bytes, with their times and sequence numbers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib import import_module
from typing import NamedTuple

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.recording.losses import LossCounter


class RawMessage(NamedTuple):
    """One message as it came."""

    data: bytes
    """The message, serialised (CDR)."""

    received: int
    """When it arrived [ns since the epoch]."""

    sent: int
    """When it was published [ns since the epoch]."""


class RawInput:
    """One topic, asked for its messages instead of being called with them.

    The events executor of rclpy 7.1 cannot give a callback the message's times, and calling one for each message
    costs more than taking them in batches. The node must therefore not be in an executor.
    """

    def __init__(self, node: Node, name: str, type_name: str, qos: QoSProfile) -> None:
        """Subscribe.

        Args:
            node: A node that no executor spins.
            name: Full name of the topic.
            type_name: Its type, as "package/msg/Type".
            qos: Quality of service; weakened later if a publisher offers less.

        Raises:
            ConfigError: The type is not installed.
        """
        self.name = name
        self._node, self._qos = node, qos
        self._type = import_type(type_name)
        self._losses = LossCounter()
        self._publishers: set[bytes] = set()
        self._subscribe()

    @property
    def lost(self) -> int:
        """Messages that were published and did not arrive."""
        return self._losses.lost

    def take(self, limit: int) -> Iterator[RawMessage]:
        """Take what has arrived.

        Args:
            limit: Most messages to take.

        Yields:
            Messages in the order of their arrival.
        """
        handle = self._subscription.handle
        with handle:
            for _ in range(limit):
                taken = handle.take_message(self._type, True)
                if taken is None:
                    return
                data, info = taken
                self._losses.note(info["publication_sequence_number"], self._count_publishers)
                received = info["received_timestamp"] or time.time_ns()
                yield RawMessage(data, received, info["source_timestamp"] or received)

    def adapt(self) -> str | None:
        """Subscribe anew with a weaker quality of service if a publisher would otherwise not be heard.

        A reliable subscriber receives nothing from a best-effort publisher, and says nothing about it.

        Returns:
            What was given up, in words; None if nothing was.
        """
        offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(self.name)]
        given_up = []
        if self._qos.reliability == ReliabilityPolicy.RELIABLE and any(
                offer.reliability == ReliabilityPolicy.BEST_EFFORT for offer in offers):
            self._qos.reliability = ReliabilityPolicy.BEST_EFFORT
            given_up.append("reliability")
        if self._qos.durability == DurabilityPolicy.TRANSIENT_LOCAL and any(
                offer.durability == DurabilityPolicy.VOLATILE for offer in offers):
            self._qos.durability = DurabilityPolicy.VOLATILE
            given_up.append("what was sent earlier")
        if not given_up:
            return None
        self._node.destroy_subscription(self._subscription)
        self._subscribe()
        return f"{self.name}: a publisher offers less, going without {' and '.join(given_up)}"

    def _subscribe(self) -> None:
        self._subscription = self._node.create_subscription(
            self._type, self.name, _never_called, self._qos, raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))

    def _count_publishers(self) -> int:
        infos = self._node.get_publishers_info_by_topic(self.name)
        self._publishers.update(bytes(info.endpoint_gid) for info in infos)
        return len(self._publishers)


def import_type(name: str) -> type:
    """Import a message class.

    Args:
        name: Type, as "package/msg/Type".

    Returns:
        The class.

    Raises:
        ConfigError: It is not installed, or the name has another form.
    """
    try:
        package, kind, plain = name.split("/")
        return getattr(import_module(f"{package}.{kind}"), plain)
    except (ValueError, ImportError, AttributeError) as error:
        raise ConfigError(f"message type {name}", expected="package/msg/Type, installed", got=str(error)) from error


def _never_called(message: bytes) -> None:
    """Stand where rclpy wants a callback."""
