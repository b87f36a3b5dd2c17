"""Decisions and messages of scripts/setup.py, without installing anything."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def setup_script(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    spec = importlib.util.spec_from_file_location("unifeed_setup", ROOT / "scripts" / "setup.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "unifeed_setup", module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def machine(setup_script):
    """Make a function that answers like `probe` on a machine with these Pythons."""

    def make(**pythons):
        described = {}
        for name, settings in pythons.items():
            command = {"default": "python3", "system": "/usr/bin/python3"}.get(name, name.replace("_", "."))
            values = {"path": f"/bin/{command}", "version": (3, 12), "venv": True, "rclpy": False, "headers": True}
            described[command] = sys.modules["machine"].Interpreter(**{**values, **settings})
        return described.get

    return make


def test_sourced_jazzy_is_used(setup_script, machine):
    ask = machine(default={"rclpy": True}, python3_11={"version": (3, 11)})
    choice = setup_script.choose({"ROS_DISTRO": "jazzy"}, ask)
    assert (choice.ros, choice.python.path) == ("sourced", "/bin/python3")


def test_sourced_jazzy_is_found_behind_another_default_python(setup_script, machine):
    ask = machine(default={"version": (3, 11)}, system={"rclpy": True})
    choice = setup_script.choose({"ROS_DISTRO": "jazzy"}, ask)
    assert (choice.ros, choice.python.path) == ("sourced", "/bin//usr/bin/python3")


def test_named_but_not_sourced_jazzy_means_wheels(setup_script, machine):
    assert setup_script.choose({"ROS_DISTRO": "jazzy"}, machine(default={})).ros == "wheels"


def test_another_sourced_ros_is_refused(setup_script, machine):
    with pytest.raises(setup_script.SetupError, match="ROS humble is sourced, this project needs jazzy"):
        setup_script.choose({"ROS_DISTRO": "humble"}, machine(default={"rclpy": True, "version": (3, 10)}))


def test_wheels_take_the_first_complete_python(setup_script, machine):
    ask = machine(python3_11={"version": (3, 11), "headers": False}, python3_13={"version": (3, 13)}, default={})
    assert setup_script.choose({}, ask).python.version == (3, 13)


@pytest.mark.parametrize(("pythons", "words"), [
    ({}, "found none"),
    ({"default": {"version": (3, 9)}}, r"found 3\.9: sudo apt install python3"),
    ({"default": {"venv": False}}, r"lacks python3\.12-venv: sudo apt install python3\.12-venv$"),
    ({"default": {"venv": False, "headers": False}}, r"sudo apt install python3\.12-venv python3\.12-dev$"),
])
def test_unsuitable_python_is_one_line(setup_script, machine, pythons, words):
    with pytest.raises(setup_script.SetupError, match=words) as caught:
        setup_script.choose({}, machine(**pythons))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("tools", "words"), [
    (set(), r"no gcc and no g\+\+"), ({"gcc"}, r"no g\+\+: sudo apt"), ({"c++"}, "no gcc")])
def test_missing_compilers_are_named(setup_script, machine, tools, words):
    choice = setup_script.Choice("wheels", machine(default={})("python3"))
    with pytest.raises(setup_script.SetupError, match=words):
        setup_script.check_tools(choice, lambda name: name if name in tools else None)


def test_sourced_ros_needs_colcon(setup_script, machine):
    python = machine(default={})("python3")
    tools = {"gcc", "g++"}.intersection
    setup_script.check_tools(setup_script.Choice("wheels", python), lambda name: tools({name}) or None)
    with pytest.raises(setup_script.SetupError, match="colcon"):
        setup_script.check_tools(setup_script.Choice("sourced", python), lambda name: tools({name}) or None)


def test_sourced_ros_gets_no_ros_wheels(setup_script, machine):
    environ = {"AMENT_PREFIX_PATH": "somewhere", "PATH": "/usr/bin"}
    python = machine(default={})("python3")
    sourced = setup_script.Setup(setup_script.Choice("sourced", python), environ, 0)
    wheels = setup_script.Setup(setup_script.Choice("wheels", python), environ, 0)
    assert sourced.env == environ
    assert wheels.env == {"PATH": "/usr/bin"}
    assert [s.name for s in sourced.steps()] == [s.name for s in wheels.steps()]
    assert all(a.inputs != b.inputs for a, b in zip(sourced.steps(), wheels.steps(), strict=True))


@pytest.mark.parametrize(("output", "words"), [
    ("Retrying after NameResolutionError\nERROR: No matching distribution found for torch==2.13.0", "no network"),
    ("ERROR: No matching distribution found for torch==2.13.0", "the package index has no torch==2.13.0"),
    ("OSError: [Errno 28] No space left on device", "the disk is full"),
    ("x.c:1: fatal error: Python.h: No such file", "Python.h"),
    ("", "no reason given"),
])
def test_failures_are_explained_in_one_line(setup_script, output, words):
    line = setup_script.explain("packages", output, ROOT / "setup.log")
    assert words in line
    assert "\n" not in line


def test_steps_are_repeated_only_for_new_inputs(setup_script, tmp_path, monkeypatch):
    monkeypatch.setattr(setup_script, "STATE", tmp_path)
    done = []
    assert setup_script.Step("a", "1", lambda: done.append(1)).update()
    assert not setup_script.Step("a", "1", lambda: done.append(2)).update()
    assert setup_script.Step("a", "2", lambda: done.append(3)).update()
    assert done == [1, 3]


def test_failed_step_is_not_taken_for_done(setup_script, tmp_path, monkeypatch):
    monkeypatch.setattr(setup_script, "STATE", tmp_path)
    setup_script.Step("a", "1", lambda: None).update()

    def fail():
        raise setup_script.SetupError("broken")

    with pytest.raises(setup_script.SetupError):
        setup_script.Step("a", "2", fail).update()
    assert setup_script.Step("a", "1", lambda: None).update()


def test_digest_sees_names_and_contents(setup_script, tmp_path, monkeypatch):
    monkeypatch.setattr(setup_script, "ROOT", tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a").write_text("1")
    first = setup_script.digest(tmp_path / "folder")
    (tmp_path / "folder" / "a").rename(tmp_path / "folder" / "b")
    second = setup_script.digest(tmp_path / "folder")
    (tmp_path / "folder" / "b").write_text("2")
    assert len({first, second, setup_script.digest(tmp_path / "folder")}) == 3


def test_cmake_paths_are_replaced_once(setup_script, tmp_path):
    foreign = "/opt/python/cp311-cp311"
    (tmp_path / "a.cmake").write_text(
        f'"{foreign}/include/python3.11;{foreign}/lib/python3.11/site-packages/numpy/_core/include"')
    assert setup_script.fix_cmake_paths(tmp_path, "PY", "NP") == 1
    assert (tmp_path / "a.cmake").read_text() == '"PY;NP"'
    assert setup_script.fix_cmake_paths(tmp_path, "PY", "NP") == 0


def test_wrong_python_ends_with_one_line_and_status_2(tmp_path):
    fake = tmp_path / "python3"
    answer = '{"path": "/x", "version": [3, 8], "venv": true, "rclpy": false, "headers": true}'
    fake.write_text(f"#!/bin/sh\necho '{answer}'\n")
    fake.chmod(0o755)
    environ = {k: v for k, v in os.environ.items() if k != "ROS_DISTRO"}
    done = subprocess.run([sys.executable, ROOT / "scripts" / "setup.py"], env={**environ, "PATH": str(tmp_path)},
                          capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("setup: Python 3.11, 3.12 or 3.13 is needed, found 3.8")
    assert done.stderr.count("\n") == 1
