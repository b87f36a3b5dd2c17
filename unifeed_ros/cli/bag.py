"""The commands ``unifeed bag info|check|recover|export BAG``."""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import json
from pathlib import Path
from typing import Any

from unifeed_ros.cli.arguments import open_recording
from unifeed_ros.cli.export import add_export_options, run_export
from unifeed_ros.core.recording import BagInfo, bag_info, check_bag, recover_bag

MEBIBYTE = 1024 * 1024


def add_bag_commands(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command "bag" with its own commands.

    Each parser's default ``run`` is a function of the parsed arguments that returns the exit status and raises
    UnifeedError for a user's mistake.

    Args:
        subparsers: What ``add_subparsers`` of the main parser gave.
    """
    parser = subparsers.add_parser("bag", help="look into, check, recover and export recordings")
    commands = parser.add_subparsers(dest="bag_command", required=True, metavar="COMMAND")
    for name, run, text in (
        ("info", run_info, "say what a bag holds: topics, counts, rates [Hz], longest gaps [s], marks"),
        ("check", run_check, "hold a bag against every rule of rosbag2's format; status 0 only if all are kept"),
        ("recover", run_recover, "rebuild the files of a bag that was not closed, and say what was lost"),
        ("export", run_export, "write tables (CSV, Parquet), a LeRobot dataset, or figures of what was taught"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag")
        command.add_argument("--json", action="store_true", help="print JSON")
        command.set_defaults(run=run)
        if name == "export":
            add_export_options(command)


def run_info(arguments: argparse.Namespace) -> int:
    """Print what a bag holds.

    Raises:
        RecordingError: Not a bag, or not closed.
    """
    info = bag_info(open_recording(arguments.bag))
    if arguments.json:
        _print_json(dataclasses.asdict(info))
    else:
        print("\n".join(_info_lines(info)))
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Print one line for each rule; status 1 if one is broken.

    Raises:
        RecordingError: Not a bag.
    """
    findings = check_bag(arguments.bag)
    if arguments.json:
        _print_json([dataclasses.asdict(finding) for finding in findings])
    else:
        print("\n".join(map(str, findings)))
    return int(any(finding.problems for finding in findings))


def run_recover(arguments: argparse.Namespace) -> int:
    """Rebuild what is torn and print one line for each file.

    Raises:
        RecordingError: Not a bag, or the disk refuses.
    """
    reports = recover_bag(arguments.bag)
    if arguments.json:
        _print_json([dataclasses.asdict(report) for report in reports])
    else:
        print("\n".join(map(str, reports)))
    return 0


def _info_lines(info: BagInfo) -> list[str]:
    lines = [
        f"bag       {info.folder}",
        f"files     {', '.join(info.files)} ({info.size / MEBIBYTE:.1f} MiB)",
        f"start     {_clock_time(info.start)}",
        f"duration  {info.duration:.3f} s",
        f"messages  {info.message_count}",
        "",
    ]
    width = max((len(t.name) for t in info.topics), default=5)
    lines.append(f"{'topic':{width}}  {'messages':>9}  {'rate [Hz]':>9}  {'longest gap [s]':>15}  type")
    lines += [f"{t.name:{width}}  {t.message_count:9d}  {t.rate:9.1f}  {t.longest_gap:15.4f}  {t.type}"
              for t in info.topics]
    if info.marks:
        lines += ["", "marks [s from the start]"]
        lines += [f"{(time - info.start) * 1e-9:10.3f}  {text}" for time, text in info.marks]
    return lines


def _clock_time(nanoseconds: int) -> str:
    if not nanoseconds:
        return "no messages"
    moment = datetime.datetime.fromtimestamp(nanoseconds * 1e-9, tz=datetime.timezone.utc)
    return moment.isoformat(timespec="milliseconds")


def _print_json(values: Any) -> None:
    print(json.dumps(values, default=str))
