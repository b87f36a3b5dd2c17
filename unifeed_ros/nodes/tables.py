"""Messages as rows of tables: nested for Parquet, flat for CSV."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from unifeed_ros.nodes.raw_input import import_type

TIME = "log_time"
"""Column of the time at which the message arrived [ns since the epoch]."""
BATCH = 10_000
"""Rows that are in memory at a time."""
SEVERAL = re.compile(r"sequence<([^,>]+)(?:,\s*\d+)?>|(.+)\[\d+\]")
SCALARS = {"boolean": pa.bool_(), "float": pa.float32(), "double": pa.float64(), "octet": pa.uint8(),
           **{f"{sign}int{size}": getattr(pa, f"{sign}int{size}")() for sign in ("", "u") for size in (8, 16, 32, 64)}}

Rows = Callable[[], Iterable[tuple[int, Any]]]
"""Gives times [ns] and messages, from the start each time."""


def write_parquet(path: Path, kind: type, rows: Rows) -> int:
    """Write messages of one class as a Parquet file, nested as the message is.

    Args:
        path: The file.
        kind: Message class.
        rows: The messages.

    Returns:
        Number of rows.
    """
    schema = pa.schema([(TIME, pa.int64()), *_fields(kind)])
    count, source = 0, iter(rows())
    with pq.ParquetWriter(path, schema) as writer:
        while batch := [{TIME: time, **plain(msg)} for time, msg in islice(source, BATCH)]:
            writer.write_table(pa.Table.from_pylist(batch, schema=schema))
            count += len(batch)
    return count


def write_csv(path: Path, rows: Rows) -> int:
    """Write messages of one class as a CSV file: a column a number, lists of messages as JSON.

    Args:
        path: The file.
        rows: The messages; they are gone through twice, since arrays may grow.

    Returns:
        Number of rows.
    """
    columns: dict[str, None] = {}
    for _, msg in rows():
        columns.update(dict.fromkeys(name for name, _ in _flat("", plain(msg))))
    count = 0
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [TIME, *columns], restval="")
        writer.writeheader()
        for time, msg in rows():
            writer.writerow({TIME: time, **dict(_flat("", plain(msg)))})
            count += 1
    return count


def plain(msg: Any) -> dict[str, Any]:
    """Give a message as nested dictionaries, lists and plain values."""
    return {name: _plain_value(getattr(msg, name)) for name in msg.get_fields_and_field_types()}


def _plain_value(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return plain(value)
    if isinstance(value, np.ndarray) or hasattr(value, "typecode"):
        return value.tolist()
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (list, tuple)):
        return [_plain_value(v) for v in value]
    return value


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _flat(f"{prefix}.{name}" if prefix else name, part)
    elif isinstance(value, list):
        if any(isinstance(part, (dict, list)) for part in value):
            yield prefix, json.dumps(value)
        else:
            yield from ((f"{prefix}[{k}]", part) for k, part in enumerate(value))
    else:
        yield prefix, value


def _fields(kind: type) -> list[tuple[str, pa.DataType]]:
    return [(name, _arrow_type(field)) for name, field in kind.get_fields_and_field_types().items()]


def _arrow_type(field: str) -> pa.DataType:
    several = SEVERAL.fullmatch(field)
    if several:
        return pa.list_(_arrow_type(several[1] or several[2]))
    if field in SCALARS:
        return SCALARS[field]
    if "string" in field:
        return pa.string()
    package, name = field.split("/")
    return pa.struct(_fields(import_type(f"{package}/msg/{name}")))
