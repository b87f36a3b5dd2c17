"""Configuration files are found from the source tree and from installs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from unifeed_ros import resources
from unifeed_ros.core.errors import ConfigError

ROOT = Path(__file__).resolve().parents[1]


def test_source_tree_is_found_first():
    assert resources.share_folder() == ROOT


@pytest.mark.parametrize(("kind", "name"), [("robots", "panda"), ("robots", "ur10"), ("tasks", "table")])
def test_named_files_exist(kind, name):
    assert name in resources.config_names(kind)
    assert resources.config_path(kind, name).read_text().startswith(("#", "/**"))


def test_own_file_is_taken_as_it_is(tmp_path):
    own = tmp_path / "mine.yaml"
    own.write_text("/**:\n  ros__parameters: {}\n")
    assert resources.config_path("robots", str(own)) == own


@pytest.mark.parametrize(("name", "words"), [("pandas", "panda"), ("", "panda"), ("../robots/panda", "one of"),
                                             ("no/such.yaml", "existing file")])
def test_unknown_name_says_what_there_is(name, words):
    with pytest.raises(ConfigError, match=words):
        resources.config_path("robots", name)


def test_installed_layout_is_found(tmp_path):
    site = tmp_path / "lib" / "python3.11" / "site-packages" / "unifeed_ros"
    (site / "core").mkdir(parents=True)
    for module in ("__init__.py", "resources.py", "core/__init__.py", "core/errors.py"):
        shutil.copy(ROOT / "unifeed_ros" / module, site / module)
    shutil.copytree(ROOT / "config", tmp_path / "share" / "unifeed_ros" / "config")
    code = "from unifeed_ros.resources import *; print(config_path('robots', 'ur10'))"
    answer = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True,
                            env={"PYTHONPATH": str(site.parent)})
    assert Path(answer.stdout.strip()) == tmp_path / "share/unifeed_ros/config/robots/ur10.yaml"
