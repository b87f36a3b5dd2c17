"""What was taught, kept in a folder: it outlives the process of the node that learns from it."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message

from unifeed_msgs.msg import Feedback
from unifeed_ros.core.errors import InputError

THERE, TAKEN_BACK = ".feedback", ".undone"
"""Endings of the files; their contents are the serialised messages, their names count."""


class KeptFeedback:
    """One file an input, written whole or not at all; taking an input back renames its file."""

    def __init__(self, folder: Path) -> None:
        """Open or make the folder.

        Args:
            folder: Where to keep the files.

        Raises:
            InputError: The folder cannot be made, or a file in it cannot be read.
        """
        self._folder = folder
        self._files: dict[str, Path] = {}
        self.found: list[tuple[Feedback, bool]] = []
        """What was there, oldest first, and whether it counts."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for path in sorted([*folder.glob(f"*{THERE}"), *folder.glob(f"*{TAKEN_BACK}")]):
                message = deserialize_message(path.read_bytes(), Feedback)
                self._files[message.id] = path
                self.found.append((message, path.suffix == THERE))
        except (OSError, RuntimeError) as error:
            raise InputError("folder of what was taught", expected="one that can be read and written",
                             got=f"{folder}: {error}", mend="give another learner.folder, or leave it empty") from error

    def add(self, message: Feedback) -> None:
        """Keep an input; one that was taken back counts again.

        Args:
            message: The input.

        Raises:
            OSError: It cannot be written.
        """
        if message.id in self._files:
            self._rename(message.id, THERE)
            return
        path = self._folder / f"{len(self._files) + 1:04d}{THERE}"
        part = path.with_suffix(".part")
        with part.open("wb") as stream:
            stream.write(serialize_message(message))
            stream.flush()
            os.fsync(stream.fileno())
        self._files[message.id] = part.rename(path)

    def take_back(self, name: str) -> None:
        """Note that an input no longer counts.

        Args:
            name: Its id.

        Raises:
            OSError: The file cannot be renamed.
        """
        if name in self._files:
            self._rename(name, TAKEN_BACK)

    def _rename(self, name: str, ending: str) -> None:
        path = self._files[name]
        self._files[name] = path.rename(path.with_suffix(ending))
