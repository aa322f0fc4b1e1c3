"""The process of a twin: signals, control lines on stdin, the parent's pipe, the port file."""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import sys

import trio

from .line import Line
from .server import Robot, Server
from .wirelog import WireLog

LINGER_S = 3.0
"""How long a twin outlives its parent, so that what others still write is logged."""

_STDIN = 0


def run(
    robot: Robot,
    line: Line,
    *,
    port_file: str | None = None,
    log: str | None = None,
    fault: str | None = None,
    parent_fd: int | None = None,
    wire_time: bool = True,
) -> None:
    """Serve until SIGTERM, SIGINT or ``LINGER_S`` after ``parent_fd`` reached its end. SIGUSR1 takes the
    robot's power away and gives it back.

    ``port_file`` holds the line's address as long as it is served. When stdin is a pipe it takes lines:
    ``fault WORD[:unit]``, ``power-cycle``, ``unplug``, ``plug``, ``freeze SECONDS``.
    """
    trio.run(_main, robot, line, port_file, log, fault, parent_fd, wire_time)


async def _main(
    robot: Robot,
    line: Line,
    port_file: str | None,
    log_path: str | None,
    fault: str | None,
    parent_fd: int | None,
    wire_time: bool,
) -> None:
    log = WireLog(log_path)
    try:
        server = Server(robot, line, log, wire_time=wire_time)
        if fault:
            server.set_fault(fault)
        with trio.open_signal_receiver(signal.SIGTERM, signal.SIGINT, signal.SIGUSR1) as signals:
            async with trio.open_nursery() as nursery:
                line.plug()
                nursery.start_soon(server.serve)
                if parent_fd is not None:
                    nursery.start_soon(_outlive_parent, parent_fd, nursery.cancel_scope)
                if _is_pipe(_STDIN):
                    nursery.start_soon(_obey, server)
                if port_file:
                    _publish(port_file, line.address)
                async for number in signals:
                    if number != signal.SIGUSR1:
                        nursery.cancel_scope.cancel()
                    else:
                        server.power_cycle()
    finally:
        line.close()
        log.close()
        if port_file:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(port_file)


async def _outlive_parent(fd: int, scope: trio.CancelScope) -> None:
    while True:
        await trio.lowlevel.wait_readable(fd)
        if not os.read(fd, 4096):
            break
    await trio.sleep(LINGER_S)
    scope.cancel()


async def _obey(server: Server) -> None:
    pending = b""
    while True:
        await trio.lowlevel.wait_readable(_STDIN)
        data = os.read(_STDIN, 4096)
        if not data:
            return
        *lines, pending = (pending + data).split(b"\n")
        for line in lines:
            try:
                command(server, line.decode())
            except ValueError as error:
                print(error, file=sys.stderr, flush=True)


def command(server: Server, line: str) -> None:
    """One control line. Raise ``ValueError`` with the lines there are."""
    match line.split():
        case []:
            pass
        case ["fault", text]:
            server.set_fault(text)
        case ["power-cycle"]:
            server.power_cycle()
        case ["unplug"]:
            server.unplug()
        case ["plug"]:
            server.plug()
        case ["freeze", seconds]:
            server.freeze(float(seconds))
        case _:
            known = "fault WORD[:unit], power-cycle, unplug, plug, freeze SECONDS"
            raise ValueError(f"no control line {line!r}. use {known}")


def _is_pipe(fd: int) -> bool:
    try:
        mode = os.fstat(fd).st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _publish(path: str, address: str) -> None:
    new = f"{path}.{os.getpid()}.new"
    with open(new, "w") as file:
        file.write(address)
    os.replace(new, path)
