"""Move a servo to 0.46 rad: ``rustypot_move.py PORT``."""

import sys
import time

from rustypot import Sts3215PyController

arm = Sts3215PyController(serial_port=sys.argv[1], baudrate=1_000_000, timeout=0.5)
print(arm.sync_read_present_position([1]))
arm.sync_write_torque_enable([1], [True])
arm.sync_write_goal_position([1], [0.46])
time.sleep(1.5)
print(arm.sync_read_present_position([1]))
