"""Command one robot for the graph, as any other program on the mesh does: with a lease, deadlines and an epoch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import trio

from strands_actors.kernel.channels.ros2.graph import Arrival
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.remote import RemoteRobot

from . import refusals
from .commands import Targets
from .streams import PAUSE_S, Sender, Streams

LOOK_S = 0.1
ENDING = frozenset(
    {
        Code.NO_ANSWER,
        Code.UNREACHABLE,
        Code.NOT_CONNECTED,
        Code.NOT_ARMED,
        Code.ARMING,
        Code.DISARMED,
        Code.FAULTED,
        Code.LOCKED_OUT,
        Code.HOLDING,
        Code.STOPPED,
        Code.ENDING,
        Code.BUSY,
        Code.RUNNING,
        Code.NO_LEASE,
        Code.LEASE,
        Code.CHANNEL,
        Code.STALE_EPOCH,
        Code.CLOCK,
        Code.TIMEOUT,
        Code.NOT_APPROVED,
        Code.NO_DRILL,
        Code.NO_STANDBY,
    }
)
"""Refusals that are about the robot, the lease or a permission. They end a stream. All others are about one target,
such as its range, so that the next target may be better."""


class _Command(NamedTuple):
    targets: Targets
    until_ns: int
    gives_back: bool  # True for the last command of a planned end: the lease is then released.


class Writer:
    """Sends the newest command of one stream to a robot. Run ``run`` in the background.

    No heartbeats are sent. Each accepted command keeps the lease for a second, and a stream that has paused for a
    second has lost its right to command anyway.

    Args:
        mesh: The mesh.
        robot: The name of the robot.
        lifetime_s: How long a command of a stream is valid, in seconds.
        report: Called with each refusal.
    """

    def __init__(self, mesh: MeshClient, robot: str, lifetime_s: float, report: Callable[[Refused], None]) -> None:
        self._mesh = mesh
        self._robot = robot
        self._streams = Streams(lifetime_s)
        self._report = report
        self._waiting: _Command | None = None
        self._came = trio.Event()
        self._remote: RemoteRobot | None = None
        self._suspended_by = ""
        self._is_sending = False

    def suspend(self, holder: str) -> None:
        """Refuse all streams until ``suspend("")``, because ``holder`` commands the robot over the graph. A stream
        that was refused stays refused until it has paused. A command that was not sent yet is dropped."""
        self._suspended_by, self._waiting = holder, None

    @property
    def holder(self) -> str:
        """The name of the program that commands the robot over the graph; empty without such a program."""
        is_active = self._remote is not None or self._is_sending
        return self._streams.sender.name if self._streams.sender is not None and is_active else ""

    def offer(self, topic: str, arrival: Arrival, sender: str, targets: Targets | Refused, at_rest: bool) -> None:
        """Take the command of a message, if its stream may command the robot. A newer command replaces one that
        was not sent yet.

        Args:
            topic: The name of the topic, for refusals.
            arrival: The message.
            sender: The name of the sender, to show to people.
            targets: The targets in the message, or the refusal of its content.
            at_rest: True if the targets make the robot stand still. The lease is then given back.
        """
        attachment = arrival.attachment
        admitted = self._streams.admit(
            topic, Sender(attachment.gid, sender), attachment.sent_ns, arrival.arrived_ns
        )
        if self._suspended_by:
            refused = refusals.second_writer(topic, sender, self._suspended_by, PAUSE_S)
            self._streams.end(refused.text)
            self._report(refused)
        elif isinstance(admitted, Refused):
            self._report(admitted)
        elif isinstance(targets, Refused):
            self._report(targets)
        else:
            self._waiting = _Command(targets, arrival.arrived_ns + round(admitted * NS), at_rest)
            self._came.set()

    async def run(self) -> None:
        """Send commands until cancelled. Then release the lease."""
        try:
            while True:
                with trio.move_on_after(LOOK_S):
                    await self._came.wait()
                self._came = trio.Event()
                command, self._waiting = self._waiting, None
                if command is not None:
                    self._is_sending = True
                    await self._send(command)
                    self._is_sending = False
                elif self._streams.is_over(self._mesh.now_ns()):
                    self._streams.forget()
                    await self._release()
        finally:
            with trio.move_on_after(1.0, shield=True):
                await self._release()

    async def _send(self, command: _Command) -> None:
        if self._remote is None and command.gives_back:
            return  # The robot is not moved by the graph, so there is nothing to end.
        refused = await self._acquire() if self._remote is None else None
        left_s = (command.until_ns - self._mesh.now_ns()) / NS
        if refused is None and left_s > 0 and self._remote is not None:
            period_s = self._streams.lifetime_s / 2
            answer = await self._remote.send_action(command.targets, left_s, period_s)
            refused = answer if isinstance(answer, Refused) else None
        if refused is not None:
            self._report(refused)
            if refused.code in ENDING:
                self._streams.end(refused.text)
                await self._release()
        elif command.gives_back and self._waiting is None:
            await self._release()

    async def _acquire(self) -> Refused | None:
        remote = RemoteRobot(self._mesh, self._robot)
        refused = await remote.acquire()
        if refused is None:
            self._remote = remote
        return refused

    async def _release(self) -> None:
        remote, self._remote = self._remote, None
        if remote is not None:
            await remote.release()


def is_at_rest(targets: Mapping[str, float] | Refused) -> bool:
    """Return True if all speeds are zero."""
    return not isinstance(targets, Refused) and all(speed == 0.0 for speed in targets.values())
