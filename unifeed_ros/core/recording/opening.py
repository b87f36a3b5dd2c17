"""Open a recording wherever a user points: a bag or a session's folder, also after a crash."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import metadata
from unifeed_ros.core.recording.records import is_closed
from unifeed_ros.core.recording.recover import FileRecovery, recover_bag

SESSION_BAG = "bag"
"""Folder of the recording within a session's folder."""


@dataclass(frozen=True, kw_only=True)
class OpenedBag:
    """A bag that can be read."""

    folder: Path
    """The bag."""

    recovered: tuple[FileRecovery, ...] = ()
    """What became of its files where it had to be recovered first; empty if it was whole."""


def open_bag(folder: Path) -> OpenedBag:
    """Find a bag and make it whole if its recorder did not end well.

    Args:
        folder: The bag, or the folder of the session that it was recorded in.

    Returns:
        The bag, and what was recovered.

    Raises:
        RecordingError: There is no bag, it is being recorded at this moment, or it cannot be recovered.
    """
    bag = next((place for place in (folder, folder / SESSION_BAG) if _is_bag(place)), None)
    if bag is None:
        raise RecordingError(f"{folder} is not a bag", got=None if folder.is_dir() else "no such folder",
                             expected=f"a folder with {metadata.FILE_NAME} and .mcap files, or one of a session")
    if _is_whole(bag):
        return OpenedBag(folder=bag)
    return OpenedBag(folder=bag, recovered=recover_bag(bag))


def _is_bag(folder: Path) -> bool:
    return (folder / metadata.FILE_NAME).is_file() or any(folder.glob("*.mcap"))


def _is_whole(bag: Path) -> bool:
    """Say whether every file is closed, listed and counted; a bag without files is left to the reader's own words."""
    paths = sorted(bag.glob("*.mcap"))
    if not paths:
        return True
    if not all(is_closed(path) for path in paths):
        return False
    try:
        values = metadata.read(bag)
        counted = sum(_messages(path) for path in paths)
    except (RecordingError, McapError, ValueError, struct.error):
        return False
    listed = {Path(str(name)).name for name in values.get("relative_file_paths") or ()}
    there = {path.name for path in paths}
    if listed - there:  # a file was taken away: the reader names it, and nothing here brings it back
        return True
    return listed == there and values.get("message_count") == counted


def _messages(path: Path) -> int:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        raise RecordingError(f"{path} has no statistics")
    return int(summary.statistics.message_count)
