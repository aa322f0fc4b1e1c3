"""Calibrate a robot of servos with LeRobot's procedure, and return the values for LeRobot's file.

A person moves all joints to the middle of their range, then through their whole range.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration

from .axes import TOP
from .setup import Ranges, Setup

READ_S = 0.05
PATIENCE_S = 1.0
"""How long a request is repeated after its answer was lost or damaged. Otherwise a person would lose a
minute of work."""
UNDO_S = 3.0

Result = TypeVar("Result")


class Person(Protocol):
    """The user interface for the person that moves the joints."""

    async def ready(self, text: str) -> None:
        """Show an instruction, and wait until the person has carried it out."""

    def show(self, ranges: Ranges) -> None:
        """Show the ranges that were recorded so far."""


async def calibrate(
    setup: Setup[Any], person: Person, whole_turn: Sequence[str], inverted: Sequence[str], max_offset: int
) -> dict[str, MotorCalibration]:
    """Calibrate the servos. If this fails or is cancelled, write their previous calibration again.

    Args:
        setup: The servos.
        person: The user interface.
        whole_turn: Keys of joints that turn without an end. Their range is the whole turn.
        inverted: Keys of joints with drive mode 1.
        max_offset: The largest value that the homing offset register can hold.

    Returns:
        The calibration that was written, by joint.

    Raises:
        WireDown: A servo does not answer, or did not keep a value.
        ValueError: A joint was not moved as required.
    """
    await setup.open()
    before = {axis.key: await _patiently(partial(setup.read_calibration, axis)) for axis in setup.axes}
    try:
        return await _calibrate(setup, person, whole_turn, inverted, max_offset)
    except BaseException:
        with trio.CancelScope(shield=True), trio.move_on_after(UNDO_S):
            await _write(setup, before)
        raise


async def _calibrate(
    setup: Setup[Any], person: Person, whole_turn: Sequence[str], inverted: Sequence[str], max_offset: int
) -> dict[str, MotorCalibration]:
    modes = {axis.key: int(axis.key in inverted) for axis in setup.axes}
    calibration = {axis.key: MotorCalibration(axis.id, modes[axis.key], 0, 0, TOP) for axis in setup.axes}
    await _write(setup, calibration)
    await person.ready("move every joint to the middle of its range")
    for axis in setup.axes:
        position = (await _patiently(setup.positions))[axis.key]
        offset = max(-max_offset, min(max_offset, setup.offset_to_middle(position)))
        calibration[axis.key] = MotorCalibration(axis.id, modes[axis.key], offset, 0, TOP)
    await _write(setup, calibration)
    ranges = Ranges(setup.axes, whole_turn)
    others = f", all but {', '.join(whole_turn)}" if whole_turn else ""
    await _record(setup, person, ranges, f"move every joint{others} from one end of its range to the other")
    if problems := ranges.problems():
        text = "; ".join(f"{key} {problem}" for key, problem in problems.items())
        raise ValueError(f"{text}. Nothing was changed. Calibrate again")
    for axis in setup.axes:
        low, high = ranges.of(axis.key)
        calibration[axis.key] = MotorCalibration(
            axis.id, modes[axis.key], calibration[axis.key].homing_offset, low, high
        )
    await _write(setup, calibration)
    return calibration


async def _record(setup: Setup[Any], person: Person, ranges: Ranges, text: str) -> None:
    """Record the positions of all joints until the person has finished."""
    failures: list[Exception] = []

    async def first(work: Callable[[], Awaitable[None]], scope: trio.CancelScope) -> None:
        try:
            await work()
        # The exception is raised below. A nursery would wrap it into an exception group.
        except Exception as failure:
            failures.append(failure)
        scope.cancel()

    async def read() -> None:
        while True:
            ranges.record(await _patiently(setup.positions))
            person.show(ranges)
            await trio.sleep(READ_S)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(first, lambda: person.ready(text), nursery.cancel_scope)
        nursery.start_soon(first, read, nursery.cancel_scope)
    if failures:
        raise failures[0]


async def _patiently(ask: Callable[[], Awaitable[Result]]) -> Result:
    """Repeat a request until it succeeds, for at most ``PATIENCE_S``. Then raise its last ``WireDown``."""
    until_s = trio.current_time() + PATIENCE_S
    while True:
        try:
            return await ask()
        except WireDown:
            if trio.current_time() >= until_s:
                raise
        await trio.sleep(READ_S)


async def _write(setup: Setup[Any], calibration: dict[str, MotorCalibration]) -> None:
    """Write a calibration to every servo, and read it back."""
    for axis in setup.axes:
        await _patiently(partial(setup.unlock, axis))
        await _patiently(partial(setup.write_calibration, axis, calibration[axis.key]))
        await _patiently(partial(setup.lock, axis))
        stored = await _patiently(partial(setup.read_calibration, axis))
        if stored != calibration[axis.key]:
            raise WireDown(f"{axis.label} did not keep its new values. Check its cable, then try again")
