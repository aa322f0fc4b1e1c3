"""Set up a robot from the page: ports, doctor, calibration, ids of motors, drill.

Each is the command of the same name, in a separate process. The command asks its questions in lines of JSON
(``--dialogue``), and the WebSocket of a page carries them. When the page is closed, the command gets the end of its
input, which counts as Ctrl-C. So it ends as safely as in a terminal.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Any

import msgspec
import trio
from starlette.requests import Request
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, list_leaders, list_native_drivers
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.lines import lines_of
from strands_actors.surfaces.serial_ports import serial_ports

from .access import Access, Role, Session
from .answers import Bad, order
from .sockets import BAD_MESSAGE, DISCONNECTED, ENDED, send

END_S = 30.0
"""How long a command may take to end by itself, in seconds. An arm that is lowered takes some of it."""
LOOK_S = 0.25
DOCTOR_S = 120.0
_COMMAND = "from strands_actors.surfaces.cli import main; main()"

_Text = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


class Calibrate(msgspec.Struct, tag="calibrate", forbid_unknown_fields=True):
    """Calibrate a robot or leader arm, or put the values back that it had before (``undo``)."""

    robot: _Text
    port: _Text
    id: _Text | None = None
    accept: list[_Text] = []
    undo: bool = False

    def arguments(self) -> list[str]:
        options = [f"--accept={word}" for word in self.accept]
        options += [] if self.id is None else [f"--id={self.id}"]
        options += ["--undo"] if self.undo else []
        return ["calibrate", f"--port={self.port}", *options]


class SetupMotors(msgspec.Struct, tag="setup-motors", forbid_unknown_fields=True):
    """Give new servos their ids. ``joints`` is empty for all joints."""

    robot: _Text
    port: _Text
    joints: list[_Text] = []

    def arguments(self) -> list[str]:
        return ["setup-motors", f"--port={self.port}", *(f"--joint={joint}" for joint in self.joints)]


class Drill(msgspec.Struct, tag="drill", forbid_unknown_fields=True):
    """Drill a robot; a simulated one without a port."""

    robot: _Text
    port: _Text | None = None
    id: _Text | None = None

    def arguments(self) -> list[str]:
        where = "--twin" if self.port is None else f"--port={self.port}"
        return ["drill", where, *([] if self.id is None else [f"--id={self.id}"])]


Order = Calibrate | SetupMotors | Drill
_decode = msgspec.json.Decoder(Order).decode


class Kind(msgspec.Struct, frozen=True):
    """A type of robot or leader arm that can be set up.

    Attributes:
        name: Its name.
        joints: The joints with servos that can be calibrated and get ids here; empty for other robots.
        drills: True if it can be drilled.
    """

    name: str
    joints: list[str]
    drills: bool


class Setup:
    """The orders of the view.

    Args:
        access: The sessions.
    """

    def __init__(self, access: Access) -> None:
        self._access = access
        self._in_use: set[str] = set()
        self._doctor_room = trio.CapacityLimiter(1)

    def routes(self) -> list[BaseRoute]:
        return [
            Route("/setup/kinds", order(self._kinds, Role.OPERATOR), methods=["GET"]),
            Route("/setup/ports", order(self._ports, Role.OPERATOR), methods=["GET"]),
            Route("/setup/doctor", order(self._doctor, Role.OPERATOR), methods=["POST"]),
            WebSocketRoute("/setup/run", self._run),
        ]

    async def _kinds(self, request: Request, session: Session) -> dict[str, Any]:
        return {"kinds": await trio.to_thread.run_sync(kinds)}

    async def _ports(self, request: Request, session: Session) -> dict[str, Any]:
        ports = await trio.to_thread.run_sync(serial_ports)
        return {"ports": [{"port": port, "about": about} for port, about in ports.items()]}

    async def _doctor(self, request: Request, session: Session) -> Any:
        async with self._doctor_room:
            with trio.move_on_after(DOCTOR_S):
                done = await trio.run_process(
                    [*PYTHON, "-c", _COMMAND, "doctor", "--json"],
                    env=environment(),
                    stdin=b"",
                    capture_stdout=True,
                    check=False,
                )
                # Exit code 1 means that something is broken, which the findings describe.
                with contextlib.suppress(msgspec.DecodeError):
                    return msgspec.json.decode(done.stdout)
        raise Bad(500, "doctor did not end with findings. Run `strands-actors doctor` in a terminal to see why.")

    # -- a command, with a page in place of the terminal

    async def _run(self, socket: WebSocket) -> None:
        session: Session = socket.state.session
        await socket.accept()
        with contextlib.suppress(*DISCONNECTED):
            if session.role is not Role.OPERATOR:
                await socket.close(ENDED, "This device may look and stop. Only an operator may do this.")
                return
            try:
                order = _decode(await socket.receive_text())
            except (msgspec.MsgspecError, RecursionError, KeyError) as error:
                await socket.close(BAD_MESSAGE, f"The order cannot be read: {error}."[:100])
                return
            try:
                with self._use(order.port):
                    await self._carry_out(socket, session, order)
            except Bad as bad:
                await send(socket, msgspec.json.encode({"error": str(bad)}).decode())
                await socket.close()

    @contextlib.contextmanager
    def _use(self, port: str | None) -> Iterator[None]:
        """Reserve a port while the block runs. Raise ``Bad`` if another page has it."""
        if port is None:
            yield
            return
        real = os.path.realpath(port)
        if real in self._in_use:
            raise Bad(409, f"{port} is just set up from another page. End that first.")
        self._in_use.add(real)
        try:
            yield
        finally:
            self._in_use.discard(real)

    async def _carry_out(self, socket: WebSocket, session: Session, order: Order) -> None:
        arguments = [*order.arguments(), "--json", "--dialogue", "--", order.robot]
        async with _command(arguments) as process, trio.open_nursery() as nursery:

            async def answer() -> None:
                """Carry the answers of the page. Its end, and the end of its session, end the command."""
                assert process.stdin is not None
                with contextlib.suppress(WebSocketDisconnect, KeyError, trio.BrokenResourceError):
                    while True:
                        text = await socket.receive_text()
                        await process.stdin.send_all(text.replace("\n", " ").encode() + b"\n")
                nursery.cancel_scope.cancel()

            async def watch() -> None:
                while self._access.holds(session):  # noqa: ASYNC110  # no event reports its end
                    await trio.sleep(LOOK_S)
                nursery.cancel_scope.cancel()

            nursery.start_soon(answer)
            nursery.start_soon(watch)
            assert process.stdout is not None
            with contextlib.suppress(*DISCONNECTED):
                async for line in lines_of(process.stdout):
                    await send(socket, line.decode())
                ending = {"type": "ended", "code": await process.wait()}
                await send(socket, msgspec.json.encode(ending).decode())
                await socket.close()
            nursery.cancel_scope.cancel()


def kinds() -> list[Kind]:
    """Return the types that can be set up. The first call imports all drivers, so call it in a thread."""
    classes = {name: get_native_driver_class(name) for name in list_native_drivers()}
    leaders = list_leaders()
    return [
        *(Kind(name, _joints(driver_class, name), True) for name, driver_class in classes.items()),
        *(Kind(name, _joints(driver_class, name), False) for name, driver_class in leaders.items()),
    ]


def _joints(driver_class: Any, name: str) -> list[str]:
    if not (issubclass(driver_class, Driver) and hasattr(driver_class, "SETUP")):
        return []
    return [joint["key"] for joint in driver_class.TABLES.robots[name]["joints"]]


@contextlib.asynccontextmanager
async def _command(arguments: list[str]) -> AsyncIterator[trio.Process]:
    """Run ``strands-actors`` while the block runs. At its end the command gets the end of its input, and time to
    make its robot safe."""
    process = await trio.lowlevel.open_process(
        [*PYTHON, "-c", _COMMAND, *arguments],
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C goes to the console, which then ends the command.
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        yield process
    finally:
        with trio.CancelScope(shield=True):
            await process.stdin.aclose()
            with trio.move_on_after(END_S):
                async for _ in process.stdout:
                    pass  # Read the rest, so that the command never waits for us.
                await process.wait()
            if process.returncode is None:
                process.kill()
                await process.wait()
