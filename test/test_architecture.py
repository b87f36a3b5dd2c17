"""The direction of the imports, and habits that hold for every file."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unifeed_ros"
MODULES = sorted(PACKAGE.rglob("*.py"))
SHARED = {path.stem for path in (PACKAGE / "core").glob("*.py")}
LAYERS = ("capture", "feedback", "reward", "planning", "control")
MAY_IMPORT = {
    "core": {"core"},
    "simulation": {"core", "simulation"},
    "baselines": {"core", "baselines"},
    "experiments": {"core", "simulation", "baselines", "experiments", "resources"},
    "resources": {"core"},
    "console": {"core", "console"},
    "nodes": {"core", "simulation", "console", "nodes", "resources"},
    "cli": {"core", "simulation", "baselines", "experiments", "nodes", "cli", "resources"},
}
ROS = re.compile(r"(rclpy|rcl_interfaces|launch|launch_ros|rosidl_\w+|builtin_interfaces|std_srvs|\w+_msgs)(\.|$)")


def name_of(path: Path) -> tuple[str, ...]:
    """Give a module's name below unifeed_ros, for example ("core", "reward", "training")."""
    return path.relative_to(PACKAGE).with_suffix("").parts


def imports(path: Path) -> set[str]:
    """Collect the dotted names that a module imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def own_imports(path: Path) -> set[tuple[str, ...]]:
    """Give the imports from this package, without its name."""
    return {tuple(name.split(".")[1:]) for name in imports(path) if name.startswith("unifeed_ros.")}


def ids(path: Path) -> str:
    return ".".join(name_of(path))


@pytest.mark.parametrize("path", [p for p in MODULES if name_of(p)[0] not in {"nodes", "cli"}], ids=ids)
def test_ros_stays_in_nodes_and_commands(path):
    assert not {name for name in imports(path) if ROS.match(name)}


@pytest.mark.parametrize("path", [p for p in MODULES if name_of(p)[0] != "__init__"], ids=ids)
def test_packages_import_in_one_direction(path):
    allowed = MAY_IMPORT[name_of(path)[0]]
    assert not {".".join(name) for name in own_imports(path) if name[0] not in {*allowed, "__version__"}}


@pytest.mark.parametrize("path", [p for p in MODULES if name_of(p)[0] == "core"], ids=ids)
def test_layers_import_only_those_to_their_left(path):
    layer = name_of(path)[1]
    wanted = {name[1] for name in own_imports(path) if name[0] == "core" and len(name) > 1}
    if layer in SHARED:
        allowed = SHARED
    elif layer == "recording":
        allowed = {*SHARED, *LAYERS, "recording"}
    else:
        allowed = {*SHARED, *LAYERS[:LAYERS.index(layer) + 1]}
    assert wanted <= allowed


def test_every_layer_is_known():
    folders = {path.name for path in (PACKAGE / "core").iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders <= {*LAYERS, "recording"}


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_modules_say_what_they_are(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree) or not tree.body


def test_no_file_names_a_folder_of_one_machine():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    machine = re.compile(rb"(?<![\w.~$}])/(?:root|home/\w+|work/|tmp/|Users/\w+)")
    found = []
    for name in filter(None, listed.stdout.decode().split("\0")):
        path = ROOT / name
        text = path.read_bytes() if path.is_file() else b""
        if path != Path(__file__) and b"\0" not in text[:4096] and (hit := machine.search(text)):
            found.append(f"{name}: {hit.group().decode()}")
    assert not found
