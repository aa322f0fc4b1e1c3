"""Run a Crazyflie as a twin: its firmware on UDP, TCP or a serial line, with a flying body behind it."""

from .server import main

__all__ = ["main"]
