"""SAF-021: a robot may carry out a late request of a dead wire process after the root's stop.

The tests run on the twins' controllers, in virtual time. They check that the stop still counts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel
from strands_actors.drivers.rby1 import protocol as rby1
from strands_actors.drivers.rby1.protocol import Control, JointOrder, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.robotiq import protocol as robotiq
from strands_actors.drivers.robotiq.protocol import Activation
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.spot import protocol as spot
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.xarm import protocol as xarm
from strands_actors.drivers.xarm.protocol import Mode, Register, State
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.stop_channel import settled
from strands_actors.testing import run_virtual
from tests.drivers.rby1.rig import World as RBY1World
from tests.drivers.robotiq.rig import Rig as RobotiqRig
from tests.drivers.spot.rig import Go
from tests.drivers.spot.rig import World as SpotWorld
from tests.drivers.xarm.rig import World as XArmWorld

LATE = 0.9
"""When the robot carries a request out, as a share of the longest delay that its driver declares."""


async def stopped(
    driver: Driver, channel: StopChannel, state: SafeState, late: Callable[[], None]
) -> tuple[float, tuple[MotorReport, ...]]:
    """Stop through the channel, as the root does after the end of a wire process with a pending request.

    Returns:
        Seconds until the stop was reported, and the report.
    """
    safety_page, clock, began_s = SafetyPage(), VirtualClock(), trio.current_time()
    safety_page.ask(round(driver.late_s * NS))
    safety_page.cut_off(clock.now_ns())

    async def take_up() -> None:
        await trio.sleep(LATE * driver.late_s)
        late()

    async with trio.open_nursery() as nursery:
        nursery.start_soon(take_up)
        motors = await settled(safety_page, clock, partial(channel.make_safe, state))
    assert all(motor.safe for motor in motors), motors
    return trio.current_time() - began_s, motors


def test_saf_021_an_xarm_that_takes_up_an_arming_late_is_stopped_again() -> None:
    async def test() -> None:
        world = XArmWorld()
        wire = world.wire()
        await wire.open()
        wires = world.connections[0]

        def arm_late() -> None:
            for number, (register, data) in enumerate(
                (
                    (Register.MOTION_ENABLE, bytes((xarm.ALL_JOINTS, 1))),
                    (Register.SET_MODE, bytes((Mode.SERVO,))),
                    (Register.SET_STATE, bytes((State.GO,))),
                ),
                1000,
            ):
                wires.write(xarm.request(number, register, data))
            assert world.controller.runs

        took_s, _ = await stopped(world.driver, world.stop_channel(), SafeState.STOP, arm_late)
        assert took_s >= world.driver.late_s
        assert world.controller.state == State.STOPPED and not world.controller.runs
        assert world.kinds("read")[-1] == "safe"

    run_virtual(test)


def test_saf_021_a_gripper_that_takes_up_its_activation_late_is_reset() -> None:
    async def test() -> None:
        rig = RobotiqRig()
        await rig.wire.open()
        wires = rig.ports[0]
        gripper = rig.wire.session.gripper
        channel = RobotiqStopChannel(rig.driver.config, (), rig.clock, rig.connect)

        def activate_late() -> None:
            gripper.write(robotiq.ACTIVATE)
            assert not wires.closed and rig.twin.status().activation == Activation.ACTIVATING

        await stopped(rig.driver, channel, SafeState.HOLD, activate_late)
        assert rig.twin.status().activation == Activation.RESET
        assert rig.written[-1] == "safe"

    run_virtual(test)


def test_saf_021_an_rby1_that_takes_up_an_arming_late_is_cancelled_again() -> None:
    async def test() -> None:
        world = RBY1World()
        async with world.living():
            wire = world.wire()
            await wire.open()
            wires = wire.session.connection

            def arm_late() -> None:
                wires.ask(Method.POWER, rby1.encode_order(rby1.ALL, PowerOrder.ON))
                wires.ask(Method.JOINT, rby1.encode_order(rby1.ALL, JointOrder.SERVO_ON))
                wires.ask(Method.MANAGER, rby1.encode_manager_order(ManagerOrder.ENABLE))
                assert world.controller.driven

            await stopped(world.driver, world.stop_channel(), SafeState.STOP, arm_late)
            assert not world.controller.driven and world.controller.control == Control.IDLE
            assert world.kinds("read", "keepalive")[-1] == "safe"

    run_virtual(test)


def test_saf_021_a_spot_refuses_late_requests_after_its_estop_was_asserted() -> None:
    async def test() -> None:
        world = SpotWorld()
        wire = world.wire()
        await wire.open()
        await wire.arm(Go())
        session, lease, estop = wire.session, wire._lease, wire._estop
        checked_in = estop.send_check_in(spot.StopLevel.NONE)
        await estop.read_check_in(checked_in)

        def ask_late() -> None:
            estop.send_check_in(spot.StopLevel.NONE)  # its challenge dates from before the stop
            session.ask("PowerCommand", {"lease": lease.use(), "request": spot.POWER_ON})
            session.ask("RobotCommand", {"lease": lease.use(), "command": spot.stand()})

        await stopped(world.driver, world.stop_channel(), SafeState.SETTLE, ask_late)
        await trio.sleep(1.0)
        assert world.twin.mechanism.motors is Motors.OFF
        assert world.names("enable") == [] and len(world.of("PowerCommand")) == 1
        assert world.twin.estop.level is not spot.StopLevel.NONE

    run_virtual(test)
