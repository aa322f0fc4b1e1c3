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
    limit="""Two thirds of the median are wake-ups: of the wire process, on a UR of the thread that may wait for
ur-rtde, and of the twin. The caller's own loop was a third wake-up and 0.2 to 0.4 ms; it is no longer on the
path.

The p99 on Feetech's half-duplex bus comes from a busy line. A setpoint waits for the end of a reading (1.5 ms, 30
a second), as in eight of the ten slowest of 400; the reference in this comparison neither reads nor repeats
anything. On a UR the p99 comes from waking up again, of a process and of a thread that slept. Three of the 18
slowest of 1800 waited for the repeated setpoint before them, and a third of the repetitions changed nothing.

`a process with the SDK` is the cost of any robot that is read, or fed, by a process that outlives the script,
without gates, leases and deadlines. On Feetech's bus its p99 is like ours, or far behind it. On a UR its p99 was
0.44 to 1.15 of the goal's limit in twelve rounds. Ours was 0.64 to 1.29, with gates, leases and deadlines. The
benefit: the caller can be killed, frozen or computing, and the wire still shows the safe state. `late` is the
p99; for the reference it is its p99 plus the millisecond that the goal allows.""",
    ground="a process with the SDK",
    rounds=4,
)
