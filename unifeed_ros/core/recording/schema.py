"""Message definitions and type hashes as rosbag2 stores them, from the files that ROS packages install."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from unifeed_ros.core.errors import RecordingError

SEPARATOR = "=" * 80
"""Line between the root definition and each of its dependencies (encoding "ros2msg")."""

BUILT_IN = frozenset({
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring"})

FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)")


@dataclass(frozen=True, kw_only=True)
class MessageType:
    """One message type, complete enough to be read without ROS."""

    name: str
    """Name, as "package/msg/Type"."""

    definition: str
    """Root definition, then each dependency after a separator and "MSG: package/Type"."""

    hash: str
    """Hash of the type description, "RIHS01_" and 64 hexadecimal digits."""


def install_prefixes() -> tuple[Path, ...]:
    """List the places where ROS packages are installed, from AMENT_PREFIX_PATH."""
    return tuple(Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p)


def message_type(name: str, prefixes: Sequence[Path] | None = None) -> MessageType:
    """Collect a message type's definition and hash.

    Args:
        name: Name, as "package/msg/Type".
        prefixes: Install prefixes, the first that has the package is taken; those of the environment by default.

    Returns:
        The type.

    Raises:
        RecordingError: The name has another form, or the package or one of its files is not installed.
    """
    package, folder, plain = _split(name)
    if folder != "msg":
        raise RecordingError(f"type {name}", expected="package/msg/Type")
    places = install_prefixes() if prefixes is None else tuple(prefixes)
    parts: dict[str, str] = {}
    _collect(f"{package}/{plain}", places, parts)
    root, *rest = parts
    text = parts[root] + "".join(f"\n{SEPARATOR}\nMSG: {name}\n{parts[name]}" for name in rest)
    return MessageType(name=name, definition=text, hash=_type_hash(name, places))


def dependencies(package: str, text: str) -> tuple[str, ...]:
    """List the message types that a definition's fields name.

    Args:
        package: Package of the definition, for types that are named without one.
        text: One definition, without dependencies.

    Returns:
        Names as "package/Type", sorted, each once.
    """
    found = set()
    for line in text.splitlines():
        match = FIELD.match(line.split("#", 1)[0])
        if match and match[1] not in BUILT_IN:
            found.add(match[1] if "/" in match[1] else f"{package}/{match[1]}")
    return tuple(sorted(found))


def definitions(text: str) -> Iterator[tuple[str | None, str]]:
    """Split a stored definition into its parts.

    Args:
        text: Root definition and dependencies, as stored.

    Yields:
        Name ("package/Type", None for the root) and text of each part.
    """
    root, *rest = re.split(rf"^{SEPARATOR}\n", text, flags=re.MULTILINE)
    yield None, root
    for part in rest:
        head, _, body = part.partition("\n")
        yield head.removeprefix("MSG: "), body


def _split(name: str) -> tuple[str, str, str]:
    parts = name.split("/")
    if len(parts) != 3 or not all(re.fullmatch(r"[A-Za-z]\w*", p) for p in parts):
        raise RecordingError(f"type {name!r}", expected="package/msg/Type")
    return parts[0], parts[1], parts[2]


def _collect(name: str, places: Sequence[Path], parts: dict[str, str]) -> None:
    package, plain = name.split("/")
    parts[name] = _installed(package, f"{plain}.msg", places).read_text()
    for dependency in dependencies(package, parts[name]):
        if dependency not in parts:
            _collect(dependency, places, parts)


def _type_hash(name: str, places: Sequence[Path]) -> str:
    package, _, plain = _split(name)
    path = _installed(package, f"{plain}.json", places)
    try:
        hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(path.read_text())["type_hashes"]}
        return str(hashes[name])
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"no type hash of {name} in {path}", mend="build the messages with ROS Jazzy") from error


def _installed(package: str, file: str, places: Sequence[Path]) -> Path:
    for place in places:
        path = place / "share" / package / "msg" / file
        if path.is_file():
            return path
    where = os.pathsep.join(map(str, places)) or "nowhere, AMENT_PREFIX_PATH is empty"
    raise RecordingError(f"{package}/msg/{file} is not installed", got=f"search in {where}",
                         mend="source the workspace, or build the messages")
