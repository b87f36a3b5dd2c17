"""Recorded messages as the classes that are installed now, whichever version of the definitions they were made by.

A bag carries the definition of every message in it. Where its hash is that of the installed type the bytes are read
as they are; otherwise they are read by the recorded definition, and the fields that both versions have are taken over:
what is new keeps its default, what is gone is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import deserialize_message, serialize_message

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import BagMessage, MessageType, bag_types, message_type
from unifeed_ros.core.recording.mcap_file import ENCODING, SCHEMA_ENCODING
from unifeed_ros.nodes.raw_input import import_type

NESTED = re.compile(r"(?:sequence<)?([A-Za-z]\w*)/([A-Za-z]\w*)(,\s*\d+>|>|\[\d+\])?$")
"""A field that holds messages: package, type, and what makes it several."""


class RecordedMessages:
    """Reads the messages of one bag.

    Args:
        bag: Folder of the bag.

    Raises:
        RecordingError: Not a bag, or not closed.
    """

    def __init__(self, bag: Path) -> None:
        self._bag = bag
        self.types = bag_types(bag)
        """Message types as recorded, by topic."""
        self._readers: dict[str, Callable[[bytes], Any]] = {}
        self._same: dict[str, bool] = {}

    def read(self, message: BagMessage) -> Any:
        """Give a message as an object of the installed class.

        Args:
            message: A message of this bag.

        Returns:
            The message.

        Raises:
            ConfigError: Its type is not installed.
            RecordingError: The bytes are not a message of its type, or its fields have other types now.
        """
        if message.topic not in self._readers:
            self._readers[message.topic] = self._reader(self.types[message.topic])
        try:
            return self._readers[message.topic](message.data)
        except RecordingError:
            raise
        except Exception as error:  # the middleware and the decoder have errors of many kinds for bytes without sense
            raise RecordingError(f"message on {message.topic} in {self._bag} cannot be read",
                                 expected=message.type, got=f"{len(message.data)} bytes, {error}") from error

    def installed_bytes(self, message: BagMessage) -> bytes:
        """Give a message serialised as the installed type.

        Args:
            message: A message of this bag.

        Returns:
            Its own bytes where the definition is the same, else those of the converted message.

        Raises:
            ConfigError: As for read.
            RecordingError: As for read.
        """
        if message.topic not in self._same:
            import_type(message.type)
            self._same[message.topic] = self.is_current(message.topic)
        return message.data if self._same[message.topic] else serialize_message(self.read(message))

    def is_current(self, topic: str) -> bool:
        """Say whether a topic's definition is the installed one."""
        kind = self.types[topic]
        return kind.hash == message_type(kind.name).hash

    def _reader(self, kind: MessageType) -> Callable[[bytes], Any]:
        installed = import_type(kind.name)
        if kind.hash == message_type(kind.name).hash:
            return lambda data: deserialize_message(data, installed)
        schema = Schema(id=1, name=kind.name, encoding=SCHEMA_ENCODING, data=kind.definition.encode())
        decode = DecoderFactory().decoder_for(ENCODING, schema)
        if decode is None:
            raise RecordingError(f"definition of {kind.name} in {self._bag}", expected=SCHEMA_ENCODING)
        return lambda data: converted(decode(data), installed)


def converted(old: Any, kind: type) -> Any:
    """Turn a message of another version into one of a class.

    Args:
        old: Anything with the fields of the other version.
        kind: Message class wanted.

    Returns:
        A message with every field that both have.

    Raises:
        RecordingError: A field of the same name holds something else now.
    """
    new = kind(check_fields=True)
    for name, field in kind.get_fields_and_field_types().items():
        if not hasattr(old, name):
            continue
        value = getattr(old, name)
        try:
            nested = NESTED.fullmatch(field)
            if nested:
                inner = import_type(f"{nested[1]}/msg/{nested[2]}")
                value = [converted(v, inner) for v in value] if nested[3] else converted(value, inner)
            elif isinstance(value, (bytes, bytearray)):
                value = list(value)
            setattr(new, name, value)
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            raise RecordingError(f"field {name} of {kind.__name__} was another one when it was recorded",
                                 expected=field, got=str(error) or type(value).__name__) from error
    return new
