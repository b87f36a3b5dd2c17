"""The command `unifeed` with real nodes: a lesson from start to report, endings, and what a user can get wrong."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from rosbags.highlevel import AnyReader

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import nodes_left_behind

from unifeed_ros.resources import config_path

UNIFEED = [sys.executable, "-m", "unifeed_ros.cli.main"]


def run(environment, *arguments):
    done = subprocess.run([*UNIFEED, *map(str, arguments)], env=environment, capture_output=True, text=True, timeout=60,
                          check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.timeout(300)
def test_a_lesson_ends_with_its_report(ros_environment, domain_id, tmp_path):
    out = tmp_path / "demo"
    done = subprocess.run([*UNIFEED, "demo", "--feedback", "DCP", "--seed", "1", "--out", str(out), "--json"],
                          env=ros_environment, capture_output=True, text=True, timeout=280, check=False)
    logs = "\n".join(f"{log.stem}: {log.read_text()[-600:]}" for log in (out / "logs").glob("*.log"))
    assert done.returncode == 0, f"{done.stderr}\n{logs}"
    report = json.loads((out / "report.json").read_text())
    assert json.loads(done.stdout) == report
    assert (report["robot"], report["task"], report["seed"], report["ok"]) == ("panda", "table", 1, True)
    kinds = [i["kind"] for i in report["interactions"]]
    assert [i["index"] for i in report["interactions"]] == list(range(1, len(kinds) + 1))
    assert kinds == ["demonstration", "correction", "preference"]
    for interaction in report["interactions"]:
        for name in ("regret", "normalised_regret", "train_s", "plan_s", "feedback_to_motion_s"):
            assert math.isfinite(interaction[name]), name
        assert not interaction["touched"]
    assert report["final"]["normalised_regret"] == interaction["normalised_regret"] < 0.6
    assert report["final"]["optimal_return"] > report["final"]["straight_return"]
    for name in ("rate_hz", "period_p99_ms", "latency_p99_ms", "missed_deadlines"):
        assert math.isfinite(report["loop"][name]), name
    for picture in ("paths.png", "regret.png"):
        assert (out / picture).read_bytes().startswith(b"\x89PNG")
    check_bag(out / report["recording"]["bag"], report)
    status, again, error = run(ros_environment, "learn", out / report["recording"]["bag"], "--out", tmp_path / "again",
                               "--json")
    models = json.loads(again)["models"]
    assert status == 0 and [m["identical"] for m in models] == [True] * len(models), error
    assert len(models) >= 3
    assert nodes_left_behind(domain_id) == []


def check_bag(bag, report):
    """Read the bag with an independent reader: all that was taught is in it."""
    with AnyReader([bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert reader.message_count == report["recording"]["messages"]
        assert {c.msgtype for c in reader.connections if c.topic == "/feedback"} == {"unifeed_msgs/msg/Feedback"}
        feedback = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(
            [c for c in reader.connections if c.topic == "/feedback"])]
    assert {f.kind for f in feedback} == {1, 2, 3}
    assert counts["/reward_model"] >= counts["/interaction"] == 3  # an input that a fault cut short is learned twice
    assert counts["/joint_states"] > 5000 and counts["/hand_wrench"] > 500


@pytest.mark.timeout(150)
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_a_session_ends_on_a_signal_with_its_bag_closed(start_process, ros_environment, domain_id, tmp_path, ending):
    out = tmp_path / "session"
    session = start_process([*UNIFEED, "up", "--robot", "panda", "--sim", "--out", out], name="up")
    session.wait_for("ready", timeout=60.0)
    if ending == signal.SIGINT:
        status, _, error = run(ros_environment, "up", "--robot", "panda", "--sim", "--out", tmp_path / "second")
        assert status == 2 and "already running" in error and len(error.strip().splitlines()) == 1
    status, seconds = session.stop(ending, timeout=10.0)
    assert status == 130 and seconds < 4.0, session.output  # 3 s for the nodes, and the interpreter's own end
    assert nodes_left_behind(domain_id) == []
    with AnyReader([out / "bag"]) as reader:
        assert reader.message_count > 100
    status, output, _ = run(ros_environment, "bag", "check", out / "bag")
    assert status == 0, output


def test_a_domain_that_is_claimed_is_refused_before_anything_is_discovered(ros_environment, domain_id, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as claim:
        claim.bind(f"\0unifeed-session-domain-{domain_id}")
        status, _, error = run(ros_environment, "up", "--robot", "panda", "--sim", "--out", tmp_path / "second")
    assert status == 2 and "already running" in error and len(error.strip().splitlines()) == 1


@pytest.mark.timeout(120)
def test_a_node_that_dies_ends_the_session_and_is_named(start_process, domain_id, tmp_path):
    session = start_process([*UNIFEED, "up", "--robot", "panda", "--sim", "--out", tmp_path / "session"], name="up")
    session.wait_for("ready", timeout=60.0)
    victim = next(p for p in Path("/proc").iterdir() if p.name.isdigit() and is_node(p, "capture", domain_id))
    subprocess.run(["kill", "-KILL", victim.name], check=True)
    assert session.wait(timeout=15.0) == 1
    assert "capture died" in session.output
    assert nodes_left_behind(domain_id) == []
    with AnyReader([tmp_path / "session" / "bag"]) as reader:
        assert reader.message_count > 100


@pytest.mark.timeout(120)
def test_killing_the_command_itself_leaves_no_node(start_process, domain_id, tmp_path):
    session = start_process([*UNIFEED, "up", "--robot", "panda", "--sim", "--out", tmp_path / "session"], name="up")
    session.wait_for("ready", timeout=60.0)
    session.send(signal.SIGKILL)
    session.wait()
    deadline = time.monotonic() + 6.0
    while nodes_left_behind(domain_id) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert nodes_left_behind(domain_id) == []


def is_node(process, name, domain_id):
    try:
        command = (process / "cmdline").read_bytes()
        environment = (process / "environ").read_bytes().split(b"\0")
    except OSError:
        return False
    return f"unifeed_ros.nodes.{name}".encode() in command and f"ROS_DOMAIN_ID={domain_id}".encode() in environment


def edited(kind, name, tmp_path, **changes):
    """Write a changed copy of a configuration file."""
    tree = yaml.safe_load(config_path(kind, name).read_text())
    section = tree["/**"]["ros__parameters"]["robot" if kind == "robots" else "scene"]
    section.update(changes)
    path = tmp_path / f"{name}.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


MISTAKES = {
    "unknown robot": (["demo", "--robot", "spot"], "spot"),
    "unknown task": (["demo", "--task", "juggle"], "juggle"),
    "unknown letters": (["demo", "--feedback", "DXP"], "DXP"),
    "no letters": (["demo", "--feedback", ""], "--feedback"),
    "negative seed": (["demo", "--seed", "-1"], "--seed"),
    "speed": (["demo", "--speed", "0"], "speed"),
    "missing file": (["demo", "--robot", "nowhere.yaml"], "nowhere.yaml"),
    "teacher without sim": (["up", "--robot", "panda", "--teacher", "D"], "--sim"),
}


@pytest.mark.parametrize("words", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_on_the_command_line_is_one_line_and_status_2(ros_environment, tmp_path, words):
    arguments, named = words
    status, _, error = run(ros_environment, *arguments, "--out", tmp_path / "out")
    assert status == 2 and named in error and len(error.strip().splitlines()) == 1, error
    assert not (tmp_path / "out" / "logs").exists()


@pytest.mark.parametrize(("kind", "changes", "named"), [
    ("robots", {"urdf": "/no/such.urdf"}, "no/such.urdf"),
    ("robots", {"colour": "white"}, "colour"),
    ("robots", {"tool_frame": "hook"}, "hook"),
    ("tasks", {"goal": [2.0, 0.0, 0.3]}, "out of reach"),
    ("tasks", {"goal": [0.5, 0.0, -0.3]}, "too low"),
    ("tasks", {"duration": "soon"}, "duration"),
], ids=["URDF missing", "unknown setting", "unknown frame", "goal out of reach", "goal under the table", "no number"])
def test_settings_that_cannot_be_used_are_one_line_and_status_2(ros_environment, tmp_path, kind, changes, named):
    name = "panda" if kind == "robots" else "table"
    path = edited(kind, name, tmp_path, **changes)
    status, _, error = run(ros_environment, "demo", "--robot" if kind == "robots" else "--task", path,
                           "--out", tmp_path / "out")
    assert status == 2 and named in error and len(error.strip().splitlines()) == 1, error
    assert not (tmp_path / "out" / "logs").exists()


def test_a_folder_that_cannot_be_used_is_refused(ros_environment, tmp_path):
    (tmp_path / "file").write_text("")
    status, _, error = run(ros_environment, "demo", "--out", tmp_path / "file")
    assert status == 2 and "cannot be used" in error
    (tmp_path / "used" / "bag").mkdir(parents=True)
    status, _, error = run(ros_environment, "demo", "--out", tmp_path / "used")
    assert status == 2 and "recording already" in error


def test_the_doctor_names_everything_it_looked_at(ros_environment):
    status, output, error = run(ros_environment, "doctor", "--json")
    findings = json.loads(output)["findings"]
    by_name = {f["name"]: f for f in findings}
    assert {"python", "packages", "messages", "robots", "disk", "control loop"} <= set(by_name)
    assert by_name["messages"]["ok"] and by_name["robots"]["ok"], error
    assert status == (0 if all(f["ok"] for f in findings) else 1)
