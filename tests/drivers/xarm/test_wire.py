"""Test the wire in virtual time, on the twin's controller: its writes, their order, and which answers it
accepts."""

from __future__ import annotations

import msgspec
import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import Register, State
from strands_actors.drivers.xarm.session import PAST_RAD
from strands_actors.drivers.xarm.wire import QUIET_S, XArmWire
from tests.drivers.common.memory_port import Permission

from .rig import Stoppable, World, armed, cycle, in_virtual_time, stepped

# -- opening


@in_virtual_time
async def test_opening_reads_and_writes_nothing_else() -> None:
    world = World(firmware="2.5.0", arm_type=3, serial="XF1000000001", speed_limit_rad_s=1.5)
    facts = await world.wire().open()
    assert set(world.kinds()) == {"read"}
    assert facts == {
        "address": "192.0.2.1:502",
        "firmware": "2.5.0",
        "arm_type": 3,
        "serial": "XF1000000001",
        "speed_limit_rad_s": 1.5,
        "speed_limit": "the controller's",
    }


@in_virtual_time
async def test_without_a_reported_limit_the_tables_applies_with_a_warning() -> None:
    world = World()
    world.no_rich = True
    wire = world.wire()
    facts = await wire.open()
    assert facts["speed_limit_rad_s"] == 3.14
    assert "assumed" in facts["speed_limit"]
    assert (await wire.read()).sensors["speed_limit_rad_s"] == (3.14,)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "6,6,XF1300012345,AC1300012345,v1.12.10",
            "has 6 joints and type 6, but xarm7 has 7 joints and type 3, 7, 13",
        ),
        ("7,4,XF1300012345,AC1300012345,v1.12.10", "has 7 joints and type 4"),
        ("v0.9.1", "names no type and firmware. Update the controller's firmware"),
    ],
)
@in_virtual_time
async def test_another_arm_is_named(text: str, says: str) -> None:
    world = World()
    world.controller.version_text = text
    with pytest.raises(WireDown, match=says):
        await world.wire().open()
    assert world.connections[-1].closed


@in_virtual_time
async def test_a_controller_that_accepts_a_connection_and_never_answers_is_named() -> None:
    world = World()
    world.deaf = True
    with pytest.raises(WireDown, match="the port is open, but nothing answers"):
        await world.wire().open()
    world.deaf = False

    def on_reply(count: int) -> None:
        world.deaf = True

    world.on_reply = on_reply
    with pytest.raises(WireDown, match="did not answer the request for its errors"):
        await world.wire().open()
    world.on_reply = lambda count: None
    world.deaf, world.mute = False, True
    with pytest.raises(WireDown, match="30003: the port is open, but no report"):
        await world.wire().open()
    assert all(connection.closed for connection in world.connections)


# -- arming


@in_virtual_time
async def test_saf_011_arming_begins_where_the_arm_is() -> None:
    world = World()
    wire = await armed(world)
    assert world.kinds("read") == ["safe", "enable", "enable", "enable", "safe"]
    assert [body[0] for body in world.bodies("enable")] == [11, 19, 12]
    stop, first = world.bodies("safe")
    assert stop == b"\x0c\x04"
    target_rad = p.unpack_floats(first[1:], 7)
    assert target_rad == pytest.approx(world.controller.plant.position_rad, abs=1e-6)
    assert (await wire.read()).sensors["mode"] == (1.0,)


@in_virtual_time
async def test_saf_011_an_arm_that_was_paused_on_its_way_does_not_go_on_when_it_is_armed() -> None:
    """The controller keeps the newest target, and moves there in state 0 if servo mode was never left."""
    world = World()
    await cycle(await armed(world), 10)
    controller = world.controller
    controller.set_state(State.PAUSED)
    here = controller.plant.position_rad
    controller.obey(Register.SERVO_JOINT, p.servo_data(stepped(world, 0.3)))

    def set_mode(mode: int) -> None:
        if mode != controller.mode:
            type(controller).set_mode(controller, mode)

    controller.set_mode = set_mode  # type: ignore[method-assign]
    written = len(world.written)
    wire = await armed(world)
    assert next(one.body for one in world.written[written:] if one.kind != "read") == b"\x0c\x04", (
        "a stop is written first"
    )
    await cycle(wire, 30)
    assert controller.plant.position_rad == pytest.approx(here, abs=0.01)


async def braked_at_its_limit(world: World, wire: XArmWire, past_rad: float) -> float:
    """Stop an arm with a joint at the end of its range. Return how far past the end it rests."""
    joint, controller = 5, world.controller
    end = controller._arm_type.range_rad[joint][1]
    await wire.make_safe(SafeState.STOP)
    controller.plant.data.qpos[controller.plant._qpos[joint]] = end
    controller._target[joint] = end + past_rad
    await cycle(wire, 100)
    return controller.plant.position_rad[joint] - end


@in_virtual_time
async def test_saf_011_an_arm_that_rests_on_its_limit_is_armed_there_each_time() -> None:
    """For a target past a range the controller ends the motion with error 23, and keeps that error."""
    world = World()
    wire = await armed(world)
    controller, end = world.controller, world.controller._arm_type.range_rad[5][1]
    for _ in range(3):
        assert 1e-3 < await braked_at_its_limit(world, wire, 0.05) < PAST_RAD
        observation = await wire.arm(Permission())
        assert controller.error == 0 and wire.session.target[5] == end
        await wire.write(observation.position, Permission())  # a policy that returns its observation
        await cycle(wire, 5)
        assert controller.error == 0 and controller.runs
        held = await wire.make_safe(SafeState.HOLD)
        assert all(motor.safe for motor in held), held


@in_virtual_time
async def test_saf_011_an_arm_far_past_its_limit_is_not_energised() -> None:
    world = World()
    wire = await armed(world)
    kind, here = wire.session.arm_type, world.controller.plant.position_rad[5]
    ranges = (*kind.range_rad[:5], (-3.0, here - 2 * PAST_RAD), kind.range_rad[6])
    wire.session.arm_type = msgspec.structs.replace(kind, range_rad=ranges)
    written = len(world.written)
    with pytest.raises(WireDown, match=r"enable: joint6 is 0\.040 rad outside its range. Move it back"):
        await wire.arm(Permission())
    assert {one.kind for one in world.written[written:]} == {"read"}


@in_virtual_time
async def test_an_error_is_refused_before_anything_is_energised() -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    world.controller.fail(31)
    with pytest.raises(WireDown, match=r"enable: the controller reports error 31 \(collision\)"):
        await wire.arm(Permission())
    assert set(world.kinds()) == {"read"}
    world.controller.obey(Register.CLEAR_ERROR, b"")
    await wire.arm(Permission())


@in_virtual_time
async def test_an_error_that_comes_while_it_is_enabled_ends_it() -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    world.controller._enable = lambda joint, on: world.controller.fail(13)  # type: ignore[method-assign]
    with pytest.raises(WireDown, match=r"error 13 \(servo motor 3\)"):
        await wire.arm(Permission())
    assert world.kinds("read") == ["safe", "enable"], "mode and state are not set after the error"


@pytest.mark.parametrize("denied_at", range(12))
@in_virtual_time
async def test_saf_009_a_stop_during_bring_up_wins(denied_at: int) -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    permission = Permission(denied_at=denied_at)
    seen: list[int] = []

    class Watched:
        def check(self) -> None:
            seen.append(len(world.kinds("read")))
            permission.check()

    try:
        await wire.arm(Watched())
    except PermitDenied:
        assert len(world.kinds("read")) == seen[-1], "nothing is written after the permit is denied"
    else:
        assert len(seen) <= denied_at
    motors = await wire.make_safe("stop")
    assert all(motor.safe for motor in motors)
    assert world.controller.state == State.STOPPED


@pytest.mark.parametrize("replies", range(1, 7))
@in_virtual_time
async def test_saf_009_a_stop_that_comes_with_a_reply_wins_before_the_next_frame(replies: int) -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    permit, before = Stoppable(), world.replies
    written: list[int] = []

    def on_reply(count: int) -> None:
        if count == before + replies:
            permit.gone = True
            written.append(len(world.written))

    world.on_reply = on_reply
    if replies < 6:
        with pytest.raises(PermitDenied):
            await wire.arm(permit)
        assert len(world.written) == written[0]
    else:
        await wire.arm(permit)
        assert world.kinds()[-1] == "safe", "no frame follows the stop"


@in_virtual_time
async def test_saf_009_a_stop_does_not_wait_for_motors_that_take_long_nor_for_an_arm_that_is_not_ready() -> None:
    for hang in ("deaf", "stubborn"):
        world = World()
        wire = world.wire()
        await wire.open()
        permit, before = Stoppable(), world.replies

        def on_reply(count: int, world: World = world, hang: str = hang, before: int = before) -> None:
            world.deaf = hang == "deaf" and count == before + 1

        world.on_reply = on_reply
        if hang == "stubborn":
            world.controller.set_mode = lambda mode: None  # type: ignore[method-assign]
        async with trio.open_nursery() as nursery:

            async def arm(wire: XArmWire = wire, permit: Stoppable = permit) -> None:
                with pytest.raises(PermitDenied):
                    await wire.arm(permit)

            nursery.start_soon(arm)
            await trio.sleep(0.5)
            permit.gone, began_s = True, trio.current_time()
        assert trio.current_time() - began_s < 0.05


@in_virtual_time
async def test_an_arm_that_does_not_take_where_it_is_as_its_target_is_not_armed() -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    obey = world.controller.obey

    def refuse_servo(register: int, data: bytes) -> tuple[int, bytes]:
        return (p.NOT_READY, b"") if register == Register.SERVO_JOINT else obey(register, data)

    world.controller.obey = refuse_servo  # type: ignore[method-assign]
    with pytest.raises(WireDown, match="refuses the arm's position as target"):
        await wire.arm(Permission())


@in_virtual_time
async def test_an_arm_that_does_not_get_ready_is_named() -> None:
    world = World()
    wire = world.wire()
    await wire.open()
    world.controller.set_mode = lambda mode: None  # type: ignore[method-assign]
    with pytest.raises(WireDown, match=r"state 2, mode 0 after 2 s, not ready in servo mode"):
        await wire.arm(Permission())
    assert trio.current_time() < 3.0


# -- setpoints


@in_virtual_time
async def test_a_setpoint_leaves_at_once_and_the_arm_follows() -> None:
    world = World()
    wire = await armed(world)
    for _ in range(20):
        await wire.write(stepped(world, 0.02), Permission())
        await cycle(wire)
    assert len(world.bodies("setpoint")) == 20
    assert world.controller.plant.position_rad[0] > 0.04


@in_virtual_time
async def test_saf_001_nothing_is_sent_after_the_permit_is_withdrawn() -> None:
    world = World()
    wire = await armed(world)
    with pytest.raises(PermitDenied):
        await wire.write(stepped(world, 0.02), Permission(denied_at=0))
    assert not world.bodies("setpoint")


@pytest.mark.parametrize("silent", ["mute", "deaf"])
@in_virtual_time
async def test_saf_010_nothing_is_written_to_a_silent_controller(silent: str) -> None:
    """Reports without replies show no working controller, nor do replies without reports."""
    world = World()
    wire = await armed(world)
    await cycle(wire, 10)
    setattr(world, silent, True)
    end_s = trio.current_time() + 2 * QUIET_S
    denied = 0
    while trio.current_time() < end_s:
        try:
            await wire.write(stepped(world, 0.001), Permission())
        except PermitDenied as why:
            assert "has sent nothing for" in str(why)
            denied += 1
        await cycle(wire)
    assert denied >= 3
    assert len(world.bodies("setpoint")) <= QUIET_S / 0.01 + 2
    with pytest.raises(WireDown, match="has sent nothing for"):
        await cycle(wire, 40)


@in_virtual_time
async def test_saf_012_the_controllers_reports_are_in_the_observation() -> None:
    world = World()
    wire = await armed(world)
    await cycle(wire, 3)
    world.controller.fail(24)
    await cycle(wire, 8)
    seen = await wire.read()
    assert (seen.sensors["error"], seen.sensors["state"]) == ((24.0,), (4.0,))
    assert seen.faults == {"controller": "error 24 (speed exceeds limit)"}
    assert trio.current_time() - seen.t_ns / 1e9 < 0.011


@pytest.mark.parametrize("fault", [Fault.INTERMITTENT, Fault.DELAYED, Fault.SLOW])
@in_virtual_time
async def test_replies_that_are_late_or_missing_end_nothing(fault: Fault) -> None:
    world = World()
    wire = await armed(world)
    world.faults.set(fault)
    for _ in range(300):
        await wire.read()
        await trio.sleep(0.01)
    world.faults.set(Fault.OK)
    await cycle(wire, 20)
    assert not world.connections[-1].closed


@in_virtual_time
async def test_a_reply_without_a_request_is_late_and_an_unmatched_one_is_invalid() -> None:
    world = World()
    wire = await armed(world)
    stream = world.connections[-1]
    stream.say(p.frame(60000, bytes((Register.ERRORS, 0, 31, 0))))
    await cycle(wire)
    assert (await wire.read()).sensors["error"] == (0.0,), "the unmatched reply is not used"
    world.deaf = True
    await cycle(wire, 6)
    stream.say(p.frame(len(world.written), bytes((Register.GET_STATE, 0, 2))))
    with pytest.raises(WireDown, match="register 13 for 15"):
        await cycle(wire)


@in_virtual_time
async def test_garbage_ends_the_link() -> None:
    world = World()
    wire = await armed(world)
    world.faults.set(Fault.GARBAGE)
    with pytest.raises(WireDown, match="sent invalid data"):
        await cycle(wire, 30)
