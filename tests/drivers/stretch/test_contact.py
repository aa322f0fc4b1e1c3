"""Test contacts of lift and arm.

Both stop by themselves at an obstacle and wait for another goal. So the wire sends each goal once, and
reports the contact.
"""

from __future__ import annotations

import trio

from strands_actors.contract.wire import Observation
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.wire import StretchWire
from tests.drivers.common.memory_port import Permission, virtual

from .rig import ARM, LEFT, LIFT, PIMU, Rig
from .test_wire import BASE_ALONE, LIFT_ALONE, target

ARM_ALONE = 2
CONDITIONS = Stretch("stretch3", "", {}).conditions


def broken(seen: Observation) -> list[str]:
    """Return the codes of the conditions that do not hold."""
    found = (each.check(seen, seen.t_ns) for each in CONDITIONS)
    return [refusal.code for refusal in found if refusal is not None]


def goals(rig: Rig, name: str) -> list[p.Command]:
    return [one for one in rig.commands(name) if one.kind == "setpoint"]


async def resend(wire: StretchWire, values: tuple[float, ...], seconds: float) -> Observation:
    """Re-send every 100 ms, as the tree does."""
    for _ in range(round(seconds / 0.1)):
        await wire.write(values, Permission())
        await trio.sleep(0.05)
        seen = await wire.read()
        await trio.sleep(0.05)
    return seen


async def armed(rig: Rig) -> StretchWire:
    wire = rig.wire()
    await wire.open()
    await wire.arm(Permission())
    return wire


def test_a_re_sent_goal_goes_to_lift_and_arm_once_and_to_the_wheels_each_time() -> None:
    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        await resend(wire, target(LIFT_ALONE | ARM_ALONE | BASE_ALONE, lift=0.6, arm=0.2, vx=0.1), 1.0)
        assert (len(goals(rig, LIFT)), len(goals(rig, ARM)), len(goals(rig, LEFT))) == (1, 1, 10)
        await resend(wire, target(LIFT_ALONE | ARM_ALONE, lift=0.7, arm=0.2), 0.5)
        assert (len(goals(rig, LIFT)), len(goals(rig, ARM))) == (2, 1), "another goal is sent"
        await wire.make_safe("hold")
        await resend(wire, target(LIFT_ALONE | ARM_ALONE, lift=0.7, arm=0.2), 0.5)
        assert (len(goals(rig, LIFT)), len(goals(rig, ARM))) == (3, 2), "after a hold the same goal is sent"

    virtual(test)


def test_a_goal_is_re_sent_until_it_is_acknowledged() -> None:
    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        there = target(LIFT_ALONE | ARM_ALONE, lift=0.6, arm=0.2)
        rig.mute.add(LIFT)
        for _ in range(3):  # one of them falls into the quiet time after a missing answer
            await wire.write(there, Permission())
            await trio.sleep(0.06)
        assert (len(goals(rig, LIFT)), len(goals(rig, ARM))) == (3, 1)
        rig.mute.clear()
        await trio.sleep(0.2)
        await resend(wire, there, 0.5)
        assert (len(goals(rig, LIFT)), len(goals(rig, ARM))) == (4, 1)

    virtual(test)


def test_an_unexpected_acknowledgement_does_not_count_for_a_goal() -> None:
    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        board = wire._boards["lift"]
        board.send(rig.config.hold("lift").call())
        await trio.sleep(0.01)  # its acknowledgement waits in the port
        rig.mute.add(LIFT)
        board.tell(rig.config.goal("lift", 0.6).call())
        assert not await board.was_acknowledged()

    virtual(test)


def test_saf_014_an_arm_at_an_obstacle_pushes_once_and_reports_it() -> None:
    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        rig.world.set_contact("arm", True)
        seen = await resend(wire, target(ARM_ALONE, arm=0.4), 3.0)
        arm = rig.world.steppers["arm"]
        events = arm.contacts
        assert events > 0 and arm.mode == p.Mode.SAFETY
        await resend(wire, target(ARM_ALONE, arm=0.4), 1.0)
        assert arm.contacts == events, "a re-sent goal does not push again"
        assert seen.faults == {"arm": "contact"} and broken(seen) == ["contact"]
        assert all(report.safe for report in await wire.make_safe("hold"))
        assert arm.mode == p.Mode.HOLD
        assert (await wire.read()).faults == {"arm": "contact"}, (
            "the contact stays reported until the arm is armed again"
        )
        seen = await wire.arm(Permission())
        assert seen.faults == {} and broken(seen) == []
        seen = await resend(wire, target(ARM_ALONE, arm=0.05), 2.0)
        assert rig.world.metres("arm") < 0.08 and broken(seen) == []

    virtual(test)


def test_saf_014_a_contact_that_a_stream_of_goals_has_cleared_is_seen_all_the_same() -> None:
    """The board clears its contact with every goal, also between two readings."""

    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        rig.world.set_contact("arm", True)
        await wire.write(target(ARM_ALONE, arm=0.3), Permission())
        seen = await wire.read()
        assert broken(seen) == []
        await trio.sleep(0.12)
        await wire.write(target(ARM_ALONE, arm=0.31), Permission())
        seen = await wire.read()
        assert not rig.world.steppers["arm"].status().has(p.Diag.CONTACT)
        assert broken(seen) == ["contact"]

    virtual(test)


def test_saf_014_a_lift_in_safety_mode_without_a_runstop_is_reported() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        seen = await wire.read()
        assert rig.world.steppers["lift"].mode == p.Mode.SAFETY and seen.faults == {}, (
            "the lift was not energised, so its contact is no fault"
        )
        await wire.arm(Permission())
        assert broken(await wire.read()) == []
        rig.world.steppers["lift"].take(p.Command(p.Mode.SAFETY))
        seen = await wire.read()
        assert seen.faults == {"lift": "safety mode"} and broken(seen) == ["safety_mode"]
        await wire.arm(Permission())
        rig.world.set_runstop(True)
        seen = await wire.read()
        assert seen.faults == {} and broken(seen) == ["runstop"]

    virtual(test)


def test_after_an_estop_no_safety_mode_is_reported() -> None:
    async def test() -> None:
        rig = Rig()
        wire = await armed(rig)
        await wire.make_safe("stop")
        rig.world.set_runstop(False)
        seen = await wire.read()
        assert {motor.mode for motor in rig.world.steppers.values()} == {p.Mode.SAFETY}
        assert seen.faults == {} and broken(seen) == []
        assert PIMU in rig.ports_written("safe")

    virtual(test)
