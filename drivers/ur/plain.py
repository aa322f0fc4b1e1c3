"""The controller's plain ports, without the SDK: the dashboard, and samples that show its clock
advance."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Iterator
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp

from . import protocol as p

ANSWER_S = 0.5
"""A controller answers within milliseconds; it may be busy starting a program."""

LOOK = ("timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state")
LOOK_HZ = 125.0


@contextlib.asynccontextmanager
async def connected(host: str, port: int) -> AsyncIterator[TcpPort]:
    """Raise ``WireDown``. The close is an orderly one: a stop that a frozen controller has not read
    yet stays there for when it wakes up."""
    stream = await open_tcp(host, port)
    try:
        yield stream
    finally:
        stream.close_in_order()


async def receive(stream: TcpPort) -> bytes:
    with trio.move_on_after(ANSWER_S):
        return await stream.read()
    raise WireDown(f"{stream.name}: does not answer for {ANSWER_S * 1e3:g} ms. Is the controller alive?")


# -- the dashboard


async def ask_dashboard(host: str, *lines: str) -> list[str]:
    """Return the answer to each line. Raise ``WireDown``."""
    answers: list[str] = []
    async with connected(host, p.DASHBOARD_PORT) as stream:
        pending = b""
        for line in ("", *lines):  # the banner comes unasked
            if line:
                stream.write(f"{line}\n".encode())
            while b"\n" not in pending:
                pending += await receive(stream)
            answer, _, pending = pending.partition(b"\n")
            answers.append(answer.decode("utf-8", "replace").strip())
    return answers[1:]


async def handshake(host: str) -> dict[str, Any]:
    """Return who it is, for ``status``. Raise ``WireDown``."""
    version, serial, model, remote = await ask_dashboard(
        host, "PolyscopeVersion", "get serial number", "get robot model", "is in remote control"
    )
    return {"polyscope": version, "serial": serial, "robot_model": model, "remote_control": remote}


# -- samples


class Samples:
    """A stream of RTDE samples of ``LOOK``."""

    def __init__(self, stream: TcpPort) -> None:
        self._stream = stream
        self._decoder = p.Decoder()
        self._packets: Iterator[p.Packet] = iter(())  # that came with one asked for
        self._recipe: p.Recipe

    async def start(self) -> None:
        if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
            raise WireDown(f"{self._stream.name}: speaks no RTDE version {p.RTDE_VERSION}. Update its software")
        self._recipe = p.outputs_answer(await self._request(p.outputs_request(LOOK_HZ, LOOK), p.Kind.OUTPUTS), LOOK)
        await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Raise ``WireDown`` when none comes."""
        return self._recipe.unpack(await self._packet(p.Kind.DATA))

    async def _request(self, request: bytes, kind: int) -> bytes:
        self._stream.write(request)
        return await self._packet(kind)

    async def _packet(self, kind: int) -> bytes:
        while True:
            for packet in self._packets:
                if packet.kind == kind:
                    return packet.payload
            self._packets = self._decoder.feed(await receive(self._stream))


@contextlib.asynccontextmanager
async def samples(host: str) -> AsyncIterator[Samples]:
    """Raise ``WireDown``, also for samples that cannot be read."""
    async with connected(host, p.RTDE_PORT) as stream:
        started = Samples(stream)
        try:
            await started.start()
            yield started
        except MalformedFrame as malformed:
            raise WireDown(f"{stream.name}: {malformed}") from None


async def look(host: str) -> None:
    """See the controller's clock advance. Raise ``WireDown`` when it does not."""
    async with samples(host) as stream:
        first = await stream.next()
        with trio.move_on_after(ANSWER_S):
            while (await stream.next())["timestamp"] == first["timestamp"]:
                pass
            return
    raise WireDown(f"{host}: samples come, but the controller's clock stands still. Restart the controller")
