"""What was taught is on disk, whole, in order, and with what was taken back."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from unifeed_msgs.msg import Feedback
from unifeed_ros.core.errors import InputError
from unifeed_ros.nodes.kept_feedback import KeptFeedback


def taught(*names):
    return [Feedback(id=name, kind=Feedback.PREFERENCE, ranks=[1, 0]) for name in names]


def test_what_was_kept_is_found_again_in_its_order_and_undone_things_stay_undone(tmp_path):
    inputs = taught(*(f"item {k}" for k in range(12)))
    kept = KeptFeedback(tmp_path / "taught")
    for message in inputs:
        kept.add(message)
    for name in ("item 3", "item 11"):
        kept.take_back(name)
    again = KeptFeedback(tmp_path / "taught")
    assert again.found == [(m, m.id not in ("item 3", "item 11")) for m in inputs]
    again.add(inputs[3])
    again.add(*taught("later"))
    assert [(m.id, counts) for m, counts in KeptFeedback(tmp_path / "taught").found][-2:] == [
        ("item 11", False), ("later", True)]
    assert (inputs[3], True) in KeptFeedback(tmp_path / "taught").found


def test_a_write_that_was_cut_short_is_as_if_it_had_not_begun(tmp_path):
    kept = KeptFeedback(tmp_path)
    kept.add(*taught("first"))
    (tmp_path / "0002.part").write_bytes(b"half")
    again = KeptFeedback(tmp_path)
    again.add(*taught("second"))
    assert [m.id for m, _ in KeptFeedback(tmp_path).found] == ["first", "second"]


def test_a_folder_that_cannot_be_used_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file.*learner\.folder"):
        KeptFeedback(tmp_path / "file")
    (tmp_path / "0001.feedback").write_bytes(b"not a message")
    with pytest.raises(InputError, match="what was taught"):
        KeptFeedback(tmp_path)
