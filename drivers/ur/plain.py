"""Use a UR controller's ports without an SDK: the dashboard, RTDE samples, and RTDE registers.

The samples also show whether the controller's clock advances. The registers command our control script.
"""

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
    """Connect to a port, for a ``with`` block. Raise ``WireDown`` if that fails.

    At the end, sent data is still delivered. So a frozen controller receives a stop when it continues.
    """
    stream = await open_tcp(host, port)
    try:
        yield stream
    finally:
        stream.close_in_order()


async def receive(stream: TcpPort) -> bytes:
    with trio.move_on_after(ANSWER_S):
        return await stream.read()
    raise WireDown(f"{stream.name}: the controller did not answer for {ANSWER_S * 1e3:g} ms. Check its power")


# -- connections to the dashboard

LONGEST_ANSWER = 16 * 1024
"""Most bytes in an answer of the dashboard to one line. Usual answers have about 20."""


def refuse_long(stream: TcpPort, received: bytes) -> None:
    """Raise ``WireDown`` if the received data is longer than any answer of a UR dashboard."""
    if len(received) > LONGEST_ANSWER:
        raise WireDown(
            f"{stream.name}: the answer has more than {LONGEST_ANSWER} bytes. Check that this is a UR controller"
        )


async def ask_dashboard(host: str, *lines: str) -> list[str]:
    """Send lines to the dashboard and return the answer to each. Raise ``WireDown`` if an answer is missing."""
    answers: list[str] = []
    async with connected(host, p.DASHBOARD_PORT) as stream:
        pending = b""
        for line in ("", *lines):  # First receive the greeting, which the dashboard sends without a request.
            if line:
                stream.write(f"{line}\n".encode())
            while b"\n" not in pending:
                pending += await receive(stream)
                refuse_long(stream, pending)
            answer, _, pending = pending.partition(b"\n")
            answers.append(answer.decode("utf-8", "replace").strip())
    return answers[1:]


async def handshake(host: str) -> dict[str, Any]:
    """Return version, serial number and model of the controller, and whether it is in remote control.

    Raise ``WireDown`` if it does not answer.
    """
    version, serial, model, remote = await ask_dashboard(
        host, "PolyscopeVersion", "get serial number", "get robot model", "is in remote control"
    )
    return {"polyscope": version, "serial": serial, "robot_model": model, "remote_control": remote}


# -- connections to RTDE: samples and registers


class Rtde:
    """One RTDE connection to a controller: requests and their answers."""

    def __init__(self, stream: TcpPort) -> None:
        self._stream = stream
        self._decoder = p.Decoder()
        self._budget = ReceiveBudget(stream.name)
        self._packets: Iterator[p.Packet] = iter(())  # Received packets that were not handled yet.
        self._outputs: p.Recipe

    def close(self) -> None:
        self._stream.close()

    async def _agree_version(self) -> None:
        if await self._request(p.version_request(), p.Kind.VERSION) != b"\x01":
            raise WireDown(
                f"{self._stream.name}: the controller does not support RTDE version {p.RTDE_VERSION}. "
                "Update its software"
            )

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
    """A stream of RTDE samples. Each sample has the present values of the requested outputs, by name."""

    async def start(self, names: Sequence[str], hz: float) -> None:
        """Request outputs at a rate, and start the stream. Raise ``WireDown`` if the controller refuses."""
        with self._understood():
            await self._agree_version()
            await self._agree_outputs(names, hz)
            await self._request(p.frame(p.Kind.START), p.Kind.START)

    async def next(self) -> dict[str, Any]:
        """Wait for a sample. If several have arrived, return the newest.

        Raises:
            WireDown: No sample has arrived, it cannot be decoded, or more data arrives than can be read.
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
        """Wait until the controller's time stamp advances, and return that sample.

        Raises:
            WireDown: Samples arrive, but their time stamp does not advance.
        """
        sample = before = await self.next()
        with trio.move_on_after(ANSWER_S):
            while sample["timestamp"] == before["timestamp"]:
                sample = await self.next()
            return sample
        raise WireDown(
            f"{self._stream.name}: samples arrive, but the controller's clock does not advance. "
            "Restart the controller"
        )


class Registers(Rtde):
    """Registers of the controller: inputs that this connection writes, and outputs that it reads.

    Each packet writes all of these inputs. The controller reserves inputs for one client until its connection ends.
    It also sends the outputs all the time. So it notices that a client has ended, even if the cable was pulled.
    """

    answers: Mapping[str, Any] = {}
    """The newest values of the outputs, by name. Empty before the first ones have arrived."""

    async def start(self, inputs: Sequence[str], outputs: Sequence[str], hz: float) -> None:
        """Request the inputs to write and the outputs to read.

        Raises:
            WireDown: The controller refuses, for example because another client writes an input.
        """
        with self._understood():
            await self._agree_version()
            await self._agree_outputs(outputs, hz)
            self._inputs = p.inputs_answer(await self._request(p.inputs_request(inputs), p.Kind.INPUTS), inputs)
            await self._request(p.frame(p.Kind.START), p.Kind.START)

    def write(self, values: Mapping[str, p.Value]) -> None:
        """Send the values of all inputs, without waiting. Raise ``WireDown`` if the connection is lost."""
        self._stream.write(self._inputs.pack(values))

    def take(self) -> None:
        """Store the output values that have arrived, without waiting. Raise ``WireDown`` if the connection is
        lost."""
        with self._understood():
            for packet in (*self._packets, *self._decoder.feed(self._stream.read_waiting() or b"")):
                if packet.kind == p.Kind.DATA:
                    self.answers = self._outputs.unpack(packet.payload)


async def open_registers(host: str, inputs: Sequence[str], outputs: Sequence[str], hz: float) -> Registers:
    """Connect, and request the registers to write and to read. Raise ``WireDown`` if that fails."""
    opened = Registers(await open_tcp(host, p.RTDE_PORT))
    try:
        await opened.start(inputs, outputs, hz)
    except BaseException:
        opened.close()
        raise
    return opened


async def open_samples(host: str, names: Sequence[str], hz: float) -> Samples:
    """Connect, and start a stream of samples. Raise ``WireDown`` if that fails."""
    started = Samples(await open_tcp(host, p.RTDE_PORT))
    try:
        await started.start(names, hz)
    except BaseException:
        started.close()
        raise
    return started
