"""A line of their own between a writer's process and the wire process, past the mesh.

Who writes often asks for one: it makes a pair of sockets and hands one end to the root, which every local writer
has a link to; the root hands it on to the wire. From then on what the two tell each other goes that way: a system
call each, no thread of zenoh's in between (6 % of a core at 500 setpoints a second). Before that, and when the
line is gone, because the wire is another process now, it goes over the mesh; nobody has to know.
"""

from __future__ import annotations

import os
import socket

import trio

from strands_actors.runtime.actor import Actor
from strands_actors.runtime.link import Link
from strands_actors.runtime.messages import Message
from strands_actors.runtime.node import Node, Ref

from . import addresses

AGAIN_S = 0.2
"""Between a line's end and the next attempt: a wire that was lost is being started."""


class Line(Message, frozen=True):
    """The wire's end."""

    descriptors: tuple[int, ...]


class Switchboard(Actor):
    """In the root: hands lines on to the wire of the present."""

    def __init__(self, wire_end: str) -> None:
        self._address = wire_end

    async def started(self) -> None:
        self._wire_end: Ref = self.context.ref(self._address)

    def receive(self, message: Line) -> None:
        self._wire_end.tell(message)
        for fd in message.descriptors:
            os.close(fd)


class WireEnd(Actor):
    """In the wire process: takes lines, and serves each until its other end is gone."""

    def receive(self, message: Line) -> None:
        for fd in message.descriptors:
            self.context.start_soon(Link(self.context.node, socket.socket(fileno=fd)).run)


async def keep_line(node: Node, robot: str) -> None:
    """Have a line to the wire of ``robot``, as often as the wire is another one. Needs a link to its root."""
    switchboard = node.ref(addresses.of(robot).switchboard, Switchboard)
    while True:
        ours, theirs = socket.socketpair()
        with theirs:
            switchboard.tell(Line((theirs.fileno(),)))
        await Link(node, ours).run()
        await trio.sleep(AGAIN_S)
