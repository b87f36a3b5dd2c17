from __future__ import annotations

import shutil

import pytest

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import BagWriter, bag_info, check_bag, open_bag, recover_bag


def test_a_whole_bag_is_opened_as_it_is(make_bag):
    folder = make_bag()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    opened = open_bag(folder)
    assert opened.folder == folder and opened.recovered == ()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_sessions_folder_is_opened_after_a_crash_and_it_is_said_what_was_lost(make_bag, tmp_path):
    session = tmp_path / "session"
    session.mkdir()
    bag = shutil.move(make_bag(), session / "bag")
    path = bag / "bag_0.mcap"
    path.write_bytes(path.read_bytes()[:-3000])
    opened = open_bag(session)
    assert opened.folder == bag
    (report,) = opened.recovered
    assert not report.intact and report.unreadable_bytes > 0
    assert bag_info(bag).message_count == report.messages > 100
    assert not [f for f in check_bag(bag) if f.problems]
    assert open_bag(session).recovered == ()  # once is enough


@pytest.mark.parametrize("spoil", ["metadata gone", "counts old", "file not listed"])
def test_a_crash_between_two_files_loses_none_of_them(make_bag, spoil):
    folder = make_bag()
    metadata = folder / "metadata.yaml"
    if spoil == "metadata gone":
        metadata.unlink()
    elif spoil == "counts old":
        metadata.write_text(metadata.read_text().replace("message_count: 200", "message_count: 0"))
    else:
        shutil.copy(folder / "bag_0.mcap", folder / "bag_1.mcap")
    assert open_bag(folder).recovered
    assert bag_info(folder).message_count == (400 if spoil == "file not listed" else 200)
    assert not [f for f in check_bag(folder) if f.problems]


def test_a_file_that_was_taken_away_is_not_forgotten(make_bag):
    folder = make_bag()
    shutil.copy(folder / "bag_0.mcap", folder / "bag_1.mcap")
    recover_bag(folder)
    (folder / "bag_1.mcap").unlink()
    assert open_bag(folder).recovered == ()
    with pytest.raises(RecordingError, match=r"bag_1\.mcap of the bag is missing"):
        bag_info(folder)


def test_a_bag_that_is_being_recorded_is_left_alone(tmp_path, topics, string_message):
    with BagWriter(tmp_path / "bag", topics) as bag:
        bag.write("/words", string_message("x"), 1)
        bag.flush()
        for refuse in (open_bag, recover_bag):
            with pytest.raises(RecordingError, match="being recorded at this moment"):
                refuse(tmp_path / "bag")
        bag.write("/words", string_message("y"), 2)
    assert bag_info(tmp_path / "bag").message_count == 2
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_what_holds_no_bag_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(RecordingError, match="is not a bag"):
            open_bag(folder)
