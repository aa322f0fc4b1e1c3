"""ftservo-python-sdk: move a servo with a speed, and then in wheel mode."""

import sys
import time

from scservo_sdk import PortHandler, sms_sts

SERVO, BY, NEAR = 1, 300, 30

port = PortHandler(sys.argv[1])
assert port.openPort() and port.setBaudRate(1_000_000)
bus = sms_sts(port)


def position() -> int:
    value, result, error = bus.ReadPos(SERVO)
    assert (result, error) == (0, 0), (result, error)
    return int(value)


start = position()
assert bus.WritePosEx(SERVO, start + BY, 800, 50) == (0, 0)
deadline = time.monotonic() + 20
while abs(position() - start - BY) > NEAR:
    assert time.monotonic() < deadline, f"at {position()}, sent to {start + BY}"
print("there:", position())
