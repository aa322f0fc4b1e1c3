"""Stop a Stretch from the supervising process (root). The root has a duplicate of the driving process's file
descriptor for each board and each servo chain. If a descriptor is dead, the root opens the port again.

The first frames are sent before anything is read, and no frame depends on a position: the wheels stand, lift
and arm hold, and the servos are held where they are. A missing board does not delay the stop of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.ports.serial_port import adopt_serial, open_serial
from strands_actors.kernel.clock import Clock

from .board import Board, OpenPort
from .chains import ChainStopChannel
from .config import BAUD, BOARDS, StretchConfig
from .safing import boards_for, make_safe, unreachable
from .together import together


class BoardStopChannel(DuplicateDescriptor[StretchConfig, Board]):
    def __init__(
        self,
        name: str,
        config: StretchConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_port: OpenPort = open_serial,
    ) -> None:
        self.name = name
        self._open = open_port
        super().__init__(config, descriptors, clock)

    async def hung_up(self, port: Board) -> None:
        await port.port.hung_up()

    def adopt(self, descriptor: int) -> Board:
        return Board(self.name, adopt_serial(descriptor, self.config.usb(self.name)), self.clock)

    async def open_port(self) -> Board:
        return Board(self.name, self._open(self.config.usb(self.name), BAUD), self.clock)

    async def make_safe_on(self, port: Board, safe_state: SafeState) -> tuple[MotorReport, ...]:
        report = await make_safe(port, self.config)
        if not report.written:
            raise WireDown(report.detail)
        return (report,)

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return (unreachable(self.name, reason),)


class StretchStopChannel(StopChannel):
    """The stop channel. ``descriptors`` has the file descriptors of all boards, then of the servo chains, as
    ``handover`` returns them. If it is empty, the ports are opened."""

    def __init__(
        self,
        config: StretchConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_port: OpenPort = open_serial,
    ) -> None:
        handed = list(descriptors)
        places = len(BOARDS) + len(config.chains)
        own = [[fd] for fd in handed] if len(handed) == places else [[] for _ in range(places)]
        self._boards = {
            name: BoardStopChannel(name, config, fds, clock, open_port)
            for name, fds in zip(BOARDS, own, strict=False)
        }
        self._chains = [
            ChainStopChannel(config, chain, fds, clock, open_port)
            for chain, fds in zip(config.chains, own[len(BOARDS) :], strict=True)
        ]

    @property
    def _all(self) -> list[BoardStopChannel | ChainStopChannel]:
        return [*self._boards.values(), *self._chains]

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        async with trio.open_nursery() as nursery:
            for channel in self._all:
                nursery.start_soon(channel.serve)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        boards = [self._boards[name] for name in boards_for(safe_state)]
        channels: list[StopChannel] = [*boards, *self._chains]
        reports = await together(*(partial(channel.make_safe, safe_state) for channel in channels))
        return tuple(report for each in reports for report in each)

    def close(self) -> None:
        for channel in self._all:
            channel.close()
