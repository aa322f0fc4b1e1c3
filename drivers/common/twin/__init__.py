"""What the twins of all wires share: the process, the line they serve, the wire log, the faults.

A wire's own ``twin.py`` is a ``Robot`` (bytes in, timed replies out) and a ``main`` that calls ``run``.
"""

from .faults import Fault, Faults, Reply, parse_fault
from .line import Line, PtyLine
from .process import run
from .server import Exchange, Robot, Server
from .wirelog import WireLog

__all__ = [
    "Exchange",
    "Fault",
    "Faults",
    "Line",
    "PtyLine",
    "Reply",
    "Robot",
    "Server",
    "WireLog",
    "parse_fault",
    "run",
]
