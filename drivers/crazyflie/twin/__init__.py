"""Simulate a Crazyflie: its firmware on UDP, TCP or a serial line, and a flying body."""

from .server import main

__all__ = ["main"]
