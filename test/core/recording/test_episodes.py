from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.modes import TeachingMode
from unifeed_ros.core.recording.episodes import ControlLog, SensorLog, cut_episodes
from unifeed_ros.core.recording.lerobot import write_lerobot

RATE = 50
JOINTS = ("a", "b", "c")


def session(gap=False):
    """Ten seconds: guided from 1 to 3 s, tracked from 4 to 7 s with a push from 5 to 6 s, back from 8 to 9 s."""
    times = np.arange(0.0, 10.0, 0.001)
    if gap:
        times = times[(times < 5.5) | (times > 5.7)]
    positions = np.stack([times, 2 * times, np.sin(times)], axis=1)
    sensors = SensorLog(times=times, positions=positions, velocities=np.gradient(positions, times, axis=0),
                        torque_times=times[::2], torques=0.1 * positions[::2])
    said = np.arange(0.0, 10.0, 0.01)
    spans = {"run": (4.0, 7.0), "return 1": (8.0, 9.0)}
    motions = [next((name for name, (a, b) in spans.items() if a <= t < b), "") for t in said]
    modes = [TeachingMode.GUIDE if 1.0 <= t < 3.0 else TeachingMode.TRACK if name else TeachingMode.HOLD
             for t, name in zip(said, motions, strict=True)]
    return sensors, ControlLog(times=said, modes=modes, motions=motions,
                               person_leads=[bool(5.0 <= t < 6.0) for t in said])


def test_runs_become_episodes_and_pushes_become_interventions():
    guided, run, back = cut_episodes(*session(), rate=RATE)
    assert (guided.kind, run.kind, back.kind) == ("guided", "run", "return 1")
    assert guided.intervention.all() and not back.intervention.any()
    led = run.times[run.intervention]
    assert (led[0], led[-1]) == (pytest.approx(1.0, abs=0.02), pytest.approx(2.0, abs=0.03))
    assert np.diff(run.times) == pytest.approx(1.0 / RATE)
    np.testing.assert_allclose(run.positions[:, 0], 4.0 + run.times, atol=1e-9)
    np.testing.assert_allclose(run.torques, 0.1 * run.positions, atol=1e-3)


def test_a_run_with_a_gap_in_the_joint_states_is_left_out():
    assert [e.kind for e in cut_episodes(*session(gap=True), rate=RATE, left_out=["return"])] == ["guided"]


def test_the_dataset_is_what_other_readers_expect_of_lerobots_v3(tmp_path):
    episodes = cut_episodes(*session(), rate=RATE, left_out=["return"])
    write_lerobot(tmp_path, episodes, robot="arm", joint_names=JOINTS, task="put it there", rate=RATE)
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    frames = pd.read_parquet(tmp_path / info["data_path"].format(chunk_index=0, file_index=0))
    rows = pd.read_parquet(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    tasks = pd.read_parquet(tmp_path / "meta" / "tasks.parquet")

    assert info["codebase_version"] == "v3.0" and info["video_path"] is None
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, len(frames), RATE)
    assert set(frames) == set(info["features"])
    assert list(tasks.index) == ["put it there"] and tasks.iloc[0].task_index == 0
    assert frames["index"].tolist() == list(range(len(frames)))
    stats = json.loads((tmp_path / "meta" / "stats.json").read_text())
    for name, feature in info["features"].items():
        column = np.stack(frames[name].to_numpy()).reshape(len(frames), -1)
        assert column.shape[1] == feature["shape"][0]
        assert str(column.dtype) == feature["dtype"]
        np.testing.assert_allclose(stats[name]["mean"], column.astype(float).mean(axis=0), rtol=1e-5)
        assert stats[name]["count"] == [len(frames)]
    for row, episode in zip(rows.itertuples(), episodes, strict=True):
        part = frames.iloc[row.dataset_from_index:row.dataset_to_index]
        assert len(part) == row.length == len(episode.times)
        assert set(part.episode_index) == {row.episode_index}
        assert part.frame_index.tolist() == list(range(row.length))
        np.testing.assert_array_equal(part.intervention, episode.intervention)
        state, action = (np.stack(part[name]) for name in ("observation.state", "action"))
        np.testing.assert_allclose(state, episode.positions, rtol=1e-6)
        np.testing.assert_array_equal(action[:-1], state[1:])
        np.testing.assert_allclose(part.timestamp, part.frame_index / RATE, atol=1e-5)
    kind = pq.read_schema(tmp_path / "data" / "chunk-000" / "file-000.parquet").field("action").type
    assert kind.list_size == 3


def test_nothing_is_exported_from_a_session_without_runs(tmp_path):
    with pytest.raises(RecordingError, match="no episode"):
        write_lerobot(tmp_path / "out", [], robot="arm", joint_names=JOINTS, task="t", rate=RATE)
    assert not (tmp_path / "out").exists()
