"""Walk through the records of an MCAP file, also of one that is torn or damaged."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

from unifeed_ros.core.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
PREFIX = struct.Struct("<BQ")
"""Opcode and length of the body [byte], before every record."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time [ns], publish time [ns], before the data of a message."""


@dataclass(frozen=True)
class RawRecord:
    """One record of a file."""

    opcode: int
    """What it is."""

    start: int
    """Where it starts in the file [byte]."""

    end: int
    """Where it ends in the file, were it complete [byte]."""

    body: bytes | None
    """Its content; None if it was not asked for or is torn."""

    torn: bool = False
    """True if the file ends before the record does; nothing follows."""

    def stream(self) -> ReadDataStream:
        """Give the content to one of mcap's record classes."""
        return ReadDataStream(BytesIO(self.body or b""))


def walk(path: Path, wanted: Collection[int] | None = None) -> Iterator[RawRecord]:
    """Read a file's records one after the other, without decompressing chunks.

    Args:
        path: The file.
        wanted: Opcodes whose bodies are read; all by default.

    Yields:
        Every record. The last one is torn if the file ends inside it.

    Raises:
        RecordingError: The file cannot be read, or does not start as an MCAP file does.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            magic = stream.read(len(MAGIC))
            if not MAGIC.startswith(magic):
                raise RecordingError(f"{path} is not an MCAP file")
            position = len(magic)
            while position < size and not (size - position == len(MAGIC) and is_closed(path)):
                head = stream.read(PREFIX.size)
                if len(head) < PREFIX.size:
                    yield RawRecord(0, position, size, None, torn=True)
                    return
                opcode, length = PREFIX.unpack(head)
                end = position + PREFIX.size + length
                if end > size:
                    yield RawRecord(opcode, position, end, None, torn=True)
                    return
                if wanted is None or opcode in wanted:
                    yield RawRecord(opcode, position, end, stream.read(length))
                else:
                    yield RawRecord(opcode, position, end, None)
                    stream.seek(end)
                position = end
    except OSError as error:
        raise RecordingError(f"cannot read {path}", got=error.strerror or str(error)) from error


def is_closed(path: Path) -> bool:
    """Tell whether a file ends as a closed MCAP file does."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < 2 * len(MAGIC):
            return False
        stream.seek(size - len(MAGIC))
        return stream.read() == MAGIC


def chunk_data(record: RawRecord) -> bytes:
    """Unpack a chunk and check it.

    Args:
        record: A chunk, with its body.

    Returns:
        The records inside, as bytes.

    Raises:
        RecordingError: Its compression is unknown, or it is damaged.
    """
    try:
        chunk = Chunk.read(record.stream())
        if chunk.compression == "zstd":
            data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
        elif chunk.compression == "lz4":
            data = lz4.frame.decompress(chunk.data)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise RecordingError("compression of a chunk", expected="none, lz4 or zstd", got=chunk.compression)
    except RecordingError:
        raise
    except Exception as error:  # each library has its own errors for bytes that make no sense
        raise RecordingError(f"damaged chunk at byte {record.start}", got=str(error)) from error
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise RecordingError(f"damaged chunk at byte {record.start}", expected="the checksum to fit")
    return data


def chunk_records(data: bytes) -> Iterator[tuple[int, Schema | Channel | Message]]:
    """Read the records inside a chunk.

    Args:
        data: Unpacked chunk.

    Yields:
        Offset within the chunk [byte], and the schema, channel or message.
    """
    position = 0
    while position < len(data):
        opcode, length = PREFIX.unpack_from(data, position)
        start, body = position, position + PREFIX.size
        position = body + length
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, body)
            yield start, Message(channel_id=channel, sequence=sequence, log_time=log_time, publish_time=publish_time,
                                 data=data[body + MESSAGE_HEAD.size:position])
        elif opcode == Opcode.SCHEMA:
            yield start, Schema.read(ReadDataStream(BytesIO(data[body:position])))
        elif opcode == Opcode.CHANNEL:
            yield start, Channel.read(ReadDataStream(BytesIO(data[body:position])))
