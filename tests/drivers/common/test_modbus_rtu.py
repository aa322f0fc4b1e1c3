"""Test that Modbus RTU frames are found in any stream, with any bytes between them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from strands_actors.drivers.common.ports.modbus_rtu import RtuDecoder, encode, request_of

READ = "09 04 07 d0 00 03 b1 ce"
ACTIVATE = "09 10 03 e8 00 03 06 01 00 00 00 00 00 72 e1"
"""As printed in the gripper's manual, except for the function of the read, which is 3 there."""

WORD = st.integers(0, 0xFFFF)
REQUESTS = st.one_of(
    st.builds(lambda count: ReadInputRegistersRequest(address=2000, count=count, dev_id=9), st.integers(1, 3)),
    st.builds(
        lambda words: WriteMultipleRegistersRequest(address=1000, registers=words, dev_id=9),
        st.lists(WORD, min_size=1, max_size=3),
    ),
    st.builds(lambda word: WriteSingleRegisterRequest(address=1000, registers=[word], dev_id=9), WORD),
    st.builds(
        lambda words: ReadWriteMultipleRegistersRequest(
            read_address=2000, read_count=3, write_address=1000, write_registers=words, dev_id=9
        ),
        st.lists(WORD, min_size=1, max_size=3),
    ),
)


def test_the_frames_of_the_manual() -> None:
    assert encode(ReadInputRegistersRequest(address=2000, count=3, dev_id=9)) == bytes.fromhex(READ)
    activate = WriteMultipleRegistersRequest(address=1000, registers=[0x0100, 0, 0], dev_id=9)
    assert encode(activate) == bytes.fromhex(ACTIVATE)


@given(st.lists(REQUESTS, min_size=1, max_size=4), st.data())
def test_requests_are_found_in_any_pieces(requests: list[ModbusPDU], data: st.DataObject) -> None:
    frames = [encode(request) for request in requests]
    stream = b"".join(frames)
    cut = data.draw(st.integers(0, len(stream)))
    decoder = RtuDecoder(requests=True)
    found = [*decoder.feed(stream[:cut]), *decoder.feed(stream[cut:])]
    assert [frame.bytes for frame in found] == frames
    assert [encode(request) for frame in found if (request := request_of(frame))] == frames


def test_an_answer_is_found_behind_noise_and_a_broken_one_is_ignored() -> None:
    answer = encode(ReadInputRegistersResponse(registers=[1, 2, 3], dev_id=9))
    decoder = RtuDecoder(requests=False)
    assert [frame.bytes for frame in decoder.feed(b"\xff\x00\x31" + answer)] == [answer]
    assert not list(decoder.feed(answer[:-1] + bytes([answer[-1] ^ 1])))
    decoder.clear()
    assert [frame.bytes for frame in decoder.feed(answer)] == [answer]


def test_a_refusal_has_its_words() -> None:
    (frame,) = RtuDecoder(requests=False).feed(encode(ExceptionResponse(4, 2, 9)))
    assert frame.failure == "illegal address (exception 2)"


@given(st.binary(max_size=600))
def test_noise_is_no_harm(noise: bytes) -> None:
    for requests in (True, False):
        for frame in RtuDecoder(requests=requests).feed(noise):
            assert len(frame.bytes) <= 256
