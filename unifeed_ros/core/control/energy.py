"""The energy account: what the arm may give to a person is bounded by what it was given and a small store."""

from __future__ import annotations

from unifeed_ros.core.control.settings import ControlConfig


class EnergyAccount:
    """A tank that every joule of the controller's torques is paid from (Ferraguti et al., ICRA 2013, energy tanks).

    Damping and a person who pushes against the spring fill it up to its size; a spring that pulls back, also one whose
    stiffness returns, and a reference that moves on empty it. Below `energy_low` the robot's share shrinks with the
    level; at none only weight and damping are left, which give nothing away. While nobody touches, a supply of limited
    power refills it for the motion's own needs. So at the hand, whatever the person does,

        energy extracted - energy put in <= store + kinetic energy at first + energy supplied while untouched.

    Energies of a period are exact for torques that were held during it: torque times the way of the joints. The law
    holds as far as weight and friction are as modelled; commands that arrive late are accounted as if they were not.

    Args:
        config: Settings.
    """

    def __init__(self, config: ControlConfig) -> None:
        self._config = config
        self.level = config.energy_store
        """What is left [J]."""
        self.supplied = 0.0
        """What the supply has given so far [J]."""

    @property
    def share(self) -> float:
        """Largest share of the robot that the level allows, in [0, 1] [1]."""
        return min(1.0, max(0.0, self.level / self._config.energy_low))

    def settle(self, spent: float, supplied_for: float) -> None:
        """Take in one period.

        Args:
            spent: Work of the controller's torques without weight on the arm; negative where they braked [J].
            supplied_for: Time during which nobody touched and the supply was open [s].
        """
        full = self._config.energy_store
        self.level = min(full, self.level - spent)
        supply = min(self._config.energy_supply * supplied_for, full - self.level)
        self.level += supply
        self.supplied += supply
