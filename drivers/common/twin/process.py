"""The process of a simulated robot: signals, control lines on stdin, the end of the parent process, and the file
with the robot's address (the port file)."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import signal
import stat
import sys
from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypedDict, Unpack, runtime_checkable

import trio

from strands_actors.drivers.common.physics.body import body_of
from strands_actors.kernel.health.realtime import TWIN_PRIORITY, run_first

from .lateness import Lateness
from .options import OptionsT, read_twin_options
from .orders import serve_orders
from .robot import HasControlLines
from .wirelog import WireLog

LINGER_S = 3.0
"""How long a twin outlives its parent, so that frames that other processes still write are logged."""

_STDIN = 0


class SimulatedRobot(Protocol):
    """A simulated robot that can be served. ``address`` is a path or host:port, which is written to the port file
    for clients."""

    @property
    def address(self) -> str: ...
    def set_fault(self, text: str) -> None: ...
    def power_cycle(self) -> None: ...
    def unplug(self) -> None: ...
    def plug(self) -> None: ...
    def freeze(self, seconds: float) -> None: ...
    async def serve(self) -> None: ...
    def close(self) -> None: ...


@runtime_checkable
class ManyClients(Protocol):
    """A simulated robot that can delay the requests of one client process."""

    def set_delay(self, lateness: Lateness) -> None: ...


class Control(Protocol):
    """The control socket by which a program uses the robot as a simulation."""

    async def get_ready(self) -> None: ...
    async def serve(self) -> None: ...
    def close(self) -> None: ...


class Start(TypedDict, total=False):
    """Keyword arguments of the ``main`` of every simulated robot."""

    port_file: str | None
    """Path of the file that holds the wire's address while it is served."""
    log: str | None
    """Path of the wire log."""
    fault: str | None
    """Fault from the beginning, ``WORD[:unit]``."""
    parent_fd: int | None
    """Descriptor that reaches its end of file when the twin's parent ends."""
    control: str | None
    """Path of the socket of the simulation control (see ``common.simulation_control``)."""
    place: Mapping[str, Any] | None
    """Pose of the robot's base in the simulation: ``position`` in metres, ``orientation`` as w x y z."""
    pictures: bool
    """Whether other processes draw the scene. They need it before anything moves."""
    orders: str | None
    """Path of the socket for control lines (see ``orders``)."""
    on_wire: bool
    """Whether only the wire drives the robot. The simulation control then serves viewers only."""


class Main(Protocol):
    """The function of a simulated robot's process, which ``Driver.TWIN`` names."""

    def __call__(self, robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None: ...


def main_of(options_type: type[OptionsT], build: Callable[[str, OptionsT, WireLog], SimulatedRobot]) -> Main:
    """Return the ``main`` of a simulated robot: it runs the robot of ``robots.toml`` until interrupted.

    Args:
        options_type: The options of this robot.
        build: Builds the server of a robot from its name, its options and the log. It raises ``ValueError`` for an
            option that the robot cannot have.
    """

    def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
        chosen = read_twin_options(robot, options_type, options)
        run_server(lambda log: build(robot, chosen, log), **start)

    return main


def run_server(build: Callable[[WireLog], SimulatedRobot], **start: Unpack[Start]) -> None:
    """Serve a simulated robot until SIGTERM or SIGINT. ``build`` gets the log and returns the server.

    It also ends ``LINGER_S`` after the parent process has ended. SIGUSR1 switches the robot's power off and on.
    Control lines are read from the socket ``orders``, and from stdin if that is a pipe: ``fault WORD[:unit]``,
    ``power-cycle``, ``unplug``, ``plug``, ``freeze SECONDS``. A robot with several clients also accepts ``late PID
    SECONDS`` (see ``lateness``).

    If a client uses the robot's real protocol, the process runs with priority, because a real robot has its own
    computer. If the robot is only simulated, it has no priority. Otherwise a program that steps it without a pause
    would keep all other processes from running.

    Raises:
        ValueError: ``control`` is given, and the robot has no simulated body.
    """
    trio.run(functools.partial(_main, build, **start))


async def _main(
    build: Callable[[WireLog], SimulatedRobot],
    *,
    port_file: str | None = None,
    log: str | None = None,
    fault: str | None = None,
    parent_fd: int | None = None,
    control: str | None = None,
    place: Mapping[str, Any] | None = None,
    pictures: bool = False,
    orders: str | None = None,
    on_wire: bool = False,
) -> None:
    wire_log = WireLog(log)
    server = build(wire_log)
    if control is None or on_wire:
        run_first(TWIN_PRIORITY)
    opened: Control | None = None
    try:
        if control is not None:
            opened = _open_control(control, server, wire_log, place, holds=not on_wire)
            if pictures:
                await opened.get_ready()
        if fault:
            server.set_fault(fault)
        with trio.open_signal_receiver(signal.SIGTERM, signal.SIGINT, signal.SIGUSR1) as signals:
            async with trio.open_nursery() as nursery:
                server.plug()
                nursery.start_soon(server.serve)
                if opened is not None:
                    nursery.start_soon(opened.serve)
                if parent_fd is not None:
                    nursery.start_soon(_outlive_parent, parent_fd, nursery.cancel_scope)
                if orders is not None:
                    await nursery.start(serve_orders, orders, functools.partial(command, server))
                if _is_pipe(_STDIN):
                    nursery.start_soon(_obey, server)
                if port_file:
                    _publish(port_file, server.address)
                async for number in signals:
                    if number != signal.SIGUSR1:
                        nursery.cancel_scope.cancel()
                    else:
                        server.power_cycle()
    finally:
        if opened is not None:
            opened.close()
        server.close()
        wire_log.close()
        if port_file:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(port_file)


def _open_control(
    path: str, server: SimulatedRobot, log: WireLog, place: Mapping[str, Any] | None, holds: bool
) -> Control:
    """Open the control socket by which programs use the robot as a simulation.

    Args:
        holds: True if the simulation holds the robot in its initial pose until a client releases it.
    """
    # These modules import MuJoCo, which not every simulated robot needs. So they are imported here.
    from strands_actors.drivers.common.physics.scenery import scenery_of
    from strands_actors.drivers.common.simulation_control.server import SimulationControl

    body = body_of(server)
    control = SimulationControl(path, body, log)
    if place is not None:
        scenery_of(body).place(place["position"], place["orientation"])
    if holds:
        control.hold_initial_pose()
    return control


async def _outlive_parent(fd: int, scope: trio.CancelScope) -> None:
    while True:
        await trio.lowlevel.wait_readable(fd)
        if not os.read(fd, 4096):
            break
    await trio.sleep(LINGER_S)
    scope.cancel()


async def _obey(server: SimulatedRobot) -> None:
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


def command(server: SimulatedRobot, line: str) -> None:
    """Carry out one control line (a command on the standard input, such as ``unplug``). For an unknown line raise
    ``ValueError``, which lists the known ones."""
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
        case ["freeze", seconds] if _is_number(seconds):
            server.freeze(float(seconds))
        case ["late", pid, seconds] if isinstance(server, ManyClients) and pid.isdecimal() and _is_number(seconds):
            server.set_delay(Lateness(int(pid), float(seconds)))
        case words if isinstance(server, HasControlLines) and server.order(words):
            pass
        case _:
            control_lines = "fault WORD[:unit], power-cycle, unplug, plug, freeze SECONDS"
            raise ValueError(f"unknown control line {line!r}. Use {control_lines}")


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


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
