"""The controller's plain ports, without the SDK: the dashboard, and samples that show its clock
advance."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Iterator, Sequence
from itertools import chain
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.receive_budget import ReceiveBudget
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp

from . import protocol as p

ANSWER_S = 0.5
"""A controller answers within milliseconds; it may be busy starting a program."""


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

LONGEST_ANSWER = 16 * 1024
"""Bytes of what the dashboard answers to a line; a serial number has 20."""


def refuse_long(stream: TcpPort, heard: bytes) -> None:
    """Raise ``WireDown`` for what is no answer of the dashboard."""
    if len(heard) > LONGEST_ANSWER:
        raise WireDown(f"{stream.name}: answers more than {LONGEST_ANSWER} bytes. Check what is served there")


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
                refuse_long(stream, pending)
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
    """A stream of RTDE samples: what each output that was asked for is now."""

    def __init__(self, stream: TcpPort) -> None:
        self._stream = stream
        self._decoder = p.Decoder()
        self._budget = ReceiveBudget(stream.name)
        self._packets: Iterator[p.Packet] = iter(())  # that came with one asked for
        self._recipe: p.Recipe

    async def start(self, names: Sequence[str], hz: float) -> None:
        """Agree on the outputs and how often they come. Raise ``WireDown``."""
        with self._understood():
            if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
                raise WireDown(f"{self._stream.name}: speaks no RTDE version {p.RTDE_VERSION}. Update its software")
            answer = await self._request(p.outputs_request(hz, names), p.Kind.OUTPUTS)
            self._recipe = p.outputs_answer(answer, names)
            await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Return the newest that has come. Raise ``WireDown`` when none comes, or one that cannot be
        read, or when the controller sends more than can be read."""
        with self._understood():
            newest = await self._packet(p.Kind.DATA)
            pieces = self._budget.turn(self._stream.read_waiting)
            behind = (packet for data in pieces for packet in self._decoder.feed(data))
            for packet in chain(self._packets, behind):
                if packet.kind == p.Kind.DATA:
                    newest = packet.payload
            return self._recipe.unpack(newest)

    async def first(self) -> dict[str, Any]:
        """Return the first that shows the controller's clock advance. Raise ``WireDown`` when it
        does not."""
        sample = before = await self.next()
        with trio.move_on_after(ANSWER_S):
            while sample["timestamp"] == before["timestamp"]:
                sample = await self.next()
            return sample
        raise WireDown(
            f"{self._stream.name}: samples come, but the controller's clock stands still. Restart the controller"
        )

    def close(self) -> None:
        self._stream.close()

    async def _request(self, request: bytes, kind: int) -> bytes:
        self._stream.write(request)
        return await self._packet(kind)

    async def _packet(self, kind: int) -> bytes:
        while True:
            for packet in self._packets:
                if packet.kind == kind:
                    return packet.payload
            self._packets = self._decoder.feed(await receive(self._stream))

    @contextlib.contextmanager
    def _understood(self) -> Iterator[None]:
        try:
            yield
        except MalformedFrame as malformed:
            raise WireDown(f"{self._stream.name}: {malformed}") from None


async def open_samples(host: str, names: Sequence[str], hz: float) -> Samples:
    """Raise ``WireDown``."""
    started = Samples(await open_tcp(host, p.RTDE_PORT))
    try:
        await started.start(names, hz)
    except BaseException:
        started.close()
        raise
    return started
