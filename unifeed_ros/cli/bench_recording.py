"""`unifeed bench recording`: what the recorder loses, what it costs, and what it withstands."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from unifeed_ros.cli.arguments import UserMistake, domain, session_files
from unifeed_ros.cli.bench_stream import ENTRY, STREAMS
from unifeed_ros.cli.monitor import SessionMonitor
from unifeed_ros.cli.processes import NodeProcesses, node_environment
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.recording import bag_info, check_bag, read_bag, recover_bag
from unifeed_ros.experiments.recording_bench import compare_writers, fill_disk, truncate_everywhere
from unifeed_ros.nodes.table import RECORDER, SessionSetup, node_table

SETTLING = 0.2
"""Share of the session before memory and processor time are watched: imports and first chunks are over then."""
MIB = 1024 * 1024
LESSON = "DCP" * 40
"""What the simulated person teaches: more than there is time for, so that learner and planner always work."""
READY_S = 60.0
"""Longest wait for a process of the benchmark to be there [s]."""


def run(options: argparse.Namespace) -> int:
    """Measure and print; 0 only if nothing was lost and every bag recovered."""
    if options.minutes <= 0 or options.kills < 1:
        raise UserMistake("--minutes and --kills", expected="more than 0", got=(options.minutes, options.kills))
    with tempfile.TemporaryDirectory(prefix="unifeed-bench-") as folder:
        figures = measure_recording(options, Path(folder))
    print(json.dumps(figures, indent=2) if options.json else recording_text(figures))
    summary = figures["summary"]
    cuts = figures["truncation"]
    withstood = (summary["recovered"] == summary["kills"] and figures["disk_full"]["recovered"]
                 and cuts["recovered"] == cuts["cuts"])
    return 0 if withstood and summary["lost"] == 0 else 1


def measure_recording(options: argparse.Namespace, place: Path) -> dict[str, Any]:
    """Run all parts, telling progress on stderr.

    Args:
        options: Parsed command line.
        place: Folder for the recordings.

    Returns:
        ``summary`` and the parts ``session``, ``writers``, ``kills``, ``disk_full``, ``truncation``.
    """
    session = record_session(60.0 * options.minutes, place)
    _tell(f"session: {session}")
    writers = compare_writers(place / "bag", place, options.peer_messages)
    _tell(f"writers: {writers}")
    kills = kill_recorders(options.kills, place, random.Random(options.seed))
    disk = fill_disk(place)
    _tell(f"full disk: {disk}")
    cuts = truncate_everywhere(place / "kill-0", place)
    _tell(f"truncation: {cuts}")
    return {
        "summary": {
            "messages": session["messages"], "lost": session["lost"], "cpu_fraction": session["cpu_fraction"],
            "writer_cpu_fraction": writers.own / writers.duration,
            "peer_cpu_fraction": writers.peer / writers.duration,
            "peer_bytes_cpu_fraction": writers.peer_bytes / writers.duration,
            "memory_growth_mib": session["memory_growth_mib"], "kills": len(kills),
            "recovered": sum(kill["recovered"] for kill in kills),
            "worst_loss_s": max(kill["loss_s"] for kill in kills)},
        "machine": {"cores": os.cpu_count(), "load": os.getloadavg()},
        "session": session, "writers": dataclasses.asdict(writers), "kills": kills, "disk_full": disk,
        "truncation": cuts}


def record_session(duration: float, place: Path) -> dict[str, Any]:
    """Record a whole live session: simulated arm and person, control, capture, learner and planner.

    Args:
        duration: Length, from the recorder being there [s].
        place: Folder; the bag is ``bag`` in it.

    Returns:
        Messages, those lost on the way, share of a core that the recorder's process took, growth of its memory.
    """
    setup = SessionSetup(parameter_files=session_files("panda", "table"), taught_by=LESSON, bag=place / "bag")
    samples: list[tuple[float, float, float]] = []
    with SessionMonitor() as monitor:
        if monitor.session_is_running():
            raise UserMistake(f"a session is already running on ROS_DOMAIN_ID {domain()}", mend="end it first")
        with NodeProcesses(node_table(setup), place / "logs") as processes:
            if not monitor.spin(READY_S, lambda: RECORDER in monitor.diagnostics):
                raise UnifeedError("the recorder did not start", got=processes.log_tail(RECORDER, 1))
            end = time.monotonic() + duration
            while time.monotonic() < end:
                monitor.spin(1.0)
                samples.append((time.monotonic(), *_used(processes.pid(RECORDER))))
                if dead := processes.dead():
                    raise UnifeedError(f"{', '.join(dead)} died", got=processes.log_tail(next(iter(dead)), 1))
            interactions = len(monitor.interactions)
        monitor.spin(0.5)
        lost = int(monitor.figure(RECORDER, "lost"))
    steady = samples[int(SETTLING * len(samples)):]
    (begun, first_cpu, first_memory), (ended, last_cpu, last_memory) = steady[0], steady[-1]
    info = bag_info(place / "bag")
    problems = [str(finding) for finding in check_bag(place / "bag") if finding.problems]
    return {"seconds": duration, "messages": info.message_count, "lost": lost, "interactions": interactions,
            "cpu_fraction": (last_cpu - first_cpu) / (ended - begun),
            "memory_growth_mib": (last_memory - first_memory) / MIB, "size_mib": info.size / MIB,
            "problems": problems, "rates_hz": {t.name: round(t.rate, 1) for t in info.topics}}


def kill_recorders(count: int, place: Path, rng: random.Random) -> list[dict[str, Any]]:
    """Kill a recorder of two streams at 1 kHz again and again, each time at a random moment, and recover its bag.

    Args:
        count: How often.
        place: Folder for the bags, named kill-0 and on.
        rng: Draws the moments.

    Returns:
        One row a kill: messages kept, whether all up to the last are there unchanged and in order in a sound bag, and
        the age of the oldest message lost at the moment of the kill [s].
    """
    rows = []
    log = place / "stream"
    stream = _start("unifeed_ros.cli.bench_stream", str(log))
    try:
        for number in range(count):
            bag = place / f"kill-{number}"
            recorder = _start("unifeed_ros.nodes.recorder", "--ros-args", "-p", f"recorder.folder:={bag}",
                              "-p", f"recorder.topics:=[{', '.join(STREAMS)}]")
            try:
                _wait_for(lambda bag=bag: _size(bag) > 20_000, f"recorder {number}")
                time.sleep(rng.uniform(0.0, 2.0))
            finally:
                recorder.send_signal(signal.SIGKILL)
                killed = time.time_ns()
                recorder.wait()
            rows.append(_judge_kill(bag, log, killed))
            _tell(f"kill {number + 1} of {count}: {rows[-1]}")
    finally:
        stream.kill()
        stream.wait()
    return rows


def _judge_kill(bag: Path, log: Path, killed: int) -> dict[str, Any]:
    recover_bag(bag)
    entries = log.read_bytes()
    times = [entry[0] for entry in ENTRY.iter_unpack(entries[:len(entries) // ENTRY.size * ENTRY.size])]
    published = sum(moment <= killed for moment in times)
    sound = not any(finding.problems for finding in check_bag(bag))
    loss, kept = 0.0, 0
    for topic in STREAMS:
        numbers = []
        for message in read_bag(bag, [f"/{topic}"]):
            msg = deserialize_message(message.data, JointState)
            numbers.append(int(msg.effort[0]))
            sound &= list(msg.position) == [0.1 * numbers[-1]] * 7 and list(msg.effort) == [numbers[-1]] * 7
        sound &= bool(numbers) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        kept += len(numbers)
        following = numbers[-1] + 1 if numbers else 0
        if following < published:
            loss = max(loss, (killed - times[following]) * 1e-9)
    return {"kept": kept, "recovered": bool(sound), "loss_s": loss}


def recording_text(figures: dict[str, Any]) -> str:
    """Say the figures in a few lines."""
    s, session, disk, cuts = (figures[name] for name in ("summary", "session", "disk_full", "truncation"))
    return "\n".join([
        f"{session['seconds']:.0f} s of a session, {session['interactions']} interactions: {s['messages']} messages, "
        f"{s['lost']} lost; the recorder took {100 * s['cpu_fraction']:.1f} % of a core, its memory grew by "
        f"{s['memory_growth_mib']:.1f} MiB",
        f"writing the same messages: {100 * s['writer_cpu_fraction']:.2f} % of a core; mcap_ros2 "
        f"{100 * s['peer_cpu_fraction']:.2f} %, without its serialising {100 * s['peer_bytes_cpu_fraction']:.2f} %",
        f"kill -9: {s['recovered']} of {s['kills']} bags recovered, worst loss {s['worst_loss_s']:.2f} s",
        f"full disk ({disk['how']}): {'recovered' if disk['recovered'] else 'NOT recovered'}, {disk['kept']} of "
        f"{disk['written']} messages kept, loss {disk['loss_s']:.2f} s; the writer said: {disk['message']}",
        f"cut at every 1 %: {cuts['recovered']} of {cuts['cuts']} recovered, worst loss {cuts['worst_loss_s']:.2f} s"])


def _start(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", module, *arguments], env=node_environment(),
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)


def _wait_for(condition: Any, what: str) -> None:
    end = time.monotonic() + READY_S
    while not condition():
        if time.monotonic() > end:
            raise UnifeedError(f"{what} did not start", expected=f"within {READY_S:.0f} s")
        time.sleep(0.02)


def _size(bag: Path) -> int:
    return sum(path.stat().st_size for path in bag.glob("*.mcap"))


def _used(pid: int) -> tuple[float, float]:
    """Give a process's processor time [s] and resident memory [byte]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(fields[21]) * os.sysconf("SC_PAGE_SIZE")


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
