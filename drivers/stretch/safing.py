"""Bring each board to its safe state, and confirm it. The process that drives the robot and the supervising
process (root) use this code.

The first frame is sent at once, and a board obeys it in any state. Then the board is read, and gets the frame
again until it reports the safe state. Its first report confirms nothing. It may be from before the board
received the frame, or from a board that hangs. Only a later report counts, in which the board's clock has
advanced.

``wheels``      velocity zero, without a profile; hold once the wheel stands
``lift, arm``   hold
``pimu``        the power board: sets the runstop, for an e-stop only; the boards then stop by themselves
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch
from strands_actors.drivers.common.kit.stop_steps import repeat_until_safe

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
    """Return the boards that must act for a safe state."""
    return BOARDS if safe_state == SafeState.STOP else STEPPERS


def number_of(board: str) -> int:
    """Return the number of a board, as reports and the simulated robot use it."""
    return BOARDS.index(board) + 1


def unreachable(board: str, reason: str) -> MotorReport:
    return MotorReport(board, number_of(board), False, False, False, reason)


async def make_safe(board: Board, config: StretchConfig, within_s: float = CONFIRM_S) -> MotorReport:
    """Bring a board to its safe state, and read back that it is in it. Never raises. The first frame is sent
    before anything is waited for."""
    steps = _Runstop if board.name == PIMU else _Wheel if board.name in WHEELS else _Joint
    # A lost port fails in every step. The caller opens it again.
    outcome = await repeat_until_safe(steps(board, config), within_s, LOOK_S, lambda: False)
    (report,) = outcome.reports((board.name,), (number_of(board.name),))
    return report


class _Report(NamedTuple):
    """The state of a board, read during a stop."""

    time_us: int
    """By the board's clock."""
    reason: str
    """Why it does not show the safe state; empty if it does."""
    next_frame: bytes
    """The frame that the board gets if it is not known to be safe."""


class _Safing(ABC):
    """The stop procedure for one board (``StopSteps``). ``first`` is the frame that is sent at once."""

    first: bytes

    def __init__(self, board: Board) -> None:
        self._board = board
        self._watch = RestWatch()
        self.written = self.acknowledged = False

    @abstractmethod
    async def look(self) -> _Report | None:
        """Read the board's state. Return None if the board does not answer."""

    async def step(self) -> str:
        """Read the board, and send the frame again if the board is not known to be safe."""
        if not self.written:
            self._board.send_first(self.first)
            self.written = True
        report = await self.look()
        if report is None:
            self._board.send(self.first)
            return "silent"
        self.acknowledged = True
        self._watch.report(report.time_us, [0] if report.reason else [])
        if self._watch.rest is Rest.RESTS:
            return ""
        self._board.send(report.next_frame)
        return report.reason or "reports nothing new"


class _Wheel(_Safing):
    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)
        self.first = config.stand(board.name).call()
        self._hold = config.hold(board.name).call()

    async def look(self) -> _Report | None:
        status = await self._board.stepper_status(wait=True)
        if status is None:
            return None
        if abs(status.velocity) > STANDS_RAD_S and status.mode != p.Mode.FREEWHEEL:
            return _Report(status.timestamp_us, f"still turns at {status.velocity:.1f} rad/s", self.first)
        return _Report(status.timestamp_us, _reason_not_at_rest(status), self._hold)


class _Joint(_Safing):
    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)
        self.first = config.hold(board.name).call()

    async def look(self) -> _Report | None:
        status = await self._board.stepper_status(wait=True)
        return None if status is None else _Report(status.timestamp_us, _reason_not_at_rest(status), self.first)


class _Runstop(_Safing):
    first = p.pimu_trigger(p.RUNSTOP_ON)

    def __init__(self, board: Board, config: StretchConfig) -> None:
        super().__init__(board)

    async def look(self) -> _Report | None:
        status = await self._board.pimu_status(wait=True)
        if status is None:
            return None
        reason = "" if status.state & p.State.RUNSTOP else "the runstop is not on"
        return _Report(status.timestamp_us, reason, self.first)


def _reason_not_at_rest(status: p.StepperStatus) -> str:
    if status.mode not in p.AT_REST:
        return f"is in mode {status.mode}"
    return "waits for a sync pulse" if status.has(p.Diag.WAITS_FOR_SYNC) else ""
