"""Rebuild bags whose recorder was killed, whose disk was full, or whose file was cut off."""

from __future__ import annotations

import contextlib
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.mcap_file import HASH_KEY, METADATA_RECORD, QOS_KEY, BagFile, is_being_written
from unifeed_ros.core.recording.metadata import FileSpan
from unifeed_ros.core.recording.records import RawRecord, chunk_data, chunk_records, is_closed, walk
from unifeed_ros.core.recording.writer import CHUNK_BYTES, DISTRO

TORN_SUFFIX = ".torn"
"""Added to the name of a file that was rebuilt; the original is kept."""


@dataclass(frozen=True, kw_only=True)
class FileRecovery:
    """What became of one file."""

    name: str
    """File name."""

    intact: bool
    """True if nothing had to be done."""

    messages: int
    """Messages in the file now."""

    end: int
    """Time of the last message in it [ns since the epoch]; 0 without messages."""

    lost_messages: int
    """Messages known to be missing in the middle, from their sequence numbers; those after the end are not known."""

    unreadable_bytes: int
    """Bytes of the file that could not be used [byte]."""

    def __str__(self) -> str:
        """Say it in a line."""
        if self.intact:
            return f"{self.name}: intact, {self.messages} messages"
        return (f"{self.name}: rebuilt, {self.messages} messages kept; lost: {self.lost_messages} messages in the "
                f"middle, {self.unreadable_bytes} unreadable bytes, and what was not on disk yet (at most about 1 s)")


@dataclass
class _Salvage:
    """What could be read of a file, while it is written into a new one."""

    target: BagFile | _Counter
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    sequences: dict[int, int] = field(default_factory=dict)
    topics: dict[str, dict[str, Any]] = field(default_factory=dict)
    lost: int = 0
    unreadable: int = 0


def recover_bag(folder: Path) -> tuple[FileRecovery, ...]:
    """Make a bag whole again.

    Files that were closed and whose checksums fit stay as they are. The others are rebuilt from every chunk whose
    checksum fits; the original is kept beside with ".torn" added to its name. metadata.yaml is written anew.

    Args:
        folder: The bag.

    Returns:
        What became of each file.

    Raises:
        RecordingError: The folder holds no bag, it is being recorded at this moment, or the disk refuses.
    """
    files = sorted(folder.glob("*.mcap"), key=_number)
    if not files:
        raise RecordingError(f"{folder} is not a bag", expected="a folder with .mcap files")
    if any(is_being_written(path) for path in files):
        raise RecordingError(f"bag {folder} is being recorded at this moment", mend="end the recorder first")
    reports, spans, topics = [], [], {}
    for path in files:
        try:
            report, span, described = _intact(path) or _rebuild(path)
        except OSError as error:
            raise RecordingError(f"cannot rebuild {path}", got=error.strerror or str(error)) from error
        reports.append(report)
        spans.append(span)
        topics.update(described)
    kept = _kept_metadata(folder)
    metadata.write(folder, metadata.build([topics[name] for name in sorted(topics)], spans,
                                          distro=str(kept.get("ros_distro") or DISTRO), custom=kept.get("custom_data")))
    return tuple(reports)


_Outcome = tuple[FileRecovery, FileSpan, dict[str, dict[str, Any]]]


class _Counter:
    """Stands in for the new file where it is only asked whether the old one can be read."""

    def __init__(self, name: str) -> None:
        self._name, self._counts = name, dict[str, int]()
        self._start, self._end = metadata.NO_TIME, 0

    @property
    def span(self) -> FileSpan:
        return FileSpan(name=self._name, start=self._start, end=self._end, counts=self._counts)

    def add_channel(self, topic: str, type_name: str, definition: bytes, details: Mapping[str, str]) -> None:
        self._counts[topic] = 0

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        self._counts[topic] += 1
        self._start, self._end = min(self._start, log_time), max(self._end, log_time)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Marks need no counting."""


def _intact(path: Path) -> _Outcome | None:
    if not is_closed(path):
        return None
    salvage = _read(path, _Counter(path.name))
    return None if salvage.unreadable else _outcome(salvage, intact=True)


def _rebuild(path: Path) -> _Outcome:
    temporary = path.with_name(f".{path.name}.rebuilding")
    temporary.unlink(missing_ok=True)
    target = BagFile(temporary, compression="zstd", chunk_bytes=CHUNK_BYTES)
    try:
        target.write_bag_metadata(metadata.build([], [], distro=DISTRO))
        salvage = _read(path, target)
        described = [salvage.topics[name] for name in sorted(salvage.topics)]
        target.write_bag_metadata(metadata.build(described, [_renamed(target.span, path.name)], distro=DISTRO))
        target.close()
        _set_aside(path)
        temporary.replace(path)
        metadata.sync_folder(path.parent)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    return _outcome(salvage, intact=False, name=path.name)


def _set_aside(path: Path) -> None:
    """Keep the original under its second name, so that no moment is without a file under the first."""
    torn = path.with_name(path.name + TORN_SUFFIX)
    try:
        torn.hardlink_to(path)
    except FileExistsError:
        return
    except OSError:  # a file system without links
        path.replace(torn)


def _read(path: Path, target: BagFile | _Counter) -> _Salvage:
    salvage = _Salvage(target)
    _read_summary(path, salvage)
    for record in walk(path, {Opcode.CHUNK, Opcode.METADATA}):
        try:
            if record.torn:
                salvage.unreadable += path.stat().st_size - record.start
            elif record.opcode == Opcode.CHUNK:
                _read_chunk(record, salvage)
            elif record.opcode == Opcode.METADATA:
                _read_metadata(record, salvage)
        except (RecordingError, McapError, ValueError, struct.error):
            salvage.unreadable += record.end - record.start
    return salvage


def _read_summary(path: Path, salvage: _Salvage) -> None:
    """Learn the topics from the end of a closed file: its first chunk, which holds them too, may be the damaged one."""
    for record in walk(path, {Opcode.SCHEMA, Opcode.CHANNEL}):
        with contextlib.suppress(RecordingError, McapError, ValueError, struct.error):
            if record.opcode == Opcode.SCHEMA and record.body:
                schema = Schema.read(record.stream())
                salvage.schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL and record.body:
                _keep_channel(Channel.read(record.stream()), salvage)


def _read_metadata(record: RawRecord, salvage: _Salvage) -> None:
    values = Metadata.read(record.stream())
    if values.name != METADATA_RECORD:
        salvage.target.write_metadata(values.name, values.metadata)


def _read_chunk(record: RawRecord, salvage: _Salvage) -> None:
    for _, item in chunk_records(chunk_data(record)):
        if isinstance(item, Schema):
            salvage.schemas[item.id] = item
        elif isinstance(item, Channel):
            _keep_channel(item, salvage)
        else:
            _keep_message(item, salvage)


def _keep_channel(channel: Channel, salvage: _Salvage) -> None:
    if channel.id in salvage.channels:
        return
    schema = salvage.schemas.get(channel.schema_id)
    if schema is None:
        raise RecordingError(f"topic {channel.topic} has no type")
    salvage.channels[channel.id] = channel
    salvage.target.add_channel(channel.topic, schema.name, schema.data, channel.metadata)
    salvage.topics[channel.topic] = metadata.describe(
        channel.topic, schema.name, yaml.safe_load(channel.metadata.get(QOS_KEY, "")) or [],
        channel.metadata.get(HASH_KEY, ""))


def _keep_message(message: Message, salvage: _Salvage) -> None:
    channel = salvage.channels.get(message.channel_id)
    if channel is None:
        salvage.lost += 1
        return
    last = salvage.sequences.get(message.channel_id, 0)
    salvage.lost += max(0, message.sequence - last - 1)
    salvage.sequences[message.channel_id] = message.sequence
    salvage.target.write(channel.topic, message.data, message.log_time, message.publish_time, message.sequence)


def _outcome(salvage: _Salvage, *, intact: bool, name: str | None = None) -> _Outcome:
    span = _renamed(salvage.target.span, name or salvage.target.span.name)
    report = FileRecovery(name=span.name, intact=intact, messages=span.messages, end=span.end,
                          lost_messages=0 if intact else salvage.lost, unreadable_bytes=salvage.unreadable)
    return report, span, salvage.topics


def _renamed(span: FileSpan, name: str) -> FileSpan:
    return FileSpan(name=name, start=span.start, end=span.end, counts=span.counts)


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r"_(\d+)\.mcap$", path.name)
    return (int(match[1]) if match else 0, path.name)


def _kept_metadata(folder: Path) -> Mapping[str, Any]:
    try:
        return metadata.read(folder)
    except RecordingError:
        return {}
