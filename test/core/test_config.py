"""Settings from files: what is there is taken, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from unifeed_ros.core.config import from_mapping, load_parameters
from unifeed_ros.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Settings:
    size: float
    count: int = 3
    on: bool = False
    name: str = "x"

    def __post_init__(self):
        if self.size < 0:
            raise ConfigError("size", expected=">= 0", got=self.size)


def test_values_and_defaults():
    assert from_mapping(Settings, {"size": 2, "on": True}, "here") == Settings(size=2, on=True)


@pytest.mark.parametrize(("values", "named"), [
    ({}, "size"), ({"size": 1.0, "colour": "red"}, "colour"), ({"size": "soon"}, "size"), ({"size": True}, "size"),
    ({"size": 1.0, "count": 2.5}, "count"), ({"size": 1.0, "on": 1}, "on"), ({"size": 1.0, "name": 4}, "name"),
    ({"size": -1.0}, ">= 0")])
def test_what_cannot_be_used_is_named(values, named):
    with pytest.raises(ConfigError, match=named):
        from_mapping(Settings, values, "here")


def test_a_parameter_file(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("/**:\n  ros__parameters:\n    robot: {name: panda}\n")
    assert load_parameters(path) == {"robot": {"name": "panda"}}


@pytest.mark.parametrize("text", ["", "robot: 1", "/**: [1]", "a: [", "/**:\n  ros__parameters: 3"])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"a\.yaml"):
        load_parameters(path)
    with pytest.raises(ConfigError, match="missing"):
        load_parameters(tmp_path / "missing.yaml")
