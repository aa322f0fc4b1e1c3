"""A node receives arbitrary bytes: nothing raises or restarts, and every frame is counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st
from trio.testing import MockClock, wait_all_tasks_blocked

from strands_actors.kernel.frames import ASK, DOWN, TELL, WATCH, frame, protocol_of
from strands_actors.kernel.messages import MAX_MESSAGE_BYTES, Message, Refused
from strands_actors.kernel.node import Node

from .kernel import Alarm, LateAnswer, Newest, Number, Recorder, Table, recorder

ADDRESS = "strands/r/actor/recorder"


class Wall:
    """A connection that keeps all sent bytes and has no peer. The node uses it as its mesh."""

    def __init__(self) -> None:
        self.channel = None
        self.sent: list[bytes] = []

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        self.sent.append(data)
        return True

    def send_at_once(self, data: bytes) -> bool:
        return False

    def ask(self, *_: object) -> Message | None:
        raise AssertionError("no thread asks in these tests")

    def forget(self, to: str, why: str) -> None:
        pass

    def announce(self, address: str, hosted: bool) -> None:
        pass

    def watch(self, address: str) -> None:
        pass


def feed(frames: list[bytes], check: Callable[[Node, Wall, list[Message]], None] | None = None) -> None:
    async def main() -> None:
        async with recorder() as (node, cell, log):
            wall = Wall()
            node.mesh = wall
            for data in frames:
                node.receive_frame(data, wall)
            await wait_all_tasks_blocked()
            if check is not None:
                check(node, wall, log)
            assert await node.ref(ADDRESS, Recorder).ask(Alarm(1), 1.0) == Alarm(1)
            assert cell.incarnations == 1
            assert cell.state == "running"

    trio.run(main, clock=MockClock(autojump_threshold=0))


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3) | st.integers(0, 9), inner),
    max_leaves=8,
)
bodies = st.binary(max_size=64).map(msgspec.Raw) | anything
addresses = st.sampled_from([ADDRESS, "strands/node/n", "strands/r/actor/none", "", "**"]) | st.text(max_size=8)
kinds = st.integers(-1, 8)
cids = st.integers(0, 3) | st.integers(-(2**63), 2**64 - 1)


def pack(*head: Any) -> bytes:
    return msgspec.msgpack.encode(head)


@given(st.lists(st.binary(max_size=200), max_size=10))
def test_random_bytes(frames: list[bytes]) -> None:
    feed(frames)


@given(st.lists(st.builds(pack, addresses, kinds, cids, addresses, addresses, bodies), max_size=10))
def test_frames_with_random_content(frames: list[bytes]) -> None:
    feed([data for data in frames if b"Boom" not in data])


@pytest.mark.long
@given(st.lists(st.lists(anything, max_size=8).map(lambda items: pack(*items)), max_size=10))
def test_arrays_that_are_nearly_frames(frames: list[bytes]) -> None:
    feed(frames)


@given(st.data())
def test_a_good_frame_with_some_bytes_changed(data: st.DataObject) -> None:
    body = data.draw(
        st.sampled_from([Number(3), Alarm(1), Newest(2), LateAnswer(), Table({"a": [1, {"b": 2.5}]}, ("x",))])
    )
    good = tuple(frame(ADDRESS, kind, 5, "s", "strands/node/x", body) for kind in (TELL, ASK))
    packed = bytearray(data.draw(st.sampled_from(good)))
    for _ in range(data.draw(st.integers(1, 4))):
        packed[data.draw(st.integers(0, len(packed) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(packed)))
    feed([bytes(packed), bytes(packed[:cut])])


def unreadable(value: Any) -> bool:
    try:
        protocol_of(Recorder).decode(msgspec.msgpack.encode(value))
    except msgspec.ValidationError:
        return True
    return False


@given(st.lists(anything.filter(unreadable), max_size=10))
def test_every_unreadable_body_is_refused_once_with_an_answer(values: list[Any]) -> None:
    frames = [frame(ADDRESS, ASK, cid, "s", "strands/node/x", value) for cid, value in enumerate(values)]
    frames += [frame(ADDRESS, TELL, 0, "s", "strands/node/x", value) for value in values]

    def check(node: Node, wall: Wall, log: list[Message]) -> None:
        assert log == []
        assert node.refused_count == node.dead_letter_count == len(frames)
        assert [msgspec.msgpack.decode(data)[2] for data in wall.sent] == list(range(len(values)))
        for data in wall.sent:
            assert msgspec.msgpack.decode(data)[5][:2] == ["Refused", "malformed"]

    feed(frames, check)


def test_a_watch_of_an_address_that_is_not_hosted_is_answered() -> None:
    """The address may have been released while the request was on its way."""

    def check(node: Node, wall: Wall, log: list[Message]) -> None:
        to, kind, _, sender, _, body = msgspec.msgpack.decode(wall.sent[-1])
        assert (to, kind, sender) == ("strands/x/actor/watcher", DOWN, "strands/r/actor/none")
        assert body == ["Down", "strands/r/actor/none", "not hosted here"]

    feed([frame("strands/r/actor/none", WATCH, 0, "strands/x/actor/watcher", "", None)], check)


@pytest.mark.parametrize("size", [MAX_MESSAGE_BYTES + 1, 10 * MAX_MESSAGE_BYTES])
def test_the_size_limit_applies_to_the_received_frame(size: int) -> None:
    empty = len(frame(ADDRESS, ASK, 1, "s", "strands/node/x", Table({}, ("",))))
    fits = frame(ADDRESS, ASK, 1, "s", "strands/node/x", Table({}, ("x" * (MAX_MESSAGE_BYTES - empty - 10),)))
    too_large = frame(ADDRESS, ASK, 2, "s", "strands/node/x", Table({}, ("x" * size,)))
    assert MAX_MESSAGE_BYTES - 20 < len(fits) <= MAX_MESSAGE_BYTES

    def check(node: Node, wall: Wall, log: list[Message]) -> None:
        assert len(log) == 1
        replies = {msgspec.msgpack.decode(data)[2]: msgspec.msgpack.decode(data)[5] for data in wall.sent}
        assert replies[1][0] == "Table"
        refusal = msgspec.convert(replies[2], Refused)
        assert (refusal.code, refusal.limit) == ("oversized", str(MAX_MESSAGE_BYTES))
        assert int(refusal.offered) == len(too_large)

    feed([fits, too_large], check)
