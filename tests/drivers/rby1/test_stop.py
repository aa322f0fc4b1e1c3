"""Test what stops the robot, in virtual time on the twin's services: the wire, a lost link, the root's stop
channel."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.grpc_messages import Status
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.protocol import Control, Manager, Method, Power
from strands_actors.drivers.rby1.stop_channel import KEPT
from strands_actors.drivers.rby1.stopping import ANSWER_S, ATTEMPTS, LONGEST_S
from tests.drivers.common.memory_port import Permission

from .rig import World, armed, cycle, in_a_world, stepped, with_each

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
    assert world.written[before].kind == "safe" and world.written[before].t_s == began_s, (
        "the stop is written before any wait"
    )
    assert [entry.kind for entry in world.written[before:] if entry.kind != "read"] == ["safe"]
    assert world.controller.manager == Manager.ENABLED
    assert world.controller.control == Control.IDLE
    at = world.controller.plant.position_rad
    await cycle(wire, 50)
    assert world.controller.plant.position_rad == pytest.approx(at, abs=0.005)


@in_a_world
async def test_saf_011_a_hold_reports_its_position(world: World) -> None:
    """The report has the hold position, and not the position when the hold was sent."""
    wire = await armed(world)
    head, target = -2, world.controller.plant.position_rad
    for _ in range(15):
        target = (*target[:head], target[head] + 0.03, target[-1])
        await wire.write(target, Permission())
        await cycle(wire, 2)
    before = (await wire.read()).position
    motors = await wire.make_safe("hold")
    held = tuple(motor.target for motor in motors if motor.target is not None)
    assert len(held) == 22 and held[head] - before[head] > 0.01, "the joint moved on while it braked"
    assert held == pytest.approx(world.controller.plant.position_rad, abs=2e-3)
    await wire.write(held, Permission())
    await cycle(wire, 30)
    assert world.controller.plant.position_rad == pytest.approx(held, abs=5e-3)


@with_each("safe_state", ["hold", "stop"])
async def test_saf_005_states_that_repeat_prove_no_standstill(world: World, safe_state: str) -> None:
    """The robot answers but does nothing. It repeats a report of a standstill."""
    wire = await armed(world)
    await cycle(wire, 5)
    world.service.faults.set(Fault.STUCK)
    before, began_s = len(world.written), trio.current_time()
    motors = await wire.make_safe(safe_state)
    assert trio.current_time() - began_s <= LONGEST_S
    assert {(motor.written, motor.safe, motor.target) for motor in motors} == {(True, False, None)}
    assert {motor.detail for motor in motors} == {"the robot's states do not change"}
    orders = [entry for entry in world.written[before:] if entry.kind == "safe"]
    assert len(orders) == (ATTEMPTS if safe_state == "hold" else ATTEMPTS + 2), "the stop is tried again"
    world.service.faults.set(Fault.OK)
    assert all(motor.safe for motor in await wire.make_safe(safe_state))


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
async def test_saf_005_an_unanswered_cancel_is_retried_then_the_manager_is_disabled(
    world: World,
) -> None:
    wire = await armed(world)
    before, began_s = len(world.written), trio.current_time()
    answer = world.service._order

    def mute(method: Method, message: bytes) -> bytes:
        if method is Method.CANCEL:
            raise p.MalformedFrame("refused")
        return answer(method, message)

    world.service._order = mute  # type: ignore[method-assign]
    motors = await wire.make_safe("stop")
    orders = [entry for entry in world.written[before:] if entry.kind == "safe"]
    assert [bool(entry.data) for entry in orders] == [False] * (ATTEMPTS + 1) + [True]
    assert world.controller.manager == Manager.IDLE, "the control manager is disabled"
    assert all(not motor.safe and "refused" in motor.detail for motor in motors), (
        "the robot did not confirm the stop"
    )
    assert trio.current_time() - began_s <= LONGEST_S


@in_a_world
async def test_a_robot_that_goes_on_although_it_was_cancelled_is_disabled(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    world.controller.cancel = lambda: None  # type: ignore[method-assign]
    world.controller.leave = lambda owner: None  # type: ignore[method-assign]
    world.controller._motions[0]._until_s = 9e9
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
    world.controller._motions[0]._until_s = 9e9
    motors = await wire.make_safe("hold")
    assert not any(motor.safe for motor in motors)
    assert {motor.detail for motor in motors} == {"its controller is EXECUTING (2)"}
    assert {motor.target for motor in motors} == {None}, "no hold position was seen"
    assert world.controller.manager == Manager.ENABLED


@in_a_world
async def test_saf_005_joints_without_a_reported_speed_do_not_count_as_at_rest(world: World) -> None:
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
async def test_off_cuts_the_power_and_verifies_it(world: World) -> None:
    wire = await armed(world)
    await wire.write(stepped(world, 0.02), Permission())
    began_s, before = trio.current_time(), len(world.written)
    motors = await wire.make_safe("off")
    assert [entry.kind for entry in world.written[before : before + 3]] == ["safe"] * 3
    assert {entry.t_s for entry in world.written[before : before + 3]} == {began_s}, (
        "three orders are written before any wait"
    )
    assert not world.controller.supplies["48v"] and not world.controller.runs
    assert world.controller.supplies["24v"], "the supply of the computer stays on"
    assert all(motor.written and motor.acknowledged for motor in motors)
    await trio.sleep(2.0)  # the arms have fallen
    again = await wire.make_safe("off")
    assert all(motor.safe for motor in again), [motor for motor in again if not motor.safe][:3]
    assert {motor.target for motor in again} == {None}, "fallen arms have no hold position"


def refused(answer: bytes) -> bytes:
    """Return an answer with an error in its header."""
    error = pb.varint_field(1, 9) + pb.bytes_field(2, b"nothing to cancel")
    return pb.bytes_field(1, pb.bytes_field(4, error)) + answer


@with_each("by_status", [False, True])
async def test_saf_005_power_that_is_off_is_seen_though_the_robot_refuses_the_other_orders(
    world: World, by_status: bool
) -> None:
    """An idle control manager may have nothing to cancel."""
    wire = await armed(world)
    channel = world.stop_channel()
    await wire.make_safe("off")
    await trio.sleep(2.0)  # the arms have fallen
    message = world.service.message

    def refuses(call: ServerCall, t_ns: int, asked: bytes) -> None:
        if call.path != Method.CANCEL:
            message(call, t_ns, asked)
        elif by_status:
            call.end(Status.FAILED_PRECONDITION, "nothing to cancel")
        else:
            call.answer(refused(b""))

    world.service.message = refuses  # type: ignore[method-assign]
    for way in (wire, channel):
        motors = await way.make_safe("off")
        assert {(motor.written, motor.safe) for motor in motors} == {(True, True)}
    world.controller.supplies["48v"] = True
    world.controller.power = lambda names, on: True  # type: ignore[method-assign]
    for way in (wire, channel):
        motors = await way.make_safe("off")
        assert {(motor.written, motor.safe) for motor in motors} == {(True, False)}
        assert all("nothing to cancel" in motor.detail for motor in motors)
    channel.close()


@pytest.mark.quick_cases(2)
@with_each(
    "powers",
    [
        (Power.OFF, Power.ON, Power.ON, Power.ON),
        (Power.OFF, Power.OFF, Power.OFF, Power.ON),
        (Power.ON, Power.ON, Power.ON, Power.UNKNOWN),
        (Power.OFF, Power.OFF, Power.OFF),
        (),
    ],
)
async def test_saf_005_off_is_confirmed_only_by_the_supply_of_the_motors(
    world: World, powers: tuple[Power, ...]
) -> None:
    """The power of one other supply does not count, nor does a robot without a report of its supplies."""
    wire = await armed(world)
    state, told = world.controller.state, powers
    world.controller.state = lambda: msgspec.structs.replace(state(), powers=told)  # type: ignore[method-assign]
    assert all(motor.safe for motor in await wire.make_safe("stop"))
    world.controller.power("48v", False)
    await trio.sleep(2.0)  # the arms have fallen
    channel = world.stop_channel()
    for way in (wire, channel):
        before = len(world.written)
        motors = await way.make_safe("off")
        orders = [entry for entry in world.written[before:] if entry.kind == "safe"]
        assert len(orders) == 3 * ATTEMPTS, "the stop is tried again"
        assert {(motor.written, motor.safe) for motor in motors} == {(True, False)}
        assert {motor.detail for motor in motors} == {"its 48v supply is not reported as off"}
    told = (Power.ON, Power.ON, Power.ON, Power.OFF)
    for way in (wire, channel):
        assert all(motor.safe for motor in await way.make_safe("off"))
    channel.close()


@in_a_world
async def test_the_supply_of_the_motors_is_found_by_its_name(world: World) -> None:
    info = world.controller.info
    wire = await armed(world)
    world.controller.supplies["48v"] = False
    world.controller._servos_off(range(24))
    await trio.sleep(2.0)
    world.controller.info = msgspec.structs.replace(info, supplies=("48v", "24v", "12v", "5v"))
    assert not any(motor.safe for motor in await wire.make_safe("off")), "the first supply is on"
    world.controller.info = msgspec.structs.replace(info, supplies=("5v", "12v", "24v", "motors"))
    assert not any(motor.safe for motor in await wire.make_safe("off")), "no supply has that name"
    world.controller.info = info
    assert all(motor.safe for motor in await wire.make_safe("off"))


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
    assert not world.streams[0].closed, "the first connection stays open, because the stop is pending on it"


@in_a_world
async def test_saf_010_a_late_setpoint_of_a_frozen_robot_is_followed_by_the_stop(world: World) -> None:
    wire = await armed(world)
    await cycle(wire, 5)
    world.frozen = True
    await wire.write(stepped(world, 0.03), Permission())
    assert not any(motor.safe for motor in await wire.make_safe("stop"))
    world.go_on()
    assert world.kinds("read", "enable")[0] == "setpoint", "the setpoint was under way"
    assert set(world.kinds("read", "enable")[1:]) == {"safe"}
    assert world.controller.control == Control.IDLE
    assert world.controller.manager == Manager.IDLE, (
        "the robot also carried out the last resort: it disabled the manager"
    )


@in_a_world
async def test_saf_010_a_late_command_on_another_connection_is_seen_and_cancelled(world: World) -> None:
    """The robot may process the root's stop before the messages of the dead wire."""
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
async def test_saf_020_a_stop_without_a_connection_opens_another(world: World) -> None:
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
    assert world.controller.control == Control.IDLE, "the end of a stream ends its command"
    before = len(world.written)
    assert all(motor.safe for motor in await wire.reach("stop"))
    assert world.written[before].kind == "safe", "the stop is written before any question"


@with_each("safe_state", ["stop", "off"])
async def test_saf_020_a_lost_link_carries_the_stop_if_no_other_can_be_opened(
    world: World, safe_state: str
) -> None:
    """Only the direction from the robot is interrupted. So a new connection cannot be made."""
    wire = await armed(world)
    await wire.write(stepped(world, 0.03), Permission())

    async def cannot_connect(host: str, port: int) -> Any:
        await trio.lowlevel.checkpoint()
        raise WireDown("cannot connect")

    wire._open_stream = cannot_connect
    before, began_s = len(world.written), trio.current_time()
    motors = await wire.reach(safe_state)
    orders = world.written[before:]
    assert [entry.kind for entry in orders] == ["safe"] * (3 if safe_state == "off" else 1)
    assert {entry.t_s for entry in orders} == {began_s}, "all of them before the first wait"
    assert {(motor.written, motor.safe, motor.detail) for motor in motors} == {(True, False, "cannot connect")}
    assert world.controller.manager == (Manager.IDLE if safe_state == "off" else Manager.ENABLED)


@with_each("is_lost", [False, True])
async def test_saf_021_a_stop_on_another_connection_drops_what_waits_on_the_first(
    world: World, is_lost: bool
) -> None:
    """The first connection is half open: what is written there may still arrive."""
    wire = await armed(world)
    first = world.streams[-1]
    first._take = lambda data: None  # type: ignore[method-assign]
    await wire.write(stepped(world, 0.03), Permission())
    before = len(world.written)
    motors = await (wire.reach("stop") if is_lost else wire.make_safe("stop"))
    assert all(motor.safe for motor in motors)
    assert first.closed == "reset"
    kinds = [entry.kind for entry in world.written[before:] if entry.kind != "read"]
    assert kinds == ["safe", "safe"], "the robot is stopped again after the reset"


@in_a_world
async def test_not_connected_is_not_safe(world: World) -> None:
    wire = world.wire()
    motors = await wire.make_safe("stop")
    assert {(motor.written, motor.safe, motor.detail) for motor in motors} == {(False, False, "not connected")}
    with pytest.raises(WireDown, match="Open the connection first"):
        await wire.read()


# -- the root's stop channel


@in_a_world
async def test_saf_003_the_stop_channel_opens_a_separate_connection_early(world: World) -> None:
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
    assert world.streams[-1].closed == "in order", (
        "it is closed in order, so that a frozen robot can still read the stop"
    )


@in_a_world
async def test_saf_020_a_dead_kept_connection_delays_only_one_attempt(world: World) -> None:
    """The connection is half open. It accepts written bytes, but has no peer."""
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
async def test_a_robot_that_ignores_stops_does_not_collect_connections(world: World) -> None:
    await armed(world)
    world.service.message = lambda call, t_ns, message: None  # type: ignore[method-assign]
    channel = world.stop_channel()
    for _ in range(6):
        began_s = trio.current_time()
        motors = await channel.make_safe("stop")
        assert {motor.detail for motor in motors} == {"silent"}
        assert trio.current_time() - began_s <= LONGEST_S + 0.01 < world.driver.timing.safe_s
    assert sum(not stream.closed for stream in world.streams) <= 1 + KEPT + 1, (
        "open are the wire's connection, the kept ones and the newest"
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
async def test_a_stop_channel_that_is_not_served_connects_when_it_is_used(world: World) -> None:
    await armed(world)
    channel = world.stop_channel()
    assert all(motor.safe for motor in await channel.make_safe("stop"))
    world.gone = True
    world.streams[-1].close()
    motors = await channel.make_safe("stop")
    assert not any(motor.written for motor in motors)
    world.gone = False
    assert all(motor.safe for motor in await channel.make_safe("stop")), "the channel connects to the robot again"
    channel.close()
