"""How long does it take from ``send_action`` to the first byte that leaves for the robot, compared with an SDK
call in the script's own thread?
"""

from __future__ import annotations

from .house import Goal, Question
from .stage import side_with_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}

QUESTION = Question(
    name="setpoint",
    title="From `send_action` to the first byte on the wire",
    sides={
        "ours": side_with_twins(ROBOTS, "setpoint", "ours"),
        "strands-robots": side_with_twins(ROBOTS, "setpoint", "strands", peer="strands"),
        "raw SDK": side_with_twins(ROBOTS, "setpoint", "sdk"),
        "a process with the SDK": side_with_twins(ROBOTS, "setpoint", "process"),
    },
    goals=(
        # The figure ``late`` is the 99th percentile. That of strands-robots has 1 ms added, since this package may
        # be later by so much.
        Goal("feetech_late_us", "strands-robots", at_most=1.0),
        Goal("ur_late_us", "strands-robots", at_most=1.0),
    ),
    notice="""Nothing at 50 commands in a second: a command leaves for the robot about 1 ms later than with a
bare SDK. A control loop of 500 Hz or more in the script itself would notice, so the wire process repeats and
checks commands at that rate instead.""",
    limit="""Two thirds of the median time of a setpoint are wake-ups: of the wire process (the only one that
writes to the robot), on a UR of the thread that waits for ur-rtde, and of the simulated robot. In an earlier
version, setpoints also passed through the caller's own loop, which needed another wake-up of 0.2 to 0.4 ms.

On Feetech's half-duplex bus, the p99 comes from a busy bus. A setpoint waits until a reading of the servos has
ended (1.5 ms, 30 readings per second). Eight of the ten slowest of 400 setpoints waited for a reading. In this
comparison strands-robots reads nothing and repeats no setpoint. On a UR the p99 comes from the wake-up of a
process and of a thread. On a UR, three of the 18 slowest of 1800 setpoints waited for the repeated setpoint before
them, but when setpoints were repeated only a third as often, the p99 did not change.

`a process with the SDK` shows the cost of any process that commands the robot and outlives the script, without
leases, deadlines and checks of commands. On Feetech's bus the p99 of `a process with the SDK` is like ours, or far
larger. On a UR the p99 of `a process with the SDK` was 0.44 to 1.15 of the goal's limit in twelve rounds, and the
p99 of this package, with leases, deadlines and checks, was 0.64 to 1.29. The benefit of our wire process is that
the robot still gets a stop command when the caller is killed, frozen or busy. The figure `late` is the p99, and
for strands-robots the p99 plus the millisecond that the goal allows.""",
    ground="a process with the SDK",
    rounds=4,
)
