"""The twin's end of the simulation control."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import time
from collections.abc import Iterable, Sequence
from typing import Any, Literal, Protocol

import trio

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from ..physics.body import Body, Flying, Hand
from ..physics.scenery import Camera, Object, Refused, scenery_of
from . import protocol as p
from .renderer import CannotRender, Renderer

BACKLOG = 16
_CHUNK = 1 << 16
_STEPS_AT_ONCE = 500
"""Steps between two turns of the event loop; they take about 3 ms."""


class Log(Protocol):
    """The log of requests: the twin's wire log."""

    def write(
        self,
        t_ns: int,
        source: Literal["control"],
        frames: Iterable[tuple[str, bytes]],
        safe_state: str | None = None,
    ) -> None: ...


class SimulationControl:
    """Serve one body on a unix socket. A thread takes the pictures, so neither the wire nor another client
    waits for one.

    Only the client that took the body last may aim, and only until another client makes the body safe.
    Otherwise a setpoint that a gone client has left in its socket could be obeyed after the safe frame.
    """

    def __init__(self, path: str, body: Body, log: Log) -> None:
        """Open the socket. Raise ``OSError`` if it cannot be opened at ``path``."""
        self._path = path
        self._body = body
        self._log = log
        self._renderer = Renderer(body.spec.copy())  # A copy, because a thread uses it.
        scenery = getattr(body, "scenery", None)
        if scenery is not None:
            scenery.changed = lambda: self._renderer.exchange(body.spec.copy())
        self._taker: object = None
        self._holds_at_first = False
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.setblocking(False)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        self._listener.bind(path)
        os.chmod(path, 0o600)
        self._listener.listen(BACKLOG)

    def hold_at_first(self) -> None:
        """Hold the robot in its first pose, now and after each reset, until a client releases it."""
        self._holds_at_first = True
        self._body.take(True)

    async def serve(self) -> None:
        """Serve until cancelled."""
        try:
            async with trio.open_nursery() as nursery:
                while True:
                    await trio.lowlevel.wait_readable(self._listener)
                    with contextlib.suppress(BlockingIOError, ConnectionError):
                        sock, _ = self._listener.accept()
                        nursery.start_soon(self._attend, sock)
        finally:
            self._renderer.close()

    async def get_ready(self) -> None:
        """Make the model for clients that draw the scene, before anything is on the wire."""
        await self._renderer.model(self._body.pose())

    def close(self) -> None:
        self._listener.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    async def _attend(self, sock: socket.socket) -> None:
        decoder = p.request_decoder()
        client = object()
        with sock, contextlib.suppress(ConnectionError, MalformedFrame):
            sock.setblocking(False)
            while True:
                await trio.lowlevel.wait_readable(sock)
                try:
                    data = sock.recv(_CHUNK)
                except BlockingIOError:
                    continue
                if not data:
                    return
                for request in decoder.feed(data):
                    reply = await self._answer(client, request)
                    if reply is not None and request.number:
                        await _send(sock, p.encode(reply))

    async def _answer(self, client: object, request: p.Request) -> p.Reply | None:
        body = self._body
        body.pass_time()
        number = request.number
        match request:
            case p.Handshake():
                return p.Axes(number, body.axes)
            case p.Take():
                self._note("enable", request)
                self._taker = client
                body.take(True)
            case p.Aim():
                if client is self._taker and self._fits(request.values):
                    self._note("setpoint", request)
                    body.aim(request.values)
                return None
            case p.Safe():
                self._note("safe", request, request.safe_state)
                if client is not self._taker:
                    self._taker = None
                if request.safe_state == p.LIMP:
                    body.take(False)
                elif request.safe_state == p.LAND and isinstance(body, Flying):
                    body.land()
                else:
                    body.hold()
            case p.Reset():
                if Hand.WIRE in body.hands:
                    return p.No(number, "the robot on the wire is energised. stop it first")
                self._note("reset", request)
                body.reset()
                if self._holds_at_first:
                    body.take(True)
            case p.Load():
                if Hand.WIRE in body.hands:
                    return p.No(number, "the robot on the wire is energised. stop it first")
                try:
                    scenery_of(body).load(request.name)
                except Refused as refusal:
                    return p.No(number, str(refusal))
                body.hold()
            case p.AddObject() | p.AddCamera() | p.RemoveObject() | p.Save():
                return self._change(request)
            case p.Step():
                if not 1 <= request.steps <= p.MOST_STEPS:
                    return p.No(number, f"{request.steps} steps. give 1 to {p.MOST_STEPS}")
                if Hand.WIRE in body.hands:
                    return p.No(
                        number, "the robot on the wire is energised, and its time is the clock's. stop it first"
                    )
                await self._step(request.steps)
            case p.Render():
                return await self._render(request)
            case p.GetModel():
                scene, binary = await self._renderer.model(self._body.pose())
                return p.Model(number, binary, scene)
            case p.GetPose():
                return p.Pose(number, tuple(body.pose()), self._renderer.scene)
            case p.Read():
                pass
        felt = body.felt()
        return p.Sample(
            number,
            felt.time_s,
            tuple(felt.position),
            tuple(felt.velocity),
            tuple(felt.effort),
            tuple(int(hand) for hand in felt.hands),
        )

    def _change(self, request: p.Change) -> p.Reply:
        """Change the scene, or save its state."""
        self._note("config", request)
        try:
            scenery = scenery_of(self._body)
            match request:
                case p.AddObject():
                    scenery.add_object(Object(*_fields(request)))
                case p.AddCamera():
                    scenery.add_camera(Camera(*_fields(request)))
                case p.RemoveObject():
                    scenery.remove_object(request.name)
                case p.Save():
                    scenery.save(request.name)
        except Refused as refusal:
            return p.No(request.number, str(refusal))
        return p.Done(request.number)

    async def _step(self, steps: int) -> None:
        """Simulate steps. Serve the other clients before the first step and between pieces."""
        while steps > 0:
            await trio.lowlevel.checkpoint()
            now = min(steps, _STEPS_AT_ONCE)
            self._body.step(now)
            steps -= now

    def _fits(self, values: Sequence[float]) -> bool:
        rows: int = getattr(self._body, "target_rows", 1)
        return len(values) == rows * len(self._body.axes) and all(map(math.isfinite, values))

    async def _render(self, request: p.Render) -> p.Reply:
        try:
            rgb = await self._renderer.render(self._body.pose(), request.width, request.height, request.camera)
        except CannotRender as failure:
            return p.No(request.number, str(failure))
        return p.Picture(request.number, request.width, request.height, rgb)

    def _note(self, kind: str, request: p.Frame, safe_state: str | None = None) -> None:
        self._log.write(time.monotonic_ns(), "control", [(kind, p.encode(request))], safe_state)


def _fields(frame: p.Frame) -> list[Any]:
    """Return the fields of a frame without its number."""
    return [getattr(frame, name) for name in frame.__struct_fields__ if name != "number"]


async def _send(sock: socket.socket, data: bytes) -> None:
    """Send all bytes. Wait only if the socket's buffer is full, which is rare."""
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[sock.send(rest) :]
        except BlockingIOError:
            await trio.lowlevel.wait_writable(sock)
