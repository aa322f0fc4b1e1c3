"""Test the wire in virtual time, on the twin's services: its writes, their order, and which answers it accepts."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.grpc_messages import Status
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import Finish
from strands_actors.drivers.rby1.driver import HOLD_S
from strands_actors.drivers.rby1.protocol import Control, Manager, Method
from strands_actors.drivers.rby1.twin.requests import Request
from strands_actors.drivers.rby1.wire import QUIET_S, RBY1Wire
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import Permission, virtual

from .rig import World, armed, cycle, in_a_world, moves, stepped, with_each

# -- opening


@in_a_world
async def test_opening_only_reads_and_moves_nothing(world: World) -> None:
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
    with pytest.raises(WireDown, match="reports model UB, without right_arm_0, "):
        await world.wire().open()
    assert world.streams[-1].closed


@in_a_world
async def test_joints_in_another_order_are_another_robot(world: World) -> None:
    """Rows of a state have no names. With another order a stop would read the wrong joints."""
    info = world.controller.info
    order = [*info.joints[:-2], info.joints[-1], info.joints[-2]]
    world.controller.info = msgspec.structs.replace(info, joints=tuple(order))
    with pytest.raises(WireDown, match="without head_0, head_1 where a model A has them"):
        await world.wire().open()


@with_each("urdf", ["", "<robot/>", "no xml", '<robot><joint name="torso_0"/></robot>'])
async def test_limits_for_fewer_joints_than_named_refuse_bring_up(world: World, urdf: str) -> None:
    world.controller.devices.urdf = urdf
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
async def test_a_robot_that_accepts_a_connection_and_never_answers_is_named(world: World) -> None:
    world.frozen = True
    with pytest.raises(WireDown, match="no gRPC service answers"):
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
    assert world.kinds("read") == ["enable"] * 3, "a supply that is on is not switched on again"


@in_a_world
async def test_the_emergency_stop_button_is_refused_before_power_on(world: World) -> None:
    world.controller.press(True)
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match=r"the emergency stop button is pressed\. Release the button"):
        await wire.arm(Permission())
    assert set(world.kinds()) == {"read"}
    world.controller.press(False)
    await wire.arm(Permission())


@with_each("fault", [Manager.MINOR_FAULT, Manager.MAJOR_FAULT])
async def test_a_fault_is_refused_before_power_on_and_can_be_cleared(world: World, fault: Manager) -> None:
    world.controller.fail(fault)
    wire = world.wire()
    await wire.open()
    with pytest.raises(WireDown, match=rf"reports {fault.name} .*reset_fault_control_manager\(\) and resume\(\)"):
        await wire.arm(Permission())
    assert set(world.kinds()) == {"read"}
    assert await wire.perform("reset_fault_control_manager", {}, Permission()) == {"control_manager": "IDLE (1)"}
    assert world.kinds("read") == ["config"]
    await wire.arm(Permission())


def no_error(answer: bytes) -> bytes:
    return p.headed(answer)


def over_current(answer: bytes) -> bytes:
    error = pb.varint_field(1, 9) + pb.bytes_field(2, b"motor 3 over current")
    return pb.bytes_field(1, pb.bytes_field(4, error)) + answer


@with_each(
    "answered",
    [
        (no_error, Manager.MAJOR_FAULT, "the control manager is MAJOR_FAULT (4)"),
        (no_error, Manager.UNKNOWN, "the control manager is UNKNOWN (0)"),
        (over_current, Manager.MAJOR_FAULT, "motor 3 over current"),
        (over_current, Manager.IDLE, "motor 3 over current"),
    ],
)
async def test_a_fault_that_was_not_cleared_is_refused(
    world: World, answered: tuple[Callable[[bytes], bytes], Manager, str]
) -> None:
    """The robot refuses to clear the fault, or the cause of the fault remains."""
    headed, state, why = answered
    world.controller.fail(Manager.MAJOR_FAULT)
    wire = world.wire()
    await wire.open()
    message = world.service.message

    def refuses(call: ServerCall, t_ns: int, asked: bytes) -> None:
        if call.path == Method.MANAGER:
            call.answer(headed(p.encode_manager_answer(p.ManagerState(state))))
        else:
            message(call, t_ns, asked)

    world.service.message = refuses  # type: ignore[method-assign]
    refusal = await wire.perform("reset_fault_control_manager", {}, Permission())
    assert isinstance(refusal, Refused)
    assert refusal.code == "not_reset" and why in refusal.text


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
        for _ in range(denied_at):  # deny a later check than arm() made
            Watched().check()
    assert len(world.kinds("read")) == seen[-1], "nothing is written after the permit is denied"


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
    assert Request.decode(data).priority == 1
    parts = moves(data)
    assert list(parts) == ["right_arm", "left_arm", "torso", "head"]
    assert parts["torso"].position == pytest.approx(target[:6])
    assert parts["head"].position == pytest.approx(target[20:])
    assert {part.minimum_s for part in parts.values()} == {0.02}
    assert {part.hold_s for part in parts.values()} == {HOLD_S}
    await cycle(wire, 20)
    assert world.controller.plant.position_rad[0] == pytest.approx(0.03, abs=0.01)


def test_priority_and_frequency_reach_the_wire() -> None:
    async def main() -> None:
        async with World(priority=7, control_frequency=25).living() as world:
            wire = await armed(world)
            await wire.write(stepped(world, 0.03), Permission())
            (data,) = world.setpoints()
            assert (Request.decode(data).priority, moves(data)["head"].minimum_s) == (7, 0.04)

    virtual(main)


@in_a_world
async def test_saf_001_nothing_is_sent_after_the_permit_is_withdrawn(world: World) -> None:
    wire = await armed(world)
    with pytest.raises(PermitDenied):
        await wire.write(stepped(world, 0.02), Permission(denied_at=0))
    assert not world.setpoints()
    assert world.controller.control == Control.IDLE


@in_a_world
async def test_saf_010_nothing_is_written_to_a_silent_robot(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.frozen = True
    await trio.sleep(QUIET_S + 0.02)
    with pytest.raises(PermitDenied, match="the robot has sent no new state for 1"):
        await wire.write(stepped(world, 0.02), Permission())
    await trio.sleep(0.3)
    with pytest.raises(WireDown, match="no new state for 4"):
        await wire.read()


@in_a_world
async def test_saf_012_states_that_repeat_are_no_life(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.service.faults.set(Fault.STUCK)
    with pytest.raises(WireDown, match="no new state for 3"):
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
async def test_a_stream_that_the_robot_ends_without_an_error_is_not_reopened(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    next(iter(world.service._commands)).end()
    world.streams[-1].flush()
    await cycle(wire)
    assert (await wire.read()).faults["controller"].startswith("the stream of commands has ended: ")
    with pytest.raises(PermitDenied, match="has ended"):
        await wire.write(stepped(world, 0.02), Permission())
    assert len(world.setpoints()) == 1
    await wire.make_safe("stop")
    await wire.arm(Permission())
    assert not (await wire.read()).faults
    await wire.write(stepped(world, 0.01), Permission())


@in_a_world
async def test_a_command_that_is_not_repeated_ends_and_the_robot_holds(world: World) -> None:
    """The robot's own watchdog is armed in every command. A repeated target stays live."""
    wire = await armed(world)
    target = stepped(world, 0.02)
    for _ in range(10):
        await wire.write(target, Permission())
        await cycle(wire, 10)
        assert world.controller.control == Control.EXECUTING
    await cycle(wire, round((HOLD_S + 0.05) / 0.01))
    assert world.controller.control == Control.IDLE
    assert not (await wire.read()).faults, "the robot carried the command out"
    await wire.write(stepped(world, 0.01), Permission())
    assert world.controller.control == Control.EXECUTING


@in_a_world
async def test_garbage_ends_the_link(world: World) -> None:
    wire = await armed(world)
    world.service.faults.set(Fault.GARBAGE)
    with pytest.raises(WireDown, match="HTTP/2"):
        await cycle(wire, 30)
