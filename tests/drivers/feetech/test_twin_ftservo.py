"""ftservo-python-sdk, the vendor's newer one, as it is, against the twin: wheel mode and moves with
a speed, which the older one has no calls for."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from strands_actors.testing import Twin
from tests.drivers.packages import FTSERVO, run_with

PROGRAM = """
import json, sys, time
from scservo_sdk import PortHandler, sms_sts

port = PortHandler(sys.argv[1])
assert port.openPort() and port.setBaudRate(1_000_000)
bus = sms_sts(port)

def read(ask):
    value, *rest = ask(1)
    assert not any(rest), rest
    return value

def until(look):
    deadline = time.monotonic() + 20
    while not look():
        assert time.monotonic() < deadline, "patience is over"

model, *rest = bus.ping(1)
assert not any(rest)
start = read(bus.ReadPos)
assert bus.WritePosEx(1, start + 300, 200, 0) == (0, 0)
began = time.monotonic()
until(lambda: abs(read(bus.ReadPos) - start - 300) < 30)
took = time.monotonic() - began
assert bus.RegWritePosEx(1, start, 0, 0) == (0, 0)
bus.RegAction()
until(lambda: abs(read(bus.ReadPos) - start) < 30)
assert bus.SyncWritePosEx(1, start + 200, 0, 0) is True
assert bus.groupSyncWrite.txPacket() == 0
until(lambda: abs(read(bus.ReadPos) - start - 200) < 30)
bus.unLockEprom(1)
assert bus.WheelMode(1) == (0, 0)
bus.WriteSpec(1, -300, 0)
until(lambda: read(bus.ReadPos) < start)
speed = read(bus.ReadSpeed)
bus.WriteSpec(1, 0, 0)
until(lambda: read(bus.ReadMoving) == 0)
bus.write1ByteTxRx(1, 33, 0)
bus.LockEprom(1)
limits = [bus.read1ByteTxRx(1, at)[0] for at in (14, 19, 30)]
print(json.dumps({"model": model, "took": took, "speed": speed, "limits": limits}))
"""


@pytest.fixture
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("so101", tmp_path_factory.mktemp("twin")) as process:
        yield process


def test_the_vendors_newer_client_moves_turns_and_reads(twin: Twin) -> None:
    told = json.loads(run_with(FTSERVO, PROGRAM, twin.port).splitlines()[-1])
    assert told["model"] == 777
    assert told["took"] > 1.0, "300 counts at 200 a second"
    assert -450 < told["speed"] < -150
    assert told["limits"] == [80, 44, 1]
