"""Command a UR by our own control script: upload the script, then send orders by RTDE registers.

This needs no SDK and no thread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from . import protocol as p
from . import script as s
from .arms import JOINTS
from .config import ControlMethod
from .gates import CONTROL_S
from .plain import Registers, open_registers

ANSWER_S = 0.5
"""Longest time in which the script arms its watchdog, or stops the arm. A stop from top speed takes 0.3 s."""


class ScriptControl:
    METHOD: ClassVar[ControlMethod] = "script"
    spent = ""

    def __init__(self, host: str, hz: float, clock: Clock) -> None:
        """Set the controller's host, the rate of its answers (Hz) and the clock. Nothing is connected yet."""
        self._host = host
        self._hz = hz
        self._clock = clock
        self._registers: Registers | None = None
        self._upload: TcpPort | None = None
        self._token = self._sequence = 0
        self._target = (0.0,) * len(JOINTS)

    async def connect(self) -> None:
        """Connect to the controller's registers. Raise ``WireDown`` if another RTDE client writes them."""
        if self._registers is None:
            self._registers = await open_registers(self._host, s.INPUTS, s.ANSWERS, self._hz)

    def take(self) -> None:
        if self._registers is not None:
            self._registers.take()

    async def upload(self, check: Callable[[], None]) -> bool:
        self._close_upload()
        self._sequence, self._token = 0, self._clock.now_ns() // 1000 % s.LAST_NUMBER + 1
        self._write(s.Order.KEEP)  # Overwrite the last order to an earlier script, which is still in the register.
        self._upload = await open_tcp(self._host, p.SECONDARY_PORT)
        check()
        self._upload.write(s.control_script(self._token))
        return True

    def script_runs(self) -> bool:
        if self._upload is not None:
            # Read and ignore the controller's state, which this port also sends. If it is not read, the controller
            # may end the connection before it has read the script [assumed].
            self._upload.read_waiting()
        return self._is_ours and self._answer(s.PHASE) != s.Phase.ENDED

    @property
    def _is_ours(self) -> bool:
        """True if the answers are from the script of the last upload, and not from an earlier one."""
        return self._answer(s.RUNS) == self._token

    async def set_watchdog(self, min_hz: float) -> bool:
        """Send packets until the script is ready. The script arms the watchdog by itself, at its first packet."""
        armed = await self._repeat(s.Order.KEEP, lambda: self._answer(s.PHASE) == s.Phase.READY)
        self._close_upload()
        return armed

    async def kick(self) -> None:
        self._write(s.Order.KEEP)

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        if not self.script_runs():
            return False
        check()
        self._target = radians
        self._write(s.Order.SERVO)
        return True

    async def halt(self, ends: bool) -> bool:
        if ends:
            return await self._repeat(s.Order.END, lambda: self._is_ours and self._answer(s.PHASE) == s.Phase.ENDED)
        ordered = s.next_number(self._sequence)
        return await self._repeat(s.Order.HOLD, lambda: s.has_reached(self._answer(s.HELD), ordered))

    def close(self) -> None:
        """Close the connections, and discard the data that the controller has not received yet.

        A script that is still being uploaded is discarded, too. The caller of this method has given up arming the
        robot, and a script that started later would have no client.
        """
        self._close_upload()
        if self._registers is not None:
            self._registers.close()
            self._registers = None

    def _close_upload(self) -> None:
        if self._upload is not None:
            self._upload.close()
            self._upload = None

    def _answer(self, output: str) -> int:
        """Return the newest value of an output register, or 0 if it is unknown.

        Raise ``WireDown`` if the connection is lost.
        """
        self.take()
        return self._registers.answers.get(output, 0) if self._registers is not None else 0

    def _write(self, order: s.Order) -> None:
        """Send one packet with an order, without waiting. Raise ``WireDown`` if the connection is lost."""
        if self._registers is None:
            raise WireDown(f"{self._host}: not connected to the controller's registers. Reconnect")
        self._sequence = s.next_number(self._sequence)
        targets = dict(zip(s.TARGETS, self._target, strict=True))
        self._registers.write({**targets, s.ORDER: order, s.SEQUENCE: self._sequence, s.TOKEN: self._token})

    async def _repeat(self, order: s.Order, answered: Callable[[], bool]) -> bool:
        """Send an order again and again until the script has answered it. The first packet is sent without waiting.

        The packets also feed the watchdog. Return True if the script has answered within ``ANSWER_S``.
        """
        with trio.move_on_after(ANSWER_S):
            while True:
                self._write(order)
                await trio.sleep(CONTROL_S)
                if answered():
                    return True
                if not self.script_runs():
                    return False
        return False
