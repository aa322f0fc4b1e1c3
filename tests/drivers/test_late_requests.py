"""SAF-021: a robot may carry out a late request of a dead wire process after the root's stop.

The tests run on the twins' controllers, in virtual time. They check that the stop still counts.
"""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.booster.rpc import Mode as BoosterMode
from strands_actors.drivers.crazyflie import protocol as crazyflie
from strands_actors.drivers.rby1 import protocol as rby1
from strands_actors.drivers.rby1.protocol import Control, JointOrder, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.robotiq import protocol as robotiq
from strands_actors.drivers.robotiq.protocol import Activation
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.spot import protocol as spot
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.unitree import link as unitree_link
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions
from strands_actors.drivers.unitree.walking.driver import G1Walking, Go2Walking
from strands_actors.drivers.unitree.walking.sport import LIE
from strands_actors.drivers.ur.protocol import RuntimeState
from strands_actors.drivers.xarm import protocol as xarm
from strands_actors.drivers.xarm.protocol import Mode, Register, State
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.stop_channel import settled
from strands_actors.testing import run_virtual
from tests.drivers.rby1.rig import World as RBY1World
from tests.drivers.robotiq.rig import Rig as RobotiqRig
from tests.drivers.spot.rig import Go
from tests.drivers.spot.rig import World as SpotWorld
from tests.drivers.xarm.rig import World as XArmWorld
from tests.hostile.bench import Bench
from tests.hostile.dds_network import ROBOT, Network
from tests.hostile.peer import HostilePeer, Steps
from tests.hostile.rigs import RIGS
from tests.hostile.services import EntryLog

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


class Late(NamedTuple):
    """A service, or an arming, that a robot in memory carries out after the stop."""

    robot: str
    verb: str
    took: Callable[[Any], bool]
    """Returns whether the robot shows the effect of the request."""
    ended: Callable[[Any], bool]
    """Returns whether the stop has ended that effect, as far as a stop of this robot ends it."""
    arguments: Mapping[str, Any] = {}
    before: tuple[str, ...] = ()
    prepare: Callable[[Any], None] = lambda robot: None
    """Puts the robot into the state before the request."""
    reason: Reason = Reason.CALLER
    send: Callable[[Any], Awaitable[Any]] | None = None
    """Sends the request by the wire. None: the wire performs the verb, which begins with the request."""

    def __str__(self) -> str:
        return "-".join((self.robot, self.verb, *(() if self.reason is Reason.CALLER else (self.reason,))))


def _walking(robot: str) -> Bench:
    log, network = EntryLog(), Network(HostilePeer(Steps()))
    server = UnitreeServer(model_of(robot), log, UnitreeTwinOptions(host=ROBOT, keeps_s=0.0))  # type: ignore[arg-type]
    driver_class = {"unitree_go2": Go2Walking, "unitree_g1": G1Walking}[robot]
    driver = driver_class(robot, f"{ROBOT}:7410", {"level": "sport"})
    return Bench(driver, lambda: log.entries, lambda: network.serving(server, unitree_link), server.onboard)


def _bench_of(robot: str) -> Bench:
    name, _, level = robot.partition(":")
    return _walking(name) if level else RIGS[name].make(HostilePeer(Steps()))


def _duck_stands(duck: Any) -> bool:
    return not any(duck.body.requested)


def _stands(onboard: Any) -> bool:
    return not any(onboard.gait.twist)


def _is_limp(onboard: Any) -> bool:
    return not onboard.commanded


LATE_VERBS = [
    Late(
        "ur5e",
        "resume",
        lambda controller: controller.runtime_state == RuntimeState.PLAYING,
        lambda controller: controller.runtime_state == RuntimeState.STOPPED,
    ),
    Late("reachy_mini", "wake", lambda twin: twin.body.move is not None, lambda twin: twin.body.move is None),
    Late("reachy_mini", "track_face", lambda twin: twin.tracking, lambda twin: not twin.tracking),
    Late(
        "reachy_mini",
        "motors",
        lambda twin: twin.body.mode == "enabled",
        lambda twin: twin.body.mode == "disabled",
        prepare=lambda twin: twin.body.set_mode("disabled"),
        reason=Reason.ESTOP,
    ),
    Late(
        "crazyflie",
        "takeoff",
        lambda firmware: firmware.armed,
        lambda firmware: not firmware.motors_on and not firmware.armed,
        send=lambda wire: wire.session.send(crazyflie.ARM),
    ),
    Late(
        "microduck",
        "enable",
        lambda duck: duck.body.enabled,
        _duck_stands,
        prepare=lambda duck: duck.body.enable(False),
    ),
    Late("microduck", "do", lambda duck: duck.body.skill, _duck_stands, {"skill": "kick_left"}),
    Late(
        "booster_t1",
        "enable_upper_body",
        lambda onboard: onboard.host_has_arms,
        lambda onboard: not onboard.host_has_arms,
    ),
    Late(
        "booster_t1",
        "move",
        lambda onboard: any(onboard.twist),
        lambda onboard: not any(onboard.twist),
        {"vx": 0.2},
    ),
    Late(
        "booster_t1",
        "change_mode",
        lambda onboard: onboard.mode is BoosterMode.PREPARE,
        lambda onboard: not any(onboard.twist) and not onboard.host_has_arms,
        {"mode": "prepare"},
    ),
    Late(
        "unitree_go2",
        "release_sport_mode",
        lambda onboard: not onboard.mode,
        _is_limp,
        prepare=lambda onboard: onboard.set_mode("normal"),
    ),
    Late(
        "unitree_go2:sport",
        "stand_up",
        lambda onboard: onboard.gait.next_mode != LIE,
        _stands,
        prepare=lambda onboard: onboard.gait.become(LIE),
    ),
    Late(
        "unitree_go2:sport",
        "select_sport_mode",
        lambda onboard: bool(onboard.mode),
        _stands,
        prepare=lambda onboard: onboard.set_mode(""),
    ),
    Late("unitree_g1:sport", "squat", lambda onboard: not onboard.gait.walks, _stands),
]


@pytest.mark.parametrize("row", LATE_VERBS, ids=str)
def test_saf_021_a_request_that_is_taken_up_late_is_ended_by_the_stop_that_counts(row: Late) -> None:
    """The wire process sends the request, and the robot takes it up after the root has stopped it."""

    async def test() -> None:
        await trio.sleep(1.0)  # at the time 0 the code would count everything as just tried
        bench, clock = _bench_of(row.robot), VirtualClock()
        driver, robot = bench.driver, bench.robot
        async with bench.living(), trio.open_nursery() as nursery:
            wire = driver.open_wire(clock)
            await wire.open()
            await nursery.start(wire.serve)
            if row.verb != "resume":
                await wire.arm(Go())
            for service in row.before:
                await wire.perform(service, {}, Go())
            row.prepare(robot)
            assert not row.took(robot), "the request would have no effect"
            channel = driver.stop_channel((), clock)
            await nursery.start(channel.serve)
            taken = trio.Event()

            async def watch() -> None:
                while not row.took(robot):  # noqa: ASYNC110  # the robot in memory has no event
                    await trio.sleep(0.001)
                taken.set()

            async def ask() -> None:
                with contextlib.suppress(WireDown):
                    if row.send is not None:
                        await row.send(wire)
                    elif row.verb == "resume":
                        await wire.arm(Go())
                    else:
                        answer = await wire.perform(row.verb, row.arguments, Go())
                        assert not isinstance(answer, Refused) or taken.is_set(), answer

            async def read() -> None:
                with contextlib.suppress(WireDown):
                    while True:
                        await wire.read()
                        await trio.sleep(0.01)

            def late() -> None:
                nursery.start_soon(watch)
                nursery.start_soon(ask)

            nursery.start_soon(read)
            took_s, _ = await stopped(driver, channel, driver.fallbacks[row.reason], late)
            assert taken.is_set(), "the request was not taken up"
            assert took_s >= driver.late_s
            assert row.ended(robot)
            await trio.sleep(driver.late_s)
            assert row.ended(robot)
            nursery.cancel_scope.cancel()

    run_virtual(test)


OTHER_TESTS: Mapping[str, str] = {
    wire: path if "::" in path else f"tests/drivers/test_late_requests.py::{path}"
    for wire, path in {
        "xarm": test_saf_021_an_xarm_that_takes_up_an_arming_late_is_stopped_again.__name__,
        "robotiq": test_saf_021_a_gripper_that_takes_up_its_activation_late_is_reset.__name__,
        "rby1": test_saf_021_an_rby1_that_takes_up_an_arming_late_is_cancelled_again.__name__,
        "spot": test_saf_021_a_spot_refuses_late_requests_after_its_estop_was_asserted.__name__,
        "kinova": "tests/drivers/kinova/test_stop.py::"
        "test_saf_021_speeds_that_wait_on_the_wires_connection_are_not_overtaken_by_a_confirmed_stop",
    }.items()
}
"""Wire to the test that was written for it alone."""

_SERIAL = "A serial line keeps its bytes in order, so no stop overtakes a request."

NOTHING_LATE: Mapping[str, str] = {
    "feetech": _SERIAL,
    "dynamixel": _SERIAL,
    "stretch": _SERIAL,
    "can_motors": "Frames to a motor keep their order on bus and adapter, so no stop overtakes a request.",
    "franka": "A motion ends with the connection on which it began, and arming sends nothing.",
    "kuka": "The controller asks, and only an answer to its newest message moves the arm.",
    "yahboom": "Nothing is energised, and the firmware ends each twist by itself.",
    "earthrover": "Nothing is energised. A stop is confirmed only by later reports of a rover that stands.",
    "unitree_g1": "Arming sends nothing, and this robot has no service at this level.",
}
"""Wires without a test here, and why no request of theirs can take effect after a confirmed stop."""
