"""Simulate a Crazyflie: its firmware on UDP, TCP or a serial line, and a flying body."""

from .packets import MODELLED
from .server import main

__all__ = ["MODELLED", "main"]
