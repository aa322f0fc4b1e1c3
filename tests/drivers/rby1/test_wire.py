"""The wire in virtual time, on the twin's services: what is written, in which order, and what is
believed."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.grpc_messages import Status
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import Command, Finish
from strands_actors.drivers.rby1.driver import HOLD_S
from strands_actors.drivers.rby1.protocol import Control, Manager, Method
from strands_actors.drivers.rby1.stop_channel import KEPT
from strands_actors.drivers.rby1.stopping import ANSWER_S, ATTEMPTS, LONGEST_S
from strands_actors.drivers.rby1.wire import QUIET_S, RBY1Wire
from tests.drivers.common.memory_port import Permission, virtual

from .rig import World

Test = Callable[..., Awaitable[None]]


def in_a_world(test: Test) -> Callable[..., None]:
    """In virtual time, with a robot."""

    @functools.wraps(test)
    def run(**kwargs: Any) -> None:
        async def main() -> None:
            async with World().living() as world:
                await test(world, **kwargs)

        virtual(main)

    # pytest looks for fixtures in the signature: without the world
    del run.__wrapped__  # type: ignore[attr-defined]
    return run


def with_each(name: str, values: list[Any]) -> Callable[[Test], Callable[..., None]]:
    """As ``in_a_world``, once for each value."""

    def decorate(test: Test) -> Callable[..., None]:
        def run(value: Any) -> None:
            async def main() -> None:
                async with World().living() as world:
                    await test(world, value)

            virtual(main)

        run.__name__, run.__doc__ = test.__name__, test.__doc__  # type: ignore[attr-defined]
        return pytest.mark.parametrize("value", values)(run)

    return decorate


async def armed(world: World) -> RBY1Wire:
    wire = world.wire()
    await wire.open()
    await wire.arm(Permission())
    return wire


async def cycle(wire: RBY1Wire, cycles: int = 1) -> None:
    for _ in range(cycles):
        await trio.sleep(0.01)
        await wire.read()


def stepped(world: World, rad: float) -> tuple[float, ...]:
    at = world.controller.plant.position_rad
    return (at[0] + rad, *at[1:])


# -- opening


@in_a_world
async def test_opening_asks_and_moves_nothing(world: World) -> None:
    wire = world.wire()
    facts = await wire.open()
    assert set(world.kinds()) == {"read"}
    assert facts == {
        "address": "192.0.2.1:50051",
        "model": "A",
        "model_version": "1.2",
        "supplies": ["5v", "12v", "24v", "48v"],
        "limits": "the robot's own model",
        "control_hold_time_s": HOLD_S,
    }
    seen = await wire.read()
    assert len(seen.position) == 22
    assert seen.sensors["range_low_rad"][0] == pytest.approx(-0.261799)
    assert seen.sensors["speed_limit_rad_s"][-1] == pytest.approx(3.14)


@in_a_world
async def test_another_model_is_named(world: World) -> None:
    info = world.controller.info
    world.controller.info = msgspec.structs.replace(info, model="UB", joints=info.joints[:8])
    with pytest.raises(WireDown, match="is a model UB without right_arm_0, "):
        await world.wire().open()
    assert world.streams[-1].closed


@in_a_world
async def test_joints_in_another_order_are_another_robot(world: World) -> None:
    """Rows of a state have no names: a stop would look at the wrong joints."""
    info = world.controller.info
    order = [*info.joints[:-2], info.joints[-1], info.joints[-2]]
    world.controller.info = msgspec.structs.replace(info, joints=tuple(order))
    with pytest.raises(WireDown, match="without head_0, head_1 where a model A has them"):
        await world.wire().open()


@with_each("urdf", ["", "<robot/>", "no xml", '<robot><joint name="torso_0"/></robot>'])
async def test_limits_for_fewer_joints_than_named_refuse_bring_up(world: World, urdf: str) -> None:
    world.controller.urdf = urdf
    with pytest.raises(WireDown, match="the robot's model"):
        await world.wire().open()
    assert set(world.kinds()) == {"read"}
    assert world.streams[-1].closed


@in_a_world
async def test_a_port_that_is_no_address_is_named(world: World) -> None:
    config = msgspec.structs.replace(world.driver.config, port="robot:x")
    with pytest.raises(WireDown, match=r"port is 'robot:x'\. Give an address"):
        await RBY1Wire(config, world.wire()._clock, world.open_stream).open()


@in_a_world
async def test_a_robot_that_opens_and_says_nothing_is_named(world: World) -> None:
    world.frozen = True
    with pytest.raises(WireDown, match="does not speak gRPC"):
        await world.wire().open()
    assert world.streams[-1].closed


# -- arming


@in_a_world
async def test_power_then_servos_then_the_control_manager(world: World) -> None:
    wire = await armed(world)
    assert world.kinds("read") == ["enable"] * 3
    orders = [entry.data for entry in world.written if entry.kind == "enable"]
    assert p.decode_order(orders[0]) == p.decode_order(orders[1]) == (".*", 1)
    assert p.decode_manager_order(orders[2]) == p.ManagerOrder.ENABLE
    assert world.controller.manager == Manager.ENABLED
    assert not world.setpoints()
    await wire.arm(Permission())
    assert world.kinds("read") == ["enable"] * 3, "what is on is not switched on again"


@in_a_world
async def test_the_emergency_stop_button_is_refused_before_power_on(world: World) -> None:
    world.controller.press(True)
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match=r"the emergency stop button is pressed\. release it"):
        await wire.arm(Permission())
    assert set(world.kinds()) == {"read"}
    world.controller.press(False)
    await wire.arm(Permission())


@with_each("fault", [Manager.MINOR_FAULT, Manager.MAJOR_FAULT])
async def test_a_fault_is_refused_before_power_on_and_can_be_cleared(world: World, fault: Manager) -> None:
    world.controller.fail(fault)
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match=rf"in {fault.name} .*reset_fault_control_manager\(\) and resume\(\)"):
        await wire.arm(Permission())
    assert set(world.kinds()) == {"read"}
    assert await wire.perform("reset_fault_control_manager", {}, Permission()) == {"control_manager": "IDLE (1)"}
    assert world.kinds("read") == ["config"]
    await wire.arm(Permission())


@in_a_world
async def test_a_robot_that_another_program_moves_is_not_armed(world: World) -> None:
    wire = await armed(world)
    other = world.wire()
    await other.open()
    await wire.write(stepped(world, 0.02), Permission())
    with pytest.raises(WireDown, match="another program moves the robot"):
        await other.arm(Permission())


@with_each("denied_at", list(range(8)))
async def test_saf_009_a_stop_during_bring_up_wins(world: World, denied_at: int) -> None:
    wire = world.wire()
    await wire.open()
    seen: list[int] = []
    permission = Permission(denied_at=denied_at)

    class Watched:
        def check(self) -> None:
            seen.append(len(world.kinds("read")))
            permission.check()

    with pytest.raises(PermitDenied):
        await wire.arm(Watched())
        for _ in range(denied_at):  # it took fewer checks than that
            Watched().check()
    assert len(world.kinds("read")) == seen[-1], "nothing is written after the denial"


@in_a_world
async def test_a_robot_that_refuses_is_named(world: World) -> None:
    world.controller.power = lambda names, on: False  # type: ignore[method-assign]
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match="the robot refuses PowerCommand: not possible now"):
        await wire.arm(Permission())
    assert world.kinds("read") == ["enable"]


@in_a_world
async def test_servos_that_do_not_come_are_named(world: World) -> None:
    world.controller.servo = lambda names, order: True  # type: ignore[method-assign]
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match="servos are not on after 5 s"):
        await wire.arm(Permission())
    assert world.controller.manager != Manager.ENABLED


@in_a_world
async def test_a_button_that_is_pressed_while_it_is_powered_ends_it(world: World) -> None:
    world.controller.servo = lambda names, order: world.controller.press(True) is None  # type: ignore[method-assign]
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match="emergency stop"):
        await wire.arm(Permission())


# -- setpoints


@in_a_world
async def test_a_setpoint_names_every_part_with_its_times(world: World) -> None:
    wire = await armed(world)
    target = stepped(world, 0.03)
    await wire.write(target, Permission())
    (data,) = world.setpoints()
    command = Command.decode(data)
    assert command.priority == 1
    assert list(command.parts) == ["right_arm", "left_arm", "torso", "head"]
    assert command.parts["torso"].position == pytest.approx(target[:6])
    assert command.parts["head"].position == pytest.approx(target[20:])
    assert {part.minimum_s for part in command.parts.values()} == {0.02}
    assert {part.hold_s for part in command.parts.values()} == {HOLD_S}
    await cycle(wire, 20)
    assert world.controller.plant.position_rad[0] == pytest.approx(0.03, abs=0.01)


def test_priority_and_frequency_reach_the_wire() -> None:
    async def main() -> None:
        async with World(priority=7, control_frequency=25).living() as world:
            wire = await armed(world)
            await wire.write(stepped(world, 0.03), Permission())
            command = Command.decode(world.setpoints()[0])
            assert (command.priority, command.parts["head"].minimum_s) == (7, 0.04)

    virtual(main)


@in_a_world
async def test_saf_001_a_permit_that_is_gone_lets_nothing_leave(world: World) -> None:
    wire = await armed(world)
    with pytest.raises(PermitDenied):
        await wire.write(stepped(world, 0.02), Permission(denied_at=0))
    assert not world.setpoints()
    assert world.controller.control == Control.IDLE


@in_a_world
async def test_saf_010_nothing_is_written_to_a_robot_that_is_silent(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.frozen = True
    await trio.sleep(QUIET_S + 0.02)
    with pytest.raises(PermitDenied, match="the robot is silent for 1"):
        await wire.write(stepped(world, 0.02), Permission())
    await trio.sleep(0.3)
    with pytest.raises(WireDown, match="silent for 4"):
        await wire.read()


@in_a_world
async def test_saf_012_states_that_repeat_are_no_life(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.service.faults.set(Fault.STUCK)
    with pytest.raises(WireDown, match="silent for 3"):
        await cycle(wire, 60)


@with_each(
    "finish",
    [finish for finish in Finish if finish is not Finish.OK],
)
async def test_a_command_that_the_robot_drops_is_named_and_not_sent_again(world: World, finish: Finish) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    world.controller._end(finish)
    await cycle(wire, 2)
    seen = await wire.read()
    assert seen.faults == {"controller": f"the robot has dropped our command: {finish.name}"}
    with pytest.raises(PermitDenied, match=finish.name):
        await wire.write(stepped(world, 0.02), Permission())
    await wire.make_safe("stop")
    await wire.arm(Permission())
    assert not (await wire.read()).faults
    await wire.write(stepped(world, 0.01), Permission())


@in_a_world
async def test_a_stream_that_the_robot_ends_is_named(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    next(iter(world.service._commands)).end(Status.INTERNAL, "out of order")
    world.streams[-1].flush()
    await cycle(wire)
    assert "INTERNAL (out of order)" in (await wire.read()).faults["controller"]


@in_a_world
async def test_a_command_that_is_not_repeated_ends_and_the_robot_holds(world: World) -> None:
    """The robot's own watchdog, armed in every command; a target that is repeated lives on."""
    wire = await armed(world)
    target = stepped(world, 0.02)
    for _ in range(10):
        await wire.write(target, Permission())
        await cycle(wire, 10)
        assert world.controller.control == Control.EXECUTING
    await cycle(wire, round((HOLD_S + 0.05) / 0.01))
    assert world.controller.control == Control.IDLE
    assert not (await wire.read()).faults, "it did what it was told"
    await wire.write(stepped(world, 0.01), Permission())
    assert world.controller.control == Control.EXECUTING


@in_a_world
async def test_garbage_ends_the_link(world: World) -> None:
    wire = await armed(world)
    world.service.faults.set(Fault.GARBAGE)
    with pytest.raises(WireDown, match="HTTP/2"):
        await cycle(wire, 30)


# -- safe


@with_each("safe_state", ["hold", "stop"])
async def test_saf_005_a_stop_ends_the_stream_cancels_and_is_read_back(world: World, safe_state: str) -> None:
    wire = await armed(world)
    for _ in range(5):
        await wire.write(stepped(world, 0.03), Permission())
        await cycle(wire, 2)
    before = len(world.written)
    began_s = trio.current_time()
    motors = await wire.make_safe(safe_state)
    assert [motor.axis for motor in motors] == list(world.driver.axes)
    assert all(motor.written and motor.acknowledged and motor.safe and not motor.detail for motor in motors)
    assert world.written[before].kind == "safe" and world.written[before].t_s == began_s, "before any wait"
    assert [entry.kind for entry in world.written[before:] if entry.kind != "read"] == ["safe"]
    assert world.controller.manager == Manager.ENABLED
    assert world.controller.control == Control.IDLE
    at = world.controller.plant.position_rad
    await cycle(wire, 50)
    assert world.controller.plant.position_rad == pytest.approx(at, abs=0.005)


@in_a_world
async def test_after_a_stop_the_next_write_opens_a_new_stream(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    (first,) = world.service._commands
    await wire.make_safe("stop")
    assert not world.service._commands
    await wire.arm(Permission())
    await wire.write(stepped(world, 0.02), Permission())
    (second,) = world.service._commands
    assert first is not second


@in_a_world
async def test_saf_005_a_cancel_that_nobody_answers_is_tried_again_then_the_manager_is_disabled(
    world: World,
) -> None:
    wire = await armed(world)
    before, began_s = len(world.written), trio.current_time()
    answer = world.service._obey

    def mute(method: Method, message: bytes) -> bytes:
        if method is Method.CANCEL:
            raise p.MalformedFrame("refused")
        return answer(method, message)

    world.service._obey = mute  # type: ignore[method-assign]
    motors = await wire.make_safe("stop")
    orders = [entry for entry in world.written[before:] if entry.kind == "safe"]
    assert [bool(entry.data) for entry in orders] == [False] * (ATTEMPTS + 1) + [True]
    assert world.controller.manager == Manager.IDLE, "disabled"
    assert all(not motor.safe and "refused" in motor.detail for motor in motors), "nobody said it was done"
    assert trio.current_time() - began_s <= LONGEST_S


@in_a_world
async def test_a_robot_that_goes_on_although_it_was_cancelled_is_disabled(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    world.controller.cancel = lambda: None  # type: ignore[method-assign]
    world.controller.leave = lambda owner: None  # type: ignore[method-assign]
    torso = world.controller._motions["torso"]
    world.controller._motions["torso"] = msgspec.structs.replace(torso, until_s=9e9)
    motors = await wire.make_safe("stop")
    assert all(motor.safe for motor in motors)
    assert world.controller.manager == Manager.IDLE
    assert world.kinds("read", "setpoint", "enable") == ["safe"] * (ATTEMPTS + 2)


@in_a_world
async def test_a_hold_does_not_disable(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    world.controller.cancel = lambda: None  # type: ignore[method-assign]
    world.controller.leave = lambda owner: None  # type: ignore[method-assign]
    torso = world.controller._motions["torso"]
    world.controller._motions["torso"] = msgspec.structs.replace(torso, until_s=9e9)
    motors = await wire.make_safe("hold")
    assert not any(motor.safe for motor in motors)
    assert {motor.detail for motor in motors} == {"its controller is EXECUTING (2)"}
    assert world.controller.manager == Manager.ENABLED


@in_a_world
async def test_saf_005_joints_whose_speed_is_not_told_do_not_stand(world: World) -> None:
    wire = await armed(world)
    state = world.controller.state
    world.controller.state = (
        lambda: msgspec.structs.replace(  # type: ignore[method-assign]
            state(), position=state().position[:22], velocity=state().velocity[:22]
        )
    )
    motors = await wire.make_safe("stop")
    assert [motor.axis for motor in motors if not motor.safe] == ["head_0", "head_1"]
    assert motors[-1].detail == "moves"


@in_a_world
async def test_off_takes_the_power_and_sees_that_it_is_gone(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    began_s, before = trio.current_time(), len(world.written)
    motors = await wire.make_safe("off")
    assert [entry.kind for entry in world.written[before : before + 3]] == ["safe"] * 3
    assert {entry.t_s for entry in world.written[before : before + 3]} == {began_s}, "all before any wait"
    assert not world.controller.supplies["48v"] and not world.controller.runs
    assert world.controller.supplies["24v"], "the computer goes on"
    assert all(motor.written and motor.acknowledged for motor in motors)
    await trio.sleep(2.0)  # the arms have fallen
    again = await wire.make_safe("off")
    assert all(motor.safe for motor in again), [motor for motor in again if not motor.safe][:3]


@in_a_world
async def test_saf_005_a_frozen_robot_is_an_error_that_names_every_joint_and_is_bounded(world: World) -> None:
    wire = await armed(world)
    world.frozen = True
    began_s = trio.current_time()
    motors = await wire.make_safe("stop")
    assert trio.current_time() - began_s == pytest.approx((ATTEMPTS + 1) * ANSWER_S, abs=0.02)
    assert trio.current_time() - began_s < world.driver.timing.safe_s
    assert all(motor.written and not motor.acknowledged and not motor.safe for motor in motors)
    assert {motor.detail for motor in motors} == {"silent"}
    assert len(world.streams) == 2, "another connection was tried"
    assert not world.streams[0].closed, "on which the order still stands"


@in_a_world
async def test_saf_010_what_a_frozen_robot_finds_late_is_followed_by_the_stop(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.frozen = True
    await wire.write(stepped(world, 0.03), Permission())
    assert not any(motor.safe for motor in await wire.make_safe("stop"))
    world.go_on()
    assert world.kinds("read", "enable")[0] == "setpoint", "it was on its way"
    assert set(world.kinds("read", "enable")[1:]) == {"safe"}
    assert world.controller.control == Control.IDLE
    assert world.controller.manager == Manager.IDLE, "the last resort was found, too"


@in_a_world
async def test_saf_010_a_late_command_on_another_connection_is_seen_and_cancelled(world: World) -> None:
    """The root's stop may be taken up before what the dead wire had sent."""
    wire = await armed(world)
    channel = world.stop_channel()
    await cycle(wire, 5)
    async with trio.open_nursery() as nursery:
        await nursery.start(channel.serve)
        world.frozen = True
        await wire.write(stepped(world, 0.04), Permission())
        reports: list[Any] = []

        async def stop() -> None:
            reports.extend(await channel.make_safe("stop"))

        nursery.start_soon(stop)
        await trio.sleep(0.05)
        world.go_on(reversed(world.streams))
        await trio.sleep(1.0)
        nursery.cancel_scope.cancel()
    assert world.kinds("read", "enable", "keepalive") == ["safe", "setpoint", "safe"]
    assert reports and all(motor.safe for motor in reports)
    assert world.controller.control == Control.IDLE
    channel.close()


@in_a_world
async def test_saf_020_a_stop_whose_connection_is_gone_takes_another(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.03), Permission())
    world.streams[-1].close()
    assert all(motor.safe for motor in await wire.make_safe("stop"))
    assert len(world.streams) == 2
    assert world.streams[-1].closed == "in order"
    world.gone = True
    motors = await wire.make_safe("stop")
    assert {(motor.written, motor.safe) for motor in motors} == {(False, False)}
    assert "cannot connect" in motors[0].detail


@in_a_world
async def test_saf_020_a_link_that_was_lost_is_stopped_all_the_same(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.03), Permission())
    wire.close()
    assert world.controller.control == Control.IDLE, "a stream that ends takes its command with it"
    before = len(world.written)
    assert all(motor.safe for motor in await wire.reach("stop"))
    assert world.written[before].kind == "safe", "it asks nothing first"


@in_a_world
async def test_not_connected_is_not_safe(world: World) -> None:
    wire = world.wire()
    motors = await wire.make_safe("stop")
    assert {(motor.written, motor.safe, motor.detail) for motor in motors} == {(False, False, "not connected")}
    with pytest.raises(WireDown, match="Open it first"):
        await wire.read()


# -- the root's stop channel


@in_a_world
async def test_saf_003_the_stop_channel_has_a_connection_of_its_own_before_it_is_needed(world: World) -> None:
    wire = await armed(world)
    channel = world.stop_channel()
    async with trio.open_nursery() as nursery:
        await nursery.start(channel.serve)
        assert len(world.streams) == 2
        await trio.sleep(2.0)
        assert "keepalive" in world.kinds()
        await wire.write(stepped(world, 0.03), Permission())
        began_s = trio.current_time()
        motors = await channel.make_safe("stop")
        safe = next(entry for entry in world.written if entry.kind == "safe")
        assert safe.t_s == began_s, "at once"
        assert all(motor.safe for motor in motors)
        assert len(world.streams) == 2
        nursery.cancel_scope.cancel()
    channel.close()
    assert world.streams[-1].closed == "in order", "so that a frozen robot still finds it"


@in_a_world
async def test_saf_020_a_kept_connection_that_has_died_in_silence_is_not_waited_for_twice(world: World) -> None:
    """Half open: it takes what is written, and nobody is there."""
    wire = await armed(world)
    channel = world.stop_channel()
    async with trio.open_nursery() as nursery:
        await nursery.start(channel.serve)
        kept = world.streams[-1]
        kept._take = lambda data: None  # type: ignore[method-assign]
        await wire.write(stepped(world, 0.03), Permission())
        began_s = trio.current_time()
        motors = await channel.make_safe("stop")
        assert all(motor.safe for motor in motors)
        assert trio.current_time() - began_s < 2 * ANSWER_S + 0.2
        assert not kept.closed
        nursery.cancel_scope.cancel()
    channel.close()
    assert kept.closed == world.streams[-1].closed == "in order"


@in_a_world
async def test_saf_020_a_stop_is_written_to_a_robot_that_cannot_be_understood(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.03), Permission())
    world.service.faults.set(Fault.GARBAGE)
    with pytest.raises(WireDown):
        await cycle(wire, 30)
    wire.close()
    before, began_s = len(world.written), trio.current_time()
    motors = await wire.reach("stop")
    assert world.written[before].kind == "safe" and world.written[before].t_s == began_s
    assert all(motor.written and not motor.safe for motor in motors)
    assert "HTTP/2" in motors[0].detail


@in_a_world
async def test_a_robot_that_speaks_and_does_nothing_does_not_collect_connections(world: World) -> None:
    await armed(world)
    world.service.message = lambda call, t_ns, message: None  # type: ignore[method-assign]
    channel = world.stop_channel()
    for _ in range(6):
        began_s = trio.current_time()
        motors = await channel.make_safe("stop")
        assert {motor.detail for motor in motors} == {"silent"}
        assert trio.current_time() - began_s <= LONGEST_S + 0.01 < world.driver.timing.safe_s
    assert sum(not stream.closed for stream in world.streams) <= 1 + KEPT + 1, (
        "the wire's, the last ones, the newest"
    )
    channel.close()
    assert sum(not stream.closed for stream in world.streams) == 1


@in_a_world
async def test_a_connection_that_is_lost_is_replaced(world: World) -> None:
    channel = world.stop_channel()
    async with trio.open_nursery() as nursery:
        await nursery.start(channel.serve)
        world.streams[-1].close()
        await trio.sleep(1.5)
        assert len(world.streams) == 2 and not world.streams[-1].closed
        nursery.cancel_scope.cancel()
    channel.close()


@in_a_world
async def test_a_stop_channel_that_nobody_serves_connects_when_it_is_used(world: World) -> None:
    await armed(world)
    channel = world.stop_channel()
    assert all(motor.safe for motor in await channel.make_safe("stop"))
    world.gone = True
    world.streams[-1].close()
    motors = await channel.make_safe("stop")
    assert not any(motor.written for motor in motors)
    world.gone = False
    assert all(motor.safe for motor in await channel.make_safe("stop")), "it finds the robot anew"
    channel.close()
