"""The policy type `buds`: a library of goal-conditioned skills and a meta controller."""

from .configuration_buds import BudsConfig

__all__ = ["BudsConfig"]
