from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import check_bag, read_bag, recover_bag

WRITER = """
import sys, time
from pathlib import Path
from unifeed_ros.core.recording import BagWriter, RecordedTopic, message_type
topics = [RecordedTopic(name="/words", type=message_type("std_msgs/msg/String"))]
bag = BagWriter(Path(sys.argv[1]), topics)
number = 0
while True:
    moment = time.time_ns()
    bag.write("/words", b"\\x00\\x01\\x00\\x00" + number.to_bytes(4, "little"), moment)
    sys.stdout.write(f"{number} {moment}\\n")
    sys.stdout.flush()
    number += 1
    time.sleep(0.0005)
"""


def assert_sound(folder):
    assert [str(f) for f in check_bag(folder) if f.problems] == []


@pytest.mark.parametrize("lifetime", [0.4, 1.3, 2.1])
def test_what_is_older_than_a_second_survives_a_kill(tmp_path, topics, lifetime):
    folder = tmp_path / "bag"
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(folder)], stdout=log)
        try:
            while not (tmp_path / "log").stat().st_size:
                time.sleep(0.01)
            time.sleep(lifetime)
        finally:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
    killed = time.time_ns()
    whole_lines, _, _ = (tmp_path / "log").read_text().rpartition("\n")
    published = [tuple(map(int, line.split())) for line in whole_lines.splitlines()]
    with pytest.raises(RecordingError, match="recover"):
        list(read_bag(folder))

    report, = recover_bag(folder)

    kept = [(int.from_bytes(m.data[4:], "little"), m.time) for m in read_bag(folder)]
    assert kept[:len(published)] == published[:len(kept)]
    assert len(kept) <= len(published) + 1  # killed after it had written a message and before it said so
    assert all(moment > killed - 1e9 for _, moment in published[len(kept):])
    assert not report.intact
    assert report.messages == len(kept)
    assert_sound(folder)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_a_file_cut_anywhere_keeps_every_whole_chunk(make_bag, compression):
    folder = make_bag(compression=compression)
    path = folder / "bag_0.mcap"
    whole = path.read_bytes()
    expected = list(read_bag(folder))
    kept = []
    for percent in range(0, 100, 4):
        path.write_bytes(whole[:len(whole) * percent // 100])
        path.with_name("bag_0.mcap.torn").unlink(missing_ok=True)
        recover_bag(folder)
        assert_sound(folder)
        messages = list(read_bag(folder))
        assert messages == expected[:len(messages)]
        kept.append(len(messages))
    assert kept == sorted(kept)
    assert kept[0] == 0
    assert kept[-1] == len(expected)  # by then only the index was cut


def test_a_damaged_chunk_costs_itself_and_its_messages_are_counted(make_bag):
    folder = make_bag(compression="none")
    path = folder / "bag_0.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"word 107\0")] ^= 1
    path.write_bytes(data)
    expected = {m.data for m in read_bag(make_bag("other"))}

    report, = recover_bag(folder)

    kept = {m.data for m in read_bag(folder)}
    assert kept < expected
    assert report.lost_messages == len(expected) - len(kept) > 0
    assert report.unreadable_bytes > 0
    assert path.with_name("bag_0.mcap.torn").read_bytes() == data
    assert_sound(folder)


def test_a_damaged_first_chunk_does_not_take_the_others_along(make_bag):
    folder = make_bag(compression="none")
    path = folder / "bag_0.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"word 1\0")] ^= 1
    path.write_bytes(data)
    report, = recover_bag(folder)
    assert report.messages > 150
    assert report.messages + report.lost_messages == 200
    assert_sound(folder)


def test_a_sound_bag_is_left_alone(make_bag):
    folder = make_bag()
    before = (folder / "bag_0.mcap").read_bytes(), (folder / "metadata.yaml").read_text()
    report, = recover_bag(folder)
    assert report.intact
    assert "intact" in str(report)
    (folder / "metadata.yaml").unlink()
    recover_bag(folder)
    assert (folder / "bag_0.mcap").read_bytes() == before[0]
    assert_sound(folder)


def test_recovering_twice_gives_the_same(make_bag):
    folder = make_bag()
    path = folder / "bag_0.mcap"
    path.write_bytes(path.read_bytes()[:-500])
    recover_bag(folder)
    once = path.read_bytes()
    assert recover_bag(folder)[0].intact
    assert path.read_bytes() == once


def test_what_is_not_a_bag_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="not a bag"):
        recover_bag(tmp_path)
    (tmp_path / "x_0.mcap").write_bytes(b"something else")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        recover_bag(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["x_0.mcap"]


@pytest.mark.parametrize("over", range(1, 8))
def test_the_end_of_a_file_is_seen_wherever_a_read_buffer_ends(tmp_path, over):
    from mcap.writer import Writer

    from unifeed_ros.core.recording.records import walk

    def write(path, padding):
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.add_metadata("padding", {"text": "x" * padding})
            writer.finish()
        return path.stat().st_size

    bare = write(tmp_path / "bare", 0)
    padding = 8192 * 2 + over - bare  # the closing bytes then lie across the end of the second buffer
    path = tmp_path / "padded"
    assert write(path, padding) % 8192 == over
    assert [record for record in walk(path) if record.torn] == []
