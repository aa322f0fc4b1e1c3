"""How long does it take from ``send_action`` to the first byte on the wire, compared with a call in the
caller's own thread?"""

from __future__ import annotations

from .house import Goal, Question
from .stage import at_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}

QUESTION = Question(
    name="setpoint",
    title="From `send_action` to the first byte on the wire",
    sides={
        "ours": at_twins(ROBOTS, "setpoint", "ours"),
        "strands-robots": at_twins(ROBOTS, "setpoint", "strands", peer="strands"),
        "raw SDK": at_twins(ROBOTS, "setpoint", "sdk"),
        "a process with the SDK": at_twins(ROBOTS, "setpoint", "process"),
    },
    goals=(
        # ``late`` is the p99. For the reference, it is its p99 plus 1 ms, the allowed difference.
        Goal("feetech_late_us", "strands-robots", at_most=1.0),
        Goal("ur_late_us", "strands-robots", at_most=1.0),
    ),
    limit="""Two thirds of the median are waking up: the wire process, on a UR the thread that may wait for
ur-rtde, the twin. The caller's own loop, which was a third wake-up and 0.2 to 0.4 ms of it, is no longer on the
way. The p99 on Feetech's half-duplex bus is a line in use: a setpoint waits for the end of a reading (1.5 ms,
30 a second; so it was in eight of the ten slowest of 400), while the reference in this comparison neither reads
nor repeats anything. On a UR it is waking up again, of a process and of a thread that slept; three of the 18
slowest of 1800 stood behind the repeated setpoint before them, and to repeat it a third as often changed
nothing. `a process with the SDK` is what anybody pays whose robot is read, or fed, by a process that outlives
the script, without gates, leases and deadlines: on Feetech's bus its p99 is ours, or far behind it; on a UR it
took 0.44 to 1.15 of what the goal allows in twelve rounds, and ours 0.64 to 1.29, with all that it has not.
What that buys: the caller can be killed, frozen or computing, and the wire still shows the safe state. `late`
is the p99; beside us it is that of the reference plus the millisecond that the goal allows.""",
    ground="a process with the SDK",
    rounds=4,
)
