"""What rosbag2 keeps beside the messages: topics, qualities of service, counts, times (metadata version 9)."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording.schema import MessageType

VERSION = 9
ROOT = "rosbag2_bagfile_information"
FILE_NAME = "metadata.yaml"
INFINITE = {"sec": 9223372036, "nsec": 854775807}
"""How rosbag2 writes an unlimited duration."""

NO_TIME = 2**63 - 1
"""Starting time of a bag without messages, as rosbag2 writes it [ns]."""

KEYS = ("version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count",
        "compression_format", "compression_mode", "relative_file_paths", "files", "custom_data", "ros_distro")
"""Keys without any of which rosbag2 refuses the bag."""

TOPIC_KEYS = ("name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash")


@dataclass(frozen=True, kw_only=True)
class Qos:
    """Quality of service that a topic was published with, in rosbag2's words."""

    history: str = "keep_last"
    """"keep_last" or "keep_all"."""

    depth: int = 10
    """Number of messages kept."""

    reliability: str = "reliable"
    """"reliable" or "best_effort"."""

    durability: str = "volatile"
    """"volatile" or "transient_local"."""

    def mapping(self) -> dict[str, Any]:
        """Give the profile as rosbag2 writes it: words, and no deadlines."""
        return {
            "history": self.history, "depth": self.depth, "reliability": self.reliability,
            "durability": self.durability, "deadline": dict(INFINITE), "lifespan": dict(INFINITE),
            "liveliness": "automatic", "liveliness_lease_duration": dict(INFINITE),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass(frozen=True, kw_only=True)
class RecordedTopic:
    """One topic of a bag."""

    name: str
    """Full name, from the slash on."""

    type: MessageType
    """Its message type."""

    qos: tuple[Qos, ...] = (Qos(),)
    """Quality of service of each publisher."""

    def __post_init__(self) -> None:
        """Reject a relative name: a bag knows no namespace."""
        if not self.name.startswith("/"):
            raise RecordingError("name of a recorded topic", expected=f"/{self.name}", got=self.name)

    def qos_text(self) -> str:
        """Give the profiles as the YAML text that a channel carries."""
        return str(yaml.safe_dump([q.mapping() for q in self.qos], sort_keys=False))


@dataclass(frozen=True, kw_only=True)
class FileSpan:
    """What one file of a bag holds."""

    name: str
    """File name, within the bag's folder."""

    start: int
    """Time of its first message [ns]; meaningless without messages."""

    end: int
    """Time of its last message [ns]; meaningless without messages."""

    counts: Mapping[str, int]
    """Messages by topic."""

    @property
    def messages(self) -> int:
        """Number of messages in the file."""
        return sum(self.counts.values())


def build(topics: Sequence[Mapping[str, Any]], files: Sequence[FileSpan], *, distro: str,
          custom: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Put a bag's metadata together.

    Args:
        topics: Topics as given by ``describe``.
        files: Files, oldest first.
        distro: ROS distribution.
        custom: Free texts by name.

    Returns:
        The metadata, without rosbag2's root key.
    """
    start, end = _span(files)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(f.messages for f in files),
        "topics_with_message_count": [
            {"topic_metadata": dict(t), "message_count": sum(f.counts.get(t["name"], 0) for f in files)}
            for t in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [f.name for f in files],
        "files": [_file_entry(f) for f in files],
        "custom_data": dict(custom) if custom else None,
        "ros_distro": distro,
    }


def describe(name: str, type_name: str, qos: Sequence[Mapping[str, Any]], type_hash: str) -> dict[str, Any]:
    """Describe a topic as the metadata lists it."""
    return {"name": name, "type": type_name, "serialization_format": "cdr",
            "offered_qos_profiles": [dict(q) for q in qos], "type_description_hash": type_hash}


def describe_topic(topic: RecordedTopic) -> dict[str, Any]:
    """Describe a topic that is being recorded."""
    return describe(topic.name, topic.type.name, [q.mapping() for q in topic.qos], topic.type.hash)


def to_text(metadata: Mapping[str, Any]) -> str:
    """Write metadata as the YAML text of the MCAP record named "rosbag2"."""
    return _dump(metadata)


def write(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write metadata.yaml in one step: a reader sees the old or the new one, never half of it.

    Raises:
        RecordingError: The folder cannot be written.
    """
    text = _dump({ROOT: dict(metadata)})
    try:
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=".metadata-")
        try:
            with os.fdopen(handle, "w") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            Path(temporary).chmod(0o644)
            Path(temporary).replace(folder / FILE_NAME)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(temporary).unlink()
            raise
        sync_folder(folder)
    except OSError as error:
        raise RecordingError(f"cannot write {folder / FILE_NAME}", got=error.strerror or str(error)) from error


def read(folder: Path) -> dict[str, Any]:
    """Read metadata.yaml.

    Returns:
        The metadata, without rosbag2's root key.

    Raises:
        RecordingError: There is none, or it is not rosbag2's.
    """
    path = folder / FILE_NAME
    try:
        tree = yaml.safe_load(path.read_text())
    except OSError as error:
        raise RecordingError(f"{folder} is not a bag", expected=f"a folder with {FILE_NAME}",
                             got=error.strerror or str(error)) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path} is not YAML", got=" ".join(str(error).split()),
                             mend="unifeed bag recover") from error
    if not isinstance(tree, dict) or not isinstance(tree.get(ROOT), dict):
        raise RecordingError(f"{path} is not of a bag", expected=f"root key {ROOT}", mend="unifeed bag recover")
    return dict(tree[ROOT])


def sync_folder(folder: Path) -> None:
    """Put a folder's list of files on disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _span(files: Sequence[FileSpan]) -> tuple[int, int]:
    filled = [f for f in files if f.messages]
    if not filled:
        return NO_TIME, NO_TIME
    return min(f.start for f in filled), max(f.end for f in filled)


def _file_entry(file: FileSpan) -> dict[str, Any]:
    start, end = _span([file])
    return {"path": file.name, "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": end - start}, "message_count": file.messages}



def _dump(values: Mapping[str, Any]) -> str:
    """Write every value out: rosbag2's reader is not promised to know YAML's references."""
    fresh = json.loads(json.dumps(values))
    return str(yaml.safe_dump(fresh, sort_keys=False))
