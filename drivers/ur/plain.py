"""The controller's ports that need no SDK: the dashboard, samples that show that its clock advances, and
registers that we write."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp

from . import protocol as p

ANSWER_S = 0.5
"""A controller answers within milliseconds, unless it is busy starting a program."""


@contextlib.asynccontextmanager
async def connected(host: str, port: int) -> AsyncIterator[TcpPort]:
    """Connect to a port. Raise ``WireDown`` if that fails. The close is orderly, so a stop that a frozen
    controller has not read stays there until it wakes up."""
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
"""Most bytes of an answer of the dashboard to one line. A serial number has 20."""


def refuse_long(stream: TcpPort, heard: bytes) -> None:
    """Raise ``WireDown`` if the data is too long for an answer of the dashboard."""
    if len(heard) > LONGEST_ANSWER:
        raise WireDown(f"{stream.name}: answers more than {LONGEST_ANSWER} bytes. Check what is served there")


async def ask_dashboard(host: str, *lines: str) -> list[str]:
    """Return the answer to each line. Raise ``WireDown`` if one is missing."""
    answers: list[str] = []
    async with connected(host, p.DASHBOARD_PORT) as stream:
        pending = b""
        for line in ("", *lines):  # the banner comes without a request
            if line:
                stream.write(f"{line}\n".encode())
            while b"\n" not in pending:
                pending += await receive(stream)
                refuse_long(stream, pending)
            answer, _, pending = pending.partition(b"\n")
            answers.append(answer.decode("utf-8", "replace").strip())
    return answers[1:]


async def handshake(host: str) -> dict[str, Any]:
    """Return the identity of the controller, for ``status``. Raise ``WireDown`` if it does not answer."""
    version, serial, model, remote = await ask_dashboard(
        host, "PolyscopeVersion", "get serial number", "get robot model", "is in remote control"
    )
    return {"polyscope": version, "serial": serial, "robot_model": model, "remote_control": remote}


# -- samples


class Rtde:
    """One RTDE connection."""

    def __init__(self, stream: TcpPort) -> None:
        self._stream = stream
        self._decoder = p.Decoder()
        self._budget = ReceiveBudget(stream.name)
        self._packets: Iterator[p.Packet] = iter(())  # packets that arrived together with a requested one
        self._outputs: p.Recipe

    def close(self) -> None:
        self._stream.close()

    async def _agree_version(self) -> None:
        if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
            raise WireDown(f"{self._stream.name}: speaks no RTDE version {p.RTDE_VERSION}. Update its software")

    async def _agree_outputs(self, names: Sequence[str], hz: float) -> None:
        answer = await self._request(p.outputs_request(hz, names), p.Kind.OUTPUTS)
        self._outputs = p.outputs_answer(answer, names)

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


class Samples(Rtde):
    """A stream of RTDE samples: the present values of the requested outputs."""

    async def start(self, names: Sequence[str], hz: float) -> None:
        """Agree on the outputs and their rate. Raise ``WireDown`` if the controller refuses."""
        with self._understood():
            await self._agree_version()
            await self._agree_outputs(names, hz)
            await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Return the newest sample.

        Raises:
            WireDown: No sample came, it cannot be read, or the controller sends more than can be read.
        """
        with self._understood():
            newest = await self._packet(p.Kind.DATA)
            pieces = self._budget.turn(self._stream.read_waiting)
            behind = (packet for data in pieces for packet in self._decoder.feed(data))
            for packet in chain(self._packets, behind):
                if packet.kind == p.Kind.DATA:
                    newest = packet.payload
            return self._outputs.unpack(newest)

    async def first(self) -> dict[str, Any]:
        """Return the first sample that shows that the controller's clock advances.

        Raises:
            WireDown: The clock stands still.
        """
        sample = before = await self.next()
        with trio.move_on_after(ANSWER_S):
            while sample["timestamp"] == before["timestamp"]:
                sample = await self.next()
            return sample
        raise WireDown(
            f"{self._stream.name}: samples come, but the controller's clock stands still. Restart the controller"
        )


class Registers(Rtde):
    """Inputs of the controller that this connection writes, all of them in each packet, and outputs that
    answer them.

    The outputs have a second use. Inputs belong to one client until its connection ends. A controller that
    sends nothing would not notice that the client has ended while the cable was pulled.
    """

    answers: Mapping[str, Any] = {}
    """The newest outputs; empty if none has come."""

    async def start(self, inputs: Sequence[str], outputs: Sequence[str], hz: float) -> None:
        """Agree on inputs and outputs.

        Raises:
            WireDown: The controller refuses, for example because another client writes an input.
        """
        with self._understood():
            await self._agree_version()
            await self._agree_outputs(outputs, hz)
            self._inputs = p.inputs_answer(await self._request(p.inputs_request(inputs), p.Kind.INPUTS), inputs)
            await self._request(p.frame(p.Kind.START), p.Kind.START)

    def write(self, values: Mapping[str, p.Value]) -> None:
        """Write one packet at once. Raise ``WireDown`` if the connection is lost."""
        self._stream.write(self._inputs.pack(values))

    def take(self) -> None:
        """Handle received answers, without waiting. Raise ``WireDown`` if the connection is lost."""
        with self._understood():
            for packet in (*self._packets, *self._decoder.feed(self._stream.read_waiting() or b"")):
                if packet.kind == p.Kind.DATA:
                    self.answers = self._outputs.unpack(packet.payload)


async def open_registers(host: str, inputs: Sequence[str], outputs: Sequence[str], hz: float) -> Registers:
    """Connect and agree on the registers. Raise ``WireDown`` if that fails."""
    opened = Registers(await open_tcp(host, p.RTDE_PORT))
    try:
        await opened.start(inputs, outputs, hz)
    except BaseException:
        opened.close()
        raise
    return opened


async def open_samples(host: str, names: Sequence[str], hz: float) -> Samples:
    """Connect and start the samples. Raise ``WireDown`` if that fails."""
    started = Samples(await open_tcp(host, p.RTDE_PORT))
    try:
        await started.start(names, hz)
    except BaseException:
        started.close()
        raise
    return started
