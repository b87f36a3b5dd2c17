"""Declare a node's parameters from settings dataclasses, and read them back checked."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from unifeed_ros.core.config import from_mapping

T = TypeVar("T")


@lru_cache
def field_docs(kind: type) -> Mapping[str, str]:
    """Read the docstring that follows each field of a dataclass.

    Args:
        kind: Dataclass whose source is at hand.

    Returns:
        Docstrings by field name.
    """
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body  # type: ignore[attr-defined]
    docs = {}
    for statement, following in pairwise(body):
        if (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
                and isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)):
            docs[statement.target.id] = str(following.value.value)
    return docs


def settings(node: Node, section: str, kind: type[T], **fixed: Any) -> T:
    """Declare one section of parameters from a dataclass and build it from what the node was given.

    The parameters are read-only: settings change by starting the node anew. The node must declare its overrides
    automatically, so that names inside mappings (objects of a scene) are known.

    Args:
        node: Node that gets the parameters, named ``section.field``.
        section: Name of the section, for example "robot".
        kind: Settings dataclass; its field docstrings become the descriptions.
        **fixed: Fields that are given here and are not parameters.

    Returns:
        The settings.

    Raises:
        ConfigError: A name is unknown or missing, or a value is refused.
    """
    values: dict[str, Any] = dict(fixed)
    for name, parameter in node.get_parameters_by_prefix(section).items():
        value = parameter.value
        target, *rest = name.split(".", 1)
        plain = list(value) if hasattr(value, "typecode") or isinstance(value, tuple) else value
        if rest:
            _nest(values.setdefault(target, {}), rest[0].split("."), plain)
        else:
            values[target] = plain
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if dataclasses.is_dataclass(field.default_factory):
            values[field.name] = settings(node, f"{section}.{field.name}", field.default_factory)
    docs = field_docs(kind)
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        full = f"{section}.{field.name}"
        descriptor = ParameterDescriptor(description=docs.get(field.name, ""), read_only=True, dynamic_typing=True)
        if node.has_parameter(full):
            if str(field.type) == "float" and isinstance(values[field.name], int):
                values[field.name] = float(values[field.name])
            node.set_descriptor(full, descriptor)
        elif field.name not in values and isinstance(field.default, (bool, int, float, str)):
            node.declare_parameter(full, field.default, descriptor)
    return from_mapping(kind, values, f"section {section} of the parameters of {node.get_name()}")


def _nest(values: dict[str, Any], names: list[str], value: Any) -> None:
    """Put a value into nested dictionaries."""
    for name in names[:-1]:
        values = values.setdefault(name, {})
    values[names[-1]] = value
