"""The common part of all simulated robots: the process, the serial port or network that it serves, the log, the
faults.

The ``twin`` of each driver defines a ``TwinRobot`` with its faults, restarts and control cycle. Its clients are
served by a session (received bytes in, timed replies out) on a ``Server`` with one cable, or by a handler for each
port of a ``TcpServer``. ``main_of`` makes the ``main`` of its process.
"""

from .faults import Fault, Faults, Reply, parse_fault
from .line import Line, PtyLine
from .options import HostOption, NetworkOptions, Port, TwinOptions, read_twin_options
from .process import Start, main_of, run_server
from .robot import Controls, TwinRobot
from .server import Exchange, Robot, Server, TwinServer, TwinSession
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
    "TwinRobot",
    "TwinServer",
    "TwinSession",
    "UnixServer",
    "WireLog",
    "answering",
    "main_of",
    "own_host",
    "parse_fault",
    "read_twin_options",
    "run_server",
]
