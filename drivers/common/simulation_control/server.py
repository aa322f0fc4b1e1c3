"""The server of a simulation's control socket."""

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

from ..physics.body import Body, Commander, Flying
from ..physics.scenery import Camera, Object, Refused, Scenery, scenery_of
from . import protocol as p
from .renderer import CannotRender, Renderer

BACKLOG = 16
_CHUNK = 1 << 16
_STEPS_AT_ONCE = 500
"""Steps between two turns of the event loop; they take about 3 ms."""


class Log(Protocol):
    """The log of the simulated robot's protocol, which also gets the requests on the control socket."""

    def write(
        self,
        t_ns: int,
        source: Literal["control"],
        frames: Iterable[tuple[str, bytes]],
        safe_state: str | None = None,
    ) -> None: ...


class SimulationControl:
    """Serve one simulated body on a unix socket. A worker thread draws the pictures, so that neither the robot's
    protocol nor another client waits for them.

    Only the client that sent the last ``Take`` (request for control) may send targets, and only until another
    client makes the body safe. Otherwise a target of a client that has ended, which still waits in its socket,
    could move the body after the stop.
    """

    def __init__(self, path: str, body: Body, log: Log) -> None:
        """Open the socket at ``path``. Raise ``OSError`` if that fails."""
        self._path = path
        self._body = body
        self._log = log
        # The renderer's thread needs a separate copy of the model.
        self._renderer = Renderer(body.spec.copy())
        scenery = getattr(body, "scenery", None)
        if scenery is not None:
            scenery.changed = lambda: self._renderer.exchange(body.spec.copy())
        self._owner: object = None
        self._holds_initial_pose = False
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.setblocking(False)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        self._listener.bind(path)
        os.chmod(path, 0o600)
        self._listener.listen(BACKLOG)

    def hold_initial_pose(self) -> None:
        """Hold the robot in its initial pose, now and after each reset, until a client releases it."""
        self._holds_initial_pose = True
        self._body.energise(True)

    async def serve(self) -> None:
        """Serve the clients of the control socket until cancelled."""
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
        """Make the file of the scene for clients that draw it. Call this before the robot can be connected,
        because it delays this process."""
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
                self._owner = client
                body.energise(True)
            case p.Aim():
                if client is self._owner and self._fits(request.values):
                    self._note("setpoint", request)
                    body.set_targets(request.values)
                return None
            case p.Safe():
                self._note("safe", request, request.safe_state)
                if client is not self._owner:
                    self._owner = None
                if request.safe_state == p.LIMP:
                    body.energise(False)
                elif request.safe_state == p.LAND and isinstance(body, Flying):
                    body.land()
                else:
                    body.hold()
            case p.Reset():
                if Commander.WIRE in body.commanders:
                    return p.No(number, "the robot on the wire is energised. Stop it first")
                self._note("reset", request)
                body.reset()
                if self._holds_initial_pose:
                    body.energise(True)
            case p.Load():
                if Commander.WIRE in body.commanders:
                    return p.No(number, "the robot on the wire is energised. Stop it first")
                try:
                    scenery_of(body).load(request.name)
                except Refused as refusal:
                    return p.No(number, str(refusal))
                body.hold()
            case p.AddObject() | p.AddCamera() | p.RemoveObject() | p.Save() | p.Pause() | p.SetLight():
                return self._change(request)
            case p.Step():
                if not 1 <= request.steps <= p.MOST_STEPS:
                    return p.No(number, f"{request.steps} steps. Give 1 to {p.MOST_STEPS}")
                if Commander.WIRE in body.commanders:
                    return p.No(
                        number, "the robot on the wire is energised, and its time is the clock's. Stop it first"
                    )
                await self._step(request.steps)
            case p.Render():
                return await self._render(request)
            case p.GetModel():
                scene, binary = await self._renderer.model(self._body.pose())
                return p.Model(number, binary, scene)
            case p.GetObjects():
                scenery: Scenery | None = getattr(body, "scenery", None)
                return p.Objects(number, {} if scenery is None else scenery.poses())
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
            tuple(int(commander) for commander in felt.commanders),
            tuple(felt.base_xyz_m),
            tuple(felt.orientation_wxyz),
            tuple(felt.gyro_rad_s),
        )

    def _change(self, request: p.Change) -> p.Reply:
        """Change the scene, or save the state of the simulation."""
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
                case p.Pause():
                    scenery.pause(request.on)
                case p.SetLight():
                    scenery.set_light((request.brightness, request.azimuth_deg, request.elevation_deg))
        except Refused as refusal:
            return p.No(request.number, str(refusal))
        return p.Done(request.number)

    async def _step(self, steps: int) -> None:
        """Simulate time steps, in groups. Other clients are served before each group."""
        while steps > 0:
            await trio.lowlevel.checkpoint()
            now = min(steps, _STEPS_AT_ONCE)
            self._body.step(now)
            steps -= now

    def _fits(self, values: Sequence[float]) -> bool:
        rows: int = getattr(self._body, "target_rows", 1)
        return len(values) == rows * len(self._body.axes) and all(map(math.isfinite, values))

    async def _render(self, request: p.Render) -> p.Reply:
        pose = self._body.pose()
        if request.qpos:
            if len(request.qpos) != len(pose):
                return p.No(
                    request.number, f"a state of {len(request.qpos)} numbers, but the scene has {len(pose)}"
                )
            pose = request.qpos
        try:
            rgb = await self._renderer.render(pose, request.width, request.height, request.camera)
        except CannotRender as failure:
            return p.No(request.number, str(failure))
        return p.Picture(request.number, request.width, request.height, rgb)

    def _note(self, kind: str, request: p.Frame, safe_state: str | None = None) -> None:
        self._log.write(time.monotonic_ns(), "control", [(kind, p.encode(request))], safe_state)


def _fields(frame: p.Frame) -> list[Any]:
    """Return the values of a frame's fields, without its number."""
    return [getattr(frame, name) for name in frame.__struct_fields__ if name != "number"]


async def _send(sock: socket.socket, data: bytes) -> None:
    """Send all bytes. The call waits only if the socket's buffer is full, which is rare."""
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[sock.send(rest) :]
        except BlockingIOError:
            await trio.lowlevel.wait_writable(sock)
