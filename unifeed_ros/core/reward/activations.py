"""Activations of the hidden layers, with their slopes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.types import Array

LEAK = 0.01
"""Slope of the leaky activations far below zero."""
SHARPNESS = 30.0
"""How sharply leaky_softplus bends; it differs from leaky_relu by at most log(2) / SHARPNESS, at zero."""


def leaky_relu(inputs: Array) -> tuple[Array, Array]:
    """Compute max(x, LEAK x) and its slope."""
    slopes: Array = np.where(inputs > 0.0, 1.0, LEAK)
    return inputs * slopes, slopes


def leaky_softplus(inputs: Array) -> tuple[Array, Array]:
    """Compute LEAK x + (1 - LEAK) log(1 + exp(b x)) / b, b the SHARPNESS, and its slope: a leaky ReLU without kink."""
    bent = np.logaddexp(0.0, SHARPNESS * inputs)
    slopes = LEAK + (1.0 - LEAK) * np.exp(SHARPNESS * inputs - bent)  # d log(1 + e^x) = e^x / (1 + e^x)
    return LEAK * inputs + (1.0 - LEAK) / SHARPNESS * bent, slopes


def tanh(inputs: Array) -> tuple[Array, Array]:
    """Compute tanh x and its slope."""
    values = np.tanh(inputs)
    return values, 1.0 - values**2


ACTIVATIONS: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "leaky_relu": leaky_relu, "leaky_softplus": leaky_softplus, "tanh": tanh}
"""Values and slopes of each activation, by its name in settings, messages and files."""


def require_activation(name: str) -> str:
    """Check the name of an activation.

    Args:
        name: Name.

    Returns:
        The name.

    Raises:
        ConfigError: It is not known here.
    """
    if name not in ACTIVATIONS:
        raise ConfigError("activation of the reward model", expected=" or ".join(ACTIVATIONS), got=name)
    return name
