"""setup.py, package.xml, the requirements and the launch files agree with the code."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from unifeed_ros import __version__
from unifeed_ros.nodes.table import SessionSetup, node_table
from unifeed_ros.resources import config_path

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
DISTRIBUTIONS = {"pinocchio": "pin", "yaml": "pyyaml", "example_robot_data": "example-robot-data",
                 "mcap_ros2": "mcap-ros2-support"}


@pytest.fixture(scope="module")
def described():
    """Run setup.py with a stand-in for setuptools.setup and give its arguments."""
    import setuptools

    given = {}
    original, setuptools.setup = setuptools.setup, given.update
    try:
        runpy.run_path(str(ROOT / "setup.py"))
    finally:
        setuptools.setup = original
    return given


ELSEWHERE = ROOT / "unifeed_ros" / "baselines" / "policy_worker.py"
"""Runs in the environment of `make policies`."""


def imported_packages(paths=None):
    found = set()
    for path in paths or set((ROOT / "unifeed_ros").rglob("*.py")) - {ELSEWHERE}:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"unifeed_ros"}


def test_one_version():
    assert MANIFEST.findtext("version") == __version__
    assert ElementTree.parse(ROOT / "unifeed_msgs" / "package.xml").getroot().findtext("version") == __version__


def test_setup_and_manifest_agree(described):
    assert described["version"] == __version__
    for key in ("name", "maintainer", "license", "description"):
        assert described[key] == MANIFEST.findtext(key)
    assert described["maintainer_email"] == MANIFEST.find("maintainer").get("email")


def test_every_node_of_the_table_is_an_executable(described):
    executables = dict(entry.split(" = ") for entry in described["entry_points"]["console_scripts"])
    setup = SessionSetup(parameter_files=(), simulated=True, taught_by="D", bag=Path("bag"), console=True)
    assert {spec.executable for spec in node_table(setup)} | {"unifeed"} == set(executables)
    for target in executables.values():
        module, function = target.split(":")
        tree = ast.parse((ROOT / (module.replace(".", "/") + ".py")).read_text())
        assert function in {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}


def test_every_package_folder_and_data_file_is_installed(described):
    folders = {p.parent.relative_to(ROOT) for p in (ROOT / "unifeed_ros").rglob("*.py")}
    assert {str(f).replace("/", ".") for f in folders} == set(described["packages"])
    installed = {name for _, names in described["data_files"] for name in names}
    wanted = {str(p.relative_to(ROOT)) for top in ("config", "launch", "msg_docs") for p in (ROOT / top).rglob("*")
              if p.is_file() and "__pycache__" not in p.parts}
    assert wanted | {"package.xml", "resource/unifeed_ros"} == installed


def test_every_import_is_declared():
    declared = {element.text for element in MANIFEST if element.tag.endswith("depend")}
    pinned = {line.split("==")[0].split("[")[0].lower() for line in (ROOT / "requirements.txt").read_text().splitlines()
              if "==" in line}
    missing = {name for name in imported_packages() - declared
               if DISTRIBUTIONS.get(name, name).lower() not in pinned}
    assert not missing


def test_every_requirement_is_imported():
    used = {DISTRIBUTIONS.get(name, name).lower() for name in imported_packages()}
    without_import = {"setuptools", "example-robot-data"}  # builds the package; holds the arms' URDFs
    lines = (ROOT / "requirements.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower() for line in lines if "==" in line}
    assert pinned <= used | without_import


def test_what_runs_in_the_environment_of_policies_has_its_own_requirements_and_nothing_of_this_package():
    lines = (ROOT / "requirements-policies.txt").read_text().splitlines()
    pinned = {line.split("==")[0].replace("-", "_") for line in lines if "==" in line}
    assert imported_packages([ELSEWHERE]) <= pinned
    assert "unifeed_ros" not in {name for node in ast.walk(ast.parse(ELSEWHERE.read_text()))
                                 if isinstance(node, ast.ImportFrom) for name in node.module.split(".")}
    assert not any("policy_worker import" in path.read_text() for path in (ROOT / "unifeed_ros").rglob("*.py"))


def test_every_requirement_is_pinned_without_an_index():
    for path in ROOT.glob("requirements*.txt"):
        for line in path.read_text().splitlines():
            assert line.startswith("#") or line.count("==") == 1, f"{path.name}: {line}"


class _Recorded:
    """Stands in for a class of ROS launch, which no wheel has, and keeps what it was given."""

    def __init__(self, *arguments, **named):
        self.arguments, self.named = arguments, named


@pytest.fixture
def launch_library(monkeypatch):
    """Put a small stand-in of launch and launch_ros in the place of the real ones."""

    class LaunchConfiguration(_Recorded):
        def perform(self, context):
            return context[self.arguments[0]]

    contents = {"launch": {"LaunchDescription": list, "LaunchContext": dict},
                "launch.actions": {"DeclareLaunchArgument": _Recorded, "OpaqueFunction": _Recorded},
                "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
                "launch_ros": {}, "launch_ros.actions": {"Node": type("Node", (_Recorded,), {})}}
    for name, members in contents.items():
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "unifeed_ros.nodes.launching", raising=False)


@pytest.mark.parametrize(("file", "given"), [
    ("sim", {"robot": "ur10", "task": "cup", "seed": "3", "teacher": "ddc", "speed": "2"}),
    ("sim", {"bag": "recording"}),
    ("sim", {"console": "true", "console_port": "8123"}),
    ("teach", {"robot": "panda", "seed": "7"}),
])
def test_launch_files_start_the_nodes_of_the_table(launch_library, file, given):
    description = runpy.run_path(str(ROOT / "launch" / f"{file}.launch.py"))["generate_launch_description"]()
    *declared, function = description
    context = {a.arguments[0]: a.named["default_value"] for a in declared}
    assert set(given) <= set(context)
    context |= given
    nodes = function.named["function"](context, *function.named["args"])
    table = node_table(SessionSetup(
        parameter_files=(config_path("robots", context["robot"]), config_path("tasks", context["task"]),
                         config_path("", "session")),
        simulated=file == "sim", taught_by=context.get("teacher", "").upper(), seed=int(context["seed"]),
        speed=float(context.get("speed", 1)), bag=Path(context["bag"]).resolve() if context["bag"] else None,
        console=context["console"] == "true",
        console_parameters={"host": context["console_host"], "port": int(context["console_port"])}))
    assert [(n.named["package"], n.named["executable"], n.named["arguments"]) for n in nodes] == [
        ("unifeed_ros", spec.executable, spec.arguments()) for spec in table]


def test_readme_links_and_commands_exist():
    text = (ROOT / "README.md").read_text()
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert link.startswith(("http", "docs/images/")) or (ROOT / link).exists(), link
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M))
    assert set(re.findall(r"\bmake (demo|test|lint|bench|clean|setup)\b", text)) <= targets
