"""Write bags that ROS 2's own tools open, and that lose at most a second when the process is killed."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.mcap_file import COMPRESSIONS, HASH_KEY, MARK_RECORD, QOS_KEY, BagFile
from unifeed_ros.core.recording.metadata import FileSpan, RecordedTopic

T = TypeVar("T")

DISTRO = "jazzy"
CHUNK_BYTES = 512 * 1024
FLUSH_PERIOD = 0.25


class BagWriter:
    """Writes a bag: ``<bag>/<bag>_0.mcap`` and on, with metadata.yaml beside.

    A thread of its own closes the open chunk and puts the file on disk every ``flush_period``, also while nothing is
    written. All methods may be called from any thread.
    """

    def __init__(self, folder: Path, topics: Sequence[RecordedTopic], *, distro: str = DISTRO,
                 compression: str = "zstd", chunk_bytes: int = CHUNK_BYTES, flush_period: float = FLUSH_PERIOD,
                 custom: Mapping[str, str] | None = None) -> None:
        """Create the bag and register every topic.

        Args:
            folder: Folder of the bag, which must not exist; its parents are made.
            topics: Every topic that will be written. They come first in the file, so that recovery knows them.
            distro: ROS distribution.
            compression: Of the chunks: "none", "lz4" or "zstd".
            chunk_bytes: Size at which a chunk is written out [byte].
            flush_period: Time between two times that everything is put on disk [s].
            custom: Free texts by name, for metadata.yaml.

        Raises:
            RecordingError: The folder exists or cannot be made, a topic comes twice, or a setting cannot be used.
        """
        if compression not in COMPRESSIONS:
            raise RecordingError("compression", expected=", ".join(COMPRESSIONS), got=compression)
        if len({t.name for t in topics}) != len(topics):
            raise RecordingError("topics of a bag", expected="each once", got=", ".join(t.name for t in topics))
        self.folder = folder.absolute()
        self._topics = tuple(topics)
        self._distro, self._custom = distro, dict(custom or {})
        self._compression, self._chunk_bytes, self._period = compression, chunk_bytes, flush_period
        self._lock = threading.RLock()
        self._done = threading.Event()
        self._closed_files: list[FileSpan] = []
        self._closed_bytes = 0
        self._failure: OSError | None = None
        self._closed = False
        _make_folder(self.folder)
        self._file = self._guard(self._open_file)
        self._save_metadata()
        self._flusher = threading.Thread(target=self._flush_forever, name="bag-flush", daemon=True)
        self._flusher.start()

    def __enter__(self) -> BagWriter:
        """Use the bag in a with block."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Close the bag."""
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None) -> None:
        """Append one message.

        Args:
            topic: Full name of a topic given at the start.
            data: The message, serialised (CDR).
            log_time: When it arrived [ns since the epoch].
            publish_time: When it was sent [ns since the epoch]; the log time by default.

        Raises:
            RecordingError: Unknown topic, closed bag, or the disk refused an earlier or this write.
        """
        with self._lock:
            self._check_open()
            try:
                self._file.write(topic, data, log_time, log_time if publish_time is None else publish_time)
            except KeyError as error:
                known = ", ".join(t.name for t in self._topics)
                raise RecordingError("topic of a message", expected=known, got=topic) from error
            except OSError as error:
                raise self._fail(error) from error

    def mark(self, text: str, time_ns: int | None = None) -> None:
        """Put a text with a time into the recording.

        Args:
            text: The text.
            time_ns: Its time [ns since the epoch]; now by default.

        Raises:
            RecordingError: Closed bag, or the disk refused.
        """
        moment = time.time_ns() if time_ns is None else time_ns
        with self._lock:
            self._check_open()
            self._guard(lambda: self._file.write_metadata(MARK_RECORD, {"text": text, "time": str(moment)}))

    def split(self) -> Path:
        """Close the file and go on in a new one.

        Returns:
            The file that was closed.

        Raises:
            RecordingError: Closed bag, or the disk refused.
        """
        with self._lock:
            self._check_open()
            finished = self._file.path
            self._guard(self._finish_file)
            self._file = self._guard(self._open_file)
            self._save_metadata()
            return finished

    def flush(self) -> None:
        """Put everything that was written so far on disk.

        Raises:
            RecordingError: The disk refused.
        """
        self._guard(self._sync)
        self._check_failure()

    def close(self) -> None:
        """Close the bag; calling it again does nothing.

        Raises:
            RecordingError: The disk refused; what had been flushed can be recovered.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._done.set()
            if self._failure is not None:
                self._file.abandon()
                self._check_failure()
            self._guard(self._finish_file)
            self._save_metadata()
        self._flusher.join(timeout=1.0)

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic, over all files."""
        with self._lock:
            spans = self._spans()
        return {t.name: sum(s.counts.get(t.name, 0) for s in spans) for t in self._topics}

    @property
    def bytes_written(self) -> int:
        """Bytes handed to the operating system, over all files."""
        with self._lock:
            return self._closed_bytes + (0 if self._closed else self._file.size)

    @property
    def free_bytes(self) -> int:
        """Free space on the bag's disk [byte]."""
        return shutil.disk_usage(self.folder).free

    def _open_file(self) -> BagFile:
        path = self.folder / f"{self.folder.name}_{len(self._closed_files)}.mcap"
        file = BagFile(path, compression=self._compression, chunk_bytes=self._chunk_bytes)
        file.write_bag_metadata(self._metadata([*self._closed_files, file.span]))
        for topic in self._topics:
            file.add_channel(topic.name, topic.type.name, topic.type.definition.encode(),
                             {QOS_KEY: topic.qos_text(), HASH_KEY: topic.type.hash})
        return file

    def _finish_file(self) -> None:
        self._file.write_bag_metadata(self._metadata(self._spans()))
        self._file.close()
        self._closed_bytes += self._file.path.stat().st_size
        self._closed_files.append(self._file.span)

    def _spans(self) -> list[FileSpan]:
        if self._closed_files and self._closed_files[-1].name == self._file.path.name:
            return list(self._closed_files)
        return [*self._closed_files, self._file.span]

    def _metadata(self, files: Sequence[FileSpan]) -> dict[str, Any]:
        topics = [metadata.describe_topic(t) for t in self._topics]
        return metadata.build(topics, files, distro=self._distro, custom=self._custom)

    def _save_metadata(self) -> None:
        metadata.write(self.folder, self._metadata(self._spans()))

    def _flush_forever(self) -> None:
        while not self._done.wait(self._period):
            try:
                self._sync()
            except OSError as error:
                self._failure = error
                return

    def _sync(self) -> None:
        with self._lock:
            if self._closed:
                return
            handle = self._file.flush()
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def _check_open(self) -> None:
        if self._closed:
            raise RecordingError(f"bag {self.folder} is closed")
        self._check_failure()

    def _check_failure(self) -> None:
        if self._failure is not None:
            raise self._fail(self._failure)

    def _guard(self, action: Callable[[], T]) -> T:
        try:
            return action()
        except OSError as error:
            raise self._fail(error) from error

    def _fail(self, error: OSError) -> RecordingError:
        self._failure = error
        return RecordingError(f"cannot write bag {self.folder}", got=error.strerror or str(error),
                              mend="what was written before can be had with: unifeed bag recover")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        raise RecordingError(f"bag {folder} exists", mend="choose another folder") from error
    except OSError as error:
        raise RecordingError(f"cannot make bag {folder}", got=error.strerror or str(error),
                             mend="choose a folder that can be written") from error
