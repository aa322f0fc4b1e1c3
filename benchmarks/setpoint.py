"""From ``send_action`` to the first byte on the wire, beside the reference's call in the caller's own thread."""

from __future__ import annotations

from benchmarks.house import Goal, Question
from benchmarks.stage import at_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}

QUESTION = Question(
    name="setpoint",
    title="From `send_action` to the first byte on the wire",
    sides={
        "ours": at_twins(ROBOTS, "setpoint", "ours"),
        "strands-robots": at_twins(ROBOTS, "setpoint", "strands", peer="strands"),
        "raw SDK": at_twins(ROBOTS, "setpoint", "sdk"),
    },
    goals=(
        # late: the p99; beside us that of the reference and the millisecond that we may be behind it
        Goal("feetech_late_us", "strands-robots", at_most=1.0),
        Goal("ur_late_us", "strands-robots", at_most=1.0),
    ),
    limit="""Ours crosses two process boundaries to the wire process, the reference none: the caller's loop, a zenoh
put (0.12 ms alone on this machine), gate and transport; on a UR also a worker thread for ur-rtde, whose calls may
hang. What that buys: the caller can be killed, frozen or computing, and the wire still shows the safe state.
`late` is the p99; beside us it is that of the reference plus the millisecond that the goal allows.""",
)
