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
        # The figure ``late`` is the 99th percentile. For strands-robots, the allowed difference of 1 ms is added.
        Goal("feetech_late_us", "strands-robots", at_most=1.0),
        Goal("ur_late_us", "strands-robots", at_most=1.0),
    ),
    limit="""Two thirds of the median are wake-ups: of the wire process (the only one that writes to the robot), on
a UR of the thread that waits for ur-rtde, and of the simulated robot. The caller's own loop was a third wake-up of
0.2 to 0.4 ms. Setpoints no longer pass through it.

On Feetech's half-duplex bus, the p99 comes from a busy bus. A setpoint waits for the end of a reading (1.5 ms, 30
per second). This was so for eight of the ten slowest of 400 setpoints. strands-robots neither reads nor repeats
anything in this comparison. On a UR the p99 comes from the wake-up of a process and of a thread. Three of the 18
slowest of 1800 setpoints waited for the repeated setpoint before them, and a third of the repetitions changed
nothing.

`a process with the SDK` shows the cost of any process that commands the robot and outlives the script, without
leases, deadlines and checks of commands. On Feetech's bus its p99 is like ours, or far larger. On a UR its p99 was
0.44 to 1.15 of the goal's limit in twelve rounds. Ours was 0.64 to 1.29, with leases, deadlines and checks. The
benefit: when the caller is killed, frozen or busy, the robot still gets a stop command. `late` is the p99. For
strands-robots it is the p99 plus the millisecond that the goal allows.""",
    ground="a process with the SDK",
    rounds=4,
)
