"""Start the nodes of a session as processes, watch them, end them all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from unifeed_ros.nodes.parent_death import end_with_parent
from unifeed_ros.nodes.table import CONSOLE, RECORDER, NodeSpec

NODES_GRACE_S = 1.6
"""Time that all nodes but the recorder have to end [s]."""
RECORDER_GRACE_S = 1.2
"""Time that the recorder has to end after the others [s]."""


class NodeProcesses:
    """The processes of a session; as a context manager it leaves none behind.

    Args:
        specs: Nodes, in the order in which they start.
        logs: Folder for one log file a node.
    """

    def __init__(self, specs: Sequence[NodeSpec], logs: Path) -> None:
        self._specs, self._logs = specs, logs
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._console_told = ""

    def __enter__(self) -> NodeProcesses:
        """Start every node."""
        self._logs.mkdir(parents=True, exist_ok=True)
        try:
            for spec in self._specs:
                self._start(spec)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End every node."""
        self.stop()

    def dead(self) -> dict[str, int]:
        """Give the exit status of each node that has ended and without which the session cannot go on."""
        return {name: code for name, p in self._processes.items() if name != CONSOLE and (code := p.poll()) is not None}

    def console_news(self, address: str) -> str:
        """Say once where the teaching page is, and once that it ended; empty when there is nothing new.

        Args:
            address: Address that the page has told; empty if it has not yet.
        """
        process = self._processes.get(CONSOLE)
        if process is None:
            return ""
        news = f"teaching page: {address}" if address else ""
        if process.poll() is not None:
            news = f"the teaching page ended, the session goes on: {self.log_tail(CONSOLE, 1) or 'see its log'}"
        told, self._console_told = self._console_told, news or self._console_told
        return news if news != told else ""

    @property
    def pids(self) -> list[int]:
        """Process ids of the nodes; each leads a session with all that it starts."""
        return [p.pid for p in self._processes.values()]

    def pid(self, name: str) -> int:
        """Give the process id of a node."""
        return self._processes[name].pid

    def log_tail(self, name: str, lines: int = 3) -> str:
        """Give the last lines that a node printed."""
        try:
            text = (self._logs / f"{name}.log").read_text(errors="replace")
        except OSError:
            return ""
        return "\n".join([line for line in text.splitlines() if line.strip()][-lines:])

    def kill(self, name: str) -> None:
        """End a node at once, as a crash would."""
        self._processes[name].kill()
        self._processes[name].wait()

    def start_again(self, name: str) -> None:
        """Start a node that has ended."""
        self._start(next(spec for spec in self._specs if spec.executable == name))

    def stop(self) -> None:
        """Ask all nodes to end, the recorder last so that it has their last words, then kill what is left."""
        self._end([n for n in self._processes if n != RECORDER], NODES_GRACE_S)
        self._end([RECORDER] if RECORDER in self._processes else [], RECORDER_GRACE_S)

    def _start(self, spec: NodeSpec) -> None:
        command = [sys.executable, "-m", f"unifeed_ros.nodes.{spec.executable}", *spec.arguments()]
        with (self._logs / f"{spec.executable}.log").open("ab") as log:
            self._processes[spec.executable] = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True,
                env=node_environment(), preexec_fn=lambda: end_with_parent(signal.SIGTERM))

    def _end(self, names: Sequence[str], grace: float) -> None:
        running = [self._processes[n] for n in names if self._processes[n].poll() is None]
        for process in running:
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + grace
        for process in running:
            try:
                process.wait(max(0.01, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def node_environment() -> dict[str, str]:
    """Give the environment of a node: one thread for mathematics, traffic that stays on this machine by default."""
    environment = dict(os.environ)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.setdefault(name, "1")
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment["PYTHONUNBUFFERED"] = "1"
    return environment
