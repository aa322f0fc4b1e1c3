"""Test Modbus TCP: the codec with random bytes, and the client with late, invalid or missing answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
)

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.modbus import SILENT_S, Decoder, ModbusClient, encode, exception_words
from strands_actors.kernel.clock import VirtualClock

from .memory_port import MemoryPort, virtual

UNIT = 9


# -- the codec

pdus = st.one_of(
    st.builds(ReadInputRegistersRequest, address=st.integers(0, 0xFFFF), count=st.integers(1, 125)),
    st.builds(
        WriteMultipleRegistersRequest,
        address=st.integers(0, 0xFFFF),
        registers=st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=100),
    ),
)


def addressed(pdu: ModbusPDU, unit: int, number: int) -> bytes:
    pdu.dev_id, pdu.transaction_id = unit, number
    return encode(pdu)


def test_the_manuals_example() -> None:
    request = WriteMultipleRegistersRequest(address=1000, registers=[0x0900, 128, 0xFFFF])
    frame = bytes.fromhex("00 01 00 00 00 0D 09 10 03 E8 00 03 06 09 00 00 80 FF FF")
    assert addressed(request, 9, 1) == frame


@given(st.lists(st.tuples(pdus, st.integers(0, 247), st.integers(0, 0xFFFF)), max_size=5), st.data())
def test_frames_are_decoded_from_pieces_of_any_size(
    sent: list[tuple[ModbusPDU, int, int]], data: st.DataObject
) -> None:
    frames = [addressed(*one) for one in sent]
    decoder, received, stream = Decoder(requests=True), [], b"".join(frames)
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        received += list(decoder.feed(stream[:size]))
        stream = stream[size:]
    assert [frame for _, frame in received] == frames
    assert [(pdu.dev_id, pdu.transaction_id) for pdu, _ in received] == [(unit, number) for _, unit, number in sent]


@given(st.binary(max_size=60), st.booleans())
def test_no_bytes_break_the_decoder(data: bytes, requests: bool) -> None:
    try:
        for pdu, frame in Decoder(requests=requests).feed(data):
            assert isinstance(pdu, ModbusPDU) and frame in data
    except MalformedFrame:
        pass


@given(st.sampled_from(["0001 0001 0006 09", "0001 0000 0001 09", "0001 0000 00ff 09"]))
def test_an_invalid_header_is_noticed_at_once(header: str) -> None:
    with pytest.raises(MalformedFrame):
        list(Decoder(requests=False).feed(bytes.fromhex(header) + b"\x04"))


def test_exceptions_have_names() -> None:
    assert exception_words(2) == "illegal address (exception 2)"
    assert exception_words(99) == "unknown (exception 99)"


# -- the client


class Server:
    """A server that answers each request with its number as the only register, after the next delay."""

    def __init__(self, delays: Iterable[float | None] = ()) -> None:
        self.delays = list(delays)
        self.requests: list[ModbusPDU] = []
        self._decoder = Decoder(requests=True)
        self.port = MemoryPort(self.hear)
        self.client = ModbusClient(self.port, UNIT, "server", VirtualClock())

    def hear(self, data: bytes) -> Iterable[tuple[float, bytes]]:
        for request, _ in self._decoder.feed(data):
            self.requests.append(request)
            delay_s = self.delays.pop(0) if self.delays else 0.001
            if delay_s is not None:
                yield delay_s, addressed(self.answer(request), request.dev_id, request.transaction_id)

    def answer(self, request: ModbusPDU) -> ModbusPDU:
        if isinstance(request, WriteMultipleRegistersRequest):
            return WriteMultipleRegistersResponse(address=request.address, count=len(request.registers))
        return ReadInputRegistersResponse(registers=[request.transaction_id])


async def ask(client: ModbusClient, within_s: float = 0.1) -> tuple[int, list[int] | None]:
    number = client.read_registers(2000, 1)
    answer = await client.answer(number, within_s)
    if answer is None:
        client.forget(number)
    return number, answer


@given(st.lists(st.sampled_from([0.001, 0.09, 0.15, 0.32, None]), max_size=30))
def test_no_answer_is_ever_taken_for_anothers(delays: list[float | None]) -> None:
    """Answers are late, lost and overtaken. Each request gets its own answer or no answer."""

    async def main() -> None:
        server = Server(delays)
        for _ in range(len(delays) + 2):
            try:
                number, answer = await ask(server.client)
            except WireDown as down:
                assert "no answer for" in str(down)
                return
            assert answer in (None, [number])
        assert answer == [number]

    virtual(main)


def test_a_late_answer_is_still_the_answer() -> None:
    async def main() -> None:
        client = Server([0.2]).client
        number = client.read_registers(2000, 1)
        assert await client.answer(number, 0.1) is None
        assert await client.answer(number, 0.11) == [number]

    virtual(main)


def test_a_write_waits_for_nothing_and_is_not_an_answer() -> None:
    async def main() -> None:
        server = Server([0.05, 0.001])
        server.client.write_registers(1000, [1, 2, 3])
        number, answer = await ask(server.client)
        assert answer == [number]
        assert await ask(server.client) == (number + 1, [number + 1])

    virtual(main)


def test_silence_ends_the_connection_within_its_bound() -> None:
    async def main() -> None:
        client = Server([None] * 99).client
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="server: no answer for"):
            while True:
                await ask(client)
        assert SILENT_S <= trio.current_time() - began_s <= SILENT_S + 0.11

    virtual(main)


def test_a_peer_that_answers_some_requests_is_not_silent() -> None:
    async def main() -> None:
        client = Server([None, 0.001] * 20).client
        for _ in range(20):
            assert (await ask(client))[1] is None
            number, answer = await ask(client)
            assert answer == [number]

    virtual(main)


def test_the_answer_to_a_forgotten_request_is_dropped() -> None:
    async def main() -> None:
        client = Server([0.05, 0.1]).client
        forgotten = client.read_registers(2000, 1)
        client.forget(forgotten)
        number = client.read_registers(2000, 1)
        assert await client.answer(number, 0.2) == [number]
        assert await client.answer(forgotten, 0.2) is None

    virtual(main)


def test_a_pause_of_this_process_does_not_count_as_silence_of_the_peer() -> None:
    async def main() -> None:
        client = Server([0.001, None, 0.001, 0.15]).client
        assert (await ask(client))[1] is not None
        assert (await ask(client))[1] is None
        await trio.sleep(60)
        assert (await ask(client))[1] is not None
        assert (await ask(client))[1] is None

    virtual(main)


def test_transaction_ids_wrap_and_are_never_zero() -> None:
    async def main() -> None:
        server = Server()
        for _ in range(0xFFFE):
            next(server.client._numbers)
        assert [(await ask(server.client))[0] for _ in range(3)] == [0xFFFF, 1, 2]

    virtual(main)


Wrong = Callable[[ModbusPDU], ModbusPDU]


def _other_number(request: ModbusPDU) -> ModbusPDU:
    request.transaction_id += 1
    return ReadInputRegistersResponse(registers=[1])


def _other_unit(request: ModbusPDU) -> ModbusPDU:
    request.dev_id += 1
    return ReadInputRegistersResponse(registers=[1])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (_other_number, "answers what was not asked"),
        (_other_unit, "answers what was not asked"),
        (lambda _: ReadInputRegistersResponse(registers=[1, 2]), "does not fit"),
        (lambda _: WriteMultipleRegistersResponse(address=2000, count=1), "does not fit"),
        (lambda _: ExceptionResponse(4, ExcCodes.GATEWAY_NO_RESPONSE), "gateway no response"),
    ],
)
def test_a_wrong_answer_ends_the_connection(wrong: Wrong, says: str) -> None:
    async def main() -> None:
        server = Server()
        server.answer = wrong  # type: ignore[method-assign]
        with pytest.raises(WireDown, match=says):
            await ask(server.client)

    virtual(main)


def test_a_refused_write_is_reported() -> None:
    async def main() -> None:
        server = Server()
        server.answer = lambda _: ExceptionResponse(16, ExcCodes.ILLEGAL_ADDRESS)  # type: ignore[method-assign]
        server.client.write_registers(1000, [1])
        with pytest.raises(WireDown, match=r"illegal address \(exception 2\)"):
            await ask(server.client)

    virtual(main)


def test_noise_ends_the_connection() -> None:
    async def main() -> None:
        client = ModbusClient(MemoryPort(lambda _: [(0.0, b"\xff" * 9)]), UNIT, "noise", VirtualClock())
        with pytest.raises(WireDown, match="no Modbus frame"):
            await ask(client)

    virtual(main)
