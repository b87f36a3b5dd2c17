"""Real processes on a ROS domain of their own; none outlives its test."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

sys.path.insert(0, str(Path(__file__).parent))
from stall_watch import StallWatch

REPOSITORY = Path(__file__).resolve().parents[2]
STALLED = ("no joint state for", "joint states stopped coming")
"""What a session says, rightly, when the machine gave the simulated arm no processor for a tenth of a second."""
DOMAINS = range(10, 100)
"""Domains whose ports stay below Linux's range of ephemeral ports."""
BEGUN = pytest.StashKey[float]()


def pytest_collection_modifyitems(config, items):
    """Let a test that failed while the machine stalled, and only such a one, try again."""
    items = [item for item in items if Path(__file__).parent in item.path.parents]
    if not items or config.option.collectonly:
        return
    watch = StallWatch()
    config.add_cleanup(watch.close)
    for item in items:
        def stalled(error, item=item):
            said = any(text in str(error) for text in STALLED)
            return said or watch.stalled_since(item.stash[BEGUN])

        item.add_marker(pytest.mark.flaky(reruns=2, condition=stalled))


def pytest_runtest_setup(item):
    """Remember when the test began, each time that it does."""
    item.stash[BEGUN] = time.monotonic()


@pytest.fixture
def domain_id():
    """Give a ROS domain that nothing on this machine uses at the moment.

    A domain is held by a lock that the kernel gives back when the process ends, however it ends.
    """
    busy, stale = _domains_with_participants(), _domains_with_leftovers()
    candidates = [domain for domain in DOMAINS if domain not in busy]
    random.shuffle(candidates)
    candidates.sort(key=lambda domain: domain in stale)
    for candidate in candidates:
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            lock.bind(f"\0unifeed-test-domain-{candidate}")
        except OSError:
            lock.close()
            continue
        yield candidate
        lock.close()
        return
    pytest.fail("no free ROS domain")


@pytest.fixture
def ros_environment(domain_id):
    """Give the environment of every process of this test."""
    paths = [str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "ROS_DOMAIN_ID": str(domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


def _domains_with_participants():
    """Read from the kernel's list of UDP ports which domains somebody is in (RTPS: port 7400 + 250 domain and on)."""
    ports = set()
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        with contextlib.suppress(OSError):
            lines = Path(table).read_text().splitlines()[1:]
            ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    return {(port - 7400) // 250 for port in ports if port >= 7400}


def _domains_with_leftovers():
    """Read from shared memory where killed participants left ports: who sends to one first waits for it in vain."""
    ports = [path.name.removeprefix("fastrtps_port") for path in Path("/dev/shm").glob("fastrtps_port*")]
    return {(int(port) - 7400) // 250 for port in ports if port.isdigit()}


class Process:
    """One process of a test, with what it printed."""

    def __init__(self, arguments, environment, log):
        self.log = log
        with log.open("wb") as stream:
            self._process = subprocess.Popen(
                [str(a) for a in arguments], env=environment, stdout=stream, stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_prepare_process)

    @property
    def pid(self):
        return self._process.pid

    @property
    def output(self):
        return self.log.read_text(errors="replace")

    @property
    def returncode(self):
        return self._process.poll()

    def send(self, number):
        self._process.send_signal(number)

    def wait(self, timeout=30.0):
        """Wait for the end; returns the exit status, fails the test with the output if it does not come."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {timeout} s:\n{self.output}")

    def stop(self, number=signal.SIGINT, timeout=5.0):
        """Send a signal and wait; returns exit status and the time that it took [s]."""
        start = time.monotonic()
        self.send(number)
        return self.wait(timeout), time.monotonic() - start

    def wait_for(self, text, timeout=60.0):
        """Wait until the process has printed a text."""
        wait_until(lambda: text in self.output or self.returncode is not None, timeout, lambda: self.output)
        if text not in self.output:
            pytest.fail(f"ended with {self.returncode} before printing {text!r}:\n{self.output}")

    def kill(self):
        """End the process and all that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


@pytest.fixture
def start_process(ros_environment, tmp_path):
    """Start processes that end with the test, also if it fails: start_process(arguments, name=..., **environment)."""
    started = []

    def start(arguments, name=None, **environment):
        log = tmp_path / f"{name or 'process'}-{len(started)}.log"
        process = Process(arguments, {**ros_environment, **environment}, log)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()


@pytest.fixture
def start_node(start_process):
    """Start one of the project's nodes: start_node("recorder", parameters={...}, arguments=[...])."""

    def start(name, parameters=None, arguments=(), parameter_files=()):
        command = [sys.executable, "-m", f"unifeed_ros.nodes.{name}", "--ros-args"]
        for file in parameter_files:
            command += ["--params-file", file]
        for key, value in (parameters or {}).items():
            command += ["-p", f"{key}:={value}"]
        return start_process([*command, *arguments], name=name)

    return start


@pytest.fixture
def ros_node(domain_id, monkeypatch):
    """Give a node in the test's own process, spun by spin_until."""
    import rclpy
    from rclpy.context import Context

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("test", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture
def spin_until(ros_node):
    """Spin the test's node until a condition holds: spin_until(lambda: ..., timeout)."""
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=ros_node.context)
    executor.add_node(ros_node)

    def spin(condition, timeout=30.0, explain=lambda: ""):
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"did not happen within {timeout} s {explain()}")
            executor.spin_once(timeout_sec=0.05)

    yield spin
    executor.shutdown()


@pytest.fixture
def call(ros_node, spin_until):
    """Call a service and wait for its answer: call(type, name, request)."""

    def ask(kind, name, request=None, timeout=60.0):
        client = ros_node.create_client(kind, name)
        spin_until(client.service_is_ready, timeout, lambda: f"(service {name})")
        answer = client.call_async(request or kind.Request())
        spin_until(answer.done, timeout, lambda: f"(answer of {name})")
        ros_node.destroy_client(client)
        return answer.result()

    return ask


def wait_until(condition, timeout, explain=lambda: ""):
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            pytest.fail(f"did not happen within {timeout} s\n{explain()}")
        time.sleep(0.02)


def _prepare_process():
    """Let the kernel end this process when the test run dies (Linux), and let Ctrl-C reach it."""
    set_parent_death_signal = 1
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a test run in the background of a shell ignores it
