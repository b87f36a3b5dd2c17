from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import BagWriter, bag_info, check_bag, read_bag

START = 1_700_000_000_000_000_000

MESSAGES = st.lists(st.tuples(st.sampled_from(["/words", "/latched"]), st.text(max_size=40), st.integers(0, 10**10)),
                    max_size=40)


def problems(folder):
    return [str(f) for f in check_bag(folder) if f.problems]


@given(messages=MESSAGES, compression=st.sampled_from(["none", "lz4", "zstd"]), cut=st.integers(0, 40))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_read_is_what_was_written(topics, messages, compression, cut, string_message):
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bag"
        with BagWriter(folder, topics, compression=compression, chunk_bytes=300, flush_period=60.0) as bag:
            for k, (topic, text, offset) in enumerate(messages):
                if k == cut:
                    bag.split()
                bag.write(topic, string_message(text), START + offset)
        parts = [messages[:cut], messages[cut:]]
        expected = [(t, START + o, string_message(x)) for p in parts for t, x, o in sorted(p, key=lambda m: m[2])]
        read = [(m.topic, m.time, m.data) for m in read_bag(folder)]
        assert sorted(read) == sorted(expected)
        assert [m[1] for m in read] == [m[1] for m in expected]
        assert problems(folder) == []
        with Reader(folder) as reader:
            other = [(c.topic, moment, bytes(data)) for c, moment, data in reader.messages()]
        assert sorted(other) == sorted(expected)


def test_an_independent_reader_decodes_the_messages(make_bag):
    from rosbags.highlevel import AnyReader

    with AnyReader([make_bag(count=50)]) as reader:
        words = [reader.deserialize(data, c.msgtype).data for c, _, data in reader.messages()]
        assert {t: i.msgtype for t, i in reader.topics.items()}["/joint_states"] == "sensor_msgs/msg/JointState"
    assert words == [f"word {k}" for k in range(50)]


def test_info_counts_rates_gaps_and_marks(tmp_path, topics, string_message):
    with BagWriter(tmp_path / "bag", topics) as bag:
        for k in (0, 1, 2, 10):
            bag.write("/words", string_message("x"), START + k * 10**9)
        bag.mark("here", START)
        assert bag.counts == {"/words": 4, "/latched": 0, "/joint_states": 0}
    info = bag_info(tmp_path / "bag")
    words = next(t for t in info.topics if t.name == "/words")
    assert (words.message_count, words.rate, words.longest_gap) == (4, pytest.approx(0.3), pytest.approx(8.0))
    assert info.marks == ((START, "here"),)
    assert (info.message_count, info.start, info.duration) == (4, START, pytest.approx(10.0))
    assert len(info.topics) == 3


def test_metadata_is_rosbag2s_version_9(make_bag):
    values = yaml.safe_load((make_bag() / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert values["version"] == 9
    assert values["compression_mode"] == ""
    assert values["relative_file_paths"] == ["bag_0.mcap"]
    details = values["topics_with_message_count"][1]["topic_metadata"]
    assert details["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert details["type_description_hash"].startswith("RIHS01_")


def test_an_empty_bag_is_a_bag(make_bag):
    folder = make_bag(count=0)
    assert problems(folder) == []
    assert list(read_bag(folder)) == []
    assert bag_info(folder).message_count == 0
    with Reader(folder) as reader:
        assert reader.message_count == 0


def test_closing_twice_does_nothing_and_writing_after_is_refused(tmp_path, topics):
    bag = BagWriter(tmp_path / "bag", topics)
    bag.close()
    bag.close()
    for action in (lambda: bag.write("/words", b"", 0), bag.split, lambda: bag.mark("x")):
        with pytest.raises(RecordingError, match="closed"):
            action()


def test_many_threads_write_one_bag(tmp_path, topics, string_message):
    with BagWriter(tmp_path / "bag", topics, chunk_bytes=500, flush_period=0.005) as bag:
        def work(k):
            for i in range(300):
                bag.write("/words", string_message(f"{k} {i}"), time.time_ns())
        threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len({m.data for m in read_bag(tmp_path / "bag")}) == 1200
    assert problems(tmp_path / "bag") == []


def test_a_full_disk_is_said_and_what_was_written_stays(tmp_path, topics, monkeypatch, string_message):
    bag = BagWriter(tmp_path / "bag", topics, flush_period=60.0, compression="none")
    bag.write("/words", string_message("kept"), START)
    bag.flush()

    def refuse(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    bag.write("/words", string_message("lost"), START + 1)
    with monkeypatch.context() as patch:
        patch.setattr("unifeed_ros.core.recording.mcap_file.BagFile.flush", refuse)
        with pytest.raises(RecordingError, match="No space left"):
            bag.flush()
    with pytest.raises(RecordingError, match="No space left"):
        bag.write("/words", b"", START)
    with pytest.raises(RecordingError, match="recover"):
        bag.close()
    bag.close()


@pytest.mark.parametrize(("settings", "what"), [
    ({"compression": "rar"}, "none, lz4, zstd"),
])
def test_unknown_settings_are_refused(tmp_path, topics, settings, what):
    with pytest.raises(RecordingError, match=what):
        BagWriter(tmp_path / "bag", topics, **settings)
    assert not (tmp_path / "bag").exists()


def test_a_folder_that_exists_or_cannot_be_made_is_refused(make_bag, topics, tmp_path):
    with pytest.raises(RecordingError, match="exists"):
        BagWriter(make_bag(), topics)
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot make"):
        BagWriter(tmp_path / "file" / "bag", topics)


def test_unknown_topics_are_refused(tmp_path, topics):
    with BagWriter(tmp_path / "bag", topics) as bag, pytest.raises(RecordingError, match="/words"):
        bag.write("/other", b"", 0)
    with pytest.raises(RecordingError, match="each once"):
        BagWriter(tmp_path / "bag2", [topics[0], topics[0]])


@pytest.mark.parametrize("spoil", ["no folder", "no metadata", "not yaml", "other yaml", "no file", "not mcap"])
def test_what_is_not_a_bag_is_refused_in_one_line(make_bag, tmp_path, spoil):
    folder = make_bag()
    {
        "no folder": lambda: None,
        "no metadata": (folder / "metadata.yaml").unlink,
        "not yaml": lambda: (folder / "metadata.yaml").write_text("a: [1"),
        "other yaml": lambda: (folder / "metadata.yaml").write_text("a: 1"),
        "no file": (folder / "bag_0.mcap").unlink,
        "not mcap": lambda: (folder / "bag_0.mcap").write_bytes(b"hello" * 100),
    }[spoil]()
    folder = tmp_path / "nowhere" if spoil == "no folder" else folder
    for read in (lambda: list(read_bag(folder)), lambda: bag_info(folder)):
        with pytest.raises(RecordingError) as error:
            read()
        assert "\n" not in str(error.value)


def test_a_changed_byte_is_noticed(make_bag):
    folder = make_bag(compression="none")
    path = folder / "bag_0.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"word 7\0")] ^= 1
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged"):
        list(read_bag(folder))
    assert any("checksum" in p for p in problems(folder))


@pytest.mark.parametrize(("old", "new", "rule"), [
    ("version: 9", "version: 8", "version 9"),
    ("bag_0.mcap", "other.mcap", "as listed"),
    ("message_count: 200", "message_count: 7", "counts"),
    ("nanoseconds: 199000000", "nanoseconds: 5", "times"),
])
def test_each_lie_in_the_metadata_breaks_its_rule(make_bag, old, new, rule):
    path = make_bag() / "metadata.yaml"
    path.write_text(path.read_text().replace(old, new))
    assert [p for p in problems(path.parent) if rule in p.split(":")[0]]
