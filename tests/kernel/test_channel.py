"""SAF-017: a link sends only in the name of the addresses that its channel permits, and each message
carries the channel that it came over.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.local_mesh import LocalMesh, LocalNetwork
from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import ASK, DOWN, HOSTS, REPLY, TELL, WATCH, Down, frame
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node, Unreachable

from .kernel import until

GATE, POLICY = "strands/r/actor/gate", "strands/r/actor/policy"
OF_POLICY = Channel("policy 7", frozenset({POLICY}), "strands/node/r.policy.", {GATE: None})


class Ping(Message, frozen=True):
    channel: str = ""


class Newest(Message, frozen=True):
    lane = "latest"

    number: int


class Pong(Message, frozen=True):
    by: str
    channel: str = ""


class Gate(Actor):
    def __init__(self, log: list[Message]) -> None:
        self._log = log

    def receive(self, message: Ping | Newest | Down) -> Pong | None:
        self._log.append(message)
        return Pong("the gate", message.channel) if isinstance(message, Ping) else None


class Rig(NamedTuple):
    """A node in the middle with links to two others: to the wire, which hosts the gate, and to a policy."""

    middle: Node
    wire: Node
    policy: Node
    to_policy: Link  # at the middle
    from_policy: Link  # at the policy
    log: list[Message]  # of the wire's gate

    def send(self, data: bytes) -> None:
        assert self.from_policy.send_at_once(data)


@contextlib.asynccontextmanager
async def rig(channel: Channel | None = OF_POLICY) -> AsyncIterator[Rig]:
    middle, wire, policy = (Node(name, MonotonicClock()) for name in ("r.root.1", "r.wire.2", "r.policy.3"))
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        for node in (middle, wire, policy):
            await nursery.start(node.run)
        await nursery.start(wire.cell("r/actor/gate", lambda: Gate(log)).run)
        to_policy, from_policy = await joined(nursery, middle, policy, channel)
        await joined(nursery, middle, wire, None)
        await until(lambda: middle.route(GATE) is not None)
        yield Rig(middle, wire, policy, to_policy, from_policy, log)
        nursery.cancel_scope.cancel()


async def joined(nursery: trio.Nursery, one: Node, other: Node, channel: Channel | None) -> tuple[Link, Link]:
    ours, theirs = socket.socketpair()
    links = Link(one, ours, channel=channel), Link(other, theirs)
    for link in links:
        await nursery.start(link.run)
    return links


def test_saf_017_a_link_can_announce_only_the_addresses_of_its_channel() -> None:
    async def main() -> None:
        async with rig() as world:
            world.send(frame("", HOSTS, 1, GATE, GATE, None))
            world.send(frame("", HOSTS, 1, POLICY, POLICY, None))
            await until(lambda: world.middle.route(POLICY) is not None)
            assert world.middle.route(GATE) is not world.to_policy
            assert await world.middle.ref(GATE, Gate).ask(Ping(), 5.0) == Pong("the gate")

    trio.run(main)


def test_saf_017_an_answer_counts_only_over_the_link_of_its_ask() -> None:
    """A peer that guesses the number of an ask must not be able to answer it."""

    async def main() -> None:
        async with rig() as world:
            answers: list[Message | None] = []

            async def ask() -> None:
                answers.append(await world.middle.ref(GATE, Gate).ask(Ping(), 5.0))

            gate = world.wire.cells[GATE].actor
            gate.receive = lambda message: gate.context.defer()  # type: ignore[method-assign]  # no answer yet
            async with trio.open_nursery() as nursery:
                nursery.start_soon(ask)
                await until(lambda: bool(world.middle.pending))
                (cid,) = world.middle.pending
                refused = world.middle.refused_count
                world.send(frame(world.middle.address, REPLY, cid, "", "", Pong("the policy")))
                await until(lambda: world.middle.refused_count > refused)
                assert not answers
                assert list(world.middle.pending) == [cid]
                nursery.cancel_scope.cancel()

    trio.run(main)


@pytest.mark.parametrize("kind", [TELL, ASK, WATCH, DOWN])
def test_saf_017_a_frame_with_the_address_of_another_sender_is_refused(kind: int) -> None:
    async def main() -> None:
        async with rig() as world:
            log: list[Message] = []
            async with trio.open_nursery() as nursery:
                await nursery.start(world.middle.cell("r/actor/tasks", lambda: Gate(log)).run)
                refused = world.middle.refused_count
                world.send(frame("strands/r/actor/tasks", kind, 5, GATE, world.policy.address, Newest(1)))
                await until(lambda: world.middle.refused_count > refused)
                assert not log
                assert world.middle.dead_letters[-1].reason == f"this channel may not send in the name of {GATE}"
                nursery.cancel_scope.cancel()

    trio.run(main)


def test_saf_017_a_channel_reaches_only_the_addresses_that_it_permits() -> None:
    """An ask to another address gets a refusal."""

    async def main() -> None:
        async with rig() as world, trio.open_nursery() as nursery:
            log: list[Message] = []
            await nursery.start(world.middle.cell("r/actor/guardian", lambda: Gate(log)).run)
            await nursery.start(world.middle.cell("r/actor/gate", lambda: Gate(log)).run)
            await until(lambda: world.policy.route("strands/r/actor/guardian") is not None)
            answer = await world.policy.ref("strands/r/actor/guardian", Gate).ask(Ping(), 5.0)
            assert isinstance(answer, Refused)
            assert answer.code == "channel"
            assert await world.policy.ref(GATE, Gate).ask(Ping(), 5.0) == Pong("the gate", "policy 7")
            assert log == [Ping("policy 7")]
            nursery.cancel_scope.cancel()

    trio.run(main)


@pytest.mark.parametrize("claimed", ["", "policy 8", "policy 7"])
@pytest.mark.parametrize("channel", [OF_POLICY, None])
def test_saf_017_the_sender_cannot_choose_the_channel_in_its_message(claimed: str, channel: Channel | None) -> None:
    async def main() -> None:
        async with rig(channel) as world, trio.open_nursery() as nursery:
            log: list[Message] = []
            await nursery.start(world.middle.cell("r/actor/gate", lambda: Gate(log)).run)
            world.send(frame(GATE, TELL, 0, POLICY, world.policy.address, Ping(claimed)))
            await until(lambda: len(log) == 1)
            assert log == [Ping("" if channel is None else "policy 7")]
            nursery.cancel_scope.cancel()

    trio.run(main)


def test_saf_017_a_linked_address_is_not_looked_up_on_the_mesh() -> None:
    async def main() -> None:
        network, log = LocalNetwork(), list[Message]()
        here, stranger = Node("here", MonotonicClock()), Node("stranger", MonotonicClock())
        LocalMesh(network).attach(here)
        LocalMesh(network).attach(stranger)
        async with trio.open_nursery() as nursery:
            for node in (here, stranger):
                await nursery.start(node.run)
            await nursery.start(stranger.cell("r/actor/gate", lambda: Gate(log)).run)
            assert await here.ref(GATE, Gate).ask(Ping(), 5.0) == Pong("the gate")
            here.linked = frozenset({GATE})
            with pytest.raises(Unreachable):
                await here.ref(GATE, Gate).ask(Ping(), 5.0)
            nursery.cancel_scope.cancel()

    trio.run(main)
