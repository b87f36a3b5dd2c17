from __future__ import annotations

import argparse
import json

import pytest

from unifeed_ros.cli.bag import add_bag_commands
from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording import BagWriter, RecordedTopic, message_type
from unifeed_ros.core.recording.schema import install_prefixes

pytestmark = pytest.mark.skipif(not install_prefixes(), reason="no ROS packages: AMENT_PREFIX_PATH is empty")

START = 1_700_000_000_000_000_000


@pytest.fixture
def bag(tmp_path):
    with BagWriter(tmp_path / "bag", [RecordedTopic(name="/words", type=message_type("std_msgs/msg/String"))]) as bag:
        for k in range(11):
            bag.write("/words", b"\0\1\0\0\1\0\0\0\0", START + k * 100_000_000)
        bag.mark("look here", START + 500_000_000)
    return bag.folder


@pytest.fixture
def run():
    parser = argparse.ArgumentParser()
    add_bag_commands(parser.add_subparsers())

    def call(*arguments):
        parsed = parser.parse_args(["bag", *map(str, arguments)])
        return parsed.run(parsed)

    return call


def test_info_names_topics_rates_and_marks(run, bag, capsys):
    assert run("info", bag) == 0
    text = capsys.readouterr().out
    row = next(line for line in text.splitlines() if line.startswith("/words")).split()
    assert row == ["/words", "11", "10.0", "0.1000", "std_msgs/msg/String"]
    assert "0.500  look here" in text


def test_info_as_json(run, bag, capsys):
    assert run("info", bag, "--json") == 0
    values = json.loads(capsys.readouterr().out)
    assert values["message_count"] == 11
    assert values["topics"][0]["rate"] == pytest.approx(10.0)


def test_check_passes_a_sound_bag_and_not_a_torn_one_until_it_is_recovered(run, bag, capsys):
    assert run("check", bag) == 0
    assert all(line.startswith("ok ") for line in capsys.readouterr().out.splitlines())
    path = bag / "bag_0.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    assert run("check", bag) == 1
    assert "FAIL  every file is closed" in capsys.readouterr().out
    assert run("recover", bag) == 0
    assert "rebuilt, 11 messages kept" in capsys.readouterr().out
    assert run("check", bag) == 0


@pytest.mark.parametrize("command", ["info", "check", "recover"])
def test_what_is_not_a_bag_is_refused(run, tmp_path, command):
    with pytest.raises(RecordingError, match="not a bag"):
        run(command, tmp_path)


def test_a_command_is_needed(run, capsys):
    with pytest.raises(SystemExit) as end:
        run()
    assert end.value.code == 2
