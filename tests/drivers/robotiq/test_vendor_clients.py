"""Test third-party clients, unmodified, on the twin: pyRobotiqGripper on a serial port and on RTU frames over
TCP, pyrobotiqur on the text port of the URCap."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from strands_actors.testing import WireLog
from tests.drivers.common.pip_target import installed, run_with
from tests.drivers.common.twin_process import TwinProcess

CLIENTS = ("pyrobotiqgripper==3.3.14", "pyrobotiqur==0.2.2")
WITHIN_S = 120.0

MODBUS = """
import contextlib, json, sys
from pyrobotiqgripper import RobotiqGripper
with contextlib.redirect_stdout(sys.stderr):
    gripper = RobotiqGripper(**json.loads(sys.argv[1]))
    gripper.connect()
    gripper.activate()
    activated = gripper.isActivated()
    gripper.move(128, start=True)
    there = gripper.position()
    gripper.open(speed=0, wait=False)
    gripper.stop()
    stopped = gripper.position()
    again = gripper.position()
    gripper.disconnect()
print(json.dumps([bool(activated), there, stopped, again]))
"""

URCAP = """
import json, sys
from pyrobotiqur import RobotiqGripper
with RobotiqGripper(sys.argv[1]) as gripper:
    gripper.activate(poll_interval=0.02)
    position, met = gripper.move(128, speed=255)
    closed, _ = gripper.close(speed=255)
    gripper.set_var("GTO", 0)
    print(json.dumps([gripper.get_fault(), position, int(met), closed]))
"""


@pytest.fixture(scope="module")
def clients() -> Path:
    return installed("robotiq", CLIENTS)


def kinds_of(twin: TwinProcess) -> list[str]:
    return [kind for kind, _ in twin.logged("host")]


@pytest.mark.parametrize("framing", ["serial", "rtu"])
def test_py_robotiq_gripper_moves_it(tmp_path: Path, clients: Path, framing: str) -> None:
    options: dict[str, Any] = {"activation_s": 0.2}
    options |= {"serial": True} if framing == "serial" else {"framing": "rtu"}
    with TwinProcess(tmp_path, "robotiq_2f85", "robotiq", options=options) as twin:
        arguments: Mapping[str, Any] = {"com_port": twin.port}
        if framing == "rtu":
            host, port = twin.port.split(":")
            arguments = {"connection_type": "RTU_VIA_TCP", "tcp_host": host, "tcp_port": int(port)}
        said = run_with(clients, MODBUS, json.dumps(arguments), within_s=WITHIN_S)
        activated, there, stopped, again = json.loads(said)
        assert activated
        assert there == pytest.approx(128, abs=2)
        assert stopped == again
        functions = {bytes.fromhex(frame)[1] for _, frame in twin.logged("host")}
        assert 23 in functions  # writes and reads in one request
        assert {"setpoint", "safe", "read"} <= set(kinds_of(twin))
        assert WireLog(twin.log_path).host("safe")


ON_A_WRIST = ("ur5e", "ur", {"gripper": "robotiq_2f85"})


@pytest.mark.parametrize(
    ("robot", "wire", "options"), [("robotiq_2f85", "robotiq", {"activation_s": 0.2}), ON_A_WRIST]
)
def test_a_client_of_the_urcap_moves_it(
    tmp_path: Path, clients: Path, robot: str, wire: str, options: Mapping[str, Any]
) -> None:
    with TwinProcess(tmp_path, robot, wire, options=options) as twin:
        fault, position, met, closed = json.loads(
            run_with(clients, URCAP, twin.port.split(":")[0], within_s=WITHIN_S)
        )
        assert (fault, met) == (0, 3)
        assert position == pytest.approx(128, abs=2)
        assert closed > 220
        assert {"enable", "setpoint", "safe", "read"} <= set(kinds_of(twin))
