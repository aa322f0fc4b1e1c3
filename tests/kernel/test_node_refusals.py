"""What a node refuses of its peer, and whether descriptors are closed, for each kind of connection."""

from __future__ import annotations

import os

import msgspec
import pytest

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.frames import ASK, HOSTS, REPLY, WATCH, frame
from strands_actors.kernel.messages import MAX_MESSAGE_BYTES, Message
from strands_actors.kernel.node import Unreachable

from .joints import JOINTS, Joint, code_of, reachable
from .kernel import Alarm, Number, Recorder, Table, Unwanted, real_time, until

encode = msgspec.msgpack.encode

BIG = Table({}, ("x" * (MAX_MESSAGE_BYTES + 1),))


# # -- refusals


@pytest.mark.parametrize(
    ("body", "code"),
    [
        pytest.param(encode(Unwanted(1)), "malformed", id="unknown type"),
        pytest.param(encode(["Number", "one"]), "malformed", id="wrong field"),
        pytest.param(encode(["Number"]), "malformed", id="missing field"),
        pytest.param(encode({"type": "Number"}), "malformed", id="not an array"),
        pytest.param(encode(None), "malformed", id="nil"),
        pytest.param(encode(float("nan")), "malformed", id="a number"),
        pytest.param(b"\x92\xa6Number\xa3\xff\xff\xff", "malformed", id="not unicode"),
        pytest.param(b"\x93\xa5Table\x81\xa1a\x81\x80\x01\x90", "malformed", id="unhashable key"),
        pytest.param(encode(BIG), "oversized", id="too large"),
    ],
)
@real_time
async def test_a_bad_message_is_refused_and_counted(joint: Joint, body: bytes, code: str) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        assert code_of(await pair.ask_raw(cell.address, body)) == code
        assert pair.there.refused_count == pair.there.dead_letter_count == 1
        pair.tell_raw(cell.address, body)
        await until(lambda: pair.there.refused_count == 2)
        assert pair.there.dead_letters[-1].to == cell.address
        ref = pair.here.ref(cell.address, Recorder)
        assert await ref.ask(Number(1), 5.0) == Number(1)
        assert log == [Number(1)]
        assert cell.incarnations == 1


@real_time
async def test_a_refusal_names_the_accepted_types_and_sizes(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        answer = await pair.ask_raw(cell.address, encode(Unwanted(1)))
        assert "Unwanted" in repr(answer) and "Number" in repr(answer) and "Recorder" in repr(answer)
        answer = await pair.ask_raw(cell.address, encode(BIG))
        assert str(MAX_MESSAGE_BYTES) in repr(answer)


@real_time
async def test_a_message_that_is_too_large_is_refused_by_the_sending_node(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        ref = pair.here.ref(cell.address, Recorder)
        for size in (MAX_MESSAGE_BYTES, 300_000, 5_000_000):
            assert code_of(await ref.ask(Table({}, ("x" * size,)), 10.0)) == "oversized"
            ref.tell(Table({}, ("x" * size,)))
        assert pair.here.refused_count == 6
        fits = Table({}, ("x" * (MAX_MESSAGE_BYTES - 500),))
        assert await ref.ask(fits, 10.0) == fits
        assert log == [fits]


@real_time
async def test_a_message_to_an_unknown_address_is_refused(joint: Joint) -> None:
    async with joint() as pair:
        answer = await pair.ask_raw("strands/r/actor/none", encode(Number(1)))
        assert code_of(answer) == "unknown_address"
        assert pair.there.refused_count == 1
        assert pair.there.dead_letters[-1].to == "strands/r/actor/none"


NOT_FRAMES = {
    "empty": b"",
    "zeros": bytes(40),
    "text": b"GET / HTTP/1.1\r\n\r\n",
    "short": encode(["a", 0]),
    "wrong types": encode([1, "a", None, [], {}, 0]),
    "not unicode": b"\x96\xa1\xff\x00\x00\xa0\xa0\xc0",
    "deep": b"\x91" * 60_000,
    "deep inside": frame("strands/r/actor/recorder", ASK, 1, "raw", "", msgspec.Raw(b"\x91" * 60_000 + b"\xc0")),
    "unknown kind": frame("strands/r/actor/recorder", 99, 0, "raw", "", None),
    "negative kind": frame("strands/r/actor/recorder", -1, 0, "raw", "", None),
}


@pytest.mark.parametrize("data", NOT_FRAMES.values(), ids=NOT_FRAMES)
@real_time
async def test_bytes_that_are_not_a_frame_are_counted_and_harmless(joint: Joint, data: bytes) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        pair.raw(data)
        await until(lambda: pair.there.refused_count == 1)
        assert pair.there.dead_letter_count == 1
        ref = pair.here.ref(cell.address, Recorder)
        assert await ref.ask(Number(1), 5.0) == Number(1)
        assert log == [Number(1)]


@pytest.mark.parametrize("back", ["", "/", "a//b", "a#b", "**", "strands/**", "$*", "?", "é/\x00", "x" * 5000])
@real_time
async def test_an_invalid_reply_address_is_harmless(joint: Joint, back: str) -> None:
    """The peer chooses the address for the answer. It may be invalid."""
    async with joint() as pair:
        cell, log = await pair.record()
        for to in (cell.address, "strands/r/actor/none"):
            pair.raw(frame(to, ASK, 7, "raw", back, Number(1)))
        pair.raw(frame(cell.address, WATCH, 0, back, back, None))
        pair.raw(frame(back, WATCH, 0, back, back, None))
        ref = pair.here.ref(cell.address, Recorder)
        assert await ref.ask(Number(2), 5.0) == Number(2)
        assert log == [Number(1), Number(2)]


@real_time
async def test_an_answer_is_never_sent_to_several_addresses(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        pair.raw(frame(cell.address, ASK, 1, "raw", "strands/node/*", Number(1)))
        assert await pair.here.ref(cell.address, Recorder).ask(Number(2), 5.0) == Number(2)
        # Over a link, the answer returns to the peer that asked, for any given address.
        assert pair.here.dead_letter_count == isinstance(pair.connection, Link)


@real_time
async def test_an_answer_of_the_wrong_type_is_a_refusal(joint: Joint) -> None:
    class Liar(Actor):
        def receive(self, message: Alarm | Number) -> Alarm | None:
            return Number(1) if isinstance(message, Number) else message  # type: ignore[return-value]

    async with joint() as pair:
        cell = await pair.host("liar", Liar)
        ref = pair.here.ref(cell.address, Liar)
        if cell.address in pair.here.cells:
            return
        assert code_of(await ref.ask(Number(1), 5.0)) == "malformed_reply"
        assert await ref.ask(Alarm(1), 5.0) == Alarm(1)


@real_time
async def test_an_answer_without_an_ask_is_a_dead_letter(joint: Joint) -> None:
    async with joint() as pair:
        pair.raw(frame(pair.there.address, REPLY, 12345, "", "", Number(1)))
        await until(lambda: pair.there.dead_letter_count == 1)
        assert pair.there.dead_letters[-1].reason == "the asker no longer waits"


@pytest.mark.parametrize("name", ["local", "zenoh"])
@real_time
async def test_on_a_mesh_no_peer_can_claim_an_address(name: str) -> None:
    async with JOINTS[name]() as pair:
        pair.raw(frame("", HOSTS, 1, "strands/r/actor/gate", "", None))
        await until(lambda: pair.there.refused_count == 1)
        with pytest.raises(Unreachable):
            await pair.there.ref("strands/r/actor/gate", Recorder).ask(Number(1), 5.0)


# -- descriptors


class Carries(Message, frozen=True):
    descriptors: tuple[int, ...]
    text: str = ""


class Received(Message, frozen=True):
    count: int


class Writer(Actor):
    """Write to the received descriptors, and close them."""

    def receive(self, message: Carries | Alarm) -> Received | Alarm:
        if isinstance(message, Alarm):
            return message
        for fd in message.descriptors:
            os.write(fd, message.text.encode())
            os.close(fd)
        return Received(len(message.descriptors))


def open_descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@real_time
async def test_descriptors_arrive_as_duplicates_or_not_at_all(joint: Joint) -> None:
    async with joint() as pair:
        cell = await pair.host("writer", Writer)
        carried = joint is not JOINTS["zenoh"]
        before = open_descriptors()
        for node in (pair.here, pair.there):  # from the other node, and from the actor's own node
            if node is pair.there:
                carried = True
            read, write = os.pipe()
            answer = await node.ref(cell.address, Writer).ask(Carries((write, write), "hello"), 5.0)
            os.close(write)  # the sender's descriptor is still open
            assert answer == Received(2 if carried else 0)
            assert os.read(read, 100) == (b"hellohello" if carried else b"")
            os.close(read)
        assert open_descriptors() == before


@real_time
async def test_descriptors_that_are_refused_are_closed(joint: Joint) -> None:
    async with joint() as pair:
        cell = await pair.host("writer", Writer)
        recorder, _ = await pair.record()
        read, write = os.pipe()
        before = open_descriptors()
        for node in (pair.here, pair.there):
            for address in (recorder.address, cell.address):
                cell.mailbox.capacity = 0
                answer = await node.ref(address, Writer).ask(Carries((write,)), 5.0)
                assert code_of(answer) in ("malformed", "wrong_type", "mailbox_full")
        pair.connection.send(pair.there.address, b"rubbish", (write,))
        unasked = frame(recorder.address, ASK, 0, "raw", pair.here.address, Number(1))
        pair.connection.send(recorder.address, unasked, (write,))
        await reachable(pair.here, recorder.address)
        assert open_descriptors() == before
        os.close(write)
        assert os.read(read, 1) == b""  # no other copy of it is open
        os.close(read)
