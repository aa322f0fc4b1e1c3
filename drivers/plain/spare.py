"""Run a process that stops the robot with a new object of the user's class, or finds out the class's axes, and then
ends.

The process imports the class, reports that it is ready, and waits for its order. If the link to it is closed, it
ends. An alarm signal ends it if a method hangs, even if the method holds the interpreter's lock.
"""

from __future__ import annotations

import signal
import socket
from typing import Any

import msgspec

from strands_actors.kernel.processes.identity import take_name

from .config import PlainConfig
from .instance import Instance
from .members import OBSERVED, Declared, declared_by, keys_of, require_axes
from .wire import stop_anew


class Ready(msgspec.Struct, frozen=True):
    """The report that the class is imported. ``failure`` is the reason if it is not."""

    failure: str = ""


class OrderResult(msgspec.Struct, frozen=True):
    """The result of the one order that the process gets: to stop the robot, or to find the axes of the user's
    class (``declared``)."""

    failure: str
    declared: Declared | None = None


STOP, LEARN = b"s", b"l"


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Import the class, wait for an order, carry it out, and exit. This is the entry point of the process."""
    config = msgspec.convert(args["config"], PlainConfig)
    take_name(config.name, "stop")
    instance = Instance(config)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, 2 * config.deadlines.load_s)
    _tell(sock, Ready(instance.load()))
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    order = sock.recv(1)
    if not order:
        return
    signal.setitimer(signal.ITIMER_REAL, config.deadlines.errand_s)
    _tell(sock, OrderResult(stop_anew(instance)) if order == STOP else _learn(instance, config))


def _learn(instance: Instance, config: PlainConfig) -> OrderResult:
    if failure := instance.make():
        return OrderResult(failure)
    try:
        declared = declared_by(instance.made, config.name)
    except ValueError as error:
        return OrderResult(str(error))
    if declared.keys:
        return OrderResult(instance.cleanup(), declared)
    failure = instance.connect()
    observed = {} if failure else instance.observe()
    if isinstance(observed, str):
        failure, observed = observed, {}
    # No motion was commanded, so the robot need not confirm this stop.
    instance.stop()
    failure = instance.cleanup() or failure
    keys = keys_of(observed)
    declared = msgspec.structs.replace(declared, keys=keys, source=OBSERVED if keys else "")
    if keys and not failure:
        try:
            require_axes(declared, config.name)
        except ValueError as error:
            return OrderResult(str(error))
    return OrderResult(failure, declared)


def _tell(sock: socket.socket, report: Ready | OrderResult) -> None:
    message = msgspec.msgpack.encode(report)
    sock.sendall(len(message).to_bytes(4, "little") + message)
