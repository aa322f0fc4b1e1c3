"""Stop the robot of a user's class after its wire process, the process that talks to the robot, has ended.

A second process is kept ready for this. It makes a new object of the class, connects it and calls its ``stop``.
Before that it waits until the wire process has ended and has closed the robot's port. Two objects at one port would
be worse than a stop that comes a little later.
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
from .spare import LEARN, STOP, OrderResult, Ready
from .wire import reports

WIRE_END_S = 1.0
"""Longest wait for the end of the wire process after it was killed, in seconds. If it still exists then, it runs no
code of this package any more."""

Message = TypeVar("Message", Ready, OrderResult)


class PlainStopChannel(StopChannel):
    """A stop channel for a user's class. ``descriptors`` is one end of a pipe. The wire process keeps the other end
    open, so the end of the pipe shows that the process has ended."""

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
        # The process ended although it got no order, so the robot has no stop channel now.
        if self._spare is spare and not spare.ordered:
            raise WireDown("the process that is kept ready to stop the robot has ended")

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        await self._until_alone()
        # If this call is cancelled, the process continues. The next call of ``make_safe``, after the wire process
        # was killed, then returns the result.
        spare = self._spare = self._spare or Spare(self._config)
        try:
            failure = (await spare.run(STOP)).failure
        except WireDown as down:
            failure = str(down)
        self._spare = None
        spare.kill()
        if failure and not self._config.has_channel:
            failure = (
                "not confirmed: this driver has no stop channel, and a new process did not stop the robot "
                f"({failure})"
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
        """Wait until the wire process has ended, for ``WIRE_END_S`` at most."""
        with trio.move_on_after(WIRE_END_S):
            for fd in self._alive:
                await trio.lowlevel.wait_readable(fd)


async def learn(config: PlainConfig) -> Declared:
    """Ask an object of the class for its axes, in a separate process, and return them.

    Raises:
        WireDown: The process or the class failed, or the class declares no axes.
    """
    spare = Spare(config)
    try:
        result = await spare.run(LEARN)
    finally:
        spare.kill()
    if result.failure or result.declared is None:
        raise WireDown(result.failure or "the class declares no axes")
    return result.declared


class Spare:
    """A process that runs ``spare.main`` and carries out one order. The constructor starts the process.

    Raises:
        WireDown: No process could be started.
    """

    def __init__(self, config: PlainConfig) -> None:
        args: dict[str, Any] = {"config": msgspec.to_builtins(config)}
        self._name = config.name
        self._deadlines = config.deadlines
        try:
            self._process: ChildProcess = start(f"{__package__}.spare:main", args)
        except OSError as error:  # the system has no free process or file descriptor
            RESERVE.lacked(error)
            raise WireDown(f"the process that stops the robot could not be started ({error})") from None
        self._process.socket.setblocking(False)
        self._socket = trio.socket.from_stdlib_socket(self._process.socket)
        self._received = b""
        self._ready = False
        self.ordered = False
        self._reading = trio.Lock()  # a stop may come while ``serve`` still waits until the process is ready

    async def ready(self) -> None:
        """Wait until the process has imported the class. Raise ``WireDown`` if the import fails or takes too
        long."""
        with _within(2 * self._deadlines.load_s, f"{self._name} is not imported"):
            async with self._reading:
                if self._ready:
                    return
                if failure := (await self._message(Ready)).failure:
                    raise WireDown(failure)
                self._ready = True

    async def run(self, order: bytes) -> OrderResult:
        """Send the order and return its result. Raise ``WireDown`` if no result comes."""
        await self.ready()
        with _within(self._deadlines.errand_s, "no answer"):
            try:
                if not self.ordered:
                    # The order is one byte, so that a cancellation cannot send half of it.
                    self._process.socket.send(order)
                    self.ordered = True
            except OSError as error:
                raise WireDown(f"the process has ended ({error})") from None
            return await self._message(OrderResult)

    async def ended(self) -> None:
        await self._process.wait()

    def kill(self) -> None:
        """Kill the process at once, and remove it from the system's table."""
        self._process.kill()
        self._process.detach()
        self._socket.close()

    async def _message(self, message_type: type[Message]) -> Message:
        size = int.from_bytes(await self._exactly(4), "little")
        return msgspec.msgpack.decode(await self._exactly(size), type=message_type)

    async def _exactly(self, size: int) -> bytes:
        while len(self._received) < size:
            try:
                data = await self._socket.recv(65536)
            except (OSError, trio.ClosedResourceError) as error:
                raise WireDown(f"the process has ended ({error})") from None
            if not data:
                raise WireDown(
                    "the process ended before it had stopped the robot: a method of the class hung or ended it"
                )
            self._received += data
        chunk, self._received = self._received[:size], self._received[size:]
        return chunk


@contextlib.contextmanager
def _within(longest_s: float, failure: str) -> Iterator[None]:
    """Raise ``WireDown`` if the code in the ``with`` block takes longer than ``longest_s``."""
    try:
        with trio.fail_after(longest_s):
            yield
    except trio.TooSlowError:
        raise WireDown(f"{failure} within {longest_s:g} s") from None
