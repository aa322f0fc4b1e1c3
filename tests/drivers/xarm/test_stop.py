"""Test what stops the arm, in virtual time on the twin's controller: the wire, a lost link, the root's stop
channel."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import Register, State
from strands_actors.drivers.xarm.twin.registers import COLLISION_SENSITIVITY
from tests.drivers.common.memory_port import Permission

from .rig import World, armed, cycle, in_virtual_time, stepped

# -- safe


@in_virtual_time
async def test_saf_005_a_stop_is_read_back() -> None:
    world = World()
    wire = await armed(world)
    await wire.write(stepped(world, 0.03), Permission())
    motors = await wire.make_safe("stop")
    assert [motor.axis for motor in motors] == [f"joint{number}" for number in range(1, 8)]
    assert all(motor.written and motor.acknowledged and motor.safe for motor in motors)
    assert world.kinds("read")[-2:] == ["setpoint", "safe"]
    assert world.bodies("safe")[-1] == b"\x0c\x04"


@in_virtual_time
async def test_saf_005_an_unanswered_stop_is_retried_and_named() -> None:
    world = World()
    wire = await armed(world)
    began_s = trio.current_time()
    world.deaf = True
    motors = await wire.make_safe("stop")
    assert all(motor.written and not motor.acknowledged and not motor.safe for motor in motors)
    assert {motor.detail for motor in motors} == {"silent"}
    assert world.bodies("safe")[-3:] == [b"\x0c\x04"] * 3
    assert trio.current_time() - began_s < world.driver.timing.safe_s


@in_virtual_time
async def test_saf_005_a_controller_that_stays_as_it_was_is_named() -> None:
    world = World()
    wire = await armed(world)
    await cycle(wire, 3)
    assert (await wire.make_safe("hold"))[0].safe
    world.controller.set_state = lambda state: None  # type: ignore[method-assign]
    (motor, *_) = await wire.make_safe("stop")
    assert (motor.safe, motor.acknowledged, motor.detail) == (False, True, "the controller reports state 2")


@in_virtual_time
@pytest.mark.parametrize(
    ("register", "said"),
    [
        (Register.GET_STATE, (False, True, "the controller refuses the request for its state")),
        (Register.SET_STATE, (True, False, "")),
    ],
)
async def test_saf_005_an_answer_that_is_marked_as_invalid_confirms_nothing(
    register: Register, said: tuple[bool, bool, str]
) -> None:
    """The data of an invalid answer may be arbitrary."""
    world = World()
    wire = await armed(world)
    obey = world.controller.obey

    def marked(asked: int, data: bytes) -> tuple[int, bytes]:
        flags, answer = obey(asked, data)
        return flags | p.INVALID * (asked == register), answer

    world.controller.obey = marked  # type: ignore[method-assign]
    (motor, *_) = await wire.make_safe("stop")
    assert (motor.safe, motor.acknowledged, motor.detail) == said


@in_virtual_time
async def test_saf_020_a_stop_without_a_connection_opens_another() -> None:
    world = World()
    wire = await armed(world)
    world.connections[-1].close()
    assert all(motor.safe for motor in await wire.make_safe("stop"))
    assert len(world.connections) == 2
    assert world.connections[-1].closed == "in order", (
        "it is closed in order, so that a frozen controller can still read the stop"
    )
    world.gone = True
    (motor, *_) = await wire.make_safe("stop")
    assert (motor.written, motor.safe) == (False, False)
    assert "cannot connect" in motor.detail


@in_virtual_time
async def test_saf_020_a_link_that_was_lost_is_stopped_all_the_same() -> None:
    world = World()
    wire = await armed(world)
    wire.close()
    assert all(motor.safe for motor in await wire.reach("stop"))
    assert world.controller.state == State.STOPPED


@in_virtual_time
async def test_saf_020_a_controller_of_one_connection_gets_the_stop_on_that_one() -> None:
    """Its answers may be lost while our requests arrive."""
    world = World()
    wire = await armed(world)
    world.full = True
    (motor, *_) = await wire.reach("stop")
    assert world.controller.state == State.STOPPED
    assert (motor.written, motor.acknowledged, motor.safe) == (True, False, False)
    assert "cannot connect" in motor.detail


@in_virtual_time
async def test_saf_020_a_controller_of_one_client_comes_back_after_a_lost_link() -> None:
    """The old connection is closed only after it has carried the stop, because it may be the only one."""
    world = World()
    world.clients = 1
    wire = await armed(world)
    old = world.connections[-1]
    world.deaf = True
    for _ in range(3):
        (motor, *_) = await wire.reach("stop")
        await trio.sleep(0.1)
        assert (motor.written, motor.safe, old.closed) == (True, False, ""), "the controller's answers are cut off"
    assert world.controller.state == State.STOPPED
    world.deaf = False
    await wire.reach("stop")
    await trio.sleep(0.1)
    assert all(motor.safe for motor in await wire.reach("stop"))
    assert old.closed == "reset", "an answer arrived, so the earlier stop was read"
    assert world.bodies("safe")[-5:] == [b"\x0c\x04"] * 5
    assert set(world.kinds("read")[-5:]) == {"safe"}
    await armed(world)


@in_virtual_time
async def test_a_hold_repeats_the_last_target_and_differs_from_it_in_the_log() -> None:
    world = World()
    wire = await armed(world)
    target = stepped(world, 0.03)
    await wire.write(target, Permission())
    motors = await wire.make_safe("hold")
    assert all(motor.safe for motor in motors) and not wire.hold_failed
    assert world.kinds("read")[-2:] == ["setpoint", "safe"]
    setpoint, hold = world.bodies("setpoint")[-1], world.bodies("safe")[-1]
    assert setpoint[:29] == hold[:29] and setpoint[29:] != hold[29:]
    assert world.controller.state in (State.MOVING, State.READY)
    await wire.write(stepped(world, 0.01), Permission())
    assert math.isclose(world.controller.plant.position_rad[0], 0.03, abs_tol=0.02)


@in_virtual_time
async def test_saf_011_only_a_confirmed_hold_reports_its_position() -> None:
    """The next command sends the joints that it does not name to this position, and not to an older reading."""
    world = World()
    wire = await armed(world)
    target = stepped(world, 0.03)
    await wire.write(target, Permission())
    motors = await wire.make_safe("hold")
    assert tuple(motor.target for motor in motors) == target
    target_rad = p.unpack_floats(world.bodies("safe")[-1][1:], 7)
    assert target_rad == pytest.approx(target, abs=1e-6), "the position is the one on the wire"
    world.controller.plant.set_stuck(0, True)
    await wire.write(stepped(world, 0.2), Permission())
    assert {motor.target for motor in await wire.make_safe("hold")} == {None}
    assert {motor.target for motor in await wire.make_safe("stop")} == {None}


@in_virtual_time
async def test_a_hold_is_not_confirmed_by_an_arm_that_is_stopped_meanwhile() -> None:
    world = World()
    wire = await armed(world)
    before = world.replies

    def on_reply(count: int) -> None:
        if count == before + 1:
            world.controller.set_state(State.STOPPED)

    world.on_reply = on_reply
    assert (await wire.make_safe("hold"))[0].safe
    assert world.bodies("safe")[-1] == b"\x0c\x04", "we stop the arm, too"


@in_virtual_time
async def test_saf_006_a_stop_does_not_wait_for_a_hold_to_be_confirmed() -> None:
    world = World()
    wire = await armed(world)
    await cycle(wire, 10)
    world.controller.plant.set_stuck(0, True)  # it never reaches its target, so the hold is not confirmed
    await wire.write(stepped(world, 0.2), Permission())
    assert wire.interruptible
    with trio.move_on_after(0.03) as cut:
        await wire.make_safe("hold")
    assert cut.cancelled_caught
    assert all(motor.safe for motor in await wire.make_safe("stop"))
    assert world.controller.state == State.STOPPED


@in_virtual_time
async def test_after_a_stop_there_is_no_target_to_hold() -> None:
    world = World()
    wire = await armed(world)
    await wire.make_safe("stop")
    written = len(world.written)
    await wire.make_safe("hold")
    assert [entry.body for entry in world.written[written:] if entry.kind != "read"] == [b"\x0c\x04"]
    assert wire.hold_failed


@in_virtual_time
async def test_an_arm_that_cannot_be_held_is_stopped() -> None:
    """The arm is stuck far from its target, or another client took it out of servo mode."""
    world = World()
    wire = await armed(world)
    await cycle(wire, 10)
    world.controller.plant.set_stuck(0, True)
    # Without collision detection the controller itself does not stop the arm.
    world.controller.obey(COLLISION_SENSITIVITY, b"\0")
    await wire.write(stepped(world, 0.2), Permission())
    motors = await wire.make_safe("hold")
    assert all(motor.safe for motor in motors)
    assert world.controller.state == State.STOPPED
    assert wire.hold_failed == "the arm did not reach the target that it must hold"
    await wire.make_safe("hold")
    assert wire.hold_failed == "it was stopped", "a second hold finds the arm stopped"
    await wire.make_safe("stop")
    assert not wire.hold_failed
    other = World()
    wire = await armed(other)
    other.controller.set_mode(0)
    assert all(motor.safe for motor in await wire.make_safe("hold"))
    assert other.bodies("safe")[-1] == b"\x0c\x04"
    assert wire.hold_failed == "the controller refuses the target"


@in_virtual_time
async def test_not_connected_is_not_safe() -> None:
    world = World()
    wire = world.wire()
    assert {(motor.written, motor.safe, motor.detail) for motor in await wire.make_safe("stop")} == {
        (False, False, "not connected")
    }
    with pytest.raises(WireDown, match="Open the connection first"):
        await wire.read()


# -- the root's stop channel


@in_virtual_time
async def test_saf_003_the_stop_channel_does_not_depend_on_the_wire() -> None:
    world = World()
    await armed(world)
    channel = world.stop_channel()
    motors = await channel.make_safe("stop")
    channel.close()
    assert all(motor.safe for motor in motors)
    assert world.connections[-1].closed == "in order"
    world.deaf = True
    began_s = trio.current_time()
    motors = await channel.make_safe("stop")
    assert all(motor.written and not motor.safe for motor in motors)
    assert trio.current_time() - began_s < world.driver.timing.safe_s
