"""Write episodes as a LeRobot dataset, format v3.0 (huggingface/lerobot, lerobot/datasets/utils.py, 2025).

One Parquet file holds the frames of all episodes, another one a row an episode, a third one the tasks; info.json names
the features, stats.json their statistics. There are no images.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from unifeed_ros.core.errors import RecordingError
from unifeed_ros.core.recording.episodes import Episode

VERSION = "v3.0"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNK_FILES, DATA_MIB, VIDEO_MIB = 1000, 100, 500
"""Limits that the format writes down: files a chunk, size of a data file, size of a video file [MiB]."""

FRAME_COLUMNS = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
                 "task_index": "int64"}
"""Columns that every dataset has, with one number a frame."""

Columns = dict[str, NDArray[Any]]


def write_lerobot(folder: Path, episodes: Sequence[Episode], *, robot: str, joint_names: Sequence[str], task: str,
                  rate: int) -> None:
    """Write a dataset of one task.

    The columns are ``observation.state`` (joint positions [rad]), ``observation.velocity`` [rad/s],
    ``observation.external_torque`` [Nm], ``action`` (joint positions one frame later [rad], in the last frame those of
    the frame itself) and ``intervention`` (true where a person led).

    Args:
        folder: Folder of the dataset; it is made.
        episodes: Episodes, at least one.
        robot: Name of the robot.
        joint_names: Names of the n joints.
        task: The task, in words.
        rate: Frames a second [Hz].

    Raises:
        RecordingError: There are no episodes.
    """
    if not episodes:
        raise RecordingError("no episode to export", expected="a guided or tracked run without gaps in joint_states")
    features = _features(joint_names, rate)
    frames, rows = [], []
    begun = 0
    for number, episode in enumerate(episodes):
        columns = _columns(episode, number, begun)
        frames.append(columns)
        rows.append(_episode_row(number, task, columns, begun))
        begun += len(episode.times)
    together = {name: np.concatenate([columns[name] for columns in frames]) for name in features}
    _write(folder / "data" / FILE.format(chunk_index=0, file_index=0), _frame_table(together, features))
    _write(folder / "meta" / "episodes" / FILE.format(chunk_index=0, file_index=0), pa.Table.from_pylist(rows))
    _write(folder / "meta" / "tasks.parquet", _task_table([task]))
    _write_json(folder / "meta" / "stats.json", {name: statistics(values) for name, values in together.items()})
    _write_json(folder / "meta" / "info.json", {
        "codebase_version": VERSION, "robot_type": robot, "total_episodes": len(episodes), "total_frames": begun,
        "total_tasks": 1, "chunks_size": CHUNK_FILES, "data_files_size_in_mb": DATA_MIB,
        "video_files_size_in_mb": VIDEO_MIB, "fps": rate, "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{FILE}", "video_path": None, "features": features})


def statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Give a column's statistics as the format keeps them, one number a component."""
    numbers = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    parts = {"min": numbers.min(axis=0), "max": numbers.max(axis=0), "mean": numbers.mean(axis=0),
             "std": numbers.std(axis=0), "count": np.array([len(numbers)])}
    return {name: part.tolist() for name, part in parts.items()}


def _features(joint_names: Sequence[str], rate: int) -> dict[str, dict[str, Any]]:
    joints = {"dtype": "float32", "shape": [len(joint_names)], "names": list(joint_names), "fps": rate}
    named = ("observation.state", "observation.velocity", "observation.external_torque", "action")
    one: dict[str, Any] = {"shape": [1], "names": None, "fps": rate}
    return {**{name: dict(joints) for name in named}, "intervention": {"dtype": "bool", **one},
            **{name: {"dtype": kind, **one} for name, kind in FRAME_COLUMNS.items()}}


def _columns(episode: Episode, number: int, begun: int) -> Columns:
    count = len(episode.times)
    following = np.concatenate([episode.positions[1:], episode.positions[-1:]])
    return {
        "observation.state": episode.positions.astype(np.float32),
        "observation.velocity": episode.velocities.astype(np.float32),
        "observation.external_torque": episode.torques.astype(np.float32),
        "action": following.astype(np.float32),
        "intervention": episode.intervention,
        "timestamp": episode.times.astype(np.float32),
        "frame_index": np.arange(count),
        "episode_index": np.full(count, number),
        "index": np.arange(begun, begun + count),
        "task_index": np.zeros(count, dtype=np.int64),
    }


def _episode_row(number: int, task: str, columns: Columns, begun: int) -> dict[str, Any]:
    count = len(columns["timestamp"])
    row: dict[str, Any] = {
        "episode_index": number, "tasks": [task], "length": count, "data/chunk_index": 0, "data/file_index": 0,
        "dataset_from_index": begun, "dataset_to_index": begun + count, "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0}
    for name, values in columns.items():
        row |= {f"stats/{name}/{key}": part for key, part in statistics(values).items()}
    return row


def _frame_table(columns: Columns, features: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    arrays = {}
    for name, values in columns.items():
        kind = pa.bool_() if features[name]["dtype"] == "bool" else getattr(pa, features[name]["dtype"])()
        if values.ndim == 1:
            arrays[name] = pa.array(values, kind)
        else:
            arrays[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), kind), values.shape[1])
    return pa.table(arrays)


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Give the tasks as pandas writes a table whose index are the tasks: that is how the format is read."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    described = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0",
        "columns": [{"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64",
                     "metadata": None},
                    {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object",
                     "metadata": None}]}
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _write_json(path: Path, values: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(values, indent=4, ensure_ascii=False) + "\n")
