"""Test Unitree's own simulator: its messages, how it differs from a robot, and the refusals that follow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.driver import G1Driver
from strands_actors.drivers.unitree.link import Link
from strands_actors.drivers.unitree.protocol import CommandCodec
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import WireLog
from tests.answers import until
from tests.drivers.common.twin_process import TwinProcess
from tests.drivers.packages import UNITREE, running_with

SIMULATOR = {"simulator": True, "domain": 1}


def refusal_of(port: str, **options: object) -> str:
    """Return why the wire does not open."""
    wire = G1Driver("unitree_g1", port, options).open_wire(MonotonicClock())
    try:
        with pytest.raises(WireDown) as down:
            trio.run(wire.open)
    finally:
        wire.close()
    return str(down.value)


def test_discarded_messages_are_named(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "unitree_g1", "unitree", options=SIMULATOR) as served:
        why = refusal_of(served.port, domain=1)
    assert "LowStates have arrived, all with a wrong checksum. For Unitree's own simulator" in why
    assert "simulator=True" in why


def test_a_simulator_is_commanded_once_it_is_called_one(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "unitree_g1", "unitree", options=SIMULATOR) as served:
        log = WireLog(served.log_path)
        with Robot("unitree_g1", mode="real", port=served.port, simulator=True) as robot:
            elbow = robot.get_observation()["left_elbow"]
            answer = robot.send_action({"left_elbow": {"q": elbow, "kp": 40.0}})
            assert answer["status"] == "success", answer
            until(lambda: log.host("setpoint"), "the simulator is commanded")
            assert robot.stop()["status"] == "success"  # type: ignore[index]
        assert log.host("safe")
        assert not log.host("other")


STRANGER = """
import json, sys, threading
from unitree_sdk2py.core.channel import ChannelFactoryInitialize, ChannelPublisher, ChannelSubscriber
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowState_
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_

ChannelFactoryInitialize(1, "lo")
state = unitree_hg_msg_dds__LowState_()  # no checksum, no mode_machine
told = [""]

def report(command):
    motors = command.motor_cmd[:29]
    said = "limp" if all(not (each.kp or each.kd or each.tau) for each in motors) else "held"
    if said != told[0]:
        told[0] = said
        print(said, flush=True)

states = ChannelPublisher("rt/lowstate", LowState_)
states.Init()
commands = ChannelSubscriber("rt/lowcmd", LowCmd_)
commands.Init(report, 10)
for _ in range(20_000):  # 100 s: then a test that waits for its output ends, too
    states.Write(state)
    threading.Event().wait(0.005)
"""
"""The relevant part of unitree_mujoco, with Unitree's own SDK in its configuration. On the loopback interface
it is found by multicast only, at ports that are not known before."""


@pytest.mark.long
def test_unitrees_own_simulator_is_found_on_this_host() -> None:
    with running_with(UNITREE, STRANGER) as simulator:
        assert simulator.stdout is not None
        robot = Robot("unitree_g1", mode="real", port="127.0.0.1", simulator=True)
        try:
            until(lambda: robot.connect_eagerly() is None, "it is found")
            answer = robot.send_action({"left_elbow": {"q": 0.0, "kp": 40.0}})
            assert answer["status"] == "success", answer
            assert "held\n" in iter(simulator.stdout.readline, "")
            assert robot.stop()["status"] == "success"  # type: ignore[index]
            assert next(iter(simulator.stdout.readline, "")) == "limp\n"
        finally:
            robot.cleanup()


def test_saf_014_a_robot_that_is_called_a_simulator_is_not_commanded(tmp_path: Path) -> None:
    """Without mode, FSM and battery the driver would check nothing before the robot moves."""
    with TwinProcess(tmp_path, "unitree_g1", "unitree", options={"domain": 1}) as served:
        assert "this is a real robot" in refusal_of(served.port, simulator=True)
        assert not [line for line in served.logged("host") if line[0] in ("setpoint", "safe")]


def test_saf_014_robots_have_their_domain_to_themselves() -> None:
    with pytest.raises(ValueError, match="domain 0 is reserved for real robots"):
        G1Driver("unitree_g1", "127.0.0.1", {"simulator": True, "domain": 0})
    assert G1Driver("unitree_g1", "127.0.0.1", {"simulator": True}).config.domain == 1
    assert G1Driver("unitree_g1", "127.0.0.1", {}).config.domain == 0


def test_a_twin_takes_no_command_for_another_machine(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "unitree_g1", "unitree") as served:
        model = model_of("unitree_g1")
        link = Link(UnitreeConfig(model, served.port), MonotonicClock())

        def polled(done: Callable[[], bool]) -> Callable[[], bool]:
            def look() -> bool:
                link.poll()
                return done()

            return look

        try:
            until(polled(lambda: link.matched), "they find each other")
            link.send(link.encode((0.0,) * 145))  # no state was received: mode_machine is 0
            until(polled(lambda: "other" in [kind for kind, _ in served.logged("host")]), "it is heard")
        finally:
            link.close()
        (frame,) = [frame for kind, frame in served.logged("host") if kind == "other"]
        assert CommandCodec(model).decode(bytes.fromhex(frame)).machine == 0
        assert "setpoint" not in [kind for kind, _ in served.logged("host")]
