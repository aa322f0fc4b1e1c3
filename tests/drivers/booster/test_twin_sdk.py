"""Test that the vendor's unmodified SDK 1.6.3 accepts the twin as a T1."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.protocol import CommandType
from strands_actors.drivers.booster.rpc import Api
from strands_actors.testing import WireLog
from tests.drivers.common.twin_process import TwinProcess

DOMAIN = 100 + os.getpid() % 50
"""Two runs of these tests on one machine use different domains."""
PATIENCE_S = 150.0
"""The SDK's constructor alone takes seconds, and a call that fails takes one to five."""


def test_the_sdk_drives_the_twin_and_a_timed_out_call_is_carried_out_late(tmp_path: Path) -> None:
    options = {"domain": DOMAIN, "multicast": True, "host": "127.0.0.1"}
    with TwinProcess(tmp_path, "booster_t1", "booster", options=options) as twin:
        done = subprocess.run(
            [sys.executable, str(Path(__file__).parent / "sdk_client.py"), str(DOMAIN), str(twin.process.pid)],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=True,
        )
        said: dict[str, Any] = {}
        calls: dict[str, dict[str, Any]] = {}
        for line in done.stdout.splitlines():
            if line.startswith('{"'):  # its library writes to standard output, too
                reported = json.loads(line)
                calls.update({reported["call"]: reported} if "call" in reported else {})
                said.update(reported)
        log = WireLog(twin.log_path)
        requests = [
            rpc.decode_request(entry.data) for entry in log.entries() if _is_request(entry.sender, entry.data)
        ]
        commands = [
            p.decode_command(entry.data) for entry in log.host("setpoint") if not _is_request("host", entry.data)
        ]

    assert said["done"] and said["served"]
    assert said["states"] >= 50 and len(said["first"]) == 23 + 3
    assert said["first"][3] == pytest.approx(-1.4, abs=0.05), "the left arm hangs down"
    assert said["fall"] == [0, False]
    assert said["battery"] == [50.0, -2.0, 80.0, 50.0]
    assert said["odometer"] == [0.0, 0.0, 0.0]
    assert said["mode"] == 2 and said["name"] == "T1 twin"
    assert said["head"] == pytest.approx([0.0625, 0.0, 0.305], abs=0.01)
    assert said["devices"] == [0, 1, 2], "sensors, hands, robot model"
    assert said["reset"] == pytest.approx([1.0, 2.0, 0.5])
    assert said["elbow"] == pytest.approx(0.49, abs=0.05), "the SDK's commands move the arm"

    stopped = calls.pop("Move to a stopped robot")
    assert "code = 100" in stopped["failed"] and stopped["took_s"] >= 0.9
    assert [call["call"] for call in calls.values() if call["failed"]] == []
    moves = [json.loads(request.body)["vx"] for request in requests if request.api == Api.MOVE]
    assert moves == pytest.approx([0.3, 0.2, 0.0, 0.4]), "the call that timed out was carried out, too"
    answered = [request.wants_answer for request in requests if request.api == Api.MOVE]
    assert answered == [True, False, True, True], "MoveCommand needs no response"

    assert len(commands) == 50
    assert {(command.command_type, len(command.motors)) for command in commands} == {(CommandType.PARALLEL, 23)}
    assert commands[-1].motors[4].kp == 60.0


def _is_request(sender: str, data: bytes) -> bool:
    return sender == "host" and b"api_id" in data
