"""Test the vendor's newer, unmodified ftservo-python-sdk against the twin: wheel mode, and moves with a speed.
The older SDK has no calls for these."""

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

def sure(ask, *values):
    # it waits 34 ms for an answer, which a busy machine may need: then once more, on a quiet line
    for _ in range(20):
        *answer, result, error = ask(1, *values)
        if result != -6:
            assert (result, error) == (0, 0), (result, error)
            return answer[0] if answer else None
        time.sleep(0.1)
        port.ser.reset_input_buffer()
    raise AssertionError("no answer")

def read(ask):
    return sure(ask)

def until(look):
    deadline = time.monotonic() + 20
    while not look():
        assert time.monotonic() < deadline, "patience is over"

model = sure(bus.ping)
start = read(bus.ReadPos)
sure(bus.WritePosEx, start + 300, 200, 0)
began = time.monotonic()
until(lambda: abs(read(bus.ReadPos) - start - 300) < 30)
took = time.monotonic() - began
sure(bus.RegWritePosEx, start, 0, 0)
bus.RegAction()
until(lambda: abs(read(bus.ReadPos) - start) < 30)
assert bus.SyncWritePosEx(1, start + 200, 0, 0) is True
assert bus.groupSyncWrite.txPacket() == 0
until(lambda: abs(read(bus.ReadPos) - start - 200) < 30)
sure(bus.unLockEprom)
sure(bus.WheelMode)
sure(bus.WriteSpec, -300, 0)
until(lambda: read(bus.ReadPos) < start)
speed = read(bus.ReadSpeed)
sure(bus.WriteSpec, 0, 0)
until(lambda: read(bus.ReadMoving) == 0)
sure(bus.write1ByteTxRx, 33, 0)
sure(bus.LockEprom)
limits = [sure(bus.read1ByteTxRx, at) for at in (14, 19, 30)]
print(json.dumps({"model": model, "took": took, "speed": speed, "limits": limits}))
"""


@pytest.fixture
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("so101", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.mark.long
def test_the_vendors_newer_client_moves_turns_and_reads(twin: Twin) -> None:
    reported = json.loads(run_with(FTSERVO, PROGRAM, twin.port).splitlines()[-1])
    assert reported["model"] == 777
    assert reported["took"] > 1.0, "300 counts at 200 a second"
    assert -450 < reported["speed"] < -150
    assert reported["limits"] == [80, 44, 1]
