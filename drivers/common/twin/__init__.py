"""The common part of all simulated robots: the process, the serial port or network that it serves, the log, the
faults.

The ``twin.py`` of each driver defines a ``Robot`` (received bytes in, timed replies out). Its ``main`` calls
``run``. A robot on TCP defines a handler per port instead, and its ``main`` calls ``run_server`` with a
``TcpServer``.
"""

from .faults import Fault, Faults, Reply, parse_fault
from .line import Line, PtyLine
from .options import HostOption, NetworkOptions, Port, TwinOptions, read_twin_options
from .process import Start, run, run_server
from .server import Controls, Exchange, Robot, Server, TwinSession
from .tcp import ClientGone, Connection, Handler, TcpServer, answering, own_host
from .unix import UnixServer
from .wirelog import WireLog

__all__ = [
    "ClientGone",
    "Connection",
    "Controls",
    "Exchange",
    "Fault",
    "Faults",
    "Handler",
    "HostOption",
    "Line",
    "NetworkOptions",
    "Port",
    "PtyLine",
    "Reply",
    "Robot",
    "Server",
    "Start",
    "TcpServer",
    "TwinOptions",
    "TwinSession",
    "UnixServer",
    "WireLog",
    "answering",
    "own_host",
    "parse_fault",
    "read_twin_options",
    "run",
    "run_server",
]
