"""Stop the robot of a user's class after its wire process is gone.

A process that stood ready makes an object, connects it and stops the robot with it. First it waits until
the wire process has released the robot: two objects at one port are worse than a stop that comes a little
later.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.kernel.processes.reserve import RESERVE

from .config import PlainConfig
from .members import Declared
from .spare import LEARN, STOP, Ready, Told
from .wire import reports

GONE_S = 1.0
"""Longest wait for the end of the wire process after it was killed. A process that lives longer does not
run code of this package any more."""

Message = TypeVar("Message", Ready, Told)


class PlainStopChannel(StopChannel):
    """``descriptors``: one end of a pipe. The wire process keeps the other end open
    (``PlainWire.handover``)."""

    def __init__(self, config: PlainConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._alive = list(descriptors)
        self._spare: Spare | None = None

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        spare = self._spare = Spare(self._config)
        try:
            await spare.ready()
        except WireDown:
            if self._spare is spare:
                raise
        task_status.started()
        await spare.ended()
        if self._spare is spare and not spare.ordered:  # it ended without an order, and is still needed
            raise WireDown("the process that would stop the robot has ended")

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        await self._until_alone()
        # If this call is cancelled, the process goes on. The next call, such as that after the fence,
        # returns its answer.
        spare = self._spare = self._spare or Spare(self._config)
        try:
            failure = (await spare.run(STOP)).failure
        except WireDown as down:
            failure = str(down)
        self._spare = None
        spare.kill()
        if failure and not self._config.has_channel:
            failure = (
                f"not confirmed: this driver has no stop channel, and a fresh process did not stop it ({failure})"
            )
        return reports(self._config, failure, written=not failure)

    def close(self) -> None:
        spare, self._spare = self._spare, None
        if spare is not None:
            spare.kill()
        for fd in self._alive:
            os.close(fd)
        self._alive.clear()

    async def _until_alone(self) -> None:
        """Return when the wire process has ended, or after ``GONE_S``."""
        with trio.move_on_after(GONE_S):
            for fd in self._alive:
                await trio.lowlevel.wait_readable(fd)


async def learn(config: PlainConfig) -> Declared:
    """Return the axes that an object of the class declares.

    Raises:
        WireDown: The process or the class failed, or the class declares no axes.
    """
    spare = Spare(config)
    try:
        result = await spare.run(LEARN)
    finally:
        spare.kill()
    if result.failure or result.declared is None:
        raise WireDown(result.failure or "the class says nothing of its axes")
    return result.declared


class Spare:
    """A process of ``spare.main`` for one order. Making it starts the process.

    Raises:
        WireDown: No process could be started.
    """

    def __init__(self, config: PlainConfig) -> None:
        args: dict[str, Any] = {"config": msgspec.to_builtins(config)}
        self._name = config.name
        self._deadlines = config.deadlines
        try:
            self._process: ChildProcess = start(f"{__package__}.spare:main", args)
        except OSError as error:  # no process or descriptor is available
            RESERVE.lacked(error)
            raise WireDown(f"no process to stop the robot could be started ({error})") from None
        self._process.socket.setblocking(False)
        self._socket = trio.socket.from_stdlib_socket(self._process.socket)
        self._heard = b""
        self._ready = False
        self.ordered = False
        self._reading = trio.Lock()  # a stop may come while ``serve`` waits for the process

    async def ready(self) -> None:
        """Return when the class is imported. Raise ``WireDown`` if it is not."""
        with _within(2 * self._deadlines.load_s, f"{self._name} is not imported"):
            async with self._reading:
                if self._ready:
                    return
                if failure := (await self._message(Ready)).failure:
                    raise WireDown(failure)
                self._ready = True

    async def run(self, order: bytes) -> Told:
        """Return the result of the order. Raise ``WireDown`` if no answer comes."""
        await self.ready()
        with _within(self._deadlines.errand_s, "no answer"):
            try:
                if not self.ordered:
                    self._process.socket.send(order)  # one byte, so a cancellation cannot send half of it
                    self.ordered = True
            except OSError as error:
                raise WireDown(f"the process has ended ({error})") from None
            return await self._message(Told)

    async def ended(self) -> None:
        await self._process.wait()

    def kill(self) -> None:
        """End and reap the process at once."""
        self._process.kill()
        self._process.part()
        self._socket.close()

    async def _message(self, kind: type[Message]) -> Message:
        size = int.from_bytes(await self._exactly(4), "little")
        return msgspec.msgpack.decode(await self._exactly(size), type=kind)

    async def _exactly(self, size: int) -> bytes:
        while len(self._heard) < size:
            try:
                data = await self._socket.recv(65536)
            except (OSError, trio.ClosedResourceError) as error:
                raise WireDown(f"the process has ended ({error})") from None
            if not data:
                raise WireDown("the process ended before it was done: a call of the class hangs, or ended it")
            self._heard += data
        taken, self._heard = self._heard[:size], self._heard[size:]
        return taken


@contextlib.contextmanager
def _within(longest_s: float, failure: str) -> Iterator[None]:
    """Raise ``WireDown`` if the block takes longer."""
    try:
        with trio.fail_after(longest_s):
            yield
    except trio.TooSlowError:
        raise WireDown(f"{failure} within {longest_s:g} s") from None
