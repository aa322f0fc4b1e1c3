"""Bring each board to its safe state, and prove it. The wire and the root's stop channel use this.

The first frame leaves at once, and a board obeys it in any state. Then the board is read, and gets the frame
again until it reports the safe state. Its first report proves nothing. It may be from before the board took the
frame, or from a board that hangs. In the next report the board's clock has advanced.

``wheels``      velocity zero, without a profile; hold once the wheel stands
``lift, arm``   hold
``pimu``        the runstop, for an e-stop only: the boards then stop by themselves
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown

from . import protocol as p
from .board import Board
from .config import BOARDS, LEFT, PIMU, RIGHT, STEPPERS, StretchConfig

CONFIRM_S = 1.0
"""Longest time until a board reports that it is safe."""
LOOK_S = 0.005
"""Pause between two reports."""
STANDS_RAD_S = 0.2
"""Speed of a wheel's motor (3 mm/s) below which it is held where it is [assumed]."""

WHEELS = (LEFT, RIGHT)


def boards_for(safe_state: SafeState) -> tuple[str, ...]:
    """Return the boards that take part in a safe state."""
    return BOARDS if safe_state == SafeState.STOP else STEPPERS


def number_of(board: str) -> int:
    """Return the number of a board in reports and in the twin."""
    return BOARDS.index(board) + 1


def unreachable(board: str, why: str) -> MotorReport:
    return MotorReport(board, number_of(board), False, False, False, why)


async def make_safe(board: Board, config: StretchConfig, within_s: float = CONFIRM_S) -> MotorReport:
    """Bring a board to rest, and read back that it is. Never raises. The first frame leaves before the first
    wait."""
    kind = _Runstop if board.name == PIMU else _Wheel if board.name in WHEELS else _Joint
    return await kind(board, config).run(within_s)


class _Safing(ABC):
    """The procedure for one board. ``first`` is the frame that leaves at once."""

    first: bytes

    def __init__(self, board: Board) -> None:
        self._board = board
        self._written = self._acknowledged = False
        self._detail = "silent"
        self._first_us: int | None = None  # board's own time in its first report

    @abstractmethod
    async def look(self) -> tuple[bytes, str] | None:
        """Read the board. Return the next frame, and why the board is not safe (empty if it is). None if it
        does not answer."""

    def old(self, report_us: int) -> str:
        """Return why a report with this time of the board proves nothing; empty if it does prove."""
        if self._first_us is None:
            self._first_us = report_us
        return "reports nothing new" if report_us == self._first_us else ""

    async def run(self, within_s: float) -> MotorReport:
        try:
            self._board.send_first(self.first)
            self._written = True
            with trio.move_on_after(within_s):
                while self._detail:
                    await self._step()
        except WireDown as down:
            self._detail = str(down)
        name, is_safe = self._board.name, not self._detail
        return MotorReport(name, number_of(name), self._written, self._acknowledged, is_safe, self._detail)

    async def _step(self) -> None:
        """Read the board, and send a frame again if it is not safe."""
        result = await self.look()
        if result is None:
            self._board.send(self.first)
            return
        self._acknowledged = True
        again, self._detail = result
        if self._detail:
            self._board.send(again)
            await trio.sleep(LOOK_S)


class _Wheel(_Safing):
    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)
        self.first = config.stand(board.name).call()
        self._hold = config.hold(board.name).call()

    async def look(self) -> tuple[bytes, str] | None:
        status = await self._board.stepper_status(wait=True)
        if status is None:
            return None
        old = self.old(status.timestamp_us)
        if abs(status.velocity) > STANDS_RAD_S and status.mode != p.Mode.FREEWHEEL:
            return self.first, f"still turns at {status.velocity:.1f} rad/s"
        if status.mode not in p.AT_REST:
            return self._hold, f"is in mode {status.mode}"
        return self._hold, _sync(status) or old


class _Joint(_Safing):
    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)
        self.first = config.hold(board.name).call()

    async def look(self) -> tuple[bytes, str] | None:
        status = await self._board.stepper_status(wait=True)
        if status is None:
            return None
        old = self.old(status.timestamp_us)
        why = "" if status.mode in p.AT_REST else f"is in mode {status.mode}"
        return self.first, why or _sync(status) or old


class _Runstop(_Safing):
    first = p.pimu_trigger(p.RUNSTOP_ON)

    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)

    async def look(self) -> tuple[bytes, str] | None:
        status = await self._board.pimu_status(wait=True)
        if status is None:
            return None
        old = self.old(status.timestamp_us)
        return self.first, old if status.state & p.State.RUNSTOP else "the runstop is not on"


def _sync(status: p.StepperStatus) -> str:
    return "waits for a sync pulse" if status.has(p.Diag.WAITS_FOR_SYNC) else ""
