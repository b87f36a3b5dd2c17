"""Teach robot arms by touch: demonstrations, corrections and preferences become one reward."""

__version__ = "0.1.0"
