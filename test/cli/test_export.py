"""Exports read again by pyarrow and pandas; a golden lesson is what is exported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from unifeed_msgs.msg import Feedback
from unifeed_ros.cli.main import main
from unifeed_ros.core.recording import read_bag

BAG = Path(__file__).resolve().parents[2] / "bags" / "panda_cup_dc"


@pytest.fixture
def export(tmp_path, capsys):
    def run(kind, *more, status=0):
        assert main(["bag", "export", str(BAG), "--format", kind, "--out", str(tmp_path / "out"), *more]) == status
        return tmp_path / "out", capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def states():
    return [(m.time, deserialize_message(m.data, JointState)) for m in read_bag(BAG, ["/joint_states"])]


def test_parquet_holds_every_message_as_it_was(export, states):
    out, _ = export("parquet", "--topic", "joint_states", "--topic", "/feedback")
    assert sorted(p.name for p in out.iterdir()) == ["feedback.parquet", "joint_states.parquet"]
    table = pq.read_table(out / "joint_states.parquet").to_pydict()
    assert table["log_time"] == [time for time, _ in states]
    assert table["position"] == [msg.position.tolist() for _, msg in states]
    assert table["velocity"] == [msg.velocity.tolist() for _, msg in states]
    assert table["header"][-1]["stamp"] == {
        "sec": states[-1][1].header.stamp.sec, "nanosec": states[-1][1].header.stamp.nanosec}
    items = [deserialize_message(m.data, Feedback) for m in read_bag(BAG, ["/feedback"])]
    rows = pq.read_table(out / "feedback.parquet").to_pylist()
    assert [row["id"] for row in rows] == [item.id for item in items]
    for row, item in zip(rows, items, strict=True):
        assert [p["positions"] for p in row["corrected"]["points"]] == [
            p.positions.tolist() for p in item.corrected.points]
        assert row["ranks"] == item.ranks.tolist()


def test_csv_has_a_column_a_number(export, states):
    out, _ = export("csv", "--topic", "/joint_states")
    table = pd.read_csv(out / "joint_states.csv")
    assert table["log_time"].tolist() == [time for time, _ in states]
    np.testing.assert_array_equal(table[[f"position[{k}]" for k in range(7)]].to_numpy(),
                                  [msg.position for _, msg in states])
    assert table["name[0]"].iloc[0] == states[0][1].name[0]


def test_csv_of_nested_messages_is_read_as_json(export):
    out, _ = export("csv", "--topic", "/feedback")
    (first, *_) = [deserialize_message(m.data, Feedback) for m in read_bag(BAG, ["/feedback"])]
    row = pd.read_csv(out / "feedback.csv").iloc[0]
    points = json.loads(row["demonstration.points"]) if first.kind == Feedback.DEMONSTRATION else []
    assert [p["positions"] for p in points] == [p.positions.tolist() for p in first.demonstration.points]


def test_lerobot_tags_what_a_person_did(export):
    out, _ = export("lerobot", "--fps", "25")
    info = json.loads((out / "meta" / "info.json").read_text())
    assert (info["robot_type"], info["fps"]) == ("panda", 25)
    frames = pd.read_parquet(out / "data" / "chunk-000" / "file-000.parquet")
    led = frames.groupby("episode_index").intervention.mean()
    assert led.iloc[0] == 1.0  # the demonstration
    assert any(0.0 < share < 1.0 for share in led)  # a run that was pushed
    assert pd.read_parquet(out / "meta" / "tasks.parquet").index.tolist() == ["cup"]


def test_an_item_is_drawn(export):
    out, _ = export("figure", "--item", "1-0")
    (figure,) = out.iterdir()
    assert figure.name == "1-0.png"
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("arguments", "words"), [
    (["parquet", "--topic", "/nothing"], "no messages on /nothing"), (["lerobot", "--fps", "0"], "--fps"),
    (["figure", "--item", "nothing"], "no feedback item nothing"),
    (["lerobot", "--robot", "ur10"], "robot of the recording")])
def test_what_cannot_be_exported_is_refused_and_nothing_written(export, arguments, words, tmp_path):
    _, printed = export(*arguments, status=2)
    assert words in printed.err and printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_left_alone(export, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("x")
    export("csv", status=2)
    assert (tmp_path / "out" / "mine").read_text() == "x"
