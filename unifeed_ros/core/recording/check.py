"""Whether a bag keeps every rule of rosbag2's MCAP format."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Header, Message, MessageIndex, Metadata, Schema, Statistics

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.mcap_file import (
    ENCODING,
    HASH_KEY,
    METADATA_KEY,
    METADATA_RECORD,
    PROFILE,
    QOS_KEY,
    SCHEMA_ENCODING,
)
from unifeed_ros.core.recording.records import chunk_data, chunk_records, is_closed, walk
from unifeed_ros.core.recording.schema import definitions, dependencies

HASH = re.compile(r"RIHS01_[0-9a-f]{64}")
TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """How a bag stands to one rule."""

    rule: str
    """The rule, as a clause."""

    problems: tuple[str, ...]
    """What breaks it; nothing if it is kept."""

    def __str__(self) -> str:
        """Say it in a line."""
        if not self.problems:
            return f"ok    {self.rule}"
        more = f" (and {len(self.problems) - 1} more)" if len(self.problems) > 1 else ""
        return f"FAIL  {self.rule}: {self.problems[0]}{more}"


@dataclass
class _File:
    """What the rules need of one file."""

    path: Path
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    start: int = metadata.NO_TIME
    end: int = 0
    statistics: Statistics | None = None
    records: list[Any] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    index_errors: list[str] = field(default_factory=list)


@dataclass
class _Bag:
    """What the rules need of a bag."""

    folder: Path
    values: dict[str, Any]
    metadata_error: str | None
    files: list[_File]


_Entries = dict[int, list[tuple[int, int]]]
"""Times and offsets of messages, by channel."""


def check_bag(folder: Path) -> tuple[Finding, ...]:
    """Hold a bag against every rule of the format.

    Args:
        folder: The bag; it may be torn or damaged.

    Returns:
        One finding a rule.

    Raises:
        RecordingError: The folder holds no bag at all.
    """
    paths = sorted(folder.glob("*.mcap"))
    if not paths and not (folder / metadata.FILE_NAME).exists():
        raise RecordingError(f"{folder} is not a bag", expected=f"a folder with {metadata.FILE_NAME} and .mcap files")
    try:
        values, error = metadata.read(folder), None
    except RecordingError as refused:
        values, error = {}, str(refused)
    bag = _Bag(folder, values, error, [_load(path) for path in paths])
    return tuple(Finding(rule=rule, problems=tuple(find(bag))) for rule, find in RULES)


def _load(path: Path) -> _File:
    file = _File(path)
    try:
        _load_records(file)
        if is_closed(path):
            with path.open("rb") as stream:
                for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                    pass
    except (RecordingError, McapError, ValueError, KeyError, struct.error) as error:
        file.damage.append(f"{path.name}: {error}")
    return file


def _load_records(file: _File) -> None:
    chunk: _Entries = {}
    for record in walk(file.path):
        if record.torn:
            file.damage.append(f"{file.path.name} ends inside the record at byte {record.start}")
        elif record.opcode == Opcode.HEADER:
            file.profile = Header.read(record.stream()).profile
        elif record.opcode == Opcode.CHUNK:
            _compare_index(file, chunk, {})
            chunk = _load_chunk(file, chunk_data(record))
        elif record.opcode == Opcode.MESSAGE_INDEX:
            index = MessageIndex.read(record.stream())
            _compare_index(file, {index.channel_id: chunk.pop(index.channel_id, [])}, {index.channel_id: index.records})
        elif record.opcode == Opcode.STATISTICS:
            file.statistics = Statistics.read(record.stream())
        elif record.opcode == Opcode.METADATA:
            file.records.append(Metadata.read(record.stream()))
        elif record.opcode == Opcode.SCHEMA:
            schema = Schema.read(record.stream())
            file.schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            channel = Channel.read(record.stream())
            file.channels[channel.id] = channel
    _compare_index(file, chunk, {})


def _load_chunk(file: _File, data: bytes) -> _Entries:
    offsets: _Entries = {}
    for offset, item in chunk_records(data):
        if isinstance(item, Message):
            offsets.setdefault(item.channel_id, []).append((item.log_time, offset))
            file.counts[file.channels[item.channel_id].topic] += 1
            file.start, file.end = min(file.start, item.log_time), max(file.end, item.log_time)
        elif isinstance(item, Schema):
            file.schemas[item.id] = item
        else:
            file.channels[item.id] = item
    return offsets


def _compare_index(file: _File, found: _Entries, indexed: _Entries) -> None:
    for channel, entries in found.items():
        if sorted(entries) != sorted(indexed.get(channel, [])):
            file.index_errors.append(f"{file.path.name}: index of channel {channel} does not fit its messages")


def _metadata_there(bag: _Bag) -> Iterator[str]:
    if bag.metadata_error:
        yield bag.metadata_error


def _metadata_version(bag: _Bag) -> Iterator[str]:
    if bag.values.get("version") != metadata.VERSION:
        yield f"version is {bag.values.get('version')}"
    yield from (f"{key} is missing" for key in metadata.KEYS if key not in bag.values)
    for topic in bag.values.get("topics_with_message_count") or ():
        details = topic["topic_metadata"]
        yield from (f"{key} is missing for a topic" for key in metadata.TOPIC_KEYS if key not in details)


def _files_listed(bag: _Bag) -> Iterator[str]:
    listed = [str(name) for name in bag.values.get("relative_file_paths") or ()]
    there = [f.path.name for f in bag.files]
    yield from (f"{name} is listed, but not there" for name in listed if name not in there)
    yield from (f"{name} is there, but not listed" for name in there if name not in listed)
    expected = [f"{bag.folder.resolve().name}_{k}.mcap" for k in range(len(listed))]
    if listed != expected:
        yield f"files are named {', '.join(listed)}"


def _closed(bag: _Bag) -> Iterator[str]:
    yield from (f"{f.path.name} was not closed" for f in bag.files if not is_closed(f.path))


def _profile(bag: _Bag) -> Iterator[str]:
    yield from (f"{f.path.name} has profile {f.profile!r}" for f in bag.files if f.profile != PROFILE)


def _schemas(bag: _Bag) -> Iterator[str]:
    for schema in (s for f in bag.files for s in f.schemas.values()):
        if schema.encoding != SCHEMA_ENCODING:
            yield f"{schema.name} has encoding {schema.encoding}"
        if not TYPE.fullmatch(schema.name):
            yield f"name {schema.name}"
            continue
        parts = list(definitions(schema.data.decode()))
        known = {name for name, _ in parts}
        for name, text in parts:
            package = (name or schema.name).split("/")[0]
            yield from (f"{schema.name} lacks {d}" for d in dependencies(package, text)
                        if d not in known and d != _short(schema.name))


def _channels(bag: _Bag) -> Iterator[str]:
    for channel in (c for f in bag.files for c in f.channels.values()):
        if channel.message_encoding != ENCODING:
            yield f"{channel.topic} has encoding {channel.message_encoding}"
        if not HASH.fullmatch(channel.metadata.get(HASH_KEY, "")):
            yield f"{channel.topic} has type hash {channel.metadata.get(HASH_KEY)!r}"


def _qos(bag: _Bag) -> Iterator[str]:
    for channel in (c for f in bag.files for c in f.channels.values()):
        try:
            profiles = yaml.safe_load(channel.metadata[QOS_KEY])
            words = [p[key] for p in profiles for key in ("history", "reliability", "durability", "liveliness")]
        except (KeyError, TypeError, yaml.YAMLError) as error:
            yield f"{channel.topic}: {error!r}"
            continue
        if not words or not all(isinstance(word, str) for word in words):
            yield f"{channel.topic}: {words}"


def _checksums(bag: _Bag) -> Iterator[str]:
    for file in bag.files:
        yield from file.damage


def _indexes(bag: _Bag) -> Iterator[str]:
    for file in bag.files:
        yield from file.index_errors


def _statistics(bag: _Bag) -> Iterator[str]:
    for file in bag.files:
        found = file.statistics.message_count if file.statistics else None
        if found != file.counts.total():
            yield f"{file.path.name} counts {found}, there are {file.counts.total()}"


def _metadata_records(bag: _Bag) -> Iterator[str]:
    for file in bag.files:
        texts = [r.metadata.get(METADATA_KEY) for r in file.records if r.name == METADATA_RECORD]
        if len(texts) < 2:
            yield f"{file.path.name} has {len(texts)}"
        elif any(not isinstance(yaml.safe_load(text or ""), dict) for text in texts):
            yield f"{file.path.name} has one that is not YAML"


def _counts(bag: _Bag) -> Iterator[str]:
    total: Counter[str] = Counter()
    for file in bag.files:
        total.update(file.counts)
    for topic in bag.values.get("topics_with_message_count") or ():
        name, count = topic["topic_metadata"]["name"], topic["message_count"]
        if count != total[name]:
            yield f"{name} is said to have {count} messages, there are {total[name]}"
    if bag.values.get("message_count") != total.total():
        yield f"message_count is {bag.values.get('message_count')}, there are {total.total()}"


def _times(bag: _Bag) -> Iterator[str]:
    start, end = min((f.start for f in bag.files), default=0), max((f.end for f in bag.files), default=0)
    if not any(f.counts for f in bag.files):
        return
    try:
        said = bag.values["starting_time"]["nanoseconds_since_epoch"], bag.values["duration"]["nanoseconds"]
    except (KeyError, TypeError) as error:
        yield f"missing {error}"
        return
    if said != (start, end - start):
        yield f"said {said[0]} and {said[1]} ns, is {start} and {end - start} ns"


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


RULES: tuple[tuple[str, Callable[[_Bag], Iterator[str]]], ...] = (
    ("metadata.yaml can be read", _metadata_there),
    ("metadata.yaml is of version 9 and has every key", _metadata_version),
    ("files are <bag>_0.mcap and on, as listed", _files_listed),
    ("every file is closed", _closed),
    ("profile is ros2", _profile),
    ("schemas are ros2msg, complete, named package/msg/Type", _schemas),
    ("channels are cdr with a RIHS01 type hash", _channels),
    ("offered_qos_profiles are in words", _qos),
    ("every checksum fits", _checksums),
    ("message indexes fit the messages", _indexes),
    ("statistics fit the messages", _statistics),
    ("rosbag2's metadata record is there at open and at close", _metadata_records),
    ("counts in metadata.yaml fit the messages", _counts),
    ("times in metadata.yaml fit the messages", _times),
)
