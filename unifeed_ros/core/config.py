"""Settings as dataclasses, read from the YAML parameter files that the nodes use too."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from unifeed_ros.core.errors import ConfigError, UnifeedError

T = TypeVar("T")

_SCALARS: Mapping[str, tuple[type, ...]] = {"float": (float, int), "int": (int,), "bool": (bool,), "str": (str,)}


def load_parameters(path: Path) -> dict[str, Any]:
    """Read a ROS 2 parameter file of the form ``/**: ros__parameters: ...``.

    Args:
        path: YAML file.

    Returns:
        The parameters as nested dictionaries.

    Raises:
        ConfigError: The file is missing, is not YAML, or has another form.
    """
    try:
        tree = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ConfigError(f"parameter file {path}", got=error.strerror or str(error), mend="check the path") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"parameter file {path} is not YAML", got=str(error).replace("\n", " ")) from error
    try:
        parameters = tree["/**"]["ros__parameters"]
    except (TypeError, KeyError) as error:
        raise ConfigError(f"parameter file {path}", expected="/**: ros__parameters:") from error
    if not isinstance(parameters, dict):
        raise ConfigError(f"parameter file {path}", expected="sections below ros__parameters:", got=parameters)
    return parameters


def from_mapping(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """Build a settings dataclass from a mapping, refusing unknown and missing names.

    Args:
        kind: Dataclass of settings.
        values: Values by field name.
        where: What the values belong to, for the error ("robot in panda.yaml").

    Returns:
        The settings, checked by the dataclass itself.

    Raises:
        ConfigError: A name is unknown or missing, or a value is refused.
    """
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(fields))
    if unknown:
        raise ConfigError(f"{where} has unknown settings", expected=", ".join(fields), got=", ".join(unknown))
    required = {name for name, field in fields.items()
                if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING}
    for name, value in values.items():
        kinds = _SCALARS.get(str(fields[name].type))
        if kinds and (not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds)):
            raise ConfigError(f"{where}: {name}", expected=f"a value of type {fields[name].type}", got=repr(value))
    missing = sorted(required - set(values))
    if missing:
        raise ConfigError(f"{where} lacks settings", expected=", ".join(missing))
    try:
        return kind(**values)
    except (TypeError, ValueError) as error:
        raise ConfigError(where, got=str(error)) from error


def load_settings(kind: type[T], path: Path, group: str) -> T:
    """Read one group of a ROS 2 parameter file into its settings dataclass.

    Args:
        kind: Dataclass of settings.
        path: YAML file.
        group: Name of the group below ros__parameters.

    Returns:
        The settings.

    Raises:
        ConfigError: The file is missing or malformed, or a value cannot be used; the message names the file.
    """
    parameters = load_parameters(path)
    if not isinstance(parameters.get(group), dict):
        raise ConfigError(f"parameter file {path}", expected=f"a group named {group}",
                          got=", ".join(parameters) or "nothing")
    try:
        return from_mapping(kind, parameters[group], f"{group} in {path.name}")
    except UnifeedError as error:
        raise ConfigError(f"parameter file {path}", got=str(error)) from error
