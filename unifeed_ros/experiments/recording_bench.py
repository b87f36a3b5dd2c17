"""What the recorder's files cost and withstand: beside mcap_ros2's writer, cut off anywhere, on a full disk."""

from __future__ import annotations

import contextlib
import json
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from mcap.records import Schema
from mcap.writer import Writer as BytesWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as PeerWriter

from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.recording import (
    BagMessage,
    BagWriter,
    MessageType,
    RecordedTopic,
    bag_types,
    check_bag,
    read_bag,
    recover_bag,
)

BATCH = 5000
"""Messages that are written by one writer before the other one has its turn."""
DISK_MIB = 4
"""Size of the disk that is filled [MiB]."""


@dataclass(frozen=True, kw_only=True)
class WriterTimes:
    """Processor time of the writers on the same messages [s]."""

    messages: int
    """Messages that each wrote."""
    duration: float
    """Recorded time that they cover [s]."""
    own: float
    """This project's writer: bytes in, on disk four times a second."""
    peer: float
    """mcap_ros2's writer: message objects in, which it serialises."""
    peer_bytes: float
    """mcap's writer, which mcap_ros2 hands its bytes to: the same without serialising."""


def compare_writers(bag: Path, place: Path, limit: int) -> WriterTimes:
    """Write a bag's messages again with this project's writer, with mcap_ros2's and with mcap's, in turns.

    Args:
        bag: The bag.
        place: Folder for what is written.
        limit: Most messages.

    Returns:
        Processor times, of all threads.
    """
    types = bag_types(bag)
    spent = {"own": 0.0, "peer": 0.0, "peer_bytes": 0.0}
    first, last, count = 0, 0, 0
    with (place / "peer.mcap").open("wb") as objects, (place / "bytes.mcap").open("wb") as raw:
        own = BagWriter(place / "own", [RecordedTopic(name=name, type=kind) for name, kind in types.items()])
        peer, plain = PeerWriter(objects), BytesWriter(raw)
        plain.start(profile="ros2")
        schemas = {kind.name: peer.register_msgdef(kind.name, kind.definition) for kind in types.values()}
        ids = {kind.name: plain.register_schema(kind.name, "ros2msg", kind.definition.encode())
               for kind in types.values()}
        channels = {name: plain.register_channel(name, "cdr", ids[kind.name]) for name, kind in types.items()}

        def write_own(batch: list[tuple[BagMessage, Any]]) -> None:
            for message, _ in batch:
                own.write(message.topic, message.data, message.time)

        def write_peer(batch: list[tuple[BagMessage, Any]]) -> None:
            for message, decoded in batch:
                peer.write_message(message.topic, schemas[message.type], decoded, message.time)

        def write_bytes(batch: list[tuple[BagMessage, Any]]) -> None:
            for message, _ in batch:
                plain.add_message(channels[message.topic], message.time, message.data, message.time)

        def timed(name: str, work: Callable[[], object]) -> None:
            begun = time.process_time()
            work()
            spent[name] += time.process_time() - begun

        factory = DecoderFactory()
        decoders = {name: factory.decoder_for("cdr", Schema(id=k + 1, name=kind.name, encoding="ros2msg",
                                                            data=kind.definition.encode()))
                    for k, (name, kind) in enumerate(types.items())}
        source = islice(read_bag(bag), limit)
        while batch := [(message, decoders[message.topic](message.data)) for message in islice(source, BATCH)]:
            first, last, count = first or batch[0][0].time, batch[-1][0].time, count + len(batch)
            timed("own", lambda batch=batch: write_own(batch))
            timed("peer", lambda batch=batch: write_peer(batch))
            timed("peer_bytes", lambda batch=batch: write_bytes(batch))
        timed("own", own.close)
        timed("peer", peer.finish)
        timed("peer_bytes", plain.finish)
    return WriterTimes(messages=count, duration=(last - first) * 1e-9, **spent)


def truncate_everywhere(bag: Path, place: Path) -> dict[str, Any]:
    """Cut a bag's only file at every hundredth of its length and recover it each time.

    Args:
        bag: A closed bag of one file.
        place: Folder for the copies.

    Returns:
        Number of ``cuts``, how many were ``recovered`` (sound afterwards, with each topic's first messages unchanged),
        and ``worst_loss_s``: the longest recorded time between the last message kept and the last one whose bytes lie
        before the cut, estimated from the file's even growth [s].
    """
    path, = bag.glob("*.mcap")
    whole, messages = path.read_bytes(), list(read_bag(bag))
    topics = {name: [m for m in messages if m.topic == name] for name in {m.topic for m in messages}}
    recovered, worst, cuts = 0, 0.0, range(100)
    for percent in cuts:
        folder = place / "cut"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        (folder / "cut_0.mcap").write_bytes(whole[:len(whole) * percent // 100])
        recover_bag(folder)
        kept = list(read_bag(folder))
        first = {name: [m for m in kept if m.topic == name] for name in topics}
        recovered += all(first[name] == topics[name][:len(first[name])] for name in topics) and not any(
            finding.problems for finding in check_bag(folder))
        span = (messages[-1].time - messages[0].time) * 1e-9
        reached = (kept[-1].time - messages[0].time) * 1e-9 if kept else 0.0
        worst = max(worst, percent / 100 * span - reached)
    return {"cuts": len(cuts), "recovered": recovered, "worst_loss_s": worst}


def fill_disk(place: Path) -> dict[str, Any]:
    """Write until the disk is full, then recover what is there.

    The disk is a small tmpfs in a mount namespace of its own where the system permits that, else a limit on the size
    of the process's files (the error is then EFBIG in place of ENOSPC).

    Args:
        place: Folder for the recovered bag.

    Returns:
        ``how`` the disk was made small, the ``message`` of the writer, messages ``written`` and ``kept``, whether it
        ``recovered``, and ``loss_s``, the age of the oldest message lost when the writer refused [s].
    """
    here = [sys.executable, "-m", "unifeed_ros.experiments.recording_bench"]
    copy = place / "full"
    how, said = "tmpfs", _said(["unshare", "-rm", *here, "tmpfs", str(copy)])
    if said is None:
        shutil.rmtree(copy, ignore_errors=True)
        how, said = "file size limit", _said([*here, "limit", str(copy)])
    if said is None:
        raise UnifeedError("no small disk could be made, and the size of files cannot be limited either")
    recover_bag(copy)
    kept = list(read_bag(copy))
    times, refused = said.pop("times"), said.pop("refused")
    sound = [m.time for m in kept] == times[:len(kept)] and all(
        m.data == _payload(k) for k, m in enumerate(kept)) and not any(f.problems for f in check_bag(copy))
    lost = times[len(kept):]
    return {"how": how, **said, "written": len(times), "kept": len(kept), "recovered": bool(sound),
            "loss_s": (refused - lost[0]) * 1e-9 if lost else 0.0}


def _said(command: list[str]) -> dict[str, Any] | None:
    """Run a command that prints JSON; None if it cannot be run or fails."""
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except OSError:
        return None
    return dict(json.loads(ended.stdout)) if ended.returncode == 0 else None


def _payload(number: int) -> bytes:
    """Give bytes that hardly compress, another for each number."""
    return b"\x00\x01\x00\x00" + random.Random(number).randbytes(3000)


def _fill(kind: str, copy: Path) -> int:
    """Write messages until the disk refuses; print what happened as JSON. Runs in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        if kind == "tmpfs":
            mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", folder], check=False)
            if mounted.returncode:
                return 1
        string = MessageType(name="std_msgs/msg/String", definition="string data\n", hash="RIHS01_" + 64 * "0")
        bag = BagWriter(Path(folder) / "full", [RecordedTopic(name="/words", type=string)], compression="none")
        if kind == "limit":
            resource.setrlimit(resource.RLIMIT_FSIZE, (DISK_MIB << 20, resource.RLIM_INFINITY))
        times: list[int] = []
        message = "never refused"
        try:
            for number in range(10 * DISK_MIB << 20 >> 10):
                times.append(time.time_ns())
                bag.write("/words", _payload(number), times[-1])
                time.sleep(0.001)
        except UnifeedError as error:
            message = str(error)
        refused = time.time_ns()
        with contextlib.suppress(UnifeedError):
            bag.close()
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        shutil.copytree(Path(folder) / "full", copy)
        if kind == "tmpfs":
            subprocess.run(["umount", "-l", folder], check=False)
    print(json.dumps({"message": message.replace(folder, ""), "refused": refused, "times": times}))
    return 0




if __name__ == "__main__":
    sys.exit(_fill(sys.argv[1], Path(sys.argv[2])))
