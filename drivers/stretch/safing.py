"""Making each board safe, and proving it: for the wire, and for the root's stop channel.

A frame that the board obeys whatever it did before goes out at once; then it is asked how it
stands, and told again until it says so. Its first report proves nothing: it may be from before the
board took the frame, or from one that hangs. By the next its clock has gone on.

``wheels``      velocity zero, without a profile; when the wheel stands: hold
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
"""Longest that a board may take to say that it is safe."""
LOOK_S = 0.005
"""Between two looks."""
STANDS_RAD_S = 0.2
"""Of a wheel's motor: 3 mm/s, below which it is held where it is [assumed]."""

WHEELS = (LEFT, RIGHT)


def boards_for(safe_state: SafeState) -> tuple[str, ...]:
    """Return the boards that have to do something for a safe state."""
    return BOARDS if safe_state == SafeState.STOP else STEPPERS


def number_of(board: str) -> int:
    """Return the number by which reports and the twin know a board."""
    return BOARDS.index(board) + 1


def unreachable(board: str, why: str) -> MotorReport:
    return MotorReport(board, number_of(board), False, False, False, why)


async def make_safe(board: Board, config: StretchConfig, within_s: float = CONFIRM_S) -> MotorReport:
    """Bring a board to rest, and see it there. Never raises; the first frame leaves before the
    first wait."""
    kind = _Runstop if board.name == PIMU else _Wheel if board.name in WHEELS else _Joint
    return await kind(board, config).run(within_s)


class _Safing(ABC):
    """``first``: what it is told at once."""

    first: bytes

    def __init__(self, board: Board) -> None:
        self._board = board
        self._written = self._acknowledged = False
        self._detail = "silent"
        self._first_us: int | None = None  # the board's own time of what was heard first

    @abstractmethod
    async def look(self) -> tuple[bytes, str] | None:
        """Return what to tell it next and why it is not safe; the latter empty: it is. None: it is
        not heard."""

    def old(self, report_us: int) -> str:
        """Return why a report of the board's own time proves nothing; empty: it does."""
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
        """Look; where it is not safe, tell it again."""
        found = await self.look()
        if found is None:
            self._board.send(self.first)
            return
        self._acknowledged = True
        again, self._detail = found
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
