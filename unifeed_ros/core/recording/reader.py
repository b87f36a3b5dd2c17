"""Read bags back: messages in the order of their times, and what a bag holds."""

from __future__ import annotations

import json
import struct
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.mcap_file import HASH_KEY, MARK_RECORD
from unifeed_ros.core.recording.records import is_closed, walk
from unifeed_ros.core.recording.schema import MessageType

RECOVER = "unifeed bag recover"
SETTINGS_KEY = "unifeed_settings"
"""Name under which a bag's metadata holds the session's parameters, as JSON."""


class BagMessage(NamedTuple):
    """One recorded message."""

    topic: str
    type: str
    time: int
    """When it arrived [ns since the epoch]."""

    data: bytes
    """The message, serialised (CDR)."""


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """What a bag holds of one topic."""

    name: str
    """Full name."""

    type: str
    """Type, as "package/msg/Type"."""

    hash: str
    """Hash of the type description."""

    message_count: int
    """Number of messages."""

    rate: float
    """Mean rate between the first and the last message [Hz]; 0 with fewer than two."""

    longest_gap: float
    """Longest time between two messages [s]."""


@dataclass(frozen=True, kw_only=True)
class BagInfo:
    """What a bag holds."""

    folder: Path
    """The bag."""

    files: tuple[str, ...]
    """Its files."""

    size: int
    """Size of the files [byte]."""

    start: int
    """Time of the first message [ns since the epoch]; 0 without messages."""

    duration: float
    """From the first to the last message [s]."""

    message_count: int
    """Number of messages."""

    topics: tuple[TopicInfo, ...]
    """Topics, by name."""

    marks: tuple[tuple[int, str], ...]
    """Marks: time [ns since the epoch] and text."""


def bag_files(folder: Path) -> tuple[Path, ...]:
    """List a bag's files in order.

    Raises:
        RecordingError: Not a bag, or a file is missing or was not closed.
    """
    values = metadata.read(folder)
    paths = tuple(folder / Path(str(name)).name for name in values.get("relative_file_paths") or ())
    if values.get("storage_identifier") != "mcap":
        raise RecordingError(f"storage of bag {folder}", expected="mcap", got=values.get("storage_identifier"))
    for path in paths:
        if not path.is_file():
            raise RecordingError(f"file {path} of the bag is missing", mend=f"{RECOVER} {folder}")
        if not is_closed(path):
            raise RecordingError(f"file {path} was not closed", mend=f"{RECOVER} {folder}")
    return paths


def bag_settings(folder: Path) -> dict[str, Any]:
    """Read the settings of the session that a bag was recorded in.

    Args:
        folder: The bag.

    Returns:
        The session's parameters by section, as in its parameter files; empty if the bag holds none.

    Raises:
        RecordingError: Not a bag, or its settings are damaged.
    """
    held = (metadata.read(folder).get("custom_data") or {}).get(SETTINGS_KEY, "{}")
    try:
        sections = json.loads(held)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"settings of bag {folder}", expected="JSON", got=str(error)) from error
    if not isinstance(sections, dict):
        raise RecordingError(f"settings of bag {folder}", expected="sections by name", got=type(sections).__name__)
    return sections


def read_bag(folder: Path, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
    """Read a bag's messages in the order of their times, checking every checksum.

    Args:
        folder: The bag.
        topics: Full names of the topics wanted; all by default.

    Returns:
        The messages, read as they are asked for.

    Raises:
        RecordingError: Not a bag, not closed, or damaged; the last one while reading.
    """
    return _messages(bag_files(folder), topics)


def _messages(paths: Collection[Path], topics: Collection[str] | None) -> Iterator[BagMessage]:
    for path in paths:
        try:
            with path.open("rb") as stream:
                for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(topics=topics):
                    name = schema.name if schema else ""
                    yield BagMessage(channel.topic, name, message.log_time, message.data)
        except (McapError, ValueError, struct.error, OSError) as error:
            raise RecordingError(f"{path} is damaged", got=str(error), mend=RECOVER) from error


def bag_info(folder: Path) -> BagInfo:
    """Tell what a bag holds, from its indexes: messages themselves are not read.

    Raises:
        RecordingError: Not a bag, or not closed.
    """
    paths = bag_files(folder)
    times: dict[str, list[NDArray[np.uint64]]] = defaultdict(list)
    types: dict[str, MessageType] = {}
    marks: list[tuple[int, str]] = []
    for path in paths:
        index = _index(path)
        types.update(index.types)
        marks.extend(index.marks)
        for topic, values in index.times.items():
            times[topic].extend(values)
    joined = {name: np.sort(np.concatenate(times[name])) if times[name] else np.zeros(0, np.uint64) for name in types}
    filled = [t for t in joined.values() if len(t)]
    start = min((int(t[0]) for t in filled), default=0)
    end = max((int(t[-1]) for t in filled), default=0)
    return BagInfo(
        folder=folder, files=tuple(p.name for p in paths), size=sum(p.stat().st_size for p in paths), start=start,
        duration=(end - start) * 1e-9, message_count=sum(len(t) for t in filled),
        topics=tuple(_topic_info(name, types[name], joined[name]) for name in sorted(types)), marks=tuple(marks))


def _topic_info(name: str, kind: MessageType, times: NDArray[np.uint64]) -> TopicInfo:
    gaps = np.diff(times.astype(np.int64)) * 1e-9
    span = float(gaps.sum())
    return TopicInfo(name=name, type=kind.name, hash=kind.hash, message_count=len(times),
                     rate=len(gaps) / span if span > 0 else 0.0, longest_gap=float(gaps.max(initial=0.0)))


def bag_types(folder: Path) -> dict[str, MessageType]:
    """Read the message types as they were when the bag was recorded.

    Args:
        folder: The bag.

    Returns:
        Types by the topic's full name, for topics with messages and without.

    Raises:
        RecordingError: Not a bag, or not closed.
    """
    return {topic: kind for path in bag_files(folder) for topic, kind in _index(path).types.items()}


class _Index(NamedTuple):
    types: Mapping[str, MessageType]
    times: Mapping[str, list[NDArray[np.uint64]]]
    marks: list[tuple[int, str]]


def _index(path: Path) -> _Index:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    entries: list[tuple[int, NDArray[np.uint64]]] = []
    marks: list[tuple[int, str]] = []
    for record in walk(path, {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX, Opcode.METADATA}):
        if record.opcode == Opcode.SCHEMA:
            schema = Schema.read(record.stream())
            schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            channel = Channel.read(record.stream())
            channels[channel.id] = channel
        elif record.opcode == Opcode.MESSAGE_INDEX and record.body:
            channel_id = int.from_bytes(record.body[:2], "little")
            entries.append((channel_id, np.frombuffer(record.body, "<u8", offset=6)[::2]))
        elif record.opcode == Opcode.METADATA:
            values = Metadata.read(record.stream())
            if values.name == MARK_RECORD:
                marks.append((int(values.metadata["time"]), values.metadata["text"]))
    times: dict[str, list[NDArray[np.uint64]]] = defaultdict(list)
    for channel_id, found in entries:
        times[channels[channel_id].topic].append(found)
    types = {c.topic: _type_of(c, schemas.get(c.schema_id)) for c in channels.values()}
    return _Index(types, times, marks)


def _type_of(channel: Channel, schema: Schema | None) -> MessageType:
    name, definition = (schema.name, schema.data.decode(errors="replace")) if schema else ("", "")
    return MessageType(name=name, definition=definition, hash=channel.metadata.get(HASH_KEY, ""))
