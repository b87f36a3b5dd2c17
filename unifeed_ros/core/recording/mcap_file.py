"""One MCAP file of a bag, as rosbag2 lays it out."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.metadata import FileSpan

PROFILE, ENCODING, SCHEMA_ENCODING = "ros2", "cdr", "ros2msg"
METADATA_RECORD, METADATA_KEY = "rosbag2", "serialized_metadata"
MARK_RECORD = "unifeed_mark"
"""Name of the metadata record of a mark; its keys are "text" and "time" [ns]."""

QOS_KEY, HASH_KEY = "offered_qos_profiles", "topic_type_hash"
LIBRARY = "unifeed_ros"

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


class BagFile:
    """Writes one file. Not safe for several threads; errors of the disk come out as OSError."""

    def __init__(self, path: Path, *, compression: str, chunk_bytes: int) -> None:
        """Create the file, which must not exist.

        Args:
            path: The file.
            compression: "none", "lz4" or "zstd".
            chunk_bytes: Size at which a chunk is written out [byte].
        """
        self.path = path
        self._stream = path.open("xb")
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # recovery leaves a file alone that is written
        self._writer = Writer(self._stream, chunk_size=chunk_bytes, compression=COMPRESSIONS[compression],
                              enable_data_crcs=True)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._start, self._end = metadata.NO_TIME, 0
        self._writer.start(profile=PROFILE, library=LIBRARY)

    def add_channel(self, topic: str, type_name: str, definition: bytes, details: Mapping[str, str]) -> None:
        """Register a topic and, the first time, its type."""
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, SCHEMA_ENCODING, definition)
        self._channels[topic] = self._writer.register_channel(topic, ENCODING, self._schemas[type_name], dict(details))
        self._counts[topic] = 0

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int | None = None) -> None:
        """Append a message; by default the sequence number counts the topic's messages from 1."""
        count = self._counts[topic] + 1
        self._writer.add_message(self._channels[topic], log_time, data, publish_time,
                                 count if sequence is None else sequence)
        self._counts[topic] = count
        self._start, self._end = min(self._start, log_time), max(self._end, log_time)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def write_bag_metadata(self, values: Mapping[str, Any]) -> None:
        """Append the record that rosbag2 reads where metadata.yaml is missing."""
        self.write_metadata(METADATA_RECORD, {METADATA_KEY: metadata.to_text(values)})

    @property
    def span(self) -> FileSpan:
        """What the file holds so far."""
        return FileSpan(name=self.path.name, start=self._start, end=self._end, counts=dict(self._counts))

    @property
    def size(self) -> int:
        """Bytes handed to the operating system."""
        return self._stream.tell()

    def flush(self) -> int:
        """Hand everything to the operating system.

        Returns:
            A file descriptor of its own, for fsync; the caller closes it.
        """
        self._writer.flush()
        return os.dup(self._stream.fileno())

    def close(self) -> None:
        """Write index and footer, and put the file on disk."""
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Close without an index; what was flushed stays readable by recovery."""
        raw = self._stream.detach()
        raw.close()


def is_being_written(path: Path) -> bool:
    """Say whether a process holds the file open for writing at this moment; its lock ends with it, however it ends."""
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            return False
    return False
