"""Calibrate a robot of servos: a person moves each joint from stop to stop, and confirms the result.

Until then the servos are only read. The values that they had are kept, and are written again if a new value cannot
be written.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Mapping
from functools import partial
from typing import Any, Protocol, TypeVar

import msgspec
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration

from .axes import COUNTS, COUNTS_PER_RADIAN, Axis
from .findings import Finding, Kind, text_of
from .handshake import check_model
from .setup import ServoState, Setup
from .sweep import Sweep, Travel, calibration_of, check_firmware, check_shift, check_sweep, encoder_travel

READ_S = 0.02
PATIENCE_S = 1.0
"""How long a request is repeated after its answer was lost or damaged. Otherwise a person would lose a
minute of work."""
UNDO_S = 3.0
TRIES = 3
"""How often a person is asked to move a joint, and how often a servo is asked at least."""
APPLIED_COUNTS = 200
"""How far a joint may sink between two readings, 18 degrees, while the values are written."""
FIRMWARE = "firmware"
"""The word of ``Plan.accepted`` for servos with different firmware."""

Registers = Mapping[str, Mapping[str, int]]
"""The registers of a calibration, by joint and name."""
Result = TypeVar("Result")


class Plan(msgspec.Struct, frozen=True):
    """The facts about a robot that its calibration needs.

    Attributes:
        ranges_rad: The range of each joint in the robot's table, in radians.
        whole_turn: Keys of joints that turn without an end. Their range is the whole turn.
        inverted: Keys of joints with drive mode 1.
        max_offset: The largest value that the homing offset register can hold.
        accepted: Joints that may have another range than the table, and ``firmware``.
    """

    ranges_rad: Mapping[str, tuple[float, float]]
    whole_turn: Collection[str]
    inverted: Collection[str]
    max_offset: int
    accepted: Collection[str] = ()

    def expected(self, key: str) -> int | None:
        """Return the range of a joint in counts; None if it turns without an end."""
        if key in self.whole_turn:
            return None
        low, high = self.ranges_rad[key]
        return round((high - low) * COUNTS_PER_RADIAN)


class Proposal(msgspec.Struct, frozen=True):
    """A calibration that was measured, and is not yet written.

    Attributes:
        motors: The new calibration, by joint.
        counts: How far each joint was swept, in encoder counts.
        findings: The findings that do not prevent the calibration.
        before: The registers that the servos have.
        after: The registers that they get.
    """

    motors: Mapping[str, MotorCalibration]
    counts: Mapping[str, int]
    findings: tuple[Finding, ...]
    before: Registers
    after: Registers


class Person(Protocol):
    """The user interface for the person that moves the joints."""

    async def ready(self, text: str) -> None:
        """Show an instruction, and wait until the person has carried it out."""

    def show(self, sweep: Sweep, joint: str, expected: int | None) -> None:
        """Show how far a joint was moved so far. ``expected`` is its range in counts; None without an end."""

    async def confirm(self, proposal: Proposal) -> bool:
        """Show a calibration, and return True if the person wants it."""


async def calibrate(setup: Setup[Any], person: Person, plan: Plan, keep: Callable[[Registers], None]) -> Proposal:
    """Calibrate the servos. If a value cannot be written, the old ones are written again.

    Args:
        setup: The servos.
        person: The user interface.
        plan: The facts about the robot.
        keep: Called with the present registers before the first one is written.

    Returns:
        The calibration that was written.

    Raises:
        WireDown: A servo does not answer, is of another model, or did not keep a value.
        ValueError: A joint was not moved as required, or the person did not confirm.
    """
    states = await open_servos(setup)
    _check_firmware(setup, plan, states)
    before = {key: state.registers for key, state in states.items()}
    proposal = await _propose(setup, person, plan, before)
    if not await person.confirm(proposal):
        raise ValueError("not confirmed. Nothing was changed")
    keep(before)
    encoders = await _encoders(setup, before)
    await write(setup, proposal.after, before, partial(_check_applied, setup, proposal, encoders))
    return proposal


async def open_servos(setup: Setup[Any]) -> dict[str, ServoState]:
    """Open the port, switch the torque off, and return the stored values of each servo, by joint. Raise
    ``WireDown`` if a servo does not answer, or has another model than in the robot's table."""
    await _patiently(setup.open)
    states = {axis.key: await _patiently(partial(setup.read_state, axis)) for axis in setup.axes}
    for axis in setup.axes:
        check_model(axis, axis.id, states[axis.key].model, setup.CODEC)
    return states


def _check_firmware(setup: Setup[Any], plan: Plan, states: Mapping[str, ServoState]) -> None:
    versions: dict[int, dict[str, str]] = {}
    for axis in setup.axes:
        versions.setdefault(states[axis.key].model, {})[axis.key] = states[axis.key].firmware
    findings = check_firmware(versions.values())
    if findings and FIRMWARE not in plan.accepted:
        raise ValueError(". ".join(map(text_of, findings)))


async def _propose(setup: Setup[Any], person: Person, plan: Plan, before: Registers) -> Proposal:
    sweep = Sweep()
    motors, counts, findings = dict[str, MotorCalibration](), dict[str, int](), list[Finding]()
    for axis in setup.axes:
        travel = await _sweep(setup, person, plan, sweep, before, axis)
        counts[axis.key] = travel.counts
        old = setup.calibration_in(axis, before[axis.key])
        old_travel = encoder_travel(old, setup.OFFSET_SIGN)
        drive_mode = int(axis.key in plan.inverted)
        if old.drive_mode != drive_mode:
            travel = travel.inverted()
            old_travel = old_travel and old_travel.inverted()
        turns = axis.key in plan.whole_turn
        if travel.wraps and not turns:
            if not setup.OFFSET_MOVES_END:
                raise ValueError(f"{text_of(Finding(Kind.CANNOT_WRAP, axis.key))}. Nothing was changed")
            findings.append(Finding(Kind.WRAPS, axis.key))
        if old_travel and not turns and (shift := check_shift(axis.key, old_travel, travel, setup.HORN_TEETH)):
            findings.append(shift)
        offset = setup.offset_to_middle(travel.middle % COUNTS)
        offset = max(-plan.max_offset, min(plan.max_offset, offset))
        motors[axis.key] = calibration_of(axis.id, drive_mode, offset, None if turns else travel, setup.OFFSET_SIGN)
    after = {axis.key: setup.registers_of(axis, motors[axis.key], before[axis.key]) for axis in setup.axes}
    return Proposal(motors, counts, tuple(findings), before, after)


async def _sweep(
    setup: Setup[Any], person: Person, plan: Plan, sweep: Sweep, before: Registers, axis: Axis
) -> Travel:
    """Let the person move one joint, and return its range. Ask again if the range cannot be used."""
    key, expected = axis.key, plan.expected(axis.key)
    motion = "from one end of its range to the other" if expected else "both ways, and leave it in its middle"
    finding: Finding | None = None
    for _ in range(TRIES):
        again = f"{text_of(finding)}. Again: " if finding else ""
        await _record(setup, person, sweep, before, key, expected, f"{again}move {key} {motion}")
        finding = check_sweep(sweep, key, expected, key in plan.accepted)
        if finding is None:
            return Travel(sweep.low[key], sweep.high[key], None if expected else sweep.now[key])
    assert finding is not None
    raise ValueError(f"{text_of(finding)}. Nothing was changed")


async def _record(
    setup: Setup[Any], person: Person, sweep: Sweep, before: Registers, key: str, expected: int | None, text: str
) -> None:
    """Record the positions of all joints until the person has moved one of them."""
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
            sweep.record(await _encoders(setup, before))
            person.show(sweep, key, expected)
            await trio.sleep(READ_S)

    # Joints may have moved while no one was asked to move them, for example while the last range was checked.
    sweep.now.clear()
    sweep.record(await _encoders(setup, before))
    sweep.begin()
    async with trio.open_nursery() as nursery:
        nursery.start_soon(first, lambda: person.ready(text), nursery.cancel_scope)
        nursery.start_soon(first, read, nursery.cancel_scope)
    if failures:
        raise failures[0]


async def _encoders(setup: Setup[Any], registers: Registers) -> dict[str, int]:
    """Return the count of each encoder, without the homing offset that its servo has."""
    positions = await _patiently(setup.positions)
    return {key: count + setup.OFFSET_SIGN * registers[key]["homing_offset"] for key, count in positions.items()}


async def write(
    setup: Setup[Any],
    after: Registers,
    before: Registers,
    check: Callable[[], Awaitable[None]] | None = None,
) -> None:
    """Write the registers of every servo. If this fails or is cancelled, write the old values again.

    Args:
        setup: The servos.
        after: The new values.
        before: The old values.
        check: Called after all were written. Its exception counts as a failure.

    Raises:
        WireDown: A servo does not answer, or did not keep a value.
    """
    try:
        await _write(setup, after)
        if check is not None:
            await check()
    except BaseException:
        with trio.CancelScope(shield=True), trio.move_on_after(UNDO_S):
            await _write(setup, before)
        raise


async def _write(setup: Setup[Any], registers: Registers) -> None:
    for axis in setup.axes:
        await _patiently(partial(setup.write_registers, axis, registers[axis.key]))


async def _check_applied(setup: Setup[Any], proposal: Proposal, encoders: Mapping[str, int]) -> None:
    """Raise ``WireDown`` if a servo does not count as its new values say. ``encoders`` was read before they were
    written, at about the same positions."""
    now = await _encoders(setup, proposal.after)
    for axis in setup.axes:
        old, new = proposal.before[axis.key], proposal.after[axis.key]
        is_inverted = old.get("drive_mode", 0) != new.get("drive_mode", 0)
        expected = -encoders[axis.key] if is_inverted else encoders[axis.key]
        off = (now[axis.key] - expected + COUNTS // 2) % COUNTS - COUNTS // 2
        if abs(off) > APPLIED_COUNTS:
            raise WireDown(
                f"{axis.label} reports {abs(off)} counts from where it should be with its new values. Hold the arm "
                "still while they are written, and calibrate again"
            )


async def _patiently(ask: Callable[[], Awaitable[Result]]) -> Result:
    """Repeat a request until it succeeds, for ``PATIENCE_S`` and at least ``TRIES`` times. Then raise its last
    ``WireDown``."""
    until_s, tries = trio.current_time() + PATIENCE_S, 0
    while True:
        try:
            return await ask()
        except WireDown:
            tries += 1
            if trio.current_time() >= until_s and tries >= TRIES:
                raise
        await trio.sleep(READ_S)
