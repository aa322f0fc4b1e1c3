"""Command a UR by our own control script: uploaded to a script port, told what to do by RTDE
registers. No SDK, no thread."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from . import protocol as p
from . import script as s
from .arms import JOINTS
from .config import Way
from .gates import CONTROL_S
from .plain import Inputs, open_inputs

ANSWER_S = 0.5
"""For the script to arm its watchdog, and to stop the arm: 0.3 s from top speed."""


class ScriptControl:
    WAY: ClassVar[Way] = "script"
    OUTPUTS: ClassVar[tuple[str, ...]] = s.ANSWERS
    spent = ""

    def __init__(self, host: str, clock: Clock) -> None:
        self._host = host
        self._clock = clock
        self._inputs: Inputs | None = None
        self._upload: TcpPort | None = None
        self._token = self._sequence = 0
        self._target = (0.0,) * len(JOINTS)
        self._answers: Mapping[str, Any] = {}

    async def connect(self) -> None:
        """Raise ``WireDown`` when another RTDE client writes these registers."""
        if self._inputs is None:
            self._inputs = await open_inputs(self._host, s.INPUTS)

    def take(self, sample: Mapping[str, Any]) -> None:
        self._answers = sample

    async def upload(self, check: Callable[[], None]) -> bool:
        self._close_upload()
        self._sequence, self._token = 0, self._clock.now_ns() // 1000 % s.LAST_NUMBER + 1
        self._write(s.Order.KEEP)  # what an earlier script was told last does not stay there
        self._upload = await open_tcp(self._host, p.SECONDARY_PORT)
        check()
        self._upload.write(s.control_script(self._token))
        return True

    def script_runs(self) -> bool:
        if self._upload is not None:
            # The port tells the controller's state. A connection that is closed with state unread is
            # reset, and the script might be dropped.
            self._upload.read_waiting()
        return self._answers.get(s.RUNS) == self._token and self._answers[s.PHASE] != s.Phase.ENDED

    async def set_watchdog(self, min_hz: float) -> bool:
        """The script arms it by itself, at its first packet."""
        armed = await self._repeat(s.Order.KEEP, lambda: self._answers.get(s.PHASE) == s.Phase.READY)
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

    async def servo_stop(self) -> bool:
        ordered = s.next_number(self._sequence)
        return await self._repeat(s.Order.HOLD, lambda: s.has_reached(self._answers.get(s.HELD, 0), ordered))

    async def stop_script(self) -> None:
        self._write(s.Order.END)

    def close(self) -> None:
        """What is still on its way is thrown away, but for a script whose upload has begun."""
        self._close_upload()
        if self._inputs is not None:
            self._inputs.close()
            self._inputs = None

    def _close_upload(self) -> None:
        if self._upload is not None:
            self._upload.close()
            self._upload = None

    def _write(self, order: s.Order) -> None:
        """Write one packet at once. Raise ``WireDown``."""
        if self._inputs is None:
            raise WireDown(f"{self._host}: the registers are not open. Reconnect")
        self._sequence = s.next_number(self._sequence)
        targets = dict(zip(s.TARGETS, self._target, strict=True))
        self._inputs.write({**targets, s.ORDER: order, s.SEQUENCE: self._sequence, s.TOKEN: self._token})

    async def _repeat(self, order: s.Order, answered: Callable[[], bool]) -> bool:
        """Write an order until the script has answered it; that feeds its watchdog meanwhile. The
        first packet leaves before the first wait. Return whether it has, and still runs."""
        with trio.move_on_after(ANSWER_S):
            while True:
                self._write(order)
                await trio.sleep(CONTROL_S)
                if not self.script_runs():
                    return False
                if answered():
                    return True
        return False
