"""A line of their own between a writer's process and the wire process, past the mesh.

Who writes often asks for one: it makes a pair of sockets and hands one end to the root, which every local writer
has a link to; the root hands it on to the wire. From then on what the two tell each other goes that way: a system
call each, no thread of zenoh's in between (6 % of a core at 500 setpoints a second). Before that, and when the
line is gone, because the wire is another process now, it goes over the mesh; nobody has to know.

A program whose verbs are called by threads has a second one, on which they ask the gate themselves
(``ThreadLine``), past its own loop.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable

import trio

from strands_actors.runtime.actor import Actor
from strands_actors.runtime.channel import Channel
from strands_actors.runtime.link import Link
from strands_actors.runtime.messages import Message
from strands_actors.runtime.node import Node, Ref
from strands_actors.runtime.thread_line import ThreadLine

from . import addresses

AGAIN_S = 0.2
"""Between a line's end and the next attempt: a wire that was lost is being started."""


class Line(Message, frozen=True):
    """The wire's end, as a writer hands it to the root. ``channel``: whose it is; the root's process writes it."""

    descriptors: tuple[int, ...]
    channel: str = ""


class WriterLine(Message, frozen=True):
    """The wire's end, as the root hands it on. ``writer``: over which channel the root got it."""

    descriptors: tuple[int, ...]
    writer: str = ""


class Switchboard(Actor):
    """In the root: hands lines on to the wire of the present, and says whose they are."""

    def __init__(self, wire_end: str) -> None:
        self._address = wire_end

    async def started(self) -> None:
        self._wire_end: Ref = self.context.ref(self._address)

    def receive(self, message: Line) -> None:
        self._wire_end.tell(WriterLine(message.descriptors, message.channel))
        for fd in message.descriptors:
            os.close(fd)


class WireEnd(Actor):
    """In the wire process: takes lines, and serves each until its other end is gone. ``channel_of``: what a writer
    of that name may say."""

    def __init__(self, channel_of: Callable[[str], Channel]) -> None:
        self._channel_of = channel_of

    def receive(self, message: WriterLine) -> None:
        channel = self._channel_of(message.writer)
        for fd in message.descriptors:
            link = Link(self.context.node, socket.socket(fileno=fd), channel=channel)
            self.context.start_soon(link.run)


async def keep_line(node: Node, robot: str, channel: Channel | None = None) -> None:
    """Have a line to the wire of ``robot``, as often as the wire is another one. Needs a link to its root.
    ``channel``: what the wire may say."""
    while True:
        try:
            sock = _lay(node, robot)
        except OSError:  # no descriptor is free: what has to be told goes over the mesh meanwhile
            await trio.sleep(AGAIN_S)
            continue
        await Link(node, sock, channel=channel).run()
        await trio.sleep(AGAIN_S)


async def keep_thread_line(
    node: Node, robot: str, gate: type[Actor], hand: Callable[[ThreadLine | None], None]
) -> None:
    """The same for this process's threads, to the gate. ``gate``: its class, imported by who needs it anyway.
    ``hand`` gets each line, and None when it is at its end."""
    own = f"{node.address}/threads/{robot}"
    while True:
        try:
            line = ThreadLine(_lay(node, robot), own, addresses.of(robot).gate, gate)
        except OSError:  # as above
            await trio.sleep(AGAIN_S)
            continue
        try:
            if await line.is_up():
                hand(line)
                await line.ended.wait()
        finally:
            hand(None)
            line.close()
        await trio.sleep(AGAIN_S)


def _lay(node: Node, robot: str) -> socket.socket:
    ours, theirs = socket.socketpair()
    with theirs:
        node.ref(addresses.of(robot).switchboard, Switchboard).tell(Line((theirs.fileno(),)))
    return ours
