"""Stop a Crazyflie from the supervising process (root), without the process that flies it (the wire). Nothing is
sent before a stop.

On UDP the drone sends its answers to the last sender, so the root's socket stays silent until a stop. For a
serial line the root has a duplicate of the wire's file descriptor. If that is dead, the root opens the port
again. A radio dongle is open in the wire process. After that process has ended, a separate process opens the
dongle, so that the root loads no USB library. Two such processes stand ready (``OwnProcess``).
"""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import DuplicateDescriptor
from strands_actors.contract.stop_process import OwnProcess
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.clock import Clock

from .config import CrazyflieConfig
from .links import Link, SerialLink, adopt_line, open_line, open_link
from .robots import AXES
from .session import CrazyflieSession
from .stopping import STOP_S, bring_down


class CrazyflieStopChannel(StopChannel):
    """Stop the drone from the supervising process (root). The kind of connection depends on the port."""

    def __init__(self, config: CrazyflieConfig, descriptors: Sequence[int], clock: Clock) -> None:
        endpoint = config.endpoint()
        channel_type = _UsbProcess if endpoint.is_usb else _SerialLine if endpoint.kind == "serial" else _OwnLink
        self._channel: StopChannel = channel_type(config, descriptors, clock)

    @property
    def hosts(self) -> Sequence[str]:
        return self._channel.hosts

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await self._channel.serve(task_status)

    @property
    def lacks(self) -> str:
        return self._channel.lacks

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await self._channel.make_safe(_within(safe_state))

    def close(self) -> None:
        self._channel.close()


def _within(safe_state: SafeState) -> SafeState:
    """Replace ``hold`` by ``land``, because a hover needs a process that keeps sending, and none is left."""
    return SafeState.LAND if safe_state == SafeState.HOLD else safe_state


class _OwnLink(StopChannel):
    """A stop channel over UDP or TCP, with its own socket."""

    def __init__(self, config: CrazyflieConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._link: Link | None = None

    @property
    def hosts(self) -> Sequence[str]:
        endpoint = self._config.endpoint()
        return (endpoint.host,) if endpoint.kind == "tcp" else ()

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        if self._config.endpoint().kind == "udp":
            self._link = await open_link(self._config.endpoint())
        task_status.started()

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        try:
            link, self._link = self._link, None
            link = link or await open_link(self._config.endpoint())
            try:
                return (await bring_down(CrazyflieSession(link, self._clock), safe_state)).reports(AXES)
            finally:
                link.close()
        except WireDown as down:
            return Outcome(False, False, str(down)).reports(AXES)

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
        self._link = None


class _SerialLine(DuplicateDescriptor[CrazyflieConfig, SerialLink]):
    async def hung_up(self, port: SerialLink) -> None:
        await port.hung_up()

    def adopt(self, descriptor: int) -> SerialLink:
        return adopt_line(descriptor, self.config.endpoint().path)

    async def open_port(self) -> SerialLink:
        return await open_line(self.config.endpoint().path)

    async def make_safe_on(self, port: SerialLink, safe_state: SafeState) -> tuple[MotorReport, ...]:
        outcome = await bring_down(CrazyflieSession(port, self.clock), safe_state)
        if not outcome.written:
            raise WireDown(outcome.detail)
        return outcome.reports(AXES)

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return Outcome(False, False, reason).reports(AXES)


class _UsbProcess(OwnProcess[CrazyflieConfig]):
    CHANNEL = f"{__package__}.usb_stop:UsbStop"
    ANSWER_S = STOP_S

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return Outcome(False, False, reason).reports(AXES)
