"""Ping a servo and move it by 300 counts, at a speed: ``st3215_move.py PORT``."""

import sys

from st3215 import ST3215

servo = ST3215(sys.argv[1])
assert servo.PingServo(1)
assert servo.MoveTo(1, 2348, speed=1000, wait=True)
print(servo.ReadPosition(1))
