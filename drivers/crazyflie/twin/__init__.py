"""Simulate a Crazyflie: its firmware on UDP, TCP or a serial line, and a flying body."""

from .log_port import CONTROLS
from .memories import MEMORIES
from .packets import LOCALIZATIONS, ORDERS, PACKETS, SETPOINTS
from .parameter_port import COMMANDS
from .server import main

MODELLED = (PACKETS, SETPOINTS, ORDERS, LOCALIZATIONS, COMMANDS, CONTROLS, MEMORIES)

__all__ = ["MODELLED", "main"]
