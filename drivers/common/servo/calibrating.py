"""How a robot of servos is calibrated: its joints are brought to their middle by hand, then through
all their range. LeRobot's procedure, and its file."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.calibration import MotorCalibration

from .axes import TOP
from .setup import Ranges, Setup

READ_S = 0.05
PATIENCE_S = 1.0
"""How long a servo is asked again whose answer was lost or damaged: a person's minute of work depends on
it."""
UNDO_S = 3.0

Told = TypeVar("Told")


class Person(Protocol):
    """Who moves the robot."""

    async def ready(self, text: str) -> None:
        """Say what is to be done, and wait until it is."""

    def show(self, ranges: Ranges) -> None:
        """Show what was found so far."""


async def calibrate(
    setup: Setup[Any], person: Person, whole_turn: Sequence[str], inverted: Sequence[str], max_offset: int
) -> dict[str, MotorCalibration]:
    """Calibrate the servos, and return what was written to them. Whatever ends it before, they have
    what they had. Raise ``WireDown``, and ``ValueError`` for a joint that was not moved as it has
    to be."""
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
    found = {axis.key: MotorCalibration(axis.id, modes[axis.key], 0, 0, TOP) for axis in setup.axes}
    await _write(setup, found)
    await person.ready("move every joint to the middle of its range")
    for axis in setup.axes:
        position = (await _patiently(setup.positions))[axis.key]
        offset = max(-max_offset, min(max_offset, setup.offset_to_middle(position)))
        found[axis.key] = MotorCalibration(axis.id, modes[axis.key], offset, 0, TOP)
    await _write(setup, found)
    ranges = Ranges(setup.axes, whole_turn)
    others = f", all but {', '.join(whole_turn)}" if whole_turn else ""
    await _record(setup, person, ranges, f"move every joint{others} from one end of its range to the other")
    if problems := ranges.problems():
        told = "; ".join(f"{key} {why}" for key, why in problems.items())
        raise ValueError(f"{told}. Nothing was changed: do it again")
    for axis in setup.axes:
        low, high = ranges.of(axis.key)
        found[axis.key] = MotorCalibration(axis.id, modes[axis.key], found[axis.key].homing_offset, low, high)
    await _write(setup, found)
    return found


async def _record(setup: Setup[Any], person: Person, ranges: Ranges, text: str) -> None:
    """Take positions up until the person is done."""
    failures: list[Exception] = []

    async def first(work: Callable[[], Awaitable[None]], scope: trio.CancelScope) -> None:
        try:
            await work()
        except Exception as failure:  # raised below: a nursery would put it into a group
            failures.append(failure)
        scope.cancel()

    async def read() -> None:
        while True:
            ranges.take(await _patiently(setup.positions))
            person.show(ranges)
            await trio.sleep(READ_S)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(first, lambda: person.ready(text), nursery.cancel_scope)
        nursery.start_soon(first, read, nursery.cancel_scope)
    if failures:
        raise failures[0]


async def _patiently(ask: Callable[[], Awaitable[Told]]) -> Told:
    """Ask again for a while. Raise ``WireDown`` of the last time."""
    until_s = trio.current_time() + PATIENCE_S
    while True:
        try:
            return await ask()
        except WireDown:
            if trio.current_time() >= until_s:
                raise
        await trio.sleep(READ_S)


async def _write(setup: Setup[Any], wanted: dict[str, MotorCalibration]) -> None:
    """To every servo, and read back."""
    for axis in setup.axes:
        await _patiently(partial(setup.unlock, axis))
        await _patiently(partial(setup.write_calibration, axis, wanted[axis.key]))
        await _patiently(partial(setup.lock, axis))
        kept = await _patiently(partial(setup.read_calibration, axis))
        if kept != wanted[axis.key]:
            raise WireDown(f"{axis.label} did not keep what was written to it. Check its cable, try again")
