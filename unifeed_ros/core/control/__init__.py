"""Shared control: reference, impedance, arbitration between robot and person, safety filter."""
