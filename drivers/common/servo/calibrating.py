"""Calibrate a robot of servos with LeRobot's procedure, and write LeRobot's file. A person moves all joints
to their middle, then through their whole range."""

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

Told = TypeVar("Told")


class Person(Protocol):
    """The user interface to the person that moves the robot."""

    async def ready(self, text: str) -> None:
        """Show an instruction, and wait until the person has carried it out."""

    def show(self, ranges: Ranges) -> None:
        """Show the ranges so far."""


async def calibrate(
    setup: Setup[Any], person: Person, whole_turn: Sequence[str], inverted: Sequence[str], max_offset: int
) -> dict[str, MotorCalibration]:
    """Calibrate the servos. If it ends early, they get their previous calibration again.

    Args:
        setup: The servos.
        person: The user interface.
        whole_turn: Keys of joints without an end, which get the whole turn.
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
    """Record positions until the person has finished."""
    failures: list[Exception] = []

    async def first(work: Callable[[], Awaitable[None]], scope: trio.CancelScope) -> None:
        try:
            await work()
        except Exception as failure:  # It is raised below, because a nursery would put it into a group.
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
    """Repeat a request for ``PATIENCE_S``. Raise the last ``WireDown``."""
    until_s = trio.current_time() + PATIENCE_S
    while True:
        try:
            return await ask()
        except WireDown:
            if trio.current_time() >= until_s:
                raise
        await trio.sleep(READ_S)


async def _write(setup: Setup[Any], wanted: dict[str, MotorCalibration]) -> None:
    """Write a calibration to every servo, and read it back."""
    for axis in setup.axes:
        await _patiently(partial(setup.unlock, axis))
        await _patiently(partial(setup.write_calibration, axis, wanted[axis.key]))
        await _patiently(partial(setup.lock, axis))
        kept = await _patiently(partial(setup.read_calibration, axis))
        if kept != wanted[axis.key]:
            raise WireDown(f"{axis.label} did not keep what was written to it. Check its cable, try again")
