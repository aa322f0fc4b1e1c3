"""Test the root's stop of a robot that stands by its own controller, in virtual time.

Such a robot shows torque and ignores our commands. The robot's answer names the controller that holds it.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.unitree import link as unitree_link
from strands_actors.drivers.unitree.driver import G1Driver, Go2Driver
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.stop_channel import UnitreeStopChannel
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions
from strands_actors.drivers.unitree.twin.onboard import Onboard
from strands_actors.kernel.clock import VirtualClock
from strands_actors.testing import run_virtual
from tests.hostile.dds_network import ROBOT, Network
from tests.hostile.peer import HostilePeer, Steps

DRIVERS = {"unitree_go2": Go2Driver, "unitree_g1": G1Driver}
HELD = "held by the robot's own controller, "


def stand(onboard: Onboard) -> None:
    """Let the robot stand by its own controller, in a state in which it ignores our commands."""
    if onboard.fsm_id is None:
        onboard.set_mode("normal")
    else:
        onboard.set_fsm(4)


def release(onboard: Onboard) -> None:
    """Let the robot obey our commands, of which it has received none."""
    if onboard.fsm_id is None:
        onboard.set_mode("")
    else:
        onboard.set_fsm(500)


@pytest.mark.parametrize(("robot", "holder"), [("unitree_go2", "sport mode 'normal'"), ("unitree_g1", "FSM 4")])
def test_saf_005_the_root_confirms_a_robot_that_its_own_controller_holds(robot: str, holder: str) -> None:
    async def test() -> None:
        await trio.sleep(1.0)  # at the time 0 the code would count everything as just tried
        network = Network(HostilePeer(Steps()))
        server = UnitreeServer(model_of(robot), WireLog(None), UnitreeTwinOptions(host=ROBOT))
        driver = DRIVERS[robot](robot, f"{ROBOT}:7410", {})
        async with network.serving(server, unitree_link), trio.open_nursery() as nursery:
            stand(server.onboard)
            channel = UnitreeStopChannel(driver.config, (), VirtualClock())
            await nursery.start(channel.serve)
            motors = await channel.make_safe(SafeState.ZERO_TORQUE)
            assert all(motor.safe for motor in motors), motors
            assert HELD + holder in {motor.detail for motor in motors}
            release(server.onboard)
            motors = await channel.make_safe(SafeState.ZERO_TORQUE)
            assert all(motor.safe and not motor.detail for motor in motors), "an old answer must not count"
            nursery.cancel_scope.cancel()

    run_virtual(test)
