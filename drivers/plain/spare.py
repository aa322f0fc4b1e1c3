"""Run a process that stops the robot with a new object, or finds out its axes, and then ends.

It imports the class, reports that it is ready, and waits for its order. To discard it, close the link. If
a call hangs, an alarm of the kernel ends the process, even if the call keeps the interpreter's lock.
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
    """Reports that the class is imported, or why it is not."""

    failure: str = ""


class Told(msgspec.Struct, frozen=True):
    """The result of the order. ``declared``: the axes, if the order was to find them."""

    failure: str
    declared: Declared | None = None


STOP, LEARN = b"s", b"l"


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry of the process."""
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
    _tell(sock, Told(stop_anew(instance)) if order == STOP else _learn(instance, config))


def _learn(instance: Instance, config: PlainConfig) -> Told:
    if failure := instance.make():
        return Told(failure)
    try:
        declared = declared_by(instance.made, config.name)
    except ValueError as error:
        return Told(str(error))
    if declared.keys:
        return Told(instance.cleanup(), declared)
    failure = instance.connect()
    observed = {} if failure else instance.observe()
    if isinstance(observed, str):
        failure, observed = observed, {}
    # Nothing was commanded. It matters more that the robot was asked to stop than what it answers.
    instance.stop()
    failure = instance.cleanup() or failure
    keys = keys_of(observed)
    declared = msgspec.structs.replace(declared, keys=keys, source=OBSERVED if keys else "")
    if keys and not failure:
        try:
            require_axes(declared, config.name)
        except ValueError as error:
            return Told(str(error))
    return Told(failure, declared)


def _tell(sock: socket.socket, report: Ready | Told) -> None:
    message = msgspec.msgpack.encode(report)
    sock.sendall(len(message).to_bytes(4, "little") + message)
